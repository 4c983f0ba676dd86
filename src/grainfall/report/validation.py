"""The validation cases: what the paper says, what the truth is, what the twins are, with intervals.

A case is a study of its own config (``config/cases``). Whatever of its twins is finished is gathered; so a
page can be made of a study that still runs, and ``n`` says of how many twins.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
import scipy  # its stats take half a second to load, and do so when they are first used

from grainfall import correlation, io, network, surface
from grainfall.errors import InputError
from grainfall.report.ensembles import read_costs, t_interval
from grainfall.volume import size_factor

COLUMNS = ("case", "variant", "quantity", "unit", "paper", "truth", "mean", "lower", "upper", "n", "sections")
"""Columns of results/validation.csv: ``n`` twins or volumes, of so many ``sections``."""

PAPER: dict[tuple[str, str, str], float] = {
    ("stereology", "truth", "porosity"): 0.227,
    ("stereology", "full", "porosity"): 0.227,
    ("stereology", "no_inversion", "porosity"): 0.227,
    ("stereology", "truth", "k_md"): 1080,
    ("stereology", "full", "k_md"): 1272,
    ("stereology", "no_inversion", "k_md"): 559,
    ("virtual_spheres", "truth", "porosity"): 0.4304,
    ("virtual_spheres", "full", "porosity"): 0.4306,
    ("virtual_spheres", "full", "porosity_first"): 0.2339,
    ("virtual_spheres", "grains_only", "porosity"): 0.2339,
    ("virtual_spheres", "truth", "k_md"): 3305,
    ("virtual_spheres", "full", "k_md"): 2861,
    ("virtual_spheres", "grains_only", "k_md"): 1062,
    ("xct", "truth", "porosity"): 0.3319,
    ("xct", "full", "porosity"): 0.3325,
    ("xct", "full", "porosity_first"): 0.2415,
    ("xct", "full", "k_md"): 1183,
    ("xct", "tomogram", "k_md"): 1284,
}
"""The paper's single numbers, where it gives one (its results section)."""
for _case, _truth in (("stereology", 1080), ("virtual_spheres", 3305)):
    PAPER |= {
        (_case, variant, "k_ratio"): value / _truth
        for (case, variant, quantity), value in list(PAPER.items())
        if case == _case and quantity == "k_md" and variant != "truth"
    }
PAPER["stereology", "no_inversion", "k_of_full"] = 559 / 1272
PAPER["virtual_spheres", "grains_only", "k_of_full"] = 1062 / 2861

BEREA_PUBLISHED_MD = 1630.0
"""Published mean Stokes permeability of the 27 cubes of 128^3 voxels of Berea, three directions."""


CUBES = "cube_*"
"""Folders of a sample's further reference cubes."""

MEASURED = (
    "reference_flow.csv",
    "reference_s2.csv",
    "reference_network_pores.csv",
    "reference_network_throats.csv",
)
"""What a volume that twins are held against is measured by; it counts where all of it is there."""

ENVELOPE, REFERENCE_ENVELOPE = "s2_envelope.json", "reference_envelope.json"
"""The envelope test of a section among slices of its twins, and of its own truth."""

NEARER = {
    "no_inversion": ("w1_f3d", "s2_gap"),
    "grains_only": ("s2_gap", "w1_pores", "k_ratio"),
    "touching": ("surface_ratio", "k_ratio"),
    "round": ("pore_r95_ratio", "w1_pores", "k_ratio"),
    "tomogram": ("s2_gap", "w1_pores", "k_ratio"),
}
"""What the full method is to come nearer to the truth in than these variants do."""


@dataclass(frozen=True)
class Quantity:
    """What a row of the table is about."""

    label: str
    unit: str = "1"
    signed: bool = False
    """Whether it may be negative; the interval of what cannot be ends at 0."""
    share: bool = False
    """Whether it is one; its interval ends at 1."""


