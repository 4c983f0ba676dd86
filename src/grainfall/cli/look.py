"""What an image shows, and the study that suits it: the first chapters of the method, run on a section."""

from __future__ import annotations

import contextlib
import math
import re
import shutil
import textwrap
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from grainfall import config as sheet
from grainfall import grains, io, morphology, packing, random, stereology
from grainfall.cli.costs import SOURCE, Cost, Costs
from grainfall.cli.study import CONFIGS, check_braces, resolved, schema
from grainfall.errors import InputError
from grainfall.section import Section, guess_kind, read_section, stated_pixel_um
from grainfall.surface import alignment, left_open, lies_aligned, sampling_errors
from grainfall.units import LENGTHS_UM

VOXELS_A_GRAIN = 16
"""Across the mean grain; docs/measured.md, 621 spheres: permeability at 16 is 5 % below that at 24 voxels."""
LARGE_GRAINS = 4
"""Large grains that fit side by side in the box."""
SHAPES = 30
"""Grain shapes made of each mineral, to be cut."""
PATIENCE_S = 2 * 3600
"""A twin that the standard preset packs for longer is suggested as a draft first."""


def length_um(text: str) -> float:
    """``"1.2um"``, ``"800 nm"``, ``"0.02mm"`` or a bare number of micrometres, in micrometres.

    Raises
    ------
    InputError
        For anything else.
    """
    found = re.fullmatch(r"\s*([0-9.]+(?:[eE][+-]?[0-9]+)?)\s*([a-zµμ]*)\s*", text)
    right = "a length like 1.2um, 800nm or 0.02mm"
    if not found or found.group(2) not in ("", *LENGTHS_UM):
        raise InputError("--pixel-size", f"'{text}' is no length", right)
    try:
        value = float(found.group(1)) * LENGTHS_UM[found.group(2) or "um"]
    except ValueError:
        raise InputError("--pixel-size", f"'{text}' is no length", right) from None
    if not (math.isfinite(value) and value > 0):
        raise InputError("--pixel-size", f"'{text}' is no length", right)
    return value


@dataclass(frozen=True)
class Findings:
    """What the section shows, and what suits it.

    Attributes
    ----------
    image : Path
    kind, reason : str
        Kind of the image, and why it is taken for one.
    section : Section
    row : dict
        Columns of the sample sheet, but for the image's path.
    summary : dict
        As in section.json.
    radius2d_um, radius3d_um : float
        Mean radius of grains in the section, and unfolded, over all minerals by number.
    preset : str
    edge_um, voxel_size_um : float
        Suggested box and voxels.
    cost : Cost
        Of one twin of these.
    """

    image: Path
    kind: str
    reason: str
    section: Section
    row: dict
    summary: dict
    radius2d_um: float
    radius3d_um: float
    preset: str
    edge_um: float
    voxel_size_um: float
    cost: Cost


