"""Common ground: the validated config, the samples, and the hash of the science that jobs use."""

import atexit
import copy
import fcntl
import hashlib
import inspect
import os
import platform
import shutil
import sys
import threading
from contextlib import suppress
from functools import cache
from pathlib import Path

from snakemake import benchmark
from snakemake.exceptions import WorkflowError
from snakemake.scheduling.job_scheduler import JobScheduler

HOUSE = Path(str(workflow.current_basedir)).parents[1]
if not HOUSE.is_dir():
    raise WorkflowError(
        f"module: {HOUSE} is no folder here; give the path of a checkout, grainfall/Snakefile"
    )
sys.path.insert(0, str(HOUSE / "src"))

from grainfall import config as sheet
from grainfall import io, presets, provenance
from grainfall.cli import needs
from grainfall.errors import InputError
from grainfall.export import FORMATS
from grainfall.lifeline import end_with
from grainfall.report.texts import TEXTS
from grainfall.section import published_file

import grimp


def sole_run():
    """Clear the locks of a killed run.

    Snakemake's lock outlives a kill; a lock on an open file does not. Every run holds a share in one, and who is alone
    when it starts leaves its machine's name there until it ends. Who can have it whole is alone on this machine: a name
    that is there is that of a killed run, and if that was here, whatever locks there are belong to nobody. Jobs on a
    cluster outlive the run that sent them, which leaves no name: it has to be unlocked by hand.
    """
    folder = Path(".snakemake")
    try:
        folder.mkdir(exist_ok=True)
        handle = (folder / "grainfall.lock").open("a+")
    except OSError:
        return None
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        handle.seek(0)
        if handle.read() == platform.node():
            shutil.rmtree(folder / "locks", ignore_errors=True)
        handle.truncate(0)
        if workflow.local_exec:
            handle.write(platform.node())
            handle.flush()
            atexit.register(forget, handle)
    except OSError:
        pass  # another run is at work, or this file system knows no such locks
    try:
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        pass
    return handle


def forget(handle):
    """Take back the name of a run that ends by itself."""
    with suppress(OSError):
        handle.truncate(0)


# Snakemake looks at a job twice a second for its first 15 s, then every 30 s, and what a job uses after the last
# look is in no table: up to half a minute of it. A look a second is cheap.
timing = inspect.unwrap(benchmark.benchmarked)
if [*inspect.signature(timing).parameters] == ["pid", "benchmark_record", "interval"]:
    timing.__defaults__ = (None, None, 1)


def look_again(scheduler, delay):
    """Have the scheduler look for jobs after so many seconds, unless it is going to look anyway.

    With Snakemake's own, every look asks for one more, and so does every job that ends: they add up to one a second for
    each job that has ended, after 400 jobs a third of a core, and the last of them keep a finished run waiting.
    """

    def look():
        scheduler.look_due = None  # before the look, which may ask for the next one
        scheduler._open_jobs.release()

    if getattr(scheduler, "look_due", None) is None:
        scheduler.look_due = threading.Timer(delay, look)
        scheduler.look_due.daemon = True
        scheduler.look_due.start()


if hasattr(JobScheduler, "_schedule_reevalutation"):
    JobScheduler._schedule_reevalutation = look_again

if workflow.is_main_process:
    RUNNING = sole_run()
    # Nobody would read what a run says whose grainfall was killed: it would wait for ever.
    if cli := os.environ.get("GRAINFALL_CLI"):
        end_with(int(cli))
os.environ.update(GRAINFALL_SNAKEMAKE=str(os.getpid()))  # jobs end when it does

# Another Snakefile may have this one as a module: the config is what that one hands over, in no file of its own, and
# rules are called as that one says, `use rule * from grainfall as rock_*`.
AS_MODULE = not workflow.modifier.is_main_snakefile()
# Relative, or results that are moved would be out of date.
CONFIG_FILES = [] if AS_MODULE else list(map(os.path.relpath, workflow.configfiles))
OVERRIDES = copy.deepcopy(
    config if AS_MODULE else dict(workflow.config_settings.config or {})
)
if AS_MODULE and not config:
    raise WorkflowError(
        "module: grainfall has no config; hand it over, config: config[...]"
    )
