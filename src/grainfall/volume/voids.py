"""Voids: the circles that planes show of them, how wide bodies leave them, how porous a bed is between."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from scipy.optimize import brentq

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

    The void of radius 1 is the one of which :func:`void_width` is 1: over all planes that meet it, the
    largest circles of each add up to those of a ball.

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
            largest += circles["r_um"].groupby(circles["x_um"] // (2 * half)).max().sum()
    if not largest:
        return np.empty(0)
    # of a body twice as large twice as many planes show circles twice as large
    return np.sort(np.concatenate(found)) / (DRAWN_PX * np.sqrt(largest / discs))


def void_width(
    bodies: pd.DataFrame, library: Meshes, shape: tuple[int, int, int], voxel_size_um: float
) -> float | None:
    """Width of the voids that bodies in the shapes of voids leave, over that of spheres of their volumes.

    A body's own width is that of the ball whose circles add up to its largest ones, over all planes across
    the three axes that meet it. Its void is taken for the body made w times as large: on the planes that meet
    the body, the largest circles between the grains whose centre lies in it add up to those of that larger
    one. Sums are over all bodies, so that wide voids count most. Circles are those of
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
        w times the bodies' own width, over the radius of spheres of their volumes: bodies 1 / width times as
        large leave voids as wide as the spheres. None where no such body's sphere lies in the region as a
        whole.
    """
    centre, radius = bodies[["x", "y", "z"]].to_numpy(float), bodies["scale"].to_numpy(float)
    edges = np.asarray(shape[::-1], int) * voxel_size_um
    whole = ((centre >= radius[:, None]) & (centre <= edges - radius[:, None])).all(axis=1)
    grain = (bodies["kind"] == "grain").to_numpy()
    widest = np.array([np.linalg.norm(v, axis=1).max() for v in library.vertices])
    reach = radius * np.where(bodies["shape"] < 0, 1.0, widest[bodies["shape"]])
    half = int(np.ceil(WINDOW * DRAWN_PX))
    height = (np.arange(0, 2 * half, EVERY) + 0.5 - half) / DRAWN_PX
    ball = 3 * np.sqrt(np.maximum(0, 1 - height**2)).sum()
    own, between, planes = [], [], []
    for i in np.flatnonzero(~grain & (bodies["shape"] >= 0).to_numpy() & whole):
        pixel = radius[i] / DRAWN_PX
        origin = centre[i] - half * pixel
        near = grain & (np.abs(centre - centre[i]) <= half * pixel + reach[:, None]).all(axis=1)
        grains, body = (
            voxelise(bodies[some], library, (2 * half,) * 3, pixel, tuple(origin))[0] > 0
            for some in (near, np.arange(len(bodies)) == i)
        )
        own.append(_largest_circles(np.where(body, WITHIN, 0)))
        between.append(_largest_circles(np.where(grains, 0, np.where(body, WITHIN, 2))))
        planes.append(radius[i] ** 2)  # as many of a fixed distance, with circles as large
    if not own:
        return None
    own, between, planes = np.array(own), np.array(between), np.array(planes)[:, None, None]

    def missing(times):
        larger = [[times * np.interp(height / times, height, axis) for axis in body] for body in own]
        return (planes * np.where(own > 0, larger - between, 0)).sum()

    return brentq(missing, 1e-3, 1e3) * np.sqrt((planes * own).sum() / (ball * planes.sum()))


def _largest_circles(labels: np.ndarray) -> np.ndarray:
    """Radius of the largest circle that has its centre within, 0 without, on planes across each axis."""
    largest = np.zeros((3, -(-len(labels) // EVERY)))
    for axis, n in np.ndindex(largest.shape):
        plane = labels.take(EVERY * n, axis)
        if (plane == WITHIN).any():
            found = inscribed_circles(plane, 1 / DRAWN_PX).set_index("pore")["r_um"]
            largest[axis, n] = min(found[WITHIN], WINDOW)  # with no grain about there is no end
    return largest


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