def look(
    image: str | Path,
    pixel_size_um: float,
    *,
    kind: str | None = None,
    phases: str | None = None,
    pore_value: int | None = None,
    array: str | None = None,
    preset: str | None = None,
) -> Findings:
    """Look at a section and suggest a study.

    Parameters
    ----------
    image : str or Path
    pixel_size_um : float
    kind, phases, pore_value, array : optional
        As in the sample sheet; the kind is judged from the pixels if omitted.
    preset : str, optional
        One of those whose cost has been measured.

    Raises
    ------
    InputError
        When the image cannot be read, or shows no whole grain of a mineral.
    """
    image = Path(image)
    reason = "as you said"
    if kind is None:
        kind, reason = guess_kind(image, array)
    names = sheet.parse_phases(phases)
    section = read_section(image, kind, pixel_size_um, names, pore_value=pore_value, array=array)
    settings = resolved({"samples": "-"}, "defaults")
    found = morphology.analyse(
        section.phase,
        pixel_size_um,
        instances=section.instances,
        grey=section.grey_as_given,
        **settings["morphology"],
    )
    summary = {**found.summary(section.phases), "pixel_size_um": pixel_size_um}
    sizes = {
        (n, "grain"): _unfolded(found, n, settings["stereology"]["method"], section.instances is not None)
        for n in range(1, len(section.phases))
    }
    for (n, _), size in sizes.items():
        if size is None:
            if len(section.phases) == 2:
                raise InputError(image, "shows no whole grain", "a larger section")
            raise InputError(
                image, f"shows no whole grain of {section.phases[n]}", "a larger section, or fewer phases"
            )
    radius2d, radius3d, large = _mean_grain(sizes, summary)
    edge = _rounded(max(10 * 2 * radius3d, LARGE_GRAINS * 2 * large))
    voxel = max(pixel_size_um, _rounded(2 * radius3d / VOXELS_A_GRAIN))
    costs = Costs.measured()

    def cost_of(preset: str) -> Cost:
        scene = resolved({"samples": "-", "preset": preset}, "defaults")["scene"]
        scene |= {"edge_um": edge, "voxel_size_um": voxel}
        return costs.twin(preset, packing.plan_scene(sizes, summary, **scene))

    if preset is None:
        preset = "standard" if cost_of("standard").cpu_s <= PATIENCE_S else "draft"
    elif preset not in costs.presets:
        known = preset in schema("config")["properties"]["preset"]["enum"]
        wrong = f"what '{preset}' costs has not been measured" if known else f"'{preset}' is not known"
        raise InputError("--preset", wrong, " or ".join(costs.presets))
    given = {"phases": phases, "pore_value": pore_value, "array": array}
    row = {"kind": kind, "pixel_size_um": pixel_size_um} | {k: v for k, v in given.items() if v is not None}
    return Findings(
        image, kind, reason, section, row, summary, radius2d, radius3d, preset, edge, voxel, cost_of(preset)
    )


def _unfolded(
    found: morphology.Analysis, phase: int, method: str, outlined: bool
) -> stereology.SizeDistribution | None:
    """Sizes in space of a mineral's grains; where outlined, by what planes cut from a few of their shapes."""
    table, particle = found.grains[found.grains.phase == phase], stereology.SPHERE
    if stereology.own_shapes(method, "auto", outlined)["on"]:
        # Where no mask makes a grain the study will say so; a sphere does to look.
        with contextlib.suppress(InputError):
            rng = random.generator(0, "new", 0, "grains")
            shapes = grains.build_library(found.grain_labels, table, SHAPES, rng, pieces=False)
            particle = grains.random_profiles(shapes.meshes(phase))
    return stereology.unfold_table(table, method=method, smallest_um=found.smallest_um, particle=particle)


def _mean_grain(sizes: dict, summary: dict) -> tuple[float, float, float]:
    """Mean radius in the section and in space, and the radius that a twentieth of the grains exceeds."""
    dists = list(sizes.values())
    share = packing.phase_probabilities(
        np.asarray(summary["fractions"]), [d.mean_volume("f3d") for d in dists]
    )
    return (
        float(share @ [d.mean("f2d") for d in dists]),
        float(share @ [d.mean("f3d") for d in dists]),
        float(max(d.quantile(0.95) for d in dists)),
    )


def _rounded(value: float) -> float:
    """Two digits: more would pretend."""
    return float(f"{value:.2g}")


def _millions(count: int) -> str:
    """Of two digits, and never as a power of ten."""
    return f"{_rounded(count / 1e6):.10g}"


OWN_NAMES = ("config.yaml", "config", "results", ".snakemake")
"""What lies in a study beside its image."""


def name_in_study(image: Path) -> str:
    """What the copy of an image is called: braces mark wildcards to Snakemake."""
    return re.sub(r"[{}]", "_", image.name)