CALLED_BEFORE, named, CALLED_AFTER = workflow.modifier.modify_rulename("*").partition(
    "*"
)
if not named:
    raise WorkflowError(
        f"module: {CALLED_BEFORE} does not tell which of grainfall's rules it is, so what it needs is not known; "
        "name it with *, use rule twin from grainfall as rock_* with"
    )
if workflow.modifier.path_modifier.replace_prefix("results/") != "results/":
    raise WorkflowError(
        "module: a prefix would move what grainfall writes from where it reads it; leave it out"
    )


def own_name(rulename):
    """What a rule is called here."""
    return rulename.removeprefix(CALLED_BEFORE).removesuffix(CALLED_AFTER)


def is_own(step):
    """Whether a rule is of this workflow, not of one that has it as a module."""
    path = Path(str(step.snakefile))
    return path == HOUSE / "Snakefile" or path.is_relative_to(HOUSE / "workflow")


# Pages, figures and records are made of all that is in a folder, more than a rule's input can name.
STORED = workflow.storage_settings.default_storage_provider is not None


CONFIG_SCHEMA = sheet.load_yaml(
    HOUSE / "workflow/schemas/config.schema.yaml", ours=True
)
SAMPLE_SCHEMA = sheet.load_yaml(
    HOUSE / "workflow/schemas/samples.schema.yaml", ours=True
)

try:
    # Snakemake lets a key that stands there twice pass.
    for path in CONFIG_FILES:
        sheet.load_yaml(path)
    CONFIG = sheet.resolve(
        config,
        CONFIG_SCHEMA,
        sheet.load_yaml(HOUSE / "config/presets.yaml", ours=True),
    )
    SAMPLES = sheet.samples_of(CONFIG, CONFIG_SCHEMA, SAMPLE_SCHEMA)
except InputError as fault:
    raise WorkflowError(str(fault))

SYNTHESES = {
    name: sheet.synthesis(CONFIG, row, CONFIG_SCHEMA, f"config: sample {name}")
    for name, row in SAMPLES.items()
    if row["kind"] == "synthetic"
}

ASKED = None
if CONFIG["accuracy"]:
    chosen = presets.choose(**CONFIG["accuracy"], table=presets.measured())
    alone = sheet.resolve(
        {"preset": chosen.preset, "samples": CONFIG["samples"]},
        CONFIG_SCHEMA,
        sheet.load_yaml(HOUSE / "config/presets.yaml", ours=True),
    )
    other = ", ".join(sheet.unmeasured(CONFIG, alone))
    beside = f"; measured without this config's {other}" if other else ""
    ASKED = {
        **CONFIG["accuracy"],
        "expected": chosen.error,
        "words": f"{chosen.words} ({presets.SOURCE}){beside}",
    }

VARIANTS = {name: sheet.variant(CONFIG, name) for name in CONFIG["variants"]}
VOID_SHAPES = any(w["effects"]["void_shapes"] != "off" for w in VARIANTS.values())
REALIZATIONS = range(CONFIG["realizations"])
SLABS = CONFIG["slabs"]
# Variants whose network comes of slabs. snow2 knows none: it takes the volume as a whole.
BY_SLABS = [
    name
    for name, whole in VARIANTS.items()
    if SLABS > 1 and whole["network"]["method"] == "persistence"
]
SLICES = [name for name, row in SAMPLES.items() if row["kind"] == "slice"]
REFERENCED = [
    name
    for name, row in SAMPLES.items()
    if row.get("reference") or name in SYNTHESES or name in SLICES
]