QUANTITIES: dict[str, Quantity] = {
    "porosity": Quantity("porosity"),
    "porosity_first": Quantity("porosity of the first packing (grains alone)"),
    "porosity_miss": Quantity("largest distance of a twin's porosity from its target"),
    "porosity_section": Quantity("porosity of the one section that the workflow saw"),
    "grains_section": Quantity("whole grains that the section shows, of the mineral with the fewest"),
    "porosity_any_slice": Quantity("porosity of one slice, all slices of the volume (2.5 to 97.5 %)"),
    "k_any_slice": Quantity(
        "K if one slice's porosity were the target, over K (Kozeny-Carman, 2.5 to 97.5 %)"
    ),
    "surface_section": Quantity("surface of the solid by its volume, the section's over the truth's"),
    "surface_any_slice": Quantity(
        "surface of the solid by its volume, one slice's over the volume's, all slices (2.5 to 97.5 %)"
    ),
    "k_any_slice_surface": Quantity(
        "K if one slice's surface were the volume's, over K (Kozeny-Carman, 2.5 to 97.5 %)"
    ),
    "cement_share": Quantity("cement, share of the volume"),
    "surface_ratio": Quantity("specific surface over the truth's, both from the slope of S₂"),
    "k_md": Quantity("permeability, mean of three axes", "mD"),
    "k_x_md": Quantity("permeability along x", "mD"),
    "k_y_md": Quantity("permeability along y", "mD"),
    "k_z_md": Quantity("permeability along z", "mD"),
    "k_ratio": Quantity("permeability over the truth's"),
    "k_z_over_xy": Quantity("permeability along z, the way the grains fell, over that along x and y"),
    "formation_factor": Quantity("formation factor, mean of three axes"),
    "f_ratio": Quantity("formation factor over the truth's"),
    "k_of_full": Quantity("permeability over that of the full method, the same numbers drawn for both"),
    "k_over_r2": Quantity("permeability over the squared mean grain radius", "mD/µm²"),
    "k_over_r2_ratio": Quantity("the same over the truth's"),
    "k_over_rs2_ratio": Quantity(
        "permeability over the squared Sauter (volume to surface) radius, over the truth's"
    ),
    "k_at_equal_n": Quantity(
        "permeability over the truth's, both scaled to equally many grains in a volume (size taken out)"
    ),
    "k_at_equal_surface": Quantity(
        "permeability over the truth's, times the square of the section's surface over the truth's (what the "
        "section shows too much or too little of taken out, Kozeny-Carman)"
    ),
    "n_ratio": Quantity("grains in a volume over the truth's"),
    "r_mean_ratio": Quantity("mean 3D grain radius over the truth's"),
    "rs_ratio": Quantity("Sauter (volume to surface) radius of the grains over the truth's"),
    "w1_f3d": Quantity("3D grain radii, Wasserstein distance to the truth over its mean"),
    "s2_gap": Quantity("S₂ in 3D, largest distance to the truth's; truth: one of its cubes to the others"),
    "pore_r_um": Quantity("network pore radius, mean by pore volume", "µm"),
    "pore_r95_um": Quantity("network pore radius below which 95 % of the pore volume lies", "µm"),
    **{
        f"pore_r{share}_ratio": Quantity(f"network pore radius ({share} % by pore volume) over the truth's")
        for share in (25, 50, 75, 95)
    },
    "pore_median_ratio": Quantity("network pore radius (median by number, linked pores) over the truth's"),
    "circle_r95_um": Quantity(
        "pore circles on slices, radius below which 95 % of their area lies; truth: the section's",
        "µm",
    ),
    "throat_r_um": Quantity("network throat radius, mean", "µm"),
    "w1_pores": Quantity(
        "network pore radii by volume, Wasserstein distance to the truth over its mean; truth: one of its "
        "cubes to the others"
    ),
    "s2_envelope_p": Quantity(
        "envelope test of the section's S₂ among slices, p (median of sections; least and largest); "
        "section: of its truth"
    ),
    "s2_windows_rejected": Quantity(
        "envelope test of every window of the section, share told from slices; truth: from slices of the "
        "truth, or where they are alike",
        share=True,
    ),
    "s2_windows_excess": Quantity("the same, less the share told from slices of the truth", signed=True),
    "lost_support": Quantity("grains that lost support with the virtual spheres, share of all", share=True),
    "resettled_porosity": Quantity(
        "change of the bed's porosity where it settles anew under gravity without its spheres", signed=True
    ),
    "resettled_s2": Quantity("S₂ in 3D, largest change by that"),
    "resettled_moved": Quantity("grains that it moves by more than 0.1 radii, share of all", share=True),
    "cpu_s": Quantity("CPU time of a twin, all its jobs", "s"),
    "first_packing_cpu_s": Quantity("CPU time of its first packing", "s"),
    "second_packing_cpu_s": Quantity("CPU time of its second packing", "s"),
    "phantom": Quantity("phantom pores: solid taken for pore, share of the solid", share=True),
}
QUANTITIES |= {
    f"{name}_nearer": Quantity(
        f"{QUANTITIES[name].label}: by how much nearer to the truth the full method's is", signed=True
    )
    for name in dict.fromkeys(name for names in NEARER.values() for name in names)
}
"""Every quantity of the table by its name there."""


