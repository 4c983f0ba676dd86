"""What is measured on one twin: the catalogue of metrics, and what each step gives to it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
import scipy  # its stats take half a second to load, and do so when they are first used

from grainfall.report.numbers import as_float
from grainfall.surface import SolidSurface, alignment, ratio_of_sums, sampling_errors


@dataclass(frozen=True)
class Metric:
    """A known metric: what it is called, its unit, where it comes from and the fixed bounds it must keep.

    ``low`` and ``high`` are bounds that hold for every sample (``None``: none); targets of one sample are
    rows of their own, named ``<metric>_target``.
    """

    label: str
    unit: str = "1"
    source: str = "twin"
    low: float | None = None
    high: float | None = None


METRICS: dict[str, Metric] = {
    "porosity": Metric("porosity of the twin", source="twin.zarr.zip"),
    "porosity_target": Metric("porosity asked for", source="scene.json"),
    "porosity_first": Metric("porosity of the first packing", source="first/packing.json"),
    "porosity_second": Metric("porosity of the second packing", source="second/packing.json"),
    "n_grains": Metric("grains in the region of interest", "grains", "bodies.csv"),
    "n_virtual": Metric("virtual spheres poured", "spheres", "second/bodies.csv"),
    "p_sp": Metric("share of virtual spheres among poured bodies", source="second/packing.json"),
    "voxels_per_grain": Metric("voxels across the mean grain", "voxels", "scene.json"),
    "cement_share": Metric("cement, share of the region", source="twin.zarr.zip"),
    "asleep": Metric("share of bodies at rest", source="bodies.csv", low=1.0),
    "drift": Metric("drift of the freed bed in 300 steps, mean grain radii", source="second/packing.json",
                    high=1e-3),
    "net_force": Metric("mean net force on a body, of its weight", source="second/packing.json", high=0.01),
    "packing_overlap": Metric("largest overlap of the shapes that the engine collided, of the smaller radius",
                              source="second/packing.json", high=0.02),
    "energy_rise": Metric("largest rise of mechanical energy at rest, of the whole",
                          source="second/packing.json", high=1e-3),
    "on_spheres": Metric("share of grains that leaned on virtual spheres", source="contacts.json"),
    "lost_support": Metric("share of grains that lost support with the spheres", source="contacts.json"),
    "porosity_resettled": Metric("porosity once the skeleton has settled anew", source="resettling.json"),
    "s2_resettled": Metric("largest change of S₂ by that", source="resettling.json"),
    "moved_resettled": Metric("share of grains that it moves by more than 0.1 radii",
                              source="resettling.json"),
    "scale_factor": Metric("final scaling of positions", source="correction.json"),
    "contacts_before": Metric("contacts before the final scaling", "contacts", "correction.json"),
    "contacts_after": Metric("contacts, scaled, before cement", "contacts", "correction.json"),
    "contact_area_before_um2": Metric("contact area before the final scaling", "µm²", "correction.json"),
    "contact_area_after_um2": Metric("contact area, scaled, before cement", "µm²", "correction.json"),
    "shared_before": Metric("share of the solid that two grains claim, before the final scaling",
                            source="correction.json"),
    "shared_after": Metric("share of the solid that two grains claim", source="correction.json"),
    "euler_before": Metric("Euler number of the pores before the final scaling", source="correction.json"),
    "euler_after": Metric("Euler number of the pores, scaled, before cement", source="correction.json"),
    "w1_grains_um": Metric("grain radii on slices, distance to the section", "µm", "grains2d.csv"),
    "w1_pores_um": Metric("pore-circle radii on slices, distance to the section", "µm", "pores2d.csv"),
    "w1_aspect_ratio": Metric("grain aspect ratio, distance to the section", source="grains2d.csv"),
    "w1_circularity": Metric("grain circularity, distance to the section", source="grains2d.csv"),
    "w1_solidity": Metric("grain solidity, distance to the section", source="grains2d.csv"),
    "s2_inside_envelope": Metric("lags where the section's S₂ lies inside the cloud of slices",
                                 source="s2_envelope.json", low=0.95),
    "s2_envelope_p": Metric("p of the envelope test of the section's S₂", source="s2_envelope.json",
                            low=0.05),
    "s2_windows_rejected": Metric("share of the section's windows that this test tells from slices",
                                  source="s2_envelope.json"),
    "max_overlap": Metric("largest overlap of the true shapes, of the smaller radius",
                          source="contacts.csv", high=0.02),
    "coordination": Metric("contacts per grain, without rattlers", "contacts", "contacts.csv"),
    "rattlers": Metric("share of rattlers (fewer than three contacts)", source="contacts.csv"),
    "n_pores": Metric("linked pores of the network", "pores", "network"),
    "n_throats": Metric("throats between two interior pores", "throats", "network"),
    "w1_network_pores_um": Metric("network pore radii by volume, distance to the reference", "µm", "network"),
    "w1_network_throats_um": Metric("network throat radii, distance to the reference", "µm", "network"),
    "w1_network_coordination": Metric("pore coordination, distance to the reference", "throats", "network"),
    "solid_surface_per_um": Metric("surface of the solid by its volume, as voxels show it", "1/µm",
                                   "twin.zarr.zip"),
    "specific_surface_per_um": Metric("specific surface from the slope of S₂", "1/µm", "s2_volume.csv"),
    "porosity_ref": Metric("porosity of the 3D reference", source="reference_s2.csv"),
    "specific_surface_ref_per_um": Metric("specific surface of the 3D reference", "1/µm", "reference_s2.csv"),
    "porosity_sampling_error": Metric("standard error of the section's porosity by its own sampling",
                                      source="section"),
    "k_sampling_error": Metric("standard error of ln K by the section's own sampling (Kozeny-Carman)",
                               source="section"),
    "section_alignment": Metric("crossings of the section's surface, across its alignment over along it",
                                source="section"),
    "section_alignment_deg": Metric("direction along which it lies, counter-clockwise from x", "deg",
                                    "section"),
    "section_alignment_p": Metric("how often chance aligns a section as much", source="section"),
    "network_coarsen": Metric("voxels along an axis that are one for network and flow", source="config"),
    "accuracy_error": Metric("error in what accuracy asks for", source="config"),
    "wall_s": Metric("wall time of the realization", "s", "benchmarks"),
    "peak_rss_mb": Metric("peak memory of its largest job", "MB", "benchmarks"),
    "k_md": Metric("permeability, mean of the axes and their range", "mD", "flow.csv"),
    **{f"k_{a}_md": Metric(f"permeability along {a}", "mD", "flow.csv") for a in "xyz"},
    **{f"k_ref_{a}_md": Metric(f"permeability of the reference along {a}", "mD", "reference_flow.csv")
       for a in "xyz"},
    **{f"formation_factor_{a}": Metric(f"formation factor along {a}", source="flow.csv") for a in "xyz"},
}  # fmt: skip
"""Every metric with a fixed name. Beside them: ``phase_fraction_<i>``, ``w1_grains_<i>_um`` for mineral i."""


def metric(name: str) -> Metric:
    """The catalogue entry of a metric, of a mineral's metric, or of their targets.

    Raises
    ------
    KeyError
        For a name that the report does not know: a metric without words must not slip in.
    """
    if name in METRICS:
        return METRICS[name]
    if name.endswith("_target"):
        base = metric(name.removesuffix("_target"))
        return Metric(f"target: {base.label}", base.unit, "section")
    for prefix, suffix, label, unit, source in (
        ("phase_fraction_", "", "share of mineral {} in the solid", "1", "twin.zarr.zip"),
        ("w1_grains_", "_um", "grain radii of mineral {}, distance to the section", "µm", "grains2d.csv"),
    ):
        index = name.removeprefix(prefix).removesuffix(suffix)
        if name.startswith(prefix) and name.endswith(suffix) and index.isdigit():
            return Metric(label.format(index), unit, source)
    raise KeyError(f"unknown metric {name!r}: name it in grainfall.report.metrics.METRICS")


def metrics_table(values: Mapping[str, object]) -> pd.DataFrame:
    """The long form of everything measured on one twin (``metrics.csv``).

    Parameters
    ----------
    values : mapping
        Metric name to a number, to ``(value, lower, upper)``, or to ``None`` where it was not computed.
        For ``<metric>_target`` the bounds are the accepted interval; for any other metric they are the
        interval of the measured value. Merge the pieces that :func:`section_comparison`,
        :func:`flow_values`, :func:`phase_values` and :func:`network_values` return.

    Returns
    -------
    DataFrame
        metric, value, unit, lower, upper, source; missing figures are NaN (empty in the file), never 0.
    """
    rows = []
    for name, entry in values.items():
        value, lower, upper = entry if isinstance(entry, tuple | list) else (entry, None, None)
        known = metric(name)
        rows.append((name, as_float(value), known.unit, as_float(lower), as_float(upper), known.source))
    return pd.DataFrame(rows, columns=["metric", "value", "unit", "lower", "upper", "source"])


SUMMARY_COLUMNS = (
    "sample", "variant", "realization", "engine", "n_grains", "voxel_size_um",
    "shape_z", "shape_y", "shape_x",
    "porosity_target", "porosity_first", "porosity_second", "porosity", "flow_method",
    "k_x_md", "k_y_md", "k_z_md", "k_ref_x_md", "k_ref_y_md", "k_ref_z_md",
    "s2_inside_envelope", "s2_envelope_p", "w1_grains_um", "w1_pores_um",
    "max_overlap", "coordination", "rattlers", "wall_s", "peak_rss_mb",
)  # fmt: skip
"""Columns of results/summary.csv, in their order."""


def summary_row(
    sample: str,
    variant: str,
    realization: int,
    engine: str,
    shape_zyx: Sequence[int],
    voxel_size_um: float,
    metrics: pd.DataFrame,
    flow_method: str | None = None,
) -> pd.DataFrame:
    """One row of ``summary.csv``, the columns of :data:`SUMMARY_COLUMNS` in their order.

    Parameters
    ----------
    sample, variant, realization, engine : str, str, int, str
    shape_zyx : sequence of int
        Voxels of the twin along z, y, x.
    voxel_size_um : float
    metrics : DataFrame
        As :func:`metrics_table` gives it; what it lacks stays empty.
    flow_method : str, optional
        Method behind the k columns.
    """
    row: dict[str, object] = dict.fromkeys(SUMMARY_COLUMNS)
    row.update(
        {
            name: as_float(value)
            for name, value in zip(metrics["metric"], metrics["value"], strict=True)
            if name in row
        }
    )
    row.update(
        sample=sample, variant=variant, realization=int(realization), engine=engine,
        voxel_size_um=float(voxel_size_um), flow_method=flow_method,
        **dict(zip(("shape_z", "shape_y", "shape_x"), map(int, shape_zyx), strict=True)),
    )  # fmt: skip
    table = pd.DataFrame([row], columns=list(SUMMARY_COLUMNS))
    return table.astype({"n_grains": "Int64"})


# ---- what each step gives


def packing_values(
    scene: Mapping,
    deficit: Mapping,
    second: Mapping,
    correction: Mapping,
    bodies: pd.DataFrame,
    phase: np.ndarray,
) -> dict[str, object]:
    """Porosities, counts and what the final scaling did, from the reports of the packing jobs.

    Parameters
    ----------
    scene, deficit, second, correction : mapping
        scene.json, deficit.json, second/packing.json, correction.json.
    bodies : DataFrame
        bodies.csv.
    phase : ndarray of uint8, (z, y, x)
        The twin; an open volume file will do.
    """
    counts = plane_counts(phase).sum(axis=0)
    before, after = correction["before"], correction["after"]
    return {
        "porosity": float(counts[0] / phase.size),
        "porosity_target": scene["porosity_target"],
        "porosity_first": deficit["porosity_first"],
        "porosity_second": before["porosity"],
        "n_grains": sum(bodies_within(bodies, scene).values()),
        "n_virtual": second["poured"] - second["poured_grains"],
        "p_sp": second["p_sp"],
        "voxels_per_grain": scene["mean_diameter_um"] / scene["voxel_size_um"],
        "cement_share": int(counts[len(scene["phases"]) :].sum()) / phase.size,
        "asleep": float(bodies["asleep"].mean()),
        "drift": second["rest"]["drift_mean"],
        "net_force": second["rest"]["net_force"],
        "packing_overlap": second["max_overlap"],
        "energy_rise": second["rest"]["energy_rise"],
        "scale_factor": correction["scale_factor"],
        **{f"{name}_before": before[name] for name in ("contacts", "euler")},
        **{f"{name}_after": after[name] for name in ("contacts", "euler")},
        "contact_area_before_um2": before["contact_area_um2"],
        "contact_area_after_um2": after["contact_area_um2"],
        "shared_before": before["shared_share"],
        "shared_after": after["shared_share"],
    }


def resettling_values(change: Mapping | None) -> dict[str, object]:
    """What became of the skeleton when it settled without its virtual spheres (resettling.json).

    Parameters
    ----------
    change : mapping or None
        None where the check was not run: empty figures.
    """
    keys = {"porosity": "porosity_after", "s2": "s2_change", "moved": "moved_share"}
    return {f"{name}_resettled": None if change is None else change[key] for name, key in keys.items()}


def bodies_within(bodies: pd.DataFrame, scene: Mapping) -> dict[int, int]:
    """Grains of each mineral in bodies.csv whose centres lie in the region, not in the margin about it."""
    own = within(bodies, scene["shape_zyx"], scene["voxel_size_um"])["phase"]
    return {int(phase): int(n) for phase, n in own.value_counts().sort_index().items()}


def within(bodies: pd.DataFrame, shape_zyx: Sequence[int], voxel_size_um: float) -> pd.DataFrame:
    """The bodies whose centres lie in a region; the others belong to the margin about it."""
    centre = bodies[["x", "y", "z"]].to_numpy(float)
    return bodies[((centre >= 0) & (centre < np.array(shape_zyx[::-1]) * voxel_size_um)).all(axis=1)]


FEWEST = 10
"""Objects of a section that tell what chance would give."""


def section_comparison(
    section_grains: pd.DataFrame | None,
    section_pores: pd.DataFrame | None,
    twin_grains: pd.DataFrame | None,
    twin_pores: pd.DataFrame | None,
    rng: np.random.Generator | None = None,
    repeats: int = 200,
    twin_bodies: Mapping[int, int] | None = None,
) -> dict[str, object]:
    """Wasserstein distances between what slices of the twin show and what the section shows.

    Parameters
    ----------
    section_grains, section_pores : DataFrame or None
        grains2d.csv and pores2d.csv of the section; border objects carry weight 0 and drop out.
    twin_grains, twin_pores : DataFrame or None
        The same, measured on slices of the twin.
    rng : numpy.random.Generator, optional
        Where given, each distance comes with a target: the 95 % quantile of the distance between two samples,
        of the two sizes at hand, both drawn from the section (what chance alone gives); none where the
        section shows fewer than :data:`FEWEST` objects, whose draws are all alike.
    repeats : int
        Draws behind that quantile.
    twin_bodies : mapping of int to int, optional
        Grains of the twin by mineral, as :func:`bodies_within` counts them. Slices closer than a grain cut
        the same ones, so its slices hold no more independent objects than that; without it every cut counts
        as one, and the target is too strict.

    Returns
    -------
    dict
        ``w1_grains_um``, ``w1_pores_um``, ``w1_aspect_ratio``, ``w1_circularity``, ``w1_solidity`` and, with
        several minerals, ``w1_grains_<i>_um``; ``None`` where either side is empty.
    """
    found: dict[str, object] = {}

    def compare(
        name: str,
        one: pd.DataFrame | None,
        two: pd.DataFrame | None,
        column: str,
        bodies: int | None = None if twin_bodies is None else sum(twin_bodies.values()),
    ) -> None:
        one, two = _weighted(one, column), _weighted(two, column)
        if one is None or two is None:
            found[name] = None
            return
        (a, wa), (b, wb) = one, two
        found[name] = scipy.stats.wasserstein_distance(a, b, wa, wb)
        if rng is not None and len(a) >= FEWEST:
            independent = len(b) if bodies is None else min(len(b), max(1, bodies))
            draws = [
                scipy.stats.wasserstein_distance(
                    rng.choice(a, len(a), p=wa / wa.sum()), rng.choice(a, independent, p=wa / wa.sum())
                )
                for _ in range(repeats)
            ]
            bound = float(np.quantile(draws, 0.95))
            found[f"{name}_target"] = (0.0, 0.0, bound)

    compare("w1_grains_um", section_grains, twin_grains, "r_um")
    if section_grains is not None and twin_grains is not None:
        minerals = sorted(set(section_grains["phase"]) | set(twin_grains["phase"]))
        if len(minerals) > 1:
            for i in minerals:
                of = [t[t["phase"] == i] for t in (section_grains, twin_grains)]
                own = None if twin_bodies is None else twin_bodies.get(int(i), 0)
                compare(f"w1_grains_{int(i)}_um", *of, "r_um", own)
    compare("w1_pores_um", section_pores, twin_pores, "r_um")
    for shape in ("aspect_ratio", "circularity", "solidity"):
        compare(f"w1_{shape}", section_grains, twin_grains, shape)
    return found


def _weighted(table: pd.DataFrame | None, column: str) -> tuple[np.ndarray, np.ndarray] | None:
    if table is None or column not in table:
        return None
    used = table[(table["weight"] > 0) & table[column].notna()]
    if used.empty:
        return None
    return used[column].to_numpy(float), used["weight"].to_numpy(float)


def flow_values(
    flow: pd.DataFrame | None, reference: pd.DataFrame | None = None, method: str | None = None
) -> dict[str, object]:
    """Permeability and formation factor per axis, with the reference by the same method, and K over the axes.

    Parameters
    ----------
    flow, reference : DataFrame or None
        flow.csv of the twin and of the reference: method, axis, k_md, formation_factor. A blocked axis has
        ``k_md`` 0 and stays 0: nothing percolates, which is a finding and not a gap.
    method : str, optional
        Method to use; the first row's if omitted.
    """
    found: dict[str, object] = {}
    if flow is None or flow.empty:
        return found
    method = method or str(flow["method"].iloc[0])
    for table, k_name in ((flow, "k_{}_md"), (reference, "k_ref_{}_md")):
        if table is None:
            continue
        of_method = table[table["method"] == method].set_index("axis")
        for axis in "xyz":
            found[k_name.format(axis)] = of_method["k_md"].get(axis)
            if table is flow and "formation_factor" in of_method:
                found[f"formation_factor_{axis}"] = of_method["formation_factor"].get(axis)
    along = np.array([found[f"k_{axis}_md"] for axis in "xyz"], float)
    if not np.isnan(along).any():
        found["k_md"] = along.mean(), along.min(), along.max()
    return found


def plane_counts(
    phase: np.ndarray,
    slab: int = 128,
    *,
    body: np.ndarray | None = None,
    shown: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None,
) -> np.ndarray:
    """Voxels of each phase in each plane of a volume.

    Parameters
    ----------
    phase : (z, y, x) ndarray of uint8
        An open volume file will do.
    slab : int
        Planes read at once.
    body : (z, y, x) ndarray of int, optional
        Body of each voxel, likewise.
    shown : callable, optional
        (phase, body) of a slab to the phases that are counted in their place.

    Returns
    -------
    (z, 256) ndarray of int
    """
    counts = np.zeros((len(phase), 256), np.int64)
    for z in range(0, len(phase), slab):
        part = phase[z : z + slab]
        # counting makes integers of eight bytes of what it counts
        for plane, own in zip(
            part if shown is None else shown(part, body[z : z + slab]), counts[z:], strict=False
        ):
            own += np.bincount(plane.ravel(), minlength=256)
    return counts


def phase_values(
    twin_phase: np.ndarray, section_phase: np.ndarray, blocks: int = 4, **shown
) -> dict[str, object]:
    """Share of each mineral in the solid of the twin, with the section's share ± 2 standard errors as target.

    The standard error is that of both: it comes from ``blocks`` × ``blocks`` tiles of the section and
    ``blocks`` slabs of the twin, whose spread holds the spatial correlation that counting pixels would
    ignore.

    Parameters
    ----------
    twin_phase : ndarray of uint8, (z, y, x)
        An open volume file will do.
    section_phase : ndarray of uint8, (y, x)
    blocks : int
    **shown
        As :func:`plane_counts` takes them: a section shows rims as the mineral that they grew on.
    """
    minerals = range(1, int(section_phase.max()) + 1)
    if len(minerals) < 2:
        return {}
    found: dict[str, object] = {}
    planes = plane_counts(twin_phase, **shown)
    slabs = np.array([part.sum(axis=0) for part in np.array_split(planes, min(blocks, len(planes)))], float)
    twin_solid = slabs[:, 1 : minerals.stop].sum(axis=1)
    tiles = [t for rows in np.array_split(section_phase, blocks, 0) for t in np.array_split(rows, blocks, 1)]
    counts = np.array([np.bincount(t.ravel(), minlength=256)[: minerals.stop] for t in tiles], float)
    solid = counts[:, 1:].sum(1)
    for i in minerals:
        own, own_error = ratio_of_sums(slabs[:, i], twin_solid)
        share, error = ratio_of_sums(counts[:, i], solid)
        both = 2 * float(np.hypot(error, own_error))
        found[f"phase_fraction_{i}"] = own
        found[f"phase_fraction_{i}_target"] = (share, share - both, share + both)
    return found


def surface_values(twin: SolidSurface, section: SolidSurface) -> dict[str, object]:
    """Surface of the twin's solid by its volume, with the section's ± 2 standard errors of both as target.

    Parameters
    ----------
    twin, section : SolidSurface
        On voxels and pixels of one size.
    """
    aim, error = section.per_um, float(np.hypot(twin.error, section.error))
    if not np.isfinite([twin.per_um, aim, error]).all():
        return {"solid_surface_per_um": None}
    target = (aim, aim - 2 * error, aim + 2 * error)
    return {"solid_surface_per_um": twin.per_um, "solid_surface_per_um_target": target}


def envelope_values(test: Mapping) -> dict[str, float]:
    """What s2_envelope.json says of the section; one window is no more than the test itself."""
    found = {"s2_inside_envelope": test["inside"], "s2_envelope_p": test["p"]}
    return found if test["n_windows"] == 1 else {**found, "s2_windows_rejected": test["windows_rejected"]}


def sampling_values(section_phase: np.ndarray, porosity_source: str) -> dict[str, object]:
    """What the section itself leaves open, however good the twins are, and how far it lies aligned.

    Parameters
    ----------
    section_phase : ndarray of uint8, (y, x)
    porosity_source : str
        As in scene.json: a porosity that was given is not the section's to be uncertain of.
    """
    errors = sampling_errors(section_phase)
    areal, lies = porosity_source.startswith("areal"), alignment(section_phase)
    return {
        "porosity_sampling_error": errors.porosity if areal else None,
        "k_sampling_error": errors.k if areal else errors.k_at_porosity,
        "section_alignment": lies.ratio,
        "section_alignment_deg": lies.along_deg,
        "section_alignment_p": lies.p,
    }


NETWORK_METRICS = {
    "throat_radius_um": "w1_network_throats_um",
    "coordination": "w1_network_coordination",
}
"""Element sizes of a pore network that are compared by number, and the metric of each."""


def network_values(
    sizes: Mapping[str, np.ndarray] | None, reference: Mapping[str, np.ndarray] | None = None
) -> dict[str, object]:
    """Counts of a pore network and the Wasserstein distances of its size distributions to the reference's.

    Parameters
    ----------
    sizes, reference : mapping or None
        As :func:`grainfall.network.element_sizes` gives them.
    """
    if sizes is None:
        return {}
    found: dict[str, object] = {
        "n_pores": len(sizes["pore_radius_um"]),
        "n_throats": len(sizes["throat_radius_um"]),
    }
    if reference is None:
        return found
    from grainfall import network  # it loads numba, which no other table needs

    found["w1_network_pores_um"] = network.pore_size_distance(sizes, reference)
    for kind, name in NETWORK_METRICS.items():
        both = len(sizes[kind]) and len(reference[kind])
        found[name] = scipy.stats.wasserstein_distance(sizes[kind], reference[kind]) if both else None
    return found


def accuracy_values(asked: Mapping, errors: Mapping[str, float]) -> dict[str, object]:
    """The error in what the config's ``accuracy`` asks for, with what was expected and asked as its target.

    Parameters
    ----------
    asked : mapping
        metric, tolerance, expected (mean error of the preset, as measured before).
    errors : mapping
        Metric to the twin's own error; none where there is no 3D reference to tell it by.
    """
    error = errors.get(asked["metric"])
    return {
        "accuracy_error": None if error is None else abs(error),
        "accuracy_error_target": (asked["expected"], 0.0, asked["tolerance"]),
    }