# What judges a synthetic truth beside its first cube.
CUBES = [f"cube_{n}" for n in range(1, CONFIG["reference_cubes"])]
TOMOGRAMS = list(SYNTHESES) if CONFIG["case"] == "xct" else []
# Volumes that are measured as a 3D reference is, by their folder: references of samples, further cubes of truths,
# what was fetched, tomograms. Slices of one volume share its measurements.
MEASURED = [
    *(name for name in REFERENCED if name not in SLICES),
    *(f"{name}/{cube}" for name in SYNTHESES for cube in CUBES),
    *(f"data/{name}" for name in CONFIG["data"]),
    *(f"{name}/tomogram" for name in TOMOGRAMS),
]

# Folders of results, from the whole to the single twin.
SAMPLE = "results/{sample}"
VARIANT = "results/{sample}/{variant}"
TWIN = "results/{sample}/{variant}/{realization}"

ENVS = {
    group: str(HOUSE / f"envs/{group}.yaml")
    for group in ("analysis", "packing", "report")
}


# Snakemake takes no benchmark on a rule whose result may come from the cache between workflows. So rules
# are cacheable only where --cache asks for it, and are then not timed (see the end of the Snakefile).
CACHING = workflow.workflow_settings.cache is not None
CACHEABLE = "omit-software" if CACHING else False
CACHED_JOBS = [
    "synthesise",
    "truth_cube",
    "further_cubes",
    "grain_library",
    "first_packing",
    "second_packing",
    "network",
]


ON_VOXELS = ["elliptic", "direct"]


def any_of(names):
    """A wildcard constraint that matches just these names, and nothing where there are none."""
    return "|".join(names) or "(?!)"


wildcard_constraints:
    sample=any_of([*SAMPLES, *MEASURED]),
    data=any_of(CONFIG["data"]),
    variant=any_of(VARIANTS),
    realization=r"\d+",
    cv=r"[0-9.]+",
    truth=r"\d+",
    method=any_of(ON_VOXELS),
    packing="first|second",
    axis="x|y|z",


scattergather:
    grainfall_slices=CONFIG["correlation"]["chunks"],
    grainfall_slabs=SLABS,


GRAPH = grimp.build_graph("grainfall", cache_dir=None)
SHARED = ("grainfall.errors", "grainfall.io", "grainfall.random", "grainfall.units")


@cache
def modules_of(chapter):
    """The modules of a chapter and all they import."""
    package = f"grainfall.{chapter}"
    return {
        package,
        *GRAPH.find_descendants(package),
        *GRAPH.find_upstream_modules(package, as_package=True),
    }


@cache
def source(module):
    """What a module's file holds."""
    stem = HOUSE / "src" / module.replace(".", "/")
    path = stem / "__init__.py" if stem.is_dir() else stem.with_suffix(".py")
    return path.read_bytes()


@cache
def science(*chapters):
    """Hash of the source of these chapters and of all they import.

    As a parameter of a rule it makes Snakemake rerun what an edit of the science touches, and nothing else.
    """
    modules = set(SHARED).union(*map(modules_of, chapters))
    digest = hashlib.sha256()
    for module in sorted(modules):
        digest.update(module.encode() + source(module))
    return digest.hexdigest()[:16]


NEEDS = needs.Needs.measured()
SNAKEMAKE_MB = 300  # on a cluster one runs beside a job's script
STOKES_MB = 600  # `elliptic` and `direct`: 1.2 kB a pore voxel, were every other voxel one; per million voxels
# What rims take beside the voxels, by million voxels: `make bench-needs` measures twins without. A twin of 1000^3 with
# rims took 10.2 GB and 604 CPU s (`make paper-scale`).
RIMS_MB, RIMS_S = 10, 1


def has_rims(rulename, wildcards):
    """Whether a job makes a twin with rims."""
    return rulename == "twin" and needs.cemented(
        expand(TWIN, **dict(wildcards.items()))[0]
    )


def share_of_slab(rulename, size):
    """Share of its volume that a slab's job holds: its planes, and what it takes of those beyond them.

    For S2 a quarter of all; for the network seven planes. Slabs that are voxelised consist of whole chunks: up to
    a layer of them more.
    """
    edge = (1e6 * size["Mvoxel"]) ** (1 / 3)
    planes = 7 if "network" in rulename else io.CHUNK
    return min(1, 1 / SLABS + (1 / 4 if "s2" in rulename else planes / edge))