def describe(quantity: str) -> Quantity:
    """Label and unit of a quantity; those of the sweep carry their CV in the name.

    Raises
    ------
    KeyError
        For a quantity without words.
    """
    base, _, cv = quantity.partition("@cv")
    known = QUANTITIES[base]
    return replace(known, label=f"{known.label}, CV {cv}") if cv else known


# ---- what a twin is


def gather(results: str | Path, cases: Mapping[str, Mapping]) -> tuple[pd.DataFrame, list[str]]:
    """Every figure of every finished twin of the cases, one a row.

    Parameters
    ----------
    results : path
    cases : mapping
        Case to ``{"samples": [...], "variants": [...]}``.

    Returns
    -------
    figures : DataFrame
        case, sample, variant, realization (-1: of all its twins), quantity, value, truth.
    left_out : list of str
        Samples whose files are damaged, or of another version, and what is wrong with them.
    """
    root, rows, left_out = Path(results), [], []
    for case, study in cases.items():
        if case == "cv_sweep":
            rows += _of_sweep(root)
            continue
        for sample in study["samples"]:
            try:
                rows += _of_sample(case, root / sample, study["variants"])
            except InputError as fault:
                left_out.append(f"{case}, {sample}: {fault}")
            except KeyError as fault:
                left_out.append(f"{case}, {sample}: no {fault} in its files, as of another version")
    columns = ["case", "sample", "variant", "realization", "quantity", "value", "truth"]
    return pd.DataFrame(rows, columns=columns).astype({"value": float, "truth": float}), left_out


def _of_sample(case: str, sample: Path, variants: Sequence[str]) -> list[tuple]:
    """Rows of one sample's twins, and of what they are held against."""
    twins, truth = [], _truth(sample)
    for variant in variants:
        own = [
            (variant, int(path.parent.name), _of_twin(path.parent, truth))
            for path in sorted((sample / variant).glob("*/metrics.csv"))
        ]
        twins += own
        if own:
            twins.append(
                (variant, -1, _of_envelope(sample / variant / ENVELOPE, sample / REFERENCE_ENVELOPE))
            )
    if not twins:
        return []
    held = twins[0][2]["porosity"][1]
    seen = section_surface_ratio(sample / twins[0][0], truth)
    twins += [
        ("truth", -1, _of_truth(truth, held)),
        ("section", -1, _of_section(sample, held, seen)),
        ("tomogram", -1, _of_tomogram(sample)),
    ]
    rows = [
        (case, sample.name, variant, realization, quantity, value, aim)
        for variant, realization, found in twins
        for quantity, (value, aim) in found.items()
        if value is not None
    ]
    return rows + _paired(case, sample.name, twins) + _nearer(case, sample.name, twins)


def _paired(case: str, sample: str, twins: Sequence) -> list[tuple]:
    """K of every other variant over that of ``full``, realization by realization."""
    k = {(variant, n): found["k_md"][0] for variant, n, found in twins if n >= 0}
    return [
        (case, sample, variant, n, "k_of_full", value / k["full", n], None)
        for (variant, n), value in k.items()
        if variant != "full" and k.get(("full", n))
    ]


def _nearer(case: str, sample: str, twins: Sequence) -> list[tuple]:
    """By how much nearer to the truth a twin of the full method is than one of another variant: means of
    their distances over the realizations that both have. A mean of twins would be nearer than any of them."""
    found = {(variant, n): figures for variant, n, figures in twins}
    full = {n: figures for (variant, n), figures in found.items() if variant == "full" and n >= 0}
    rows = []
    for other, quantities in NEARER.items():
        # a tomogram has no realizations
        pairs = [(own, found.get((other, -1 if other == "tomogram" else n), {})) for n, own in full.items()]
        for quantity in quantities:
            values = [[figures.get(quantity, (None,))[0] for figures in pair] for pair in pairs]
            values = np.array(values, float).reshape(-1, 2)
            values = values[~np.isnan(values).any(axis=1)]
            if len(values):
                aim = 1.0 if quantity.endswith("_ratio") else 0.0
                own, others = np.abs(values - aim).mean(axis=0)
                rows.append((case, sample, other, -1, f"{quantity}_nearer", others - own, 0.0))
    return rows