def check_free(folder: Path, image: Path, force: bool) -> None:
    """Refuse a folder that no study can lie in, and one that holds a study or another image of this name,
    unless they may be replaced.

    Raises
    ------
    InputError
    """
    for path in (folder, *folder.absolute().parents):
        if path.exists() and not path.is_dir():
            raise InputError(path, "is a file", "give the name of a new folder")
    check_braces(folder)
    try:
        image.name.encode()
    except UnicodeEncodeError:
        raise InputError(image, "has a name that is no UTF-8 text", "rename it") from None
    if image.name in OWN_NAMES:
        raise InputError(image, "has a name that a study needs for itself", "rename it")
    copy = folder / name_in_study(image)
    there = [folder / name for name in (*CONFIGS, "results") if (folder / name).exists()]
    there += [copy] if copy.exists() and not (image.exists() and copy.samefile(image)) else []
    if there and not force:
        right = "another folder, or --force to replace config and image"
        raise InputError(there[0], "is there already", right)


def write_study(
    folder: str | Path,
    found: Findings,
    *,
    force: bool = False,
) -> Path:
    """Make a study: a folder with a copy of the image and a commented config that a run accepts.

    Parameters
    ----------
    folder : str or Path
    found : Findings
    force : bool
        Replace the config and the image of a study that is there; results stay.

    Returns
    -------
    Path
        The config.

    Raises
    ------
    InputError
        When the folder holds a study already, and ``force`` is not set.
    """
    folder = Path(folder)
    check_free(folder, found.image, force)
    name = re.sub(r"[^A-Za-z0-9_-]+", "-", folder.resolve().name).strip("-")[:64]
    name = name if sheet.is_name(name) else "rock"
    image = folder / name_in_study(found.image)
    row = {"image": image.name, **found.row}
    text = config_text(name, row, found)
    resolved(yaml.safe_load(text), "config.yaml")
    sheet.check(row, schema("samples"), "sample")
    folder.mkdir(parents=True, exist_ok=True)
    if found.image.resolve() != image.resolve():
        if found.image.is_dir():
            shutil.copytree(found.image, image, dirs_exist_ok=force)
        else:
            with io.atomic_path(image) as part:
                shutil.copyfile(found.image, part)
    config = folder / "config.yaml"
    io.write_text(config, text)
    return config


def config_text(name: str, row: dict, found: Findings) -> str:
    """The config of a study as commented YAML; what a key means is what the schema says of it."""
    properties = schema("config")["properties"]

    def about(key: str, more: str = "", indent: str = "") -> list[str]:
        part = {"properties": properties}
        for word in key.split("."):
            part = part["properties"][word]
        return _comment(f"{part['description']}. {more}", indent)

    def shown(group: str, key: str) -> list[str]:
        default = _yaml(properties[group]["properties"][key]["default"])
        return [*about(f"{group}.{key}"), f"# {group}: {{{key}: {default}}}"]

    diameter = 2 * found.radius3d_um
    across = diameter / found.voxel_size_um
    lines = [
        *(part for line in described(found) for part in _comment(line)),
        "#",
        "# Every key, its unit, range and default: config/README.md. When this file is right: grainfall run",
        "",
        *about("title"),
        f"title: {_yaml(name)}",
        *about("seed"),
        "seed: 1",
        *about("preset"),
        f"preset: {found.preset}",
        *about("samples"),
        "samples:",
        f"  {_yaml(name)}:",
        *(f"    {key}: {_yaml(value)}" for key, value in row.items()),
        *about("realizations"),
        f"realizations: {properties['realizations']['default']}",
        "",
        "scene:",
        *about("scene.edge_um", f"Here {found.edge_um / diameter:.3g} mean grains.", "  "),
        f"  edge_um: {found.edge_um:g}",
        *about("scene.voxel_size_um", f"Here {across:.3g} across the mean grain.", "  "),
        f"  voxel_size_um: {found.voxel_size_um:g}",
        *about("scene.porosity", indent="  "),
        "  porosity: null",
        "",
        *about("variants"),
        "variants:",
        "  full: {}",
        "",
        "# Worth a look next (defaults shown):",
        *shown("packing", "engine"),
        *shown("flow", "methods"),
    ]
    return "\n".join(lines) + "\n"


def _comment(text: str, indent: str = "") -> list[str]:
    """Text as lines of a comment, whatever it holds."""
    return textwrap.wrap(text, 100, initial_indent=f"{indent}# ", subsequent_indent=f"{indent}# ")