def need(rulename, wildcards):
    """What a job needs by what such jobs have needed, None where that, or its size, is not known; and its size.

    A slab's job, of a rule X_slab, needs what that of rule X would for a volume of its size.
    """
    rulename, slab, _ = rulename.removesuffix("_on_voxels").partition("_slab")
    if rulename in ("truth_cube", "further_cubes"):
        rulename = "synthesise"
    if rulename == "synthesise":
        size = needs.of_shape(SYNTHESES[wildcards.sample]["shape"])
    else:
        folder, variant = Path(f"results/{wildcards.sample}"), getattr(
            wildcards, "variant", None
        )
        coarsen = VARIANTS.get(variant, CONFIG)["network"]["coarsen"]
        size = needs.size_of(rulename, folder, variant, coarsen)
    if slab and size:
        size["Mvoxel"] *= share_of_slab(rulename, size)
    return NEEDS.job(rulename, size), size


def memory(otherwise):
    """A resource function: MB to ask for, by the job's size where that is known; more where it was not enough."""

    def of(wildcards, rulename, attempt):
        rulename = own_name(rulename)
        known, size = need(rulename, wildcards)
        asked = known.mem_mb if known else otherwise
        if known and rulename.endswith("_on_voxels"):
            asked += STOKES_MB * size["Mvoxel"]
        if known and has_rims(rulename, wildcards):
            asked += RIMS_MB * size["Mvoxel"]
        beside = 0 if workflow.local_exec else SNAKEMAKE_MB
        return round(asked * attempt + beside)

    return of


def runtime(otherwise):
    """A resource function: minutes to ask for, as :func:`memory`."""

    def of(wildcards, rulename, attempt):
        rulename = own_name(rulename)
        known, size = need(rulename, wildcards)
        if known is None or rulename.endswith("_on_voxels"):
            return max(known.runtime_min if known else 0, otherwise) * attempt
        minutes = known.runtime_min
        if minutes == needs.SHORTEST_MIN:
            # over in no time: a group of such jobs would ask for the sum of what costs one of them nothing
            minutes = min(minutes, otherwise)
        if has_rims(rulename, wildcards):
            minutes += round(needs.SLOWER * RIMS_S * size["Mvoxel"] / 60)
        return minutes * attempt

    return of


def many_threads(wildcards, rulename):
    """Threads of jobs that can use several: one more for every two minutes that such jobs have needed."""
    known, _ = need(own_name(rulename), wildcards)
    return known.threads if known else 1


def of_variant(wildcards):
    """The config as the job's variant sees it; all of it where the job has none."""
    return VARIANTS.get(getattr(wildcards, "variant", None), CONFIG)


def methods_of_variant(wildcards):
    """The tiers of flow that a twin, or what it is held against, is solved by."""
    return of_variant(wildcards)["flow"]["methods"]


def the_method(wildcards):
    """The tier of flow that a job of its own solves by."""
    return [wildcards.method]


def settings(*keys):
    """A params function: these keys of the config as the rule's variant sees them.

    ``section.key`` is that key alone, so that no other of its section makes the rule run again.
    """

    def of(wildcards):
        whole, found = of_variant(wildcards), {}
        for section, _, key in (name.partition(".") for name in keys):
            if key:
                found.setdefault(section, {})[key] = whole[section][key]
            else:
                found[section] = whole[section]
        return found

    return of


def whole_settings(wildcards):
    """The whole config as the twin's variant sees it."""
    return VARIANTS[wildcards.variant]


def stream(wildcards):
    """Where a job's random numbers come from; a parameter, so that cached results are never mixed up."""
    return {
        "seed": CONFIG["seed"],
        "sample": wildcards.sample,
        "realization": int(getattr(wildcards, "realization", -1)),
    }


def row(*keys):
    """A params function: these entries of the sample's row, those that are there; no other makes the rule run again."""

    def of(wildcards):
        found = SAMPLES[wildcards.sample]
        return {key: found[key] for key in keys if key in found}

    return of