def _truth(sample: Path) -> dict:
    """What is known of the rock itself: its 3D reference, where it has one, and its grains."""
    found = _of_references([sample, *sorted(sample.glob(CUBES))])
    if (sample / "truth_sizes.csv").exists():
        found["grains"] = io.read_table(sample / "truth_sizes.csv")
    return found


def _of_references(folders: Sequence[Path]) -> dict:
    """Cubes of one rock, as far as they are measured: means, the pores of all, and how alike they are."""
    cubes = [folder for folder in folders if all((folder / name).exists() for name in MEASURED)]
    if not cubes:
        return {}
    k = [_flow(folder / "reference_flow.csv") for folder in cubes]
    curves = [mean_s2(folder / "reference_s2.csv") for folder in cubes]
    sizes = [network_sizes(folder / "reference_network") for folder in cubes]
    s2 = _mean_curve(curves)
    return {
        "k": {
            method: {along: float(np.mean([of[method][along] for of in k])) for along in of_first}
            for method, of_first in k[0].items()
            if all(method in of for of in k)
        },
        "s2": s2,
        "porosity": 1 - float(s2[1][0]),
        "sizes": network.pooled_sizes(sizes),
        "alike": _alike(curves, sizes),
    }


def _mean_curve(curves: Sequence[tuple]) -> tuple[np.ndarray, np.ndarray]:
    """Mean of curves of the same lags."""
    return curves[0][0], np.mean([values for _, values in curves], axis=0)


def _alike(curves: Sequence[tuple], sizes: Sequence[Mapping]) -> dict[str, tuple]:
    """Distances of one cube of a rock to its others, mean over the cubes: what a perfect twin has of them."""
    if len(sizes) < 2:
        return {}
    found = []
    for i, (curve, own) in enumerate(zip(curves, sizes, strict=True)):
        others = network.pooled_sizes([*sizes[:i], *sizes[i + 1 :]])
        gap, _ = _s2_gap(curve, {"s2": _mean_curve([*curves[:i], *curves[i + 1 :]])})
        found.append({"s2_gap": gap, "w1_pores": _pore_figures(own, others).get("w1_pores", (None,))[0]})
    means = pd.DataFrame(found, dtype=float).mean().dropna()
    return {quantity: (value, 0.0) for quantity, value in means.items()}


def _flow(path: Path) -> dict[str, dict[str, float]]:
    """K by axis, its mean and that of the formation factor, by each method of a flow table, in its order."""
    found = {}
    for method, rows in io.read_table(path).groupby("method", sort=False):
        along = rows.set_index("axis").reindex(index=list("xyz"), columns=["k_md", "formation_factor"])
        k, factor = along.astype(float).to_numpy().T
        found[method] = {
            "k_md": float(k.mean()),
            **{f"k_{axis}_md": float(of) for axis, of in zip("xyz", k, strict=True)},
            "formation_factor": float(factor.mean()),
        }
    return found


def _fall_ratio(k: Mapping) -> float | None:
    """K along z, the way the grains fell, over the mean of that along x and y."""
    return _over(k["k_z_md"], (k["k_x_md"] + k["k_y_md"]) / 2) if k else None


def _flow_figures(k: Mapping, k_ref: Mapping) -> dict[str, tuple]:
    """What one method of flow says, beside the truth by the same one, as far as that was measured."""
    return {
        **{quantity: (value, k_ref.get(quantity)) for quantity, value in k.items()},
        "k_ratio": (_over(k["k_md"], k_ref.get("k_md")), 1.0),
        "k_z_over_xy": (_fall_ratio(k), _fall_ratio(k_ref)),
        "f_ratio": (_over(k["formation_factor"], k_ref.get("formation_factor")), 1.0),
    }


def _over(value: float, aim: float | None) -> float | None:
    """A ratio; none to nothing."""
    return value / aim if aim else None


