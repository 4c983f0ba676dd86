"""From the second packing to the twin: spheres out, the last of the porosity, voxels."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from grainfall.io import CHUNK, create_volume
from grainfall.packing.plan import decide
from grainfall.volume.cement import cement
from grainfall.volume.compaction import compact
from grainfall.volume.correction import correct_porosity
from grainfall.volume.scan import Meshes, voxelise_slabs


def finish(
    bodies: pd.DataFrame,
    library: Meshes,
    scene: Mapping,
    overgrowth: Mapping,
    densification: Mapping,
    switches: Mapping[str, str],
    limit: float = 0.01,
    progress: Callable[[str], None] | None = None,
) -> tuple[pd.DataFrame, Iterator[tuple[int, np.ndarray, np.ndarray]], dict, dict]:
    """The twin of a packing: grains scaled in position or cemented, where the porosity calls for it.

    Parameters
    ----------
    bodies : DataFrame
        The second packing; virtual bodies are left out.
    library : Library
        Meshes of the shapes.
    scene : mapping
        shape_zyx, voxel_size_um, resolution_um, margin_um, mean_diameter_um, porosity_target, phases.
    overgrowth : mapping
        As :func:`grainfall.packing.plan_deficit` gives it: cement is called for where the section's grains
        have grown together, and positions are then scaled to the porosity before their rims.
    densification : mapping
        Of the second packing's report: cement is called for, too, where the grains were too loose and
        densification fell short.
    switches : mapping
        ``position_scaling``, ``cement`` and ``compaction``: auto, on or off.
    limit : float
        Largest porosity difference that position scaling may mend.
    progress : callable, optional
        Called with a line of text.

    Returns
    -------
    bodies : DataFrame
        The grains of the twin.
    slabs : iterator of z, phase, body
        The voxels, slab by slab from the plane z on: phase uint8, 0 pore, 1...M minerals, M + 1 cement; body
        int32, body id + 1, 0 pore; a rim belongs to the grain it grew on.
    scaling : dict
        As :func:`grainfall.volume.correct_porosity` gives it.
    rims : dict
        As :func:`grainfall.volume.cement` gives it, with on, forced, called_for, reason, ``room``: the
        factor on all lengths of the bed that made room for the rims (:func:`make_room`), and
        ``compaction``: as :func:`grainfall.volume.compact` gives it.
    """
    target, shape, voxel = scene["porosity_target"], scene["shape_zyx"], scene["voxel_size_um"]
    grains, scaling = correct_porosity(
        bodies, library, shape, voxel, overgrowth["porosity"], limit, switch=switches["position_scaling"]
    )
    left = scaling["after"]["porosity"]
    if overgrowth["on"]:
        reason = overgrowth["reason"]
    elif left <= target:
        reason = f"porosity {left:.4f} is not above the target {target:.4f}"
    elif left - target <= limit:
        reason = f"porosity {left:.4f} is within {limit:g} of the target {target:.4f}"
    elif not densification["too_loose"]:
        reason = (
            f"porosity {left:.4f} is above the target {target:.4f} by the virtual spheres, not the grains"
        )
    else:
        means = "densification" if densification["on"] else "the packing"
        reason = f"{means} leaves a porosity of {left:.4f}, above the target {target:.4f}"
    rims = decide(
        switches["cement"],
        overgrowth["called_for"] or (densification["too_loose"] and left - target > limit),
        reason,
        possible=(left - target) * np.prod(shape, dtype=float) >= 1,
    )
    if rims["on"]:
        grains, room = make_room(grains, scene, left)
        grains, pressed = compact(
            grains,
            library,
            scene,
            overgrowth["section_per_um"],
            dense=densification["called_for"],
            switch=switches["compaction"],
            progress=progress,
        )
        phase, body, grown = cement(grains, library, shape, voxel, target, len(scene["phases"]))
        made = {**grown, "room": room, "compaction": pressed}
        size = 100 * (size_factor(made) - 1)
        rims["reason"] += f": rims of {grown['rim_um']:.3g} µm on grains {abs(size):.2g} % "
        rims["reason"] += "smaller" if size < 0 else "larger"
        return grains, iter([(0, phase, body)]), scaling, {**made, **rims}
    nothing = {"target": target, "before": left, "after": left, "share": 0.0, "rim_um": 0.0, "wall_s": 0.0}
    nothing["room"] = 1.0
    nothing["compaction"] = decide(switches["compaction"], False, "there are no rims", possible=False)
    nothing["compaction"] |= {"factor": 1.0, "porosity": left, "wall_s": 0.0}
    slabs = voxelise_slabs(grains, library, shape, voxel, slab=CHUNK)
    return grains, slabs, scaling, {**nothing, **rims}


def size_factor(cement: Mapping) -> float:
    """Radius of the grains in a twin's bodies.csv over the one they were drawn with, by its cement.json.

    Grains are drawn with the sizes of the section's, rims and all; room for the rims makes them smaller
    (:func:`make_room`), pressing them into each other larger (:func:`grainfall.volume.compact`).
    """
    return cement["room"] * cement["compaction"]["factor"]


def write_twin(
    path: str | Path,
    slabs: Iterable[tuple[int, np.ndarray, np.ndarray]],
    scene: Mapping,
    cemented: bool,
    seed: int,
) -> None:
    """The volume file of a twin, or of some slabs of it.

    Parameters
    ----------
    path : str or Path
        Target, ``*.zarr.zip``.
    slabs : iterable of z, phase, body
        As :func:`finish` gives them; where none is, the file is that of an empty region.
    scene : mapping
        shape_zyx, voxel_size_um, phases.
    cemented : bool
        Whether cement is a phase of the twin.
    seed : int
    """
    attributes = {"phases": scene["phases"] + (["cement"] if cemented else []), "seed": seed}
    kinds = {"phase": "uint8", "body": "int32"}
    with create_volume(path, tuple(scene["shape_zyx"]), kinds, scene["voxel_size_um"], attributes) as twin:
        for z, phase, body in slabs:
            twin["phase"][z : z + len(phase)] = phase
            twin["body"][z : z + len(body)] = body


def make_room(bodies: pd.DataFrame, scene: Mapping, porosity_before: float) -> tuple[pd.DataFrame, float]:
    """Shrink a bed, grains and distances alike, so that grains with their rims are as large as the section's.

    A section shows a grain with all that grew on it, so its sizes are those of cemented grains. Rims multiply
    the mean volume of a grain by the solid fraction after over that before; the bed shrinks by that
    beforehand. Beds look the same at any scale: the packing stays what it is, the region sees more of it.

    Parameters
    ----------
    bodies : DataFrame
        Grains, um from the region's corner.
    scene : mapping
        shape_zyx, voxel_size_um, margin_um, mean_diameter_um, porosity_target.
    porosity_before : float
        Of the bed.

    Returns
    -------
    bodies : DataFrame
    factor : float
        At most 1; larger than wanted where the bed must reach half a mean grain beyond the region.
    """
    wanted = ((1 - porosity_before) / (1 - scene["porosity_target"])) ** (1 / 3)
    size = np.array(scene["shape_zyx"][::-1]) * scene["voxel_size_um"]
    reach = (size / 2 + scene["mean_diameter_um"] / 2) / (size / 2 + scene["margin_um"])
    factor = float(min(1.0, max(wanted, *reach)))
    place = bodies[["x", "y", "z"]].to_numpy(float)
    x, y, z = (size / 2 + factor * (place - size / 2)).T
    return bodies.assign(x=x, y=y, z=z, scale=factor * bodies["scale"]), factor
