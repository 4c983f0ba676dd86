"""The validation report: one HTML file that opens offline, and its figures as files of their own."""

from __future__ import annotations

import base64
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path

import jinja2
import numpy as np
import pandas as pd
import scipy  # its parts load when they are first used
from matplotlib.figure import Figure

from grainfall import __version__, io, network
from grainfall.report import figures, view3d
from grainfall.report.ensembles import intervals, paired_differences, read_costs
from grainfall.report.judgement import headline, judge, verdict
from grainfall.report.metrics import metric, within
from grainfall.report.numbers import number
from grainfall.report.texts import TEXTS
from grainfall.volume import size_factor

COMPARED = (
    "porosity", "porosity_first", "k_x_md", "k_y_md", "k_z_md", "w1_grains_um", "w1_pores_um", "coordination",
    "rattlers", "max_overlap", "wall_s",
)  # fmt: skip
"""Columns of summary.csv that ensembles are compared by: those that each twin has of its own."""
OVERVIEW = (
    ("porosity", "porosity"), ("k_x_md", "K along x (mD)"), ("k_y_md", "K along y (mD)"),
    ("k_z_md", "K along z (mD)"), ("coordination", "contacts per grain"), ("s2_envelope_p", "p of S₂"),
)  # fmt: skip
"""Columns of summary.csv that samples stand side by side with, and their heads."""
GALLERY = 8
"""Grains shown with their masks."""
PACKED = ("twin:first/volume.zarr.zip", "twin:second/volume.zarr.zip", "twin:twin.zarr.zip")
"""Volumes of the two packings and of the twin."""


class Results:
    """Files of one sample and one of its twins; what is not there reads as ``None``.

    Parameters
    ----------
    root : path
        The results folder.
    sample : str
    variant : str, optional
    realization : int, optional
    """

    def __init__(
        self, root: str | Path, sample: str, variant: str | None = None, realization: int | None = None
    ):
        self.root, self.sample_name = Path(root), sample
        self.variant_name, self.realization = variant, realization
        self.sample = self.root / sample
        self.variant = self.sample / variant if variant is not None else self.sample / "-"
        self.twin = self.variant / str(realization) if realization is not None else self.sample / "-"

    def path(self, name: str) -> Path:
        """``root:…``, ``sample:…``, ``variant:…`` or ``twin:…`` as a path."""
        level, file = name.split(":", 1)
        return getattr(self, level) / file

    def table(self, name: str) -> pd.DataFrame | None:
        """A CSV table; ``None`` where it is missing or has no columns."""
        path = self.path(name)
        # a table without columns is written as one line feed
        return io.read_table(path) if path.exists() and path.stat().st_size > 1 else None

    def json(self, name: str) -> dict | None:
        """A JSON object."""
        path = self.path(name)
        return io.read_json(path) if path.exists() else None

    def volume(self, name: str, array: str | None = None) -> np.ndarray | None:
        """An array of a volume file; ``None`` where the file or the array is missing."""
        found = self.attributes(name)
        if found is None or (array is not None and array not in found[1]):
            return None
        return io.read_volume(self.path(name), array)[0]

    @contextmanager
    def opened(self, *names: str) -> Iterator[list[io.Volume | None]]:
        """The phases of volume files, read where they are indexed; ``None`` where a file is missing."""
        with ExitStack() as stack:
            paths = map(self.path, names)
            yield [stack.enter_context(io.open_volume(p, "phase"))[0] if p.exists() else None for p in paths]

    def attributes(self, name: str) -> tuple[dict, dict[str, tuple]] | None:
        """Group attributes of a volume file, and the shapes of its arrays by name."""
        import zarr

        if not self.path(name).exists():
            return None
        with zarr.storage.ZipStore(self.path(name), mode="r") as store:
            group = zarr.open_group(store, mode="r")
            return dict(group.attrs), {key: array.shape for key, array in group.arrays()}

    @cached_property
    def phases(self) -> list[str]:
        """Names of the phases, index 0 the pore."""
        for source in (self.json("sample:section.json"), *(a[0] for a in [self._section] if a)):
            if source and source.get("phases"):
                return [str(p) for p in source["phases"]]
        return ["pore"]

    @cached_property
    def twin_phases(self) -> list[str]:
        """Names of the twin's phases: the section's, and cement where there is some."""
        found = self.attributes("twin:twin.zarr.zip")
        return [str(p) for p in found[0].get("phases", self.phases)] if found else self.phases

    @cached_property
    def _section(self) -> tuple[dict, dict[str, tuple]] | None:
        return self.attributes("sample:section.zarr.zip")

    @property
    def pixel_size_um(self) -> float:
        """Pixel size of the section."""
        return float(self._section[0]["voxel_size_um"])

    @cached_property
    def section_phase(self) -> np.ndarray | None:
        """Phases of the section as the chain used them: after the grains were given minerals by rules."""
        labelled = self.volume("sample:labels.zarr.zip", "phase")
        return labelled if labelled is not None else self.volume("sample:section.zarr.zip", "phase")


