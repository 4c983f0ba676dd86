"""The SNOW algorithm by PoreSpy, kept beside grainfall's own extraction."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import skimage

from grainfall.network.elements import LENGTH_POWER, Network
from grainfall.network.geometry import CIRCLE

BOUNDARY_WIDTH = 3
"""Thickness in voxels of the boundary pores that snow2 puts outside each face (PoreSpy's default)."""


def snow2(pore: np.ndarray, voxel_size_um: float, *, sigma: float = 0.4, r_max: int = 4) -> Network:
    """SNOW (Gostick 2017) by PoreSpy: the steps of ``porespy.networks.snow2`` in series, so that no number of
    threads or chunks changes the result, with two repairs:

    - the watershed of PoreSpy floods through the solid into closed parts of the pore space that got no
      marker, and such a part, taken by two regions, links them: it becomes a region of its own;
    - boundary pores are those outside the faces, not those of extreme coordinates, which are interior pores
      where nothing opens onto a face.

    Two pores have one throat however often they meet. Pores' shape factors take the equivalent diameter as
    length.
    """
    width = BOUNDARY_WIDTH
    # PoreSpy wants at least two voxels along each axis; a sheet repeated along its normal is the same sheet.
    repeats = [2 if n == 1 else 1 for n in pore.shape]
    image = pore
    for axis, repeat in enumerate(repeats):
        image = np.repeat(image, repeat, axis=axis)
    with _quiet_porespy() as porespy:
        snow = porespy.filters.snow_partitioning(image, sigma=sigma, r_max=r_max)
        components = skimage.measure.label(image, connectivity=1)
        marked = np.zeros(components.max() + 1, bool)
        marked[components[snow.peaks > 0]] = True
        parts = np.where(marked[components], snow.regions.astype(np.int64), snow.regions.max() + components)
        regions = skimage.measure.label(parts * image, connectivity=1)
        n_interior = int(regions.max())
        regions = porespy.networks.add_boundary_regions(regions, pad_width=width)
        padded = np.pad(image, width, mode="edge").astype(np.uint8)
        raw = porespy.networks.regions_to_network(regions, phases=padded, voxel_size=1)

    coords = raw["pore.coords"]
    below, above = coords < width, coords > np.array(image.shape) + width - 1
    boundary = (below | above).any(axis=1)
    if np.count_nonzero(~boundary) != n_interior:
        raise AssertionError("boundary pores and interior pores do not add up")
    network: Network = {"pore.coords": (coords + 0.5 - width) / repeats}
    network["throat.conns"] = raw["throat.conns"].astype(np.int64).reshape(-1, 2)
    network["throat.coords"] = (raw["throat.global_peak"].reshape(-1, 3) + 0.5 - width) / repeats
    for name in LENGTH_POWER:
        if name in raw and not name.endswith("coords"):
            network[name] = np.asarray(raw[name], float)
    ends = network["pore.coords"][network["throat.conns"]]
    network["throat.half_lengths"] = np.linalg.norm(ends - network["throat.coords"][:, None], axis=2)
    network["pore.shape_factor"] = _at_most_circle(
        network["pore.volume"] * network["pore.equivalent_diameter"], network["pore.surface_area"]
    )
    network["throat.shape_factor"] = _at_most_circle(
        network["throat.cross_sectional_area"], network["throat.perimeter"]
    )
    network["pore.volume"] = np.where(boundary, 0.0, network["pore.volume"] / np.prod(repeats))
    for name, power in LENGTH_POWER.items():
        network[name] = network[name] * voxel_size_um**power
    for name in ("pore.coords", "throat.coords"):
        network[name] = network[name][:, ::-1].copy()  # (z, y, x) -> (x, y, z)
    network["pore.boundary"] = boundary
    for axis, letter in zip((2, 1, 0), "xyz", strict=True):
        network[f"pore.{letter}min"], network[f"pore.{letter}max"] = below[:, axis], above[:, axis]
    network["throat.disc_bounding"] = np.zeros(len(network["throat.conns"]), bool)
    return network


def _at_most_circle(size: np.ndarray, rim: np.ndarray) -> np.ndarray:
    """Shape factors size / rim^2, no larger than a circle's."""
    return np.minimum(np.divide(size, rim**2, out=np.full(len(rim), np.inf), where=rim > 0), CIRCLE)


@contextmanager
def _quiet_porespy() -> Iterator[object]:
    """PoreSpy (6 s to import) without progress bars and on one thread; its settings are put back."""
    import porespy

    settings = porespy.settings
    before = settings.tqdm, settings.ncores
    settings.tqdm, settings.ncores = {**settings.tqdm, "disable": True}, 1
    try:
        yield porespy
    finally:
        settings.tqdm, settings.ncores = before
