"""Voids: the circles that planes show of them, how wide bodies leave them, how porous a bed is between."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from grainfall.grains import VOID, Library, spread_planes
from grainfall.morphology import Intergranular, inscribed_circles, intergranular, split_pores
from grainfall.section import resample
from grainfall.volume.scan import Meshes, voxelise

EVERY = 2
"""Voxels from one plane to the next: circles of neighbours are all but the same."""

WINDOW = 2.5
"""Half the edge of what is looked at about a body, in radii of its sphere: circles reach no farther."""

DRAWN_PX = 20
"""Radius at which voids are drawn for their circles, pixels, as they have it on a fine section."""

WITHIN = 1
"""Label of pores within the body that is looked at; others have another."""

TURNS = 8
"""Ways in which each shape is turned; dozens of shapes make them hundreds."""


def void_circles(library: Library, *, pore_persistence: float, min_radius_px: float) -> np.ndarray:
    """Circles that random planes show of a section's voids, by which those of its pores are unfolded.

    Each shape is turned in several ways, drawn in voxels, and its planes go through the steps of a section:
    an uneven void shows small circles near its rim and in its lobes more often than a sphere would, and as
    spheres those would be bodies that are not there.

    The void of radius 1 is the one of which :func:`void_width` is 1: over the planes that would meet a ball,
    the largest circles of each add up to those of the ball.

    Parameters
    ----------
    library : Library
        With or without shapes of voids.
    pore_persistence, min_radius_px : float
        See :func:`grainfall.morphology.split_pores`.

    Returns
    -------
    (n,) ndarray
        Their radii, of a void of radius 1, increasing, for :func:`~grainfall.stereology.particle_of`; empty
        where the library has no shapes of voids, or their planes show none.
    """
    found, largest, discs = [], 0.0, 0.0
    for n, number in enumerate(library.table.loc[library.table["phase"] == VOID, "shape"]):
        normals, shift = spread_planes(n, TURNS)
        half = int(np.ceil(DRAWN_PX * np.linalg.norm(library.vertices[number], axis=1).max())) + EVERY
        turned = pd.DataFrame(
            {
                "id": np.arange(TURNS),
                "kind": "virtual",
                "phase": VOID,
                "shape": number,
                "scale": float(DRAWN_PX),
                "x": half * (2.0 * np.arange(TURNS) + 1),
                "y": float(half),
                "z": half + EVERY * shift,
                "qw": 1 + normals[:, 2],  # turns the normal to z
                "qx": normals[:, 1],
                "qy": -normals[:, 0],
                "qz": 0.0,
            }
        )
        drawn, _ = voxelise(turned, library, (2 * half + EVERY, 2 * half, 2 * half * TURNS), 1.0)
        for plane in range(0, len(drawn), EVERY):
            disc = DRAWN_PX**2 - (plane + 0.5 - turned["z"].to_numpy()) ** 2
            discs += np.sqrt(disc[disc > 0]).sum()
            labels = split_pores(
                np.uint8(drawn[plane] == 0), persistence=pore_persistence, min_radius_px=min_radius_px
            )
            circles = inscribed_circles(labels, 1.0)
            found.append(circles["r_um"].to_numpy())
            of = (circles["x_um"] // (2 * half)).astype(int)
            largest += circles["r_um"][disc[of] > 0].groupby(of).max().sum()
    return np.sort(np.concatenate(found)) * discs / (largest * DRAWN_PX) if largest else np.empty(0)


def void_width(
    bodies: pd.DataFrame, library: Meshes, shape: tuple[int, int, int], voxel_size_um: float
) -> float | None:
    """Width of the voids that bodies in the shapes of voids leave, over that of spheres of their volumes.

    On planes across each of the three axes: the largest circle between the grains whose centre lies in the
    body, over the circle in which the plane cuts a sphere of the body's volume about its centre. The
    first are summed over the second, so that wide voids count most. Circles are those of
    :func:`grainfall.morphology.inscribed_circles`, the section's. Voids are drawn one by one, each as finely
    as its own radius asks for: no volume is held as a whole, and the scene's voxels do not show.

    Parameters
    ----------
    bodies : DataFrame
        As :func:`~grainfall.volume.voxelise` takes them; grains and virtual bodies.
    library : Library
    shape : (nz, ny, nx)
        Voxels of the region of interest.
    voxel_size_um : float

    Returns
    -------
    float or None
        None where no such body's sphere lies in the region as a whole.
    """
    centre, radius = bodies[["x", "y", "z"]].to_numpy(float), bodies["scale"].to_numpy(float)
    edges = np.asarray(shape[::-1], int) * voxel_size_um
    whole = ((centre >= radius[:, None]) & (centre <= edges - radius[:, None])).all(axis=1)
    grain = (bodies["kind"] == "grain").to_numpy()
    widest = np.array([np.linalg.norm(v, axis=1).max() for v in library.vertices])
    reach = radius * np.where(bodies["shape"] < 0, 1.0, widest[bodies["shape"]])
    half = int(np.ceil(WINDOW * DRAWN_PX))
    height = np.arange(2 * half) + 0.5 - half
    circles = discs = 0.0
    for i in np.flatnonzero(~grain & (bodies["shape"] >= 0).to_numpy() & whole):
        pixel = radius[i] / DRAWN_PX
        origin = centre[i] - half * pixel
        near = grain & (np.abs(centre - centre[i]) <= half * pixel + reach[:, None]).all(axis=1)
        grains, body = (
            voxelise(bodies[some], library, (2 * half,) * 3, pixel, tuple(origin))[0]
            for some in (near, np.arange(len(bodies)) == i)
        )
        pores = np.where(grains > 0, 0, np.where(body > 0, WITHIN, 2))
        for plane in np.flatnonzero(np.abs(height) < DRAWN_PX)[::EVERY]:
            discs += 3 * pixel * np.sqrt(DRAWN_PX**2 - height[plane] ** 2)
            for axis in range(3):
                found = inscribed_circles(pores.take(plane, axis), pixel).set_index("pore")["r_um"]
                circles += min(found.get(WITHIN, 0.0), half * pixel)
    return circles / discs if discs else None


def bed_between_voids(
    bodies: pd.DataFrame, library: Meshes, scene: Mapping, radius_um: float
) -> Intergranular | None:
    """How porous a bed is between its voids, on planes across each of the three axes as on a section.

    Parameters
    ----------
    bodies : DataFrame
        As :func:`~grainfall.volume.voxelise` takes them; virtual bodies are left out.
    library : Library
    scene : mapping
        shape_zyx, voxel_size_um, resolution_um.
    radius_um : float
        Of the disc by which pores are opened for their voids; planes are as far apart, too, and reach two
        radii beyond the region, so that its own edge cuts no void.

    Returns
    -------
    Intergranular or None
        As :func:`grainfall.morphology.intergranular` gives it.
    """
    voxel, resolution = scene["voxel_size_um"], scene["resolution_um"]
    rim = int(np.ceil(np.ceil(2 * radius_um / resolution) * resolution / voxel))
    bodies = bodies[bodies["kind"] == "grain"]

    def planes():
        for axis, n in enumerate(scene["shape_zyx"]):
            shape = np.array(scene["shape_zyx"]) + 2 * rim
            shape[axis] = 1
            number = max(1, round(n * voxel / radius_um))
            for index in ((np.arange(number) + 0.5) * n / number).astype(int):
                start = np.full(3, -rim * voxel)
                start[axis] = index * voxel
                phase, _ = voxelise(bodies, library, tuple(shape), voxel, tuple(start[::-1]))
                yield resample(phase.squeeze(axis) == 0, voxel, resolution)

    return intergranular(planes(), resolution, radius_um)