@dataclass(frozen=True)
class FigureFile:
    """A figure of the report: what it says, what it needs, how it is drawn."""

    name: str
    title: str
    category: str
    caption: str
    alt: str
    absent: str
    """What to say where there is nothing to draw."""
    needs: tuple[Path, ...]
    """Files without which there is nothing to draw."""
    make: Callable[[], Figure | None]

    @property
    def available(self) -> bool:
        """Whether the needed files are there."""
        return all(p.exists() for p in self.needs)

    def draw(self) -> Figure | None:
        """The figure, or ``None`` where there is nothing to draw."""
        return self.make() if self.available else None

    def save(self, path: str | Path) -> None:
        """Write the figure, or the sentence that stands for it."""
        figures.save_figure(self.draw() or figures.note_figure(self.absent), path)


def _section(r: Results) -> Figure:
    return figures.section_figure(
        r.section_phase,
        r.pixel_size_um,
        r.phases,
        r.volume("sample:labels.zarr.zip", "grains"),
        r.table("sample:pores2d.csv"),
        r.table("sample:grains2d.csv"),
        r.volume("sample:section.zarr.zip", "grey"),
    )


def _sizes(r: Results) -> Figure | None:
    table = r.table("sample:sizes.csv")
    if table is None or table.empty:
        return None
    return figures.sizes_figure(
        table,
        r.phases,
        r.table("sample:truth_sizes.csv"),
        r.table("twin:grains2d.csv"),
        r.table("twin:pores2d.csv"),
        drawn_grains(r),
    )


def _grain_gallery(r: Results) -> Figure | None:
    chosen = gallery(r)
    return figures.gallery_figure(chosen, r.phases) if chosen else None


def _twin(r: Results) -> Figure:
    attributes, _ = r.attributes("twin:twin.zarr.zip")
    with r.opened("twin:twin.zarr.zip") as (twin,):
        return figures.twin_figure(
            r.section_phase, r.pixel_size_um, twin, attributes["voxel_size_um"], r.twin_phases
        )


def _packings(r: Results) -> Figure:
    attributes, _ = r.attributes("twin:twin.zarr.zip")
    by_name = _values(r.table("twin:metrics.csv"))
    porosities = [by_name.get(k) for k in ("porosity_first", "porosity_second", "porosity")]
    with r.opened(*PACKED) as volumes:
        return figures.packings_figure(*volumes, attributes["voxel_size_um"], r.twin_phases, porosities)


def _forces(r: Results) -> Figure | None:
    contacts, bodies = r.table("twin:contacts.csv"), r.table("twin:bodies.csv")
    scene = r.json("variant:scene.json")
    if contacts is None or bodies is None or scene is None:
        return None
    return figures.forces_figure(contacts, bodies, scene["edge_um"], scene["mean_diameter_um"])


def _virtual(r: Results) -> Figure | None:
    table = r.table("twin:virtual_spheres.csv")
    if table is None or table.empty:
        return None
    return figures.virtual_figure(table, (r.json("twin:second/packing.json") or {}).get("p_sp"))