def phases_of(wildcards):
    """Names of the sample's phases, and their values in the image, as its row gives them."""
    return sheet.parse_phases(SAMPLES[wildcards.sample].get("phases"))


def whole_row(wildcards):
    """The sample's row of the sheet."""
    return SAMPLES[wildcards.sample]


def synthesis_but(without):
    """A params function: the synthetic rock of a sample, less the key that the rule does not use."""

    def of(wildcards):
        rock = SYNTHESES[wildcards.sample]
        return {key: value for key, value in rock.items() if key != without}

    return of


def users_file(key):
    """An input function: the file that the sample's row names, if it names one.

    Mark it ancient, with :func:`checksums` as a parameter: content decides, not a date, which a copy or a wrong
    clock gets wrong.
    """

    def of(wildcards):
        # the user's own files are here, also where results are elsewhere
        path = SAMPLES[wildcards.sample].get(key)
        return local(path) if path else []

    return of


@cache
def checksum(path):
    try:
        return provenance.checksum(path)
    except InputError as fault:
        raise WorkflowError(str(fault))


def checksums(*keys):
    """A params function: SHA-256 of the files that the sample's row names."""

    def of(wildcards):
        row = SAMPLES[wildcards.sample]
        return {key: checksum(row[key]) for key in keys if row.get(key)}

    return of


def twins(path, **wildcards):
    """``path`` below every twin's folder, or below those that ``wildcards`` picks."""
    chosen = {
        "sample": list(SAMPLES),
        "variant": list(VARIANTS),
        "realization": list(REALIZATIONS),
        **wildcards,
    }
    return expand(f"{TWIN}/{path}", **chosen)


KEPT_OF_SAMPLE = (
    "section.zarr.zip",
    "section.json",
    "labels.zarr.zip",
    "grains2d.csv",
    "pores2d.csv",
    "sizes.csv",
    "grains3d",
)
KEPT_OF_VARIANT = ("scene.json", "s2_envelope.csv", "s2_envelope.json")
KEPT_OF_TWIN = (
    "first/packing.json",
    "virtual_spheres.csv",
    "deficit.json",
    "second/packing.json",
    "correction.json",
    "cement.json",
    "twin.zarr.zip",
    "bodies.csv",
    "grains2d.csv",
    "pores2d.csv",
    "contacts.csv",
    "s2_slices.csv",
    "s2_volume.csv",
    "network_pores.csv",
    "network_throats.csv",
    "flow.csv",
    "metrics.csv",
    "plan.json",
)


def kept(**chosen):
    """What tables and pages come of, of all twins or of those chosen: named, a file that was deleted, or that a run
    refused as damaged, is made again."""
    which = {
        "sample": list(SAMPLES),
        "variant": list(VARIANTS),
        "realization": list(REALIZATIONS),
        **chosen,
    }
    paths = [
        *(f"{SAMPLE}/{name}" for name in KEPT_OF_SAMPLE),
        *(f"{VARIANT}/{name}" for name in KEPT_OF_VARIANT),
        *(f"{TWIN}/{name}" for name in KEPT_OF_TWIN),
    ]
    return list(dict.fromkeys(expand(paths, **which)))


def shown(wildcards):
    """What a figure shows of its twin, or a page of all; without the folder of shapes, whose date says nothing."""
    origin = {key: value for key, value in wildcards.items() if key != "figure"}
    return [path for path in kept(**origin) if Path(path).name != "grains3d"]


def figures_shown():
    """Figures of the page: of each sample's first twin, and of its ensembles."""
    first = twins(
        "figures/{figure}.svg",
        variant=list(VARIANTS)[:1],
        realization=REALIZATIONS[:1],
        figure=FIGURES,
    )
    return first + expand(f"{SAMPLE}/figures/ensembles.svg", sample=list(SAMPLES))