def mean_s2(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Lags and S2, mean of the three axes, of an S2 table."""
    return correlation.along_axes(io.read_table(path))


def network_sizes(stem: Path) -> dict[str, np.ndarray]:
    """Sizes of a network, by its path without what tells pores from throats."""
    return network.element_sizes(network.load(f"{stem}_pores.csv", f"{stem}_throats.csv"))


def _pore_figures(sizes: Mapping, other: Mapping | None) -> dict[str, tuple]:
    if not len(sizes["pore_radius_um"]) or not len(sizes["throat_radius_um"]):
        return {}

    def of(measure):
        return (measure(sizes), measure(other) if other else None)

    found = {
        "pore_r_um": of(network.mean_pore_radius),
        "pore_r95_um": of(lambda of: network.pore_radius_quantile(of, 0.95)),
        "throat_r_um": of(lambda of: of["throat_radius_um"].mean()),
    }
    if other:
        for share in (25, 50, 75, 95):
            own, aim = (network.pore_radius_quantile(of, share / 100) for of in (sizes, other))
            found[f"pore_r{share}_ratio"] = (own / aim, 1.0)
        found["pore_median_ratio"] = (
            np.median(sizes["pore_radius_um"]) / np.median(other["pore_radius_um"]),
            1.0,
        )
        distance = network.pore_size_distance(sizes, other)
        found["w1_pores"] = (distance / network.mean_pore_radius(other), 0.0)
    return found


def _circle_tail(path: Path) -> float | None:
    """Radius below which 95 % of the area of a section's uncut pore circles lies."""
    table = io.read_table(path)
    area = table["weight"] * table["r_um"] ** 2
    if not area.sum():
        return None
    return float(np.quantile(table["r_um"], 0.95, weights=area, method="inverted_cdf"))


def _surface_ratio(metrics: Mapping, truth: Mapping) -> float | None:
    own = metrics.get("specific_surface_per_um")
    return None if pd.isna(own) or "s2" not in truth else own / correlation.surface_from_s2(*truth["s2"])


def section_surface_ratio(variant: Path, truth: Mapping) -> float | None:
    """Surface of the solid by its volume, a section's over the truth's, where both are seen on one spacing.

    The truth's by the first step of its S2, which is the share of neighbouring voxels that differ: as a
    section's by the crossings of its lines (:func:`grainfall.surface.specific_surface`).

    Parameters
    ----------
    variant : path
        Folder with section_surface.json and scene.json.
    truth : mapping
        ``s2``: (lags, values) of the solid, mean of the axes.
    """
    if "s2" not in truth:
        return None
    lags, s2 = truth["s2"]
    if not np.isclose(lags[1], io.read_json(variant / "scene.json")["resolution_um"]):
        return None
    own = io.read_json(variant / "section_surface.json")["per_um"]
    return own / (4 * (s2[0] - s2[1]) / lags[1] / s2[0])


def _s2_gap(curve: tuple, truth: Mapping) -> tuple:
    if "s2" not in truth:
        return (None, None)
    lags, values = truth["s2"]
    seen = lags <= curve[0].max()
    return (float(np.abs(np.interp(lags[seen], *curve) - values[seen]).max()), 0.0)


def _of_twin(folder: Path, truth: Mapping) -> dict[str, tuple]:
    """Quantity to (value, truth) of one twin; no truth of flow and network that were measured otherwise."""
    metrics = io.read_table(folder / "metrics.csv").set_index("metric")["value"]
    scene = io.read_json(folder.parent / "scene.json")
    target = scene["porosity_target"]
    # a target that was held is the truth's; one that the section gave is to be judged by it
    held = truth.get("porosity", target) if scene["porosity_source"].startswith("areal") else target
    method, k = next(iter(_flow(folder / "flow.csv").items()))
    k_ref = truth.get("k", {}).get(method, {}) if pd.notna(metrics.get("k_ref_x_md")) else {}
    k_ratio, seen = _over(k["k_md"], k_ref.get("k_md")), section_surface_ratio(folder.parent, truth)
    sizes = truth.get("sizes") if pd.notna(metrics.get("w1_network_throats_um")) else None
    found: dict[str, tuple] = {
        "porosity": (metrics["porosity"], held),
        "porosity_first": (metrics["porosity_first"], None),
        "porosity_miss": (abs(metrics["porosity"] - target), 0.0),
        "cement_share": (metrics.get("cement_share"), None),
        "surface_ratio": (_surface_ratio(metrics, truth), 1.0),
        **_flow_figures(k, k_ref),
        # at one porosity K goes as the inverse square of the solid's surface by its volume
        "k_at_equal_surface": (k_ratio and seen and k_ratio * seen**2, 1.0),
        "s2_gap": _s2_gap(mean_s2(folder / "s2_volume.csv"), truth),
        **_pore_figures(network_sizes(folder / "network"), sizes),
        "circle_r95_um": (
            _circle_tail(folder / "pores2d.csv"),
            _circle_tail(folder.parent / "section_pores2d.csv"),
        ),
        "lost_support": (metrics.get("lost_support"), None),
        **_resettled_figures(folder / "resettling.json"),
        **_cost_figures(folder),
    }
    if "grains" in truth and k_ratio is not None:
        bodies = io.read_table(folder / "bodies.csv")
        bodies["scale"] /= size_factor(io.read_json(folder / "cement.json"))
        found |= _grain_figures(bodies[bodies["kind"] == "grain"], truth["grains"], k["k_md"], k_ref["k_md"])
        # everything scales with the distance of the grains: K times the 2/3 power of their number does not
        box = (4 / 3 * np.pi * truth["grains"]["r_um"] ** 3).sum() / (1 - held)
        n = metrics["n_grains"] / (np.prod(scene["shape_zyx"]) * scene["voxel_size_um"] ** 3)
        n_ratio = n / (len(truth["grains"]) / box)
        found |= {
            "n_ratio": (n_ratio, 1.0),
            "k_at_equal_n": (k_ratio * n_ratio ** (2 / 3), 1.0),
        }
    return found


def _resettled_figures(path: Path) -> dict[str, tuple]:
    """What gravity did to the skeleton without its spheres, where that was tried."""
    if not path.exists():
        return {}
    change = io.read_json(path)
    return {
        "resettled_porosity": (change["porosity_after"] - change["porosity_before"], 0.0),
        "resettled_s2": (change["s2_change"], 0.0),
        "resettled_moved": (change["moved_share"], 0.0),
    }


def _cost_figures(folder: Path) -> dict[str, tuple]:
    """What a twin's jobs took, by their benchmark files."""
    costs = read_costs(sorted(folder.glob("benchmarks/*.tsv"))).set_index("rule")["cpu_s"]
    packings = {f"{rule}_cpu_s": (costs.get(rule), None) for rule in ("first_packing", "second_packing")}
    return {"cpu_s": (costs.sum(min_count=1), None), **packings}


def _grain_figures(bodies: pd.DataFrame, grains: pd.DataFrame, k: float, k_ref: float) -> dict[str, tuple]:
    """Sizes by mineral, weighted as the truth has the minerals; K over the squared mean radius of all."""
    ratios, distances, shares = [], [], []
    for phase, true in grains.groupby("phase")["r_um"]:
        own = bodies.loc[bodies["phase"] == phase, "scale"]
        ratios.append(own.mean() / true.mean())
        distances.append(scipy.stats.wasserstein_distance(own, true) / true.mean())
        shares.append(len(true))
    r, r_ref = bodies["scale"].mean(), grains["r_um"].mean()
    sauter, sauter_ref = ((of**3).sum() / (of**2).sum() for of in (bodies["scale"], grains["r_um"]))
    return {
        "rs_ratio": (sauter / sauter_ref, 1.0),
        "r_mean_ratio": (np.average(ratios, weights=shares), 1.0),
        "w1_f3d": (np.average(distances, weights=shares), 0.0),
        "k_over_r2": (k / r**2, k_ref / r_ref**2),
        "k_over_r2_ratio": (k / r**2 / (k_ref / r_ref**2), 1.0),
    }


def _of_truth(truth: Mapping, held: float) -> dict[str, tuple]:
    if not truth.get("k"):
        return {}
    k = next(iter(truth["k"].values()))
    own = {**k, "k_z_over_xy": _fall_ratio(k)}
    return {
        "porosity": (truth["porosity"], held),
        **{quantity: (value, value) for quantity, value in own.items()},
        **{q: (value, value) for q, (value, _) in _pore_figures(truth["sizes"], None).items()},
        **truth["alike"],
    }


def _of_envelope(path: Path, of_truth: Path | None = None) -> dict[str, tuple]:
    """The envelope test of a section among slices of all twins of a variant, its tomogram or its truth.

    One window's p is in part that window's luck, and windows of a rock scatter more than slices of a few
    volumes of one porosity: how many are told from slices of the truth itself, seen in windows of the same
    size, is what there is to be reached.
    """
    if not path.exists():
        return {}
    test = io.read_json(path)
    alike = io.read_json(of_truth) if of_truth and of_truth.exists() else None
    if alike and alike["window_um"] != test["window_um"]:
        alike = None  # larger windows scatter less
    found = {"s2_envelope_p": (test["p"], alike["p"] if alike else None)}
    if test["n_windows"] > 1:
        told, aim = test["windows_rejected"], alike["windows_rejected"] if alike else test["alpha"]
        found["s2_windows_rejected"] = (told, aim)
        if alike:
            found["s2_windows_excess"] = (told - aim, 0.0)
    return found


def _of_section(sample: Path, held: float, seen: float | None) -> dict[str, tuple]:
    grains = io.read_table(sample / "grains2d.csv")
    whole = grains[grains["weight"] > 0].groupby("phase").size()
    return {
        "porosity_section": (io.read_json(sample / "section.json")["porosity"], held),
        "grains_section": (whole.min() if len(whole) else None, None),
        "surface_section": (seen, 1.0),
        **_of_envelope(sample / REFERENCE_ENVELOPE),
    }


def _of_tomogram(sample: Path) -> dict[str, tuple]:
    """The tomogram, where there is one, against the very cube that it was taken of."""
    folder, truth = sample / "tomogram", _of_references([sample])
    if not truth or not all((folder / name).exists() for name in (*MEASURED, "tomogram.json")):
        return {}
    about = io.read_json(folder / "tomogram.json")
    method, k = next(iter(_flow(folder / MEASURED[0]).items()))
    k_ref = truth["k"].get(method, {})
    return {
        "porosity": (about["porosity"], truth["porosity"]),
        "phantom": (about["phantom"], 0.0),
        **_flow_figures(k, k_ref),
        "s2_gap": _s2_gap(mean_s2(folder / "reference_s2.csv"), truth),
        **_pore_figures(network_sizes(folder / "reference_network"), truth["sizes"]),
        **_of_envelope(folder / ENVELOPE, sample / REFERENCE_ENVELOPE),
    }


def size_bias(results: str | Path) -> pd.DataFrame:
    """Packs of the study of size bias over their truths, whose K is the mean of cubes.

    Returns
    -------
    DataFrame
        cv, truth, variant, realization, then ratios: r_mean_ratio and k_ratio, k_of_full (to the pack with
        the inversion), K over the square of the mean radius and over that of the Sauter radius.
    """
    tables = []
    for path in sorted((Path(results) / "cv_sweep").glob("*/*/truth.csv")):
        true = io.read_table(path).mean(numeric_only=True)
        packs = [io.read_table(p) for p in sorted(path.parent.glob("*.csv")) if p.stem.isdigit()]
        if packs:
            own = pd.concat(packs, ignore_index=True)
            full = own[own["variant"] == "full"].set_index("realization")["k_md"].replace(0, np.nan)
            ratio = own["k_md"] / (true["k_md"] or np.nan)
            found = own[["variant", "realization"]].assign(
                r_mean_ratio=own["r_um"] / true["r_um"],
                k_ratio=ratio,
                k_of_full=own["k_md"] / own["realization"].map(full),
                k_over_r2_ratio=ratio * (true["r_um"] / own["r_um"]) ** 2,
                k_over_rs2_ratio=ratio * (true["r_sauter_um"] / own["r_sauter_um"]) ** 2,
            )
            found.loc[own["variant"] == "full", "k_of_full"] = np.nan
            cv, truth = path.parts[-3:-1]
            tables.append(found.assign(cv=float(cv), truth=int(truth)))
    return pd.concat(tables, ignore_index=True) if tables else pd.DataFrame()


def _of_sweep(root: Path) -> list[tuple]:
    """Ratios of the study of size bias, by CV."""
    ratios = size_bias(root)
    if ratios.empty:
        return []
    long = ratios.melt(["cv", "truth", "variant", "realization"], var_name="quantity").dropna()
    long["aim"] = np.where(long["quantity"] == "k_of_full", np.nan, 1.0)
    long["quantity"] += long["cv"].map("@cv{:g}".format)
    long["sample"] = long["truth"].map("truth_{}".format)
    columns = ["sample", "variant", "realization", "quantity", "value", "aim"]
    return [("cv_sweep", *row) for row in long[columns].itertuples(index=False, name=None)]


def slice_porosities(phase: np.ndarray) -> np.ndarray:
    """Porosity of every plane of a volume, along its three axes."""
    pore = phase == 0
    return np.concatenate([pore.mean(axis=tuple(a for a in range(3) if a != axis)) for axis in range(3)])


def slice_surfaces(phase: np.ndarray) -> np.ndarray:
    """Surface of the solid by its volume, by 1 / voxel, of every plane of a volume, along its three axes."""
    return np.array(
        [
            surface.solid_surface(plane, 1.0).per_um
            for axis in range(3)
            for plane in np.moveaxis(phase, axis, 0)
        ]
    )


# ---- the table


def aggregate(figures: pd.DataFrame) -> pd.DataFrame:
    """Means with 95 % intervals.

    Where there are several sections they are what was drawn independently: twins of one section are averaged
    first and the t-interval is over sections. With a single one it is over its twins, and says nothing of
    others. Sections of one volume share its truth, which counts once. The largest distance from a target is
    the largest, not a mean; of p-values it is their median, the bounds the least and the largest.

    Parameters
    ----------
    figures : DataFrame
        As :func:`gather` gives it; figures that are NaN count for nothing.

    Returns
    -------
    DataFrame
        :data:`COLUMNS`.
    """
    rows = []
    figures = _each_truth_once(figures.dropna(subset="value"))
    for (case, variant, quantity), group in figures.groupby(["case", "variant", "quantity"], sort=False):
        known = describe(quantity)
        by_section = group.groupby("sample")[["value", "truth"]].mean()
        n, sections = len(group), len(by_section)
        values = (by_section if sections > 1 else group)["value"].to_numpy(float)
        _, mean, lower, upper = t_interval(values)
        if quantity == "porosity_miss":
            mean, lower, upper = group["value"].max(), math.nan, math.nan
        elif quantity == "s2_envelope_p":  # one test for all twins of a section
            mean, lower, upper = by_section["value"].agg(["median", "min", "max"])
            lower, upper = (lower, upper) if sections > 1 else (math.nan, math.nan)
        elif not known.signed and not math.isnan(lower):
            lower, upper = max(lower, 0.0), min(upper, 1.0) if known.share else upper
        paper = PAPER.get((case, variant, quantity.partition("@")[0]))
        truth = by_section["truth"].mean()
        rows.append((case, variant, quantity, known.unit, paper, truth, mean, lower, upper, n, sections))
    return pd.DataFrame(rows, columns=COLUMNS)


def _each_truth_once(figures: pd.DataFrame) -> pd.DataFrame:
    """Without the truths that are another's in all their figures: those of slices of one volume."""
    known, copies = set(), []
    for (case, _), own in figures[figures["variant"] == "truth"].groupby(["case", "sample"], sort=False):
        whole = (case, frozenset(zip(own["quantity"], own["value"], strict=True)))
        copies += own.index.to_list() if whole in known else []
        known.add(whole)
    return figures.drop(index=copies)


def berea_slices(phase: np.ndarray) -> list[dict]:
    """Rows of the table: what one slice's porosity or surface would do, from all slices of the volume."""
    each, whole = slice_porosities(phase), float((phase == 0).mean())
    shown = slice_surfaces(phase) / surface.solid_surface(phase, 1.0).per_um
    shown = shown[np.isfinite(shown) & (shown > 0)]  # a plane of one phase has no surface to go by

    def carman(porosity):
        return porosity**3 / (1 - porosity) ** 2

    rows = []
    for quantity, values, truth in (
        ("porosity_any_slice", each, whole),
        ("k_any_slice", carman(each) / carman(whole), 1.0),
        ("surface_any_slice", shown, 1.0),
        ("k_any_slice_surface", shown**-2, 1.0),
    ):
        lower, upper = np.quantile(values, [0.025, 0.975])
        rows.append(
            {
                "case": "berea", "variant": "section", "quantity": quantity, "unit": describe(quantity).unit,
                "paper": math.nan, "truth": truth, "mean": values.mean(), "lower": lower, "upper": upper,
                "n": len(values), "sections": len(values),
            }
        )  # fmt: skip
    return rows


def validation_table(results: str | Path, cases: Mapping[str, Mapping]) -> tuple[pd.DataFrame, list[str]]:
    """All cases, as far as they have come: :data:`COLUMNS`; and what was left out, as of :func:`gather`.

    Parameters
    ----------
    results : path
    cases : mapping
        As for :func:`gather`.
    """
    figures, left_out = gather(results, cases)
    table = aggregate(figures)
    volume = Path(results) / "data/berea/reference.zarr.zip"
    if volume.exists() and "berea" in cases:
        extra = pd.DataFrame(berea_slices(io.read_volume(volume, "phase")[0]))
        table = pd.concat([table, extra], ignore_index=True) if len(table) else extra
    order = {case: i for i, case in enumerate(cases)}
    table["_case"] = table["case"].map(order)
    table["_quantity"] = [list(QUANTITIES).index(q.partition("@")[0]) for q in table["quantity"]]
    table = table.sort_values(["_case", "_quantity"], kind="stable", ignore_index=True)
    return table.drop(columns=["_case", "_quantity"]), left_out