def _s2(r: Results) -> Figure:
    return figures.s2_figure(
        r.table("twin:s2_slices.csv"),
        r.table("variant:s2_envelope.csv"),
        r.json("variant:s2_envelope.json"),
        r.table("sample:reference_s2.csv"),
    )


def _pore_network(r: Results) -> Figure | None:
    twin = _network(r, "twin:network")
    if twin is None or len(network.element_sizes(twin)["pore_radius_um"]) == 0:
        return None
    reference = _network(r, "sample:reference_network") if _measured_alike(r) else None
    sizes = (None if n is None else network.element_sizes(n) for n in (twin, reference))
    joined = _values(r.table("twin:metrics.csv")).get("network_coarsen", 1)
    return figures.network_figure(*sizes, joined * r.json("variant:scene.json")["voxel_size_um"])


def _ensembles(r: Results) -> Figure | None:
    rows = _summary(r)
    if rows is None or len(rows) < 2:
        return None
    return figures.comparison_figure(rows, intervals(rows, COMPARED))


SOURCES = {
    "twin": (_twin, ["sample:section.zarr.zip", "twin:twin.zarr.zip"]),
    "s2": (_s2, ["twin:s2_slices.csv"]),
    "sizes": (_sizes, ["sample:sizes.csv"]),
    "network": (
        _pore_network,
        ["twin:network_pores.csv", "twin:network_throats.csv", "variant:scene.json"],
    ),
    "ensembles": (_ensembles, ["root:summary.csv"]),
    "section": (_section, ["sample:section.zarr.zip"]),
    "gallery": (_grain_gallery, ["sample:grains3d/library.csv", "sample:labels.zarr.zip"]),
    "packings": (_packings, ["twin:twin.zarr.zip"]),
    "forces": (_forces, ["twin:contacts.csv"]),
    "virtual": (_virtual, ["twin:virtual_spheres.csv"]),
}
"""Figure name to what draws it and the files without which there is nothing to draw."""


FOLDERS = {"ensembles": "sample:"}
"""Whose folder ``figures`` a figure lies in, where it is not the twin's."""


def figure_files(
    results_dir: str | Path, sample: str, variant: str | None = None, realization: int | None = None
) -> dict[str, FigureFile]:
    """Every figure of a sample and one of its twins, by name.

    Parameters
    ----------
    results_dir : path
    sample, variant, realization : str, str, int
        With neither variant nor realization only the sample's own figures have their files.

    Returns
    -------
    dict
        Figure name to :class:`FigureFile`, in the order of the report. ``figure_files(...)[name].save(path)``
        writes one as a file.
    """
    r = Results(results_dir, sample, variant, realization)
    return {
        name: FigureFile(name, *TEXTS[name], tuple(map(r.path, needs)), partial(make, r))
        for name, (make, needs) in SOURCES.items()
    }


def build_report(
    results_dir: str | Path,
    samples: Sequence[str],
    out: str | Path,
    title: str = "Digital twins of a granular rock",
    variants: Sequence[str] | None = None,
    realizations: Sequence[int] | None = None,
    drawn: bool = False,
) -> None:
    """Write the whole report as one HTML file that needs nothing else.

    Parameters
    ----------
    results_dir : path
        The results folder (results/README.md lists its files). What is missing is said to be missing.
    samples : sequence of str
    out : path
        Target, written atomically.
    title : str
    variants, realizations : sequences, optional
        Which twins; every folder that holds a ``metrics.csv`` if omitted. Pictures show the first
        realization of the first variant, tables show all.
    drawn : bool
        Take the figures that lie in folders ``figures`` instead of drawing them.
    """
    import plotly.offline

    root = Path(results_dir)
    parts = [_sample_part(root, name, n, variants, realizations, drawn) for n, name in enumerate(samples)]
    loader = jinja2.Environment(
        loader=jinja2.PackageLoader("grainfall.report"), autoescape=True, trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )  # fmt: skip
    loader.filters["number"] = number
    page = loader.get_template("report.html.j2").render(
        title=title,
        version=__version__,
        samples=parts,
        overview=_overview(root, parts),
        overview_heads=[head for _, head in OVERVIEW],
        plotly=plotly.offline.get_plotlyjs() if any(p["view"] for p in parts) else None,
    )
    io.write_text(out, page)