def _yaml(value: object) -> str:
    """A value on one line as YAML."""
    return yaml.safe_dump(value, default_flow_style=True, width=10**6).removesuffix("\n...\n").strip()


TAPPED = 0.32
"""Porosity below which no bed comes by itself: lubricated and tapped they end at 0.33 to 0.36."""


def described(found: Findings) -> list[str]:
    """What was seen and what it will cost, line by line."""
    height, width = found.section.phase.shape
    pixel, names = found.section.pixel_size_um, found.summary["phases"]
    shares = ", ".join(
        f"{name} {share:.1%}" for name, share in zip(names[1:], found.summary["fractions"], strict=True)
    )
    cost = found.cost
    beyond = "" if cost.measured else " This one is more than twice as large as any of those."
    if found.summary["porosity"] < TAPPED:
        beyond += " A rock this dense may take two to four times as long, as Berea's: its beds are tapped."
    box = f"a box of {found.edge_um:g} um, voxels of {found.voxel_size_um:g} um"
    errors, aligned = sampling_errors(found.section.phase), lies_aligned(alignment(found.section.phase))
    return [
        f"{found.image.name}: {width} x {height} pixels of {pixel:g} um.{_otherwise(found)}",
        f"Taken for kind {found.kind}: {found.reason}.{_pore_taken(found)}",
        f"Porosity {found.summary['porosity']:.4f}; of the solid: {shares}.",
        f"{found.summary['n_grains']} grains, {found.summary['n_grains_uncut']} of them whole; mean radius "
        f"{found.radius2d_um:.3g} um in the section, {found.radius3d_um:.3g} um in space.",
        *([_few(whole)] if (whole := found.summary["n_grains_uncut"]) < ENOUGH else []),
        f"{left_open(errors.k, errors.porosity)}.",
        *([f"{aligned}."] if aligned else []),
        f"Suggested: preset {found.preset}, {box}.",
        f"A twin of {cost.grains} grains and {_millions(cost.voxels)} million voxels takes about "
        f"{duration(cost.cpu_s)} of one core ({duration(cost.cpu_s / cost.factor)} to "
        f"{duration(cost.cpu_s * cost.factor)}) and {cost.memory_mb / 1024:.1f} GB, by the twins in "
        f"{SOURCE}.{beyond}",
    ]


ENOUGH = 50
"""Whole grains below which the sizes are said to rest on few."""


def _few(whole: int) -> str:
    """What to know of a section that shows few whole grains."""
    rest = "rest on a single whole grain" if whole == 1 else f"rest on {whole} whole grains"
    return (
        f"Sizes and shapes {rest}, and how far that is off is not in what follows: of a mineral, 200 "
        "leave the sizes open by 5 % (docs/choosing.md)."
    )


def _otherwise(found: Findings) -> str:
    """What the file says of its pixels, where that is something else."""
    given = found.section.pixel_size_um
    stated = stated_pixel_um(found.image)
    if stated is None or np.allclose(stated, given, rtol=0.01):
        return ""
    x, y = stated
    if not math.isclose(x, y, rel_tol=0.01):
        return f" The file gives its pixels as {x:g} x {y:g} um: make them square first."
    return f" The file itself gives its pixels as {x:g} um, and K goes as their square."


def _pore_taken(found: Findings) -> str:
    """What was taken for the pore where nobody said it: images of bright pores are as common."""
    if {"pore_value", "phases"} & found.row.keys():
        return ""
    if found.kind == "binary":
        return " The lower value is taken for the pore; if it is the other, say --pore-value."
    if found.kind == "phases":
        return " The value 0 is taken for the pore, the others for minerals; if not, say --phases."
    if found.kind == "grey":
        levels = ", ".join(f"{level:g}" for level in found.section.notes["multi_otsu_thresholds"])
        return f" The darkest class is taken for the pore, parted at {levels}."
    return ""


def duration(seconds: float) -> str:
    """Seconds as people say them."""
    if seconds < 100:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.1f} h"