def where_referenced(path):
    """An input function: ``path`` in the sample's folder where the sample has a 3D reference, else nothing."""

    def of(wildcards):
        chosen = [wildcards.sample] if hasattr(wildcards, "sample") else list(SAMPLES)
        return expand(f"{SAMPLE}/{path}", sample=[s for s in chosen if s in REFERENCED])

    return of


def where_measured_alike(path):
    """An input function: as :func:`where_referenced`, where the variant measures its twins as the reference was."""

    def by(whole):
        return whole["network"], whole["flow"]["conductance"]

    def of(wildcards):
        alike = by(VARIANTS[wildcards.variant]) == by(CONFIG)
        return where_referenced(path)(wildcards) if alike else []

    return of


def where_checked(path):
    """An input function: ``path`` of a twin whose skeleton is settled anew as a check, else nothing."""

    def of(wildcards):
        checked = int(wildcards.realization) < CONFIG["contacts"]["resettled"]
        return expand(f"{TWIN}/{path}", **dict(wildcards.items())) if checked else []

    return of


def timed(*jobs):
    """Benchmark files of a twin's jobs, without those that the cache may have spared."""
    kept = [job for job in jobs if not (CACHING and job in CACHED_JOBS)]
    return expand(f"{TWIN}/benchmarks/{{job}}.tsv", job=kept, allow_missing=True)


def solved_on_voxels(path):
    """An input function: ``path`` of each method that is solved on all voxels."""

    def of(wildcards):
        methods = [
            m for m in of_variant(wildcards)["flow"]["methods"] if m in ON_VOXELS
        ]
        return expand(path, method=methods, **dict(wildcards.items()))

    return of


def timed_jobs_of_twin(wildcards):
    """Benchmark files of the jobs that make and measure a twin, those of its parts among them."""
    slabs = NETWORK_JOBS if wildcards.variant in BY_SLABS else []
    on_voxels = solved_on_voxels(f"{TWIN}/benchmarks/flow_{{method}}.tsv")(wildcards)
    return [*expand(timed(*TWIN_JOBS, *slabs), **wildcards), *on_voxels]


def beside(path):
    """An input function: this file of a slab and of its neighbours."""

    def of(wildcards):
        which, _, last = wildcards.scatteritem.partition("-of-")
        near = range(max(int(which) - 1, 1), min(int(which) + 1, int(last)) + 1)
        items = [f"{i}-of-{last}" for i in near]
        return expand(path, **{**wildcards, "scatteritem": items})

    return of


def figure_caption(wildcards):
    """The words of a figure, one source for the report and for Snakemake's."""
    return TEXTS[wildcards.figure].caption


# ---- published volumes and slices of them

MEASUREMENTS = (
    "reference_network_pores.csv",
    "reference_network_throats.csv",
    "reference_flow.csv",
    "reference_s2.csv",
)


TO_FETCH = [
    name
    for name in CONFIG["data"]
    if not published_file(f"results/data/{name}/published")
]


def data_entry(wildcards):
    """What is known of a published volume, wherever it is taken from."""
    return {
        key: CONFIG["data"][wildcards.data][key] for key in ("voxel_size_um", "files")
    }


def sliced_volume(wildcards):
    return f"results/data/{SAMPLES[wildcards.sample]['data']}/reference.zarr.zip"


def sliced_measurements(wildcards):
    folder = f"results/data/{SAMPLES[wildcards.sample]['data']}"
    return [f"{folder}/{name}" for name in MEASUREMENTS]


def data_source(wildcards):
    """The file as it was published: from this machine, or through Snakemake's storage."""
    source = CONFIG["data"][wildcards.data]["source"]
    return storage.http(source) if sheet.is_address(source) else local(source)


# ---- the validation cases


@cache
def known_cases():
    """Samples and variants of every case, this config's own in place of its namesake's."""
    studies = [
        sheet.load_yaml(path, ours=True)
        for path in sorted((HOUSE / "config/cases").glob("*.yaml"))
    ]
    found = {study["case"]: study for study in studies if study.get("case")}
    if CONFIG["case"]:  # its samples may stand in a sheet
        found[CONFIG["case"]] = {"samples": SAMPLES, "variants": VARIANTS}
    order = CONFIG_SCHEMA["properties"]["case"]["enum"]
    return {
        case: {
            "samples": list(found[case]["samples"]),
            "variants": list(found[case].get("variants", {"full": {}})),
        }
        for case in order
        if case in found
    }


