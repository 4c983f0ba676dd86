"""What the first packing lacks of the section, and which effects are to make up for it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from grainfall.morphology import Intergranular
from grainfall.packing.overgrowth import Overgrowth
from grainfall.packing.plan import decide
from grainfall.packing.tail import PoreTail
from grainfall.packing.virtual import THROAT, VirtualSizes, sphere_probability, virtual_sizes
from grainfall.stereology import SizeDistribution

WIDEST_SPHERE = 0.25
"""Largest virtual-sphere radius over the edge of the region: a wider one would be the region, not in it."""


def plan_deficit(
    scene: Mapping,
    target: SizeDistribution | None,
    first: SizeDistribution | None,
    tail: PoreTail,
    overgrowth: Overgrowth,
    porosity_first: float,
    mean_grain_volume: float,
    *,
    voids: int = 0,
    between: Intergranular | None = None,
    switch: str = "auto",
    cement: str = "auto",
    void_shapes: str = "auto",
    limit: float = 0.01,
) -> tuple[VirtualSizes, dict]:
    """What the first packing lacks of the target, and the virtual spheres that would make up for it.

    Spheres are called for by the porosity or by the large pores. Where the porosity calls for them, they have
    all the radii that the first packing is short of, as many as the porosity wants. Where only the large
    pores do (vugs in a dense rock), they have the radii of the tail alone and keep their share, and the
    grains about them may have to be packed denser. Where the section has voids, and grains alone pour as
    loose as those between, spheres have the radii of voids alone: none loosens what is loose enough.

    Where the section's grains have grown together, cement is to take the surface that a packing has beyond
    theirs, and the packings aim above the target by what it will fill. Spheres open the bed for that, too,
    but not in a rock that is denser than its grains pour to: that was compacted, and rims fill what room
    there is.

    Parameters
    ----------
    scene : mapping
    target, first : SizeDistribution or None
        Pore circles of the section and of slices of the first packing, unfolded; None without circles.
    tail : PoreTail
        Large pores of the two compared.
    overgrowth : Overgrowth
        Surfaces of the two compared.
    porosity_first : float
        Porosity of the first packing.
    mean_grain_volume : float
        Mean grain volume over all phases, um^3.
    voids : int
        Shapes of voids in the library.
    between : Intergranular, optional
        How porous the section is between its voids.
    switch, cement, void_shapes : {"auto", "on", "off"}
        Of the virtual spheres, of the cement, and of the shapes of voids in place of large spheres.
    limit : float
        Porosity that the final scaling of positions can mend.

    Returns
    -------
    sizes : VirtualSizes
    deficit : dict
        porosity_first, porosity_target, mean_sphere_volume_um3, mean_grain_volume_um3, tail (of
        :class:`PoreTail`), overgrowth: on, forced, called_for, reason, filled, section_per_um,
        porosity (before the rims, what the packings aim for: the target where there are none); and
        virtual_spheres: on, forced, called_for, reason, p_sp (first guess), for_tail (whether the tail alone
        called for them, so that they keep their share); void_shapes: on, forced, called_for, reason; and
        between, where spheres are to hold voids open that the section has: radius_um, porosity and error
        (of the section between them), wanted (the same before the rims).
    """
    target_porosity = scene["porosity_target"]
    rims, wanted = _rims(overgrowth, target_porosity, porosity_first, cement, limit)
    aim = f"porosity {wanted:.4f} before the rims" if rims["on"] else f"target porosity {wanted:.4f}"
    short = wanted - porosity_first
    for_tail = tail.exceeds and short <= limit
    # Rims fill pores between the voids, which have 1 - v = (1 - phi) / (1 - phi_between) of the region.
    between_voids = None
    if between is not None and tail.exceeds and not for_tail:
        filled = (wanted - target_porosity) * (1 - between.porosity) / (1 - target_porosity)
        between_voids = between.porosity + filled
    radius = (3 * mean_grain_volume / (4 * np.pi)) ** (1 / 3)
    limits = {
        "smallest_um": max(THROAT * radius, tail.first_um if for_tail else 0.0),
        "largest_um": WIDEST_SPHERE * scene["edge_um"],
    }
    sizes, alone = virtual_sizes(target, first, **limits), ""
    if between_voids is not None and between_voids <= porosity_first + limit:
        # Smaller spheres would loosen the grains there, and less friction would have to make up for it.
        in_voids = virtual_sizes(target, first, **limits | {"smallest_um": between.radius_um})
        if in_voids.called_for:
            sizes = in_voids
            alone = (
                f"; grains alone pour as loose as those between the voids ({between_voids:.4f}), so "
                "spheres are to hold voids open only"
            )
    spheres = decide(
        switch,
        (short > limit or for_tail) and sizes.called_for,
        f"{_compared(aim, short, porosity_first, limit)}; {tail.words}{alone}"
        + (f"; {sizes.reason}" if sizes.reason else ""),
        possible=(short > 0 or for_tail) and sizes.called_for,
    )
    # Pores of the volume share v in a matrix of the first packing's porosity.
    with_tail = tail.share + (1 - tail.share) * porosity_first
    p_sp = (
        sphere_probability(
            with_tail if for_tail else wanted, porosity_first, sizes.mean_volume, mean_grain_volume
        )
        if spheres["on"]
        else 0.0
    )
    holding = "virtual spheres hold" if spheres["on"] else "no virtual spheres hold"
    shaped = decide(
        void_shapes,
        spheres["on"] and tail.exceeds and voids > 0,
        f"{holding} voids open, {voids or 'no'} shapes of the section's voids were made; {tail.words}",
        possible=spheres["on"] and voids > 0,
    )
    held = None
    if between_voids is not None and spheres["on"]:
        held = {
            "radius_um": between.radius_um,
            "porosity": between.porosity,
            "error": between.error,
            "wanted": between_voids,
        }
    return sizes, {
        "porosity_first": float(porosity_first),
        "porosity_target": float(target_porosity),
        "mean_sphere_volume_um3": sizes.mean_volume,
        "mean_grain_volume_um3": float(mean_grain_volume),
        "tail": {
            "target_um": tail.target_um,
            "first_um": tail.first_um,
            "excess_um": tail.excess_um,
            "share": tail.share,
            "exceeds": tail.exceeds,
        },
        "overgrowth": {
            **rims,
            "filled": float(overgrowth.filled),
            "porosity": float(wanted),
            "section_per_um": float(overgrowth.section.per_um),
        },
        "virtual_spheres": {**spheres, "for_tail": bool(for_tail), "p_sp": p_sp},
        "void_shapes": shaped,
        "between": held,
    }


def _rims(
    overgrowth: Overgrowth, target: float, first: float, switch: str, limit: float
) -> tuple[dict, float]:
    """Whether rims are called for, and the porosity that the packings aim at before them."""
    wanted = overgrowth.porosity_before(target, first)
    if target < first - limit:
        wanted = min(wanted, first)
    fill = wanted - target
    rims = decide(
        switch,
        overgrowth.exceeds and fill > 0,
        f"{overgrowth.words}; rims that closed their contacts would fill {fill:.4f} of the region",
        possible=fill > 0,
    )
    return rims, wanted if rims["on"] else target


def _compared(aim: str, short: float, first: float, limit: float) -> str:
    """How the porosity aimed at lies to the first packing's, in words."""
    if short > limit:
        return f"the {aim} exceeds the first packing's {first:.4f}"
    if short >= -limit:
        return f"the first packing's {first:.4f} is within {limit:g} of the {aim}"
    return f"the {aim} is below the first packing's {first:.4f}"
