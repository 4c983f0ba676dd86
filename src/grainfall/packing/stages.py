"""The two packings of a twin: grains alone, then grains with temporary virtual spheres."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from grainfall.grains import Library
from grainfall.packing.deposition import Box, deposit
from grainfall.packing.mixing import Mixture, draw_zones
from grainfall.packing.parameters import Parameters
from grainfall.packing.virtual import (
    THROAT,
    VirtualSizes,
    match_porosity,
    sphere_probability,
    virtual_sizes,
)
from grainfall.stereology import SizeDistribution

WIDEST_SPHERE = 0.25
"""Largest virtual-sphere radius over the edge of the region: a wider one would be the region, not in it."""


def pack(
    scene: Mapping,
    sizes: Mapping[tuple[int, str], SizeDistribution],
    library: Library,
    parameters: Parameters,
    rng: np.random.Generator,
    *,
    spheres: VirtualSizes | None = None,
    p_sphere: float = 0.0,
    progress: Callable[[str], None] | None = None,
    checkpoints: Path | None = None,
) -> tuple[pd.DataFrame, dict]:
    """Draw the bodies of a scene and pour them.

    Parameters
    ----------
    scene : mapping
        As :func:`grainfall.packing.plan_scene` gives it.
    sizes : mapping of (phase, kind) to SizeDistribution
    library : Library
    parameters : Parameters
    rng : numpy.random.Generator
    spheres : VirtualSizes, optional
        Sizes of virtual spheres poured among the grains.
    p_sphere : float
        Probability that the next body is one of them.
    progress : callable, optional
        Called with a line of text as the bed grows.
    checkpoints : Path, optional
        Folder of the states from which a killed packing resumes.

    Returns
    -------
    bodies : DataFrame
        Columns of bodies.csv, um from the corner of the region of interest.
    report : dict
        Content of packing.json; ``forces`` are the normal forces between bodies: a, b (ids), force_n.
    """
    mixture = Mixture(
        {n: sizes[n, "grain"] for n in range(1, len(scene["phases"]))},
        dict(enumerate(scene["fractions"], start=1)),
        scene["sizes_from"],
        spheres if p_sphere > 0 else None,
        p_sphere,
    )
    box = Box((scene["edge_um"],) * 3, scene["margin_um"])
    share = scene["edge_um"] ** 2 / np.prod(box.sides_um)
    population = draw_zones(mixture, library, box.solid_um3(), share, rng)

    def tell(poured: int, settled: int, expected: int, steps: int) -> None:
        progress(f"{settled} of about {expected} bodies settled, {poured} poured, step {steps}")

    bodies = deposit(population, library, box, parameters, rng, tell if progress else None, checkpoints)
    report = {**bodies.attrs.pop("report"), "p_sp": float(p_sphere)}
    return bodies, {**report, "forces": bodies.attrs.pop("forces")}


def plan_spheres(
    scene: Mapping,
    target: SizeDistribution | None,
    first: SizeDistribution | None,
    porosity_first: float,
    mean_grain_volume: float,
    *,
    enabled: bool = True,
    limit: float = 0.01,
) -> tuple[VirtualSizes, dict]:
    """Decide on virtual spheres: whether, of which sizes, with which first guess of their probability.

    Parameters
    ----------
    scene : mapping
    target, first : SizeDistribution or None
        Pore circles of the section and of slices of the first packing, unfolded; None without circles.
    porosity_first : float
        Porosity of the first packing.
    mean_grain_volume : float
        Mean grain volume over all phases, um^3.
    enabled : bool
        False leaves spheres out whatever the target.
    limit : float
        Porosity that the final scaling of positions can mend.

    Returns
    -------
    sizes : VirtualSizes
    plan : dict
        called_for, reason, porosity_first, porosity_target, p_sp, mean_sphere_volume_um3,
        mean_grain_volume_um3.
    """
    wanted = scene["porosity_target"]
    radius = (3 * mean_grain_volume / (4 * np.pi)) ** (1 / 3)
    sizes = virtual_sizes(
        target, first, smallest_um=THROAT * radius, largest_um=WIDEST_SPHERE * scene["edge_um"]
    )
    called_for = False
    if not enabled:
        reason = "switched off in the config"
    elif abs(wanted - porosity_first) <= limit:
        reason = (
            f"first packing {porosity_first:.4f} is within {limit:g} of the target {wanted:.4f}: "
            "scaling of positions does the rest"
        )
    elif wanted < porosity_first:
        reason = f"target {wanted:.4f} not reachable by this plan, nearest {porosity_first:.4f}"
    elif not sizes.called_for:
        reason = sizes.reason
    else:
        called_for = True
        reason = f"the target porosity {wanted:.4f} exceeds the first packing's {porosity_first:.4f}"
        reason += f"; {sizes.reason}" if sizes.reason else ""
    return sizes, {
        "called_for": called_for,
        "reason": reason,
        "porosity_first": float(porosity_first),
        "porosity_target": float(wanted),
        "p_sp": sphere_probability(wanted, porosity_first, sizes.mean_volume, mean_grain_volume)
        if called_for
        else 0.0,
        "mean_sphere_volume_um3": sizes.mean_volume,
        "mean_grain_volume_um3": float(mean_grain_volume),
    }


def pack_again(
    plan: Mapping,
    pack_with: Callable[[float], tuple[pd.DataFrame, dict]],
    porosity_of: Callable[[pd.DataFrame], float],
    first: tuple[pd.DataFrame, dict],
    *,
    tolerance: float,
    passes: int,
) -> tuple[pd.DataFrame, dict]:
    """The second packing: grains and spheres until the porosity without the spheres meets the target.

    Parameters
    ----------
    plan : mapping
        As :func:`plan_spheres` gives it. Where spheres are not called for, the first packing is the second.
    pack_with : callable
        Probability of a sphere to (bodies, report).
    porosity_of : callable
        Grains alone to their porosity.
    first : (bodies, report)
        The first packing.
    tolerance : float
        Distance from the target that ends the passes.
    passes : int
        Most packings tried.

    Returns
    -------
    bodies : DataFrame
    report : dict
        That of the pass kept, with ``passes``, ``reached`` and ``reason``.
    """
    if not plan["called_for"]:
        bodies, report = first
        return bodies, {**report, "passes": [], "reached": False, "reason": plan["reason"]}
    match = match_porosity(
        pack_with,
        lambda packing: porosity_of(packing[0][packing[0]["kind"] == "grain"]),
        plan["porosity_target"],
        plan["p_sp"],
        plan["porosity_first"],
        tolerance,
        passes,
    )
    bodies, report = match.packing
    return bodies, {**report, "passes": match.passes, "reached": match.reached, "reason": match.reason}