# ---- parts of the page


def _sample_part(root: Path, name: str, index: int, variants, realizations, drawn: bool) -> dict:
    """Everything the template shows of one sample."""
    twins = _twins(root / name, variants, realizations)
    first = twins[0] if twins else (None, None)
    r = Results(root, name, *first)
    files = figure_files(root, name, *first)
    shown = {
        key: {
            "title": f.title, "caption": f.caption, "alt": f.alt, "absent": f.absent,
            "image": shown_uri(r.path(f"{FOLDERS.get(key, 'twin:')}figures/{key}.svg"))
            if drawn
            else _drawn_uri(f.draw()),
        }
        for key, f in files.items()
    }  # fmt: skip
    judged = []
    for variant, realization in twins:
        metrics = Results(root, name, variant, realization).table("twin:metrics.csv")
        judgements = judge(metrics, r.phases) if metrics is not None else []
        judged.append(
            {
                "variant": variant,
                "realization": realization,
                "anchor": f"sample-{index}-twin-{len(judged)}",
                "metrics": metrics,
                "judgements": judgements,
                "verdict": verdict(judgements),
            }
        )
    return {
        "name": name,
        "anchor": f"sample-{index}",
        "facts": _facts(r),
        "judged": judged,
        "verdicts": _verdicts(judged),
        "figures": shown,
        "first": {"variant": first[0], "realization": first[1]},
        "all_metrics": _all_metrics(judged),
        "permeability": _permeability(root, name, twins),
        "plans": _plans(root, name, twins),
        "packing": _packing_facts(r),
        "costs": _costs(r, twins).to_dict("records"),
        "comparison": _comparison(_summary(r)),
        "view": _view(r),
    }


def _overview(root: Path, parts: list[dict]) -> list[dict]:
    """A row for every ensemble of every sample, where there are several samples: means and how much they
    scatter."""
    path = root / "summary.csv"
    if len(parts) < 2 or not path.exists():
        return []
    table = intervals(io.read_table(path), [name for name, _ in OVERVIEW])
    rows = []
    for part in parts:
        of = table[table["sample"] == part["name"]]
        for (variant, engine), found in of.groupby(["variant", "engine"], sort=False):
            cells = found.set_index("metric").to_dict("index")
            rows.append(
                {
                    "sample": part["name"],
                    "anchor": part["anchor"],
                    "ensemble": f"{variant} ({engine})",
                    "n": int(found["n"].max()),
                    "cells": [cells.get(name) for name, _ in OVERVIEW],
                }
            )
    return rows


def _twins(folder: Path, variants, realizations) -> list[tuple[str, int]]:
    """Variants and realizations to report, in the order asked for or the order of their names."""
    names = variants if variants is not None else sorted(p.name for p in folder.glob("*") if p.is_dir())
    found = []
    for variant in names:
        numbers = realizations
        if numbers is None:
            numbers = sorted(
                int(p.parent.name)
                for p in (folder / variant).glob("*/metrics.csv")
                if p.parent.name.isdigit()
            )
        found += [(str(variant), int(n)) for n in numbers if (folder / str(variant) / str(n)).is_dir()]
    return found