def ages(found):
    """Files with their ages. No input: a page of what there is asks for nothing."""
    return {str(path): path.stat().st_mtime_ns for path in sorted(found)}


def benchmarks_so_far(wildcards):
    """Tables of benchmarks, for a page to show."""
    return ages(Path("results/benchmarks").glob("*.csv"))


def come_so_far(wildcards):
    """What is there of the cases to be gathered."""
    found = [
        *Path("results").glob("*/*/*/metrics.csv"),
        *Path("results").glob("*/*/*/second/volume.zarr.zip"),  # of figures
        *Path("results").glob("cv_sweep/*/*/*.csv"),
        *Path("results").glob("*/reference_*.csv"),
        *Path("results").glob("*/*/reference_*.csv"),  # tomograms, further cubes
        *Path("results").glob("*/*/s2_envelope.json"),
    ]
    return ages(found)


def twins_of_case(wildcards):
    if CONFIG["case"] == "cv_sweep":
        return []
    # the second packings of the first twins are there to be shown
    return kept() + twins("second/volume.zarr.zip", realization=[0])


def references_of_case(wildcards):
    if CONFIG["case"] == "cv_sweep":
        return []
    further = expand(
        f"{SAMPLE}/{{cube}}/{{name}}", sample=SYNTHESES, cube=CUBES, name=MEASUREMENTS
    )
    own = ("reference_s2.csv", "reference_envelope.json")
    return [
        *(path for name in own for path in where_referenced(name)(wildcards)),
        *further,
    ]


def volumes_of_truth(wildcards):
    """All that is known in 3D of the rock of a section."""
    if wildcards.sample in SLICES:
        return [sliced_volume(wildcards)]
    return [f"results/{wildcards.sample}/reference.zarr.zip", *cubes_of(wildcards)]


def sweep_of_case(wildcards):
    if CONFIG["case"] != "cv_sweep":
        return []
    sweep = CONFIG["cv_sweep"]
    return expand(
        "results/cv_sweep/{cv}/{truth}/{name}.csv",
        cv=[f"{cv:g}" for cv in sweep["cv"]],
        truth=range(sweep["truths"]),
        name=["truth", *REALIZATIONS],
    )


def size_bias_stream(wildcards):
    """Whose random numbers a step draws: chapters add their names."""
    return {
        "seed": CONFIG["seed"],
        "sample": f"cv_sweep/{wildcards.cv}/{wildcards.truth}",
        "realization": int(getattr(wildcards, "realization", -1)),
    }


def tomograms_of_case(wildcards):
    names = (*MEASUREMENTS, "s2_envelope.json")
    return expand(f"{SAMPLE}/tomogram/{{name}}", sample=TOMOGRAMS, name=names)


# ---- what accuracy costs


def cubes_of(wildcards):
    """What judges a synthetic truth beside its first cube."""
    known = CUBES if wildcards.sample in SYNTHESES else []
    return [f"results/{wildcards.sample}/{cube}/reference.zarr.zip" for cube in known]


def observed_so_far(wildcards):
    """What the sweep has measured; as above, no input."""
    found = [
        *Path("results").glob("*/*/*/first/observed.json"),
        *Path("results").glob("*/*/*/observed.json"),
        *Path("results").glob("*/observed.json"),  # of truths
        *Path("results/accuracy").glob("*/*.csv"),
    ]
    return ages(found)


def known_settings(wildcards):
    """Settings of a knob of the analysis, as words."""
    return [str(value) for value in CONFIG["accuracy_sweep"]["known"][wildcards.knob]]


onstart:
    target = Path("results") if Path("results").exists() else Path()
    if not os.access(target, os.W_OK):
        raise WorkflowError(
            f"{target.resolve()}: may not be written to; give write permission, or run elsewhere"
        )
