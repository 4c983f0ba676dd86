"""From the second packing to the twin: spheres out, the last of the porosity, voxels."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from grainfall.packing.plan import decide
from grainfall.volume.cement import cement
from grainfall.volume.correction import correct_porosity
from grainfall.volume.measures import porosity
from grainfall.volume.scan import Meshes, voxelise


def finish(
    bodies: pd.DataFrame,
    library: Meshes,
    scene: Mapping,
    densification: Mapping,
    switches: Mapping[str, str],
    limit: float = 0.01,
) -> tuple[pd.DataFrame, np.ndarray, np.ndarray, dict, dict]:
    """The twin of a packing: grains scaled in position or cemented, where the porosity calls for it.

    Parameters
    ----------
    bodies : DataFrame
        The second packing; virtual bodies are left out.
    library : Library
        Meshes of the shapes.
    scene : mapping
        shape_zyx, voxel_size_um, porosity_target, phases.
    densification : mapping
        Of the second packing's report: cement is called for only where densification was and fell short.
    switches : mapping
        ``position_scaling`` and ``cement``: auto, on or off.
    limit : float
        Largest porosity difference that position scaling may mend.

    Returns
    -------
    bodies : DataFrame
        The grains of the twin.
    phase : (nz, ny, nx) uint8
        0 pore, 1...M minerals, M + 1 cement.
    body : (nz, ny, nx) int32
        Body id + 1, 0 pore; a rim belongs to the grain it grew on.
    scaling : dict
        As :func:`grainfall.volume.correct_porosity` gives it.
    rims : dict
        As :func:`grainfall.volume.cement` gives it, with on, forced, called_for, reason.
    """
    target, shape, voxel = scene["porosity_target"], scene["shape_zyx"], scene["voxel_size_um"]
    grains, scaling = correct_porosity(
        bodies, library, shape, voxel, target, limit, switch=switches["position_scaling"]
    )
    left = scaling["after"]["porosity"]
    if left <= target:
        reason = f"porosity {left:.4f} is not above the target {target:.4f}"
    elif left - target <= limit:
        reason = f"porosity {left:.4f} is within {limit:g} of the target {target:.4f}"
    elif not densification["called_for"]:
        reason = (
            f"porosity {left:.4f} is above the target {target:.4f} by the virtual spheres, not the grains"
        )
    else:
        means = "densification" if densification["on"] else "the packing"
        reason = f"{means} leaves a porosity of {left:.4f}, above the target {target:.4f}"
    rims = decide(
        switches["cement"],
        densification["called_for"] and left - target > limit,
        reason,
        possible=(left - target) * np.prod(shape, dtype=float) >= 1,
    )
    if rims["on"]:
        phase, body, grown = cement(grains, library, shape, voxel, target, len(scene["phases"]))
        rims["reason"] += f": rims of {grown['rim_um']:.3g} um"
        return grains, phase, body, scaling, {**grown, **rims}
    phase, body = voxelise(grains, library, shape, voxel)
    after = porosity(phase)
    nothing = {"target": target, "before": after, "after": after, "share": 0.0, "rim_um": 0.0, "wall_s": 0.0}
    return grains, phase, body, scaling, {**nothing, **rims}