def _facts(r: Results) -> list[tuple[str, str]]:
    """What the sample is, as term and description."""
    about = r.json("sample:section.json") or {}
    facts = []
    phase = r.section_phase
    if phase is not None:
        height, width = phase.shape
        pixel = r.pixel_size_um
        size = f"{number(width * pixel)} × {number(height * pixel)} µm"
        facts.append(("Section", f"{width} × {height} pixels of {number(pixel)} µm: {size}"))
        facts.append(("Porosity of the section", number(about.get("porosity", (phase == 0).mean()))))
        counts = np.bincount(phase.ravel(), minlength=len(r.phases))
        shares = [
            f"{p} {counts[i] / max(counts[1:].sum(), 1):.1%}"
            for i, p in enumerate(r.phases)
            if i and i < len(counts)
        ]
        facts.append(("Minerals, shares of the solid", ", ".join(shares)))
    if about.get("n_grains") is not None:
        whole = about.get("n_grains_uncut")
        counted = number(about["n_grains"]) + ("" if whole is None else f", {number(whole)} of them whole")
        facts.append(("Grains in the section", counted))
    for key, value in (about.get("notes") or {}).items():
        words = _words(key)
        facts.append((words[:1].upper() + words[1:], _plain(value)))
    scene = r.json("variant:scene.json") or {}
    twin = r.attributes("twin:twin.zarr.zip")
    if twin:
        shape = twin[1]["phase"]
        voxel = float(twin[0]["voxel_size_um"])
        facts.append(("Twin", f"{shape[2]} × {shape[1]} × {shape[0]} voxels (x, y, z) of {number(voxel)} µm"))
        unit = (r.json("twin:first/packing.json") or {}).get("unit_um")
        if unit is not None:
            facts.append(
                ("Unit of length in the engine", f"{number(unit)} µm, so that a grain is of order 1")
            )
        if twin[0].get("seed") is not None:
            facts.append(("Seed", str(twin[0]["seed"])))
    if scene.get("porosity_target") is not None:
        facts.append(("Porosity asked for", number(scene["porosity_target"])))
    judged = r.path("sample:reference_s2.csv").exists()
    facts.append(("3D reference", "yes" if judged else "none: the section alone judges the twin"))
    return facts


def _all_metrics(judged: list[dict]) -> dict:
    """Every metric of every twin: one row per metric, one column per twin."""
    labels: dict[str, tuple[str, str]] = {}
    for twin in judged:
        for j in twin["judgements"]:
            labels.setdefault(j.metric, (j.label, j.unit))
    by_twin = [{j.metric: j for j in twin["judgements"]} for twin in judged]
    return {
        "heads": [f"{t['variant']} {t['realization']}" for t in judged],
        "rows": [
            {"metric": m, "label": label, "unit": unit, "cells": [twin.get(m) for twin in by_twin]}
            for m, (label, unit) in labels.items()
        ],
    }


def _verdicts(judged: list[dict]) -> list[dict]:
    """What to say of each variant: its figures, and every miss in the words of the first twin with it."""
    found = []
    for variant in dict.fromkeys(t["variant"] for t in judged):
        twins = [t for t in judged if t["variant"] == variant]
        misses: dict[str, list[tuple[str, int]]] = {}
        for t in twins:
            for j in (j for j in t["judgements"] if j.status == "missed"):
                misses.setdefault(j.metric, []).append((j.words, t["realization"]))
        met = [t["metrics"] for t in twins if t["metrics"] is not None]
        found.append(
            {
                "variant": variant,
                "said": headline(met) if met else [],
                "twins": twins,
                "misses": [
                    (
                        own[0][0],
                        f"missed by {len(own)} of {len(twins)}; figures of realization {own[0][1]}"
                        if len(twins) > 1
                        else "",
                    )
                    for own in misses.values()
                ],
            }
        )
    return found


def _permeability(root: Path, name: str, twins) -> list[dict]:
    """Rows of the permeability table, references first: K, its change, formation factor by axis."""

    def row(who: str, method: str, flow: pd.DataFrame, reference: pd.DataFrame | None) -> dict:
        cells = []
        for axis in "xyz":
            k, factor = _along(flow, method, axis)
            k_ref = _along(reference, method, axis)[0] if reference is not None else None
            change = f"{k / k_ref - 1:+.0%}".replace("-", "−") if k is not None and k_ref else ""
            cells.append({"k": k, "change": change, "factor": factor})
        return {"who": who, "method": method, "cells": cells}

    reference = Results(root, name).table("sample:reference_flow.csv")
    rows = []
    for variant, realization in twins:
        r = Results(root, name, variant, realization)
        flow, held = r.table("twin:flow.csv"), reference if _measured_alike(r) else None
        if flow is not None:
            rows += [row(f"{variant} {realization}", m, flow, held) for m in flow["method"].unique()]
    if rows and reference is not None:
        rows = [row("reference", m, reference, None) for m in reference["method"].unique()] + rows
    return rows


