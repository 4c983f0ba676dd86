"""Common ground: the validated config, the samples, and the hash of the science that jobs use."""

import hashlib
import sys
from pathlib import Path

from snakemake.exceptions import WorkflowError

HOUSE = Path(workflow.basedir)
sys.path.insert(0, str(HOUSE / "src"))

from grainfall import config as sheet
from grainfall.errors import InputError
from grainfall.export import FORMATS
from grainfall.report.texts import TEXTS

import grimp

CONFIG_SCHEMA = sheet.load_yaml(HOUSE / "workflow/schemas/config.schema.yaml")
SAMPLE_SCHEMA = sheet.load_yaml(HOUSE / "workflow/schemas/samples.schema.yaml")

try:
    CONFIG = sheet.resolve(
        config, CONFIG_SCHEMA, sheet.load_yaml(HOUSE / "config/presets.yaml")
    )
    SAMPLES = sheet.read_samples(CONFIG["samples"], SAMPLE_SCHEMA)
except InputError as fault:
    raise WorkflowError(str(fault))

VARIANTS = {name: sheet.variant(CONFIG, name) for name in CONFIG["variants"]}
REALIZATIONS = range(CONFIG["realizations"])
SYNTHETIC = [name for name, row in SAMPLES.items() if row["kind"] == "synthetic"]
REFERENCED = [
    name for name, row in SAMPLES.items() if row.get("reference") or name in SYNTHETIC
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
    "grain_library",
    "first_packing",
    "second_packing",
    "network",
]


def any_of(names):
    """A wildcard constraint that matches just these names, and nothing where there are none."""
    return "|".join(names) or "(?!)"


wildcard_constraints:
    sample=any_of(SAMPLES),
    variant=any_of(VARIANTS),
    realization=r"\d+",
    packing="first|second",
    axis="x|y|z",


scattergather:
    slices=CONFIG["correlation"]["chunks"],


GRAPH = grimp.build_graph("grainfall", cache_dir=None)
SHARED = ("grainfall.errors", "grainfall.io", "grainfall.random", "grainfall.units")


def science(*chapters):
    """Hash of the source of these chapters and of all they import.

    As a parameter of a rule it makes Snakemake rerun what an edit of the science touches, and nothing else.
    """
    modules = set(SHARED)
    for chapter in chapters:
        package = f"grainfall.{chapter}"
        modules |= {package, *GRAPH.find_descendants(package)}
        modules |= GRAPH.find_upstream_modules(package, as_package=True)
    digest = hashlib.sha256()
    for module in sorted(modules):
        stem = HOUSE / "src" / module.replace(".", "/")
        source = stem / "__init__.py" if stem.is_dir() else stem.with_suffix(".py")
        digest.update(module.encode() + source.read_bytes())
    return digest.hexdigest()[:16]


def settings(*keys):
    """A params function: these keys of the config as the rule's variant sees them."""

    def of(wildcards):
        whole = VARIANTS.get(getattr(wildcards, "variant", None), CONFIG)
        return {key: whole[key] for key in keys}

    return of


def stream(wildcards):
    """Where a job's random numbers come from; a parameter, so that cached results are never mixed up."""
    return {
        "seed": CONFIG["seed"],
        "sample": wildcards.sample,
        "realization": int(getattr(wildcards, "realization", -1)),
    }


def sample_row(wildcards):
    """The sample's row of the sheet."""
    return SAMPLES[wildcards.sample]


def sample_image(wildcards):
    return SAMPLES[wildcards.sample]["image"]


def reference_image(wildcards):
    return SAMPLES[wildcards.sample]["reference"]


def twins(path, **wildcards):
    """``path`` below every twin's folder, or below those that ``wildcards`` picks."""
    chosen = {
        "sample": list(SAMPLES),
        "variant": list(VARIANTS),
        "realization": list(REALIZATIONS),
        **wildcards,
    }
    return expand(f"{TWIN}/{path}", **chosen)


def where_referenced(path):
    """An input function: ``path`` in the sample's folder where the sample has a 3D reference, else nothing."""

    def of(wildcards):
        chosen = [wildcards.sample] if hasattr(wildcards, "sample") else list(SAMPLES)
        return expand(f"{SAMPLE}/{path}", sample=[s for s in chosen if s in REFERENCED])

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


def figure_caption(wildcards):
    """The words of a figure, one source for the report and for Snakemake's."""
    return TEXTS[wildcards.figure].caption
