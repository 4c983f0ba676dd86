"""The scene of a twin: region of interest, voxels and targets, in one table of plain numbers."""

from __future__ import annotations

import numpy as np

from grainfall.errors import InputError
from grainfall.packing.mixing import phase_probabilities
from grainfall.packing.plan import decide
from grainfall.stereology import SizeDistribution

LEAST_GRAINS = 3
"""Narrower regions, in mean grains, are all boundary."""

LEAST_VOXELS = 4
"""Voxels across the mean grain below which pores close or join by chance."""

MOST_VOXELS = 4_000_000_000
"""Larger volumes overflow 32-bit labels."""

POURED = 0.65
"""Solid fraction, from wall to wall, that the number of grains to pour is reckoned by."""


def plan_scene(
    sizes: dict[tuple[int, str], SizeDistribution],
    section: dict,
    *,
    edge_um: float | None,
    edge_grains: float,
    voxel_size_um: float | None,
    voxels_per_grain: float | None,
    porosity: float | None,
    margin_grains: float,
    sizes_from: str,
    porosity_of_sample: float | None = None,
    phase_mixing: str = "auto",
) -> dict:
    """Lay out the region of interest and its targets.

    The mean grain that measures lengths is the number mean over all minerals of the unfolded 3D
    diameters, whichever distribution the grains will follow, so that variants share one region.

    Parameters
    ----------
    sizes : dict
        (phase, kind) to its size distribution.
    section : dict
        ``phases``, ``porosity``, ``fractions`` (of the solid, one a mineral), ``pixel_size_um``.
    edge_um, edge_grains : float
        Edge of the cubic region in um, or in mean grain diameters where ``edge_um`` is None.
    voxel_size_um, voxels_per_grain : float or None
        Voxel edge in um, or voxels across the mean grain; with neither, the section's pixel size.
    porosity : float or None
        Target; None takes ``porosity_of_sample``, else the section's areal porosity.
    margin_grains : float
        Distance from walls, floor and surface in mean grain diameters.
    sizes_from : {"f3d", "f2d"}
        The distribution that the grains follow.
    phase_mixing : {"auto", "on", "off"}
        off pours the most abundant mineral alone.

    Returns
    -------
    dict
        shape_zyx, voxel_size_um, resolution_um (the voxel, or the section's pixel where that is coarser: on
        images of this spacing section and packings show their surface alike), edge_um, margin_um,
        mean_diameter_um, phases, fractions, mean_volumes_um3, probabilities, sizes_from, porosity_target,
        porosity_source, phase_mixing (on, forced, called_for, reason).

    Raises
    ------
    InputError
        When the region cannot be resolved or holds no packing.
    """
    names, fractions = section["phases"], np.asarray(section["fractions"], float)
    minerals = [sizes[n, "grain"] for n in range(1, len(names))]
    share = phase_probabilities(fractions, [s.mean_volume("f3d") for s in minerals])
    diameter = float(2 * share @ [s.mean("f3d") for s in minerals])
    volumes = [float(s.mean_volume(sizes_from)) for s in minerals]

    mixing = decide(
        phase_mixing,
        len(minerals) > 1,
        f"{len(minerals)} minerals, mixed by volume quota" if len(minerals) > 1 else "one mineral",
        possible=len(minerals) > 1,
    )
    if not mixing["on"]:
        # the region stays the same: only what is poured into it changes
        fractions = np.where(np.arange(len(minerals)) == fractions.argmax(), 1.0, 0.0)

    edge = edge_um or edge_grains * diameter
    voxel = voxel_size_um or (diameter / voxels_per_grain if voxels_per_grain else section["pixel_size_um"])
    n = max(1, round(edge / voxel))
    if voxel * LEAST_VOXELS > diameter * (1 + 1e-9):
        raise InputError(
            "scene.voxel_size_um",
            f"{voxel:.4g} um is {diameter / voxel:.2g} voxels across the mean grain of {diameter:.4g} um",
            f"at most {diameter / LEAST_VOXELS:.4g} um ({LEAST_VOXELS} voxels a grain); 16 a grain are usual",
        )
    if edge < LEAST_GRAINS * diameter:
        raise InputError(
            "scene.edge_um",
            f"{edge:.4g} um is less than {LEAST_GRAINS} mean grains of {diameter:.4g} um",
            f"at least {LEAST_GRAINS * diameter:.4g}; 10 mean grains are {10 * diameter:.4g}",
        )
    if n**3 > MOST_VOXELS:
        raise InputError(
            "scene.voxel_size_um",
            f"{n} voxels an edge are {n**3:.3g} voxels",
            f"a voxel size of at least {edge / MOST_VOXELS ** (1 / 3):.4g} um",
        )
    target, source = next(
        (value, source)
        for value, source in (
            (porosity, "config scene.porosity"),
            (porosity_of_sample, "sample sheet"),
            (section["porosity"], "areal porosity of the section"),
        )
        if value is not None
    )
    return {
        "shape_zyx": [n, n, n],
        "voxel_size_um": float(voxel),
        "resolution_um": float(max(voxel, section["pixel_size_um"])),
        "edge_um": float(n * voxel),
        "margin_um": float(margin_grains * diameter),
        "mean_diameter_um": diameter,
        "phases": list(names),
        "fractions": fractions.tolist(),
        "mean_volumes_um3": volumes,
        "probabilities": phase_probabilities(fractions, volumes).tolist(),
        "sizes_from": sizes_from,
        "porosity_target": float(target),
        "porosity_source": source,
        "phase_mixing": mixing,
    }


def poured_grains(scene: dict, solid_fraction: float = POURED) -> float:
    """Number of grains that fill the region and the margin around it at this solid fraction.

    Parameters
    ----------
    scene : dict
        As :func:`plan_scene` gives it.
    solid_fraction : float
    """
    side = scene["edge_um"] + 2 * scene["margin_um"]
    return solid_fraction * side**3 / float(np.dot(scene["probabilities"], scene["mean_volumes_um3"]))