def _measured_alike(r: Results) -> bool:
    """Whether the twin was held against the reference's network: not where a variant measures otherwise."""
    metrics = r.table("twin:metrics.csv")
    return metrics is not None and "w1_network_pores_um" in set(metrics["metric"])


def _along(flow: pd.DataFrame, method: str, axis: str) -> tuple[float | None, float | None]:
    """Permeability and formation factor of one method and axis."""
    found = flow[(flow["method"] == method) & (flow["axis"] == axis)]
    if found.empty or pd.isna(found["k_md"].iloc[0]):
        return None, None
    return float(found["k_md"].iloc[0]), found["formation_factor"].iloc[0]


def _plans(root: Path, name: str, twins) -> list[dict]:
    """The plans of all twins; realizations that agree in an effect and its reason share a row."""
    shared: dict[tuple, list] = {}
    for variant, realization in twins:
        plan = Results(root, name, variant, realization).json("twin:plan.json") or {}
        for effect, entry in plan.items():
            if isinstance(entry, dict) and "on" in entry:
                state = ("on" if entry["on"] else "off") + (", forced" if entry.get("forced") else "")
                key = (_words(effect), variant, state, str(entry.get("reason", "")))
                shared.setdefault(key, []).append((realization, entry.get("cost_s"), entry.get("saved_s")))
    rows = []
    for (effect, variant, state, reason), members in shared.items():
        cost, saved = (_mean(column) for column in list(zip(*members, strict=True))[1:])
        rows.append(
            {
                "effect": effect,
                "twins": f"{variant} {', '.join(str(m[0]) for m in members)}",
                "state": state,
                "reason": reason,
                "cost_s": cost,
                "saved_s": saved,
            }
        )
    return rows


def _mean(values) -> float | None:
    known = [v for v in values if v is not None]
    return sum(known) / len(known) if known else None


def _packing_facts(r: Results) -> list[dict]:
    """What each packing reported of itself, side by side."""
    both = [_flat(r.json(f"twin:{stage}/packing.json") or {}) for stage in ("first", "second")]
    return [{"name": _words(key), "cells": [b.get(key, "") for b in both]} for key in {**both[0], **both[1]}]


def _flat(content: dict, prefix: str = "") -> dict[str, str]:
    flat = {}
    for key, value in content.items():
        if isinstance(value, dict):
            flat |= _flat(value, f"{prefix}{key} ")
        elif not (isinstance(value, list) and len(value) > 6):
            flat[f"{prefix}{key}"] = _plain(value)
    return flat


def _costs(r: Results, twins) -> pd.DataFrame:
    """Seconds and memory per rule over the sample and its twins."""
    folders = [
        r.sample,
        *dict.fromkeys(r.sample / v for v, _ in twins),
        *(r.sample / v / str(n) for v, n in twins),
    ]
    return read_costs(sorted(f for folder in folders for f in (folder / "benchmarks").glob("*.tsv")))


def _comparison(summary: pd.DataFrame | None) -> dict | None:
    """Means of one sample's ensembles, and their differences, where there is more than one twin."""
    if summary is None or len(summary) < 2:
        return None
    found = {}
    for name, table in (
        ("intervals", intervals(summary, COMPARED)),
        ("differences", paired_differences(summary, COMPARED)),
    ):
        table["label"] = [figures.short_label(m) for m in table["metric"]]
        table["unit"] = ["" if (unit := metric(m).unit) == "1" else unit for m in table["metric"]]
        order = table["metric"].map({m: i for i, m in enumerate(COMPARED)})
        found[name] = table.iloc[np.argsort(order, kind="stable")].to_dict("records")
    return found


def _summary(r: Results) -> pd.DataFrame | None:
    """The sample's rows of summary.csv."""
    table = r.table("root:summary.csv")
    return None if table is None else table[table["sample"] == r.sample_name]


def _view(r: Results) -> dict | None:
    """Data of the 3D view."""
    with r.opened("twin:twin.zarr.zip") as (phase,):
        if phase is None:
            return None
        attributes, _ = r.attributes("twin:twin.zarr.zip")
        view = view3d.view_data(
            phase, float(attributes["voxel_size_um"]), r.twin_phases, _network(r, "twin:network")
        )
    return view if any(group != "network" for group in view["groups"]) else None


def _network(r: Results, stem: str) -> dict | None:
    """A pore network, where both of its tables are there."""
    pores, throats = r.path(f"{stem}_pores.csv"), r.path(f"{stem}_throats.csv")
    return network.load(pores, throats) if pores.exists() and throats.exists() else None


def gallery(r: Results, count: int = GALLERY) -> list[dict]:
    """Grains spread evenly over the library's minerals and sizes, each with the masks it was made from."""
    from grainfall.grains import VOID, Library

    library = Library.load(r.path("sample:grains3d"))
    labels = r.volume("sample:labels.zarr.zip", "grains")
    if labels is None:
        return []
    boxes = scipy.ndimage.find_objects(labels)
    minerals = sorted(set(library.table["phase"]) - {VOID})
    chosen = []
    for mineral in minerals:
        shapes = library.table[library.table["phase"] == mineral].sort_values(["r2d_um", "shape"])
        share = min(len(shapes), -(-count // len(minerals)))
        for position in np.linspace(0, len(shapes) - 1, share).round().astype(int):
            row = shapes.iloc[position]
            masks = [int(row[f"mask_{plane}"]) for plane in ("xy", "xz", "yz")]
            vertices, faces = library.mesh(int(row["shape"]))
            chosen.append(
                {
                    "vertices": vertices,
                    "faces": faces,
                    "phase": int(mineral),
                    "masks": [labels[boxes[m - 1]] == m for m in masks],
                    "words": f"r = {number(row['r2d_um'])} µm",
                }
            )
    return chosen


def drawn_grains(r: Results) -> pd.DataFrame | None:
    """Bodies whose centre lies inside the twin's volume (those outside belong to the margin), with the radii
    they were drawn with: what the section's sizes are to be held against."""
    bodies, twin = r.table("twin:bodies.csv"), r.attributes("twin:twin.zarr.zip")
    cement = r.json("twin:cement.json")
    if bodies is None or twin is None or cement is None:
        return None
    bodies["scale"] /= size_factor(cement)
    return within(bodies, twin[1]["phase"], float(twin[0]["voxel_size_um"]))


# ---- helpers


def data_uri(path: Path) -> str:
    """An SVG file as an address that a page can carry in itself."""
    return "data:image/svg+xml;base64," + base64.b64encode(path.read_bytes()).decode()


def shown_uri(path: Path) -> str | None:
    """The same of a figure; ``None`` where it is missing or a sentence in place of one."""
    if not path.exists() or f'id="{figures.NOTE}"' in path.read_text(encoding="utf-8"):
        return None
    return data_uri(path)


def _drawn_uri(figure: Figure | None) -> str | None:
    if figure is None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "figure.svg"
        figures.save_figure(figure, path)
        return data_uri(path)


def _values(metrics: pd.DataFrame | None) -> dict[str, float]:
    return {} if metrics is None else dict(zip(metrics["metric"], metrics["value"], strict=True))


def _words(key: str) -> str:
    return str(key).replace("_", " ")


def _plain(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int | float):
        return number(value)
    if isinstance(value, list | tuple):
        return ", ".join(map(_plain, value))
    if isinstance(value, dict):
        return ", ".join(f"{_words(k)} {_plain(v)}" for k, v in value.items())
    return "" if value is None else str(value)
