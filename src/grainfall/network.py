"""Pore network of a voxel image: pores, throats and their geometry, in OpenPNM's names.

A network is a plain ``dict`` of arrays named as OpenPNM names them (``pore.coords``, ``throat.conns``, ...).
Lengths are micrometres, coordinates are (x, y, z) from the corner of the region of interest, x along axis 2
of the image. :func:`to_openpnm` gives the same network in metres as an ``openpnm.network.Network``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeAlias

import numpy as np
import pandas as pd
from skimage.measure import label

from grainfall.errors import InputError
from grainfall.io import read_table, write_table

Network: TypeAlias = dict[str, np.ndarray]
"""OpenPNM names to arrays; the first axis is the pore or the throat."""

LENGTH_POWER = {
    "pore.coords": 1,
    "pore.volume": 3,
    "pore.surface_area": 2,
    "pore.inscribed_diameter": 1,
    "pore.extended_diameter": 1,
    "pore.equivalent_diameter": 1,
    "throat.coords": 1,
    "throat.cross_sectional_area": 2,
    "throat.perimeter": 1,
    "throat.inscribed_diameter": 1,
    "throat.equivalent_diameter": 1,
    "throat.direct_length": 1,
    "throat.total_length": 1,
}
"""Dimensional properties of every network and the power of length that each carries."""

FACES = ("xmin", "xmax", "ymin", "ymax", "zmin", "zmax")
BOUNDARY_WIDTH = 3
"""Thickness in voxels of the boundary pores that snow2 puts outside each face (PoreSpy's default)."""


def extract(pore: np.ndarray, voxel_size_um: float, method: str = "snow2", **options: object) -> Network:
    """Extract the pore network of a binary volume, with boundary pores on all six faces.

    Parameters
    ----------
    pore : (nz, ny, nx) array of bool
        True in the pore space.
    voxel_size_um : float
        Edge of a voxel in micrometres.
    method : {"snow2"}
        Extraction method; see :data:`METHODS`.
    **options
        Passed to the method; snow2 takes ``sigma`` (0.4, blur of the distance map in voxels) and
        ``r_max`` (4, radius in voxels within which a maximum must stand alone).

    Returns
    -------
    dict of str to ndarray
        ``pore.coords`` (n, 3) um, ``pore.boundary`` and ``pore.xmin`` ... ``pore.zmax`` (n,) bool,
        ``throat.conns`` (m, 2) int, and the properties of :data:`LENGTH_POWER` (um to that power):

        - ``pore.inscribed_diameter``: largest sphere in the pore's own region;
          ``pore.extended_diameter``: the same in the whole pore space; ``pore.equivalent_diameter``: sphere
          of the region's volume (also of boundary pores, whose ``pore.volume`` is 0 as they lie outside)
        - ``throat.inscribed_diameter``: largest sphere centred on the interface; ``throat.total_length``:
          pore centre to throat centre to pore centre; ``throat.direct_length``: straight.

        Without pore voxels, and without solid voxels (no walls: nothing to partition), the network is empty.

    Raises
    ------
    InputError
        For an unknown method, or an image that is not three-dimensional.
    """
    pore = np.asarray(pore)
    if pore.ndim != 3 or 0 in pore.shape:
        raise InputError("pore", f"an image of shape {pore.shape}", "give a volume (z, y, x)")
    if method not in METHODS:
        raise InputError(
            "network method", f"unknown method {method!r}", f"choose one of {', '.join(METHODS)}"
        )
    pore = pore.astype(bool)
    if pore.all() or not pore.any():
        return empty()
    return METHODS[method](pore, float(voxel_size_um), **options)


def empty() -> Network:
    """A network of no pores and no throats that has every property."""
    network: Network = {"throat.conns": np.empty((0, 2), np.int64)}
    for name in LENGTH_POWER:
        network[name] = np.empty((0, 3) if name.endswith("coords") else 0)
    for name in ("boundary", *FACES):
        network[f"pore.{name}"] = np.empty(0, bool)
    return network


def _snow2(pore: np.ndarray, voxel_size_um: float, *, sigma: float = 0.4, r_max: int = 4) -> Network:
    """SNOW (Gostick 2017) by PoreSpy: the steps of ``porespy.networks.snow2`` in series, so that no number of
    threads or chunks changes the result, with two repairs:

    - the watershed of PoreSpy floods through the solid into closed parts of the pore space that got no
      marker, and such a part, taken by two regions, links them: it becomes a region of its own;
    - boundary pores are those outside the faces, not those of extreme coordinates, which are interior pores
      where nothing opens onto a face.
    """
    width = BOUNDARY_WIDTH
    # PoreSpy wants at least two voxels along each axis; a sheet repeated along its normal is the same sheet.
    repeats = [2 if n == 1 else 1 for n in pore.shape]
    image = pore
    for axis, repeat in enumerate(repeats):
        image = np.repeat(image, repeat, axis=axis)
    with _quiet_porespy() as porespy:
        snow = porespy.filters.snow_partitioning(image, sigma=sigma, r_max=r_max)
        components = label(image, connectivity=1)
        marked = np.zeros(components.max() + 1, bool)
        marked[components[snow.peaks > 0]] = True
        parts = np.where(marked[components], snow.regions.astype(np.int64), snow.regions.max() + components)
        regions = label(parts * image, connectivity=1)
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
        if not name.endswith("coords"):
            network[name] = np.asarray(raw[name], float)
    network["pore.volume"] = np.where(boundary, 0.0, network["pore.volume"] / np.prod(repeats))
    for name, power in LENGTH_POWER.items():
        network[name] = network[name] * voxel_size_um**power
    for name in ("pore.coords", "throat.coords"):
        network[name] = network[name][:, ::-1].copy()  # (z, y, x) -> (x, y, z)
    network["pore.boundary"] = boundary
    for axis, letter in zip((2, 1, 0), "xyz", strict=True):
        network[f"pore.{letter}min"], network[f"pore.{letter}max"] = below[:, axis], above[:, axis]
    return network


METHODS: dict[str, Callable[..., Network]] = {"snow2": _snow2}
"""Extraction methods: (pore, voxel_size_um, **options) -> network."""


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


def subnetwork(network: Network, keep: np.ndarray) -> Network:
    """The pores ``keep`` (n,) bool and the throats between them, renumbered."""
    conns = network["throat.conns"]
    throats = keep[conns].all(axis=1)
    number = np.cumsum(keep) - 1
    part = {k: v[keep if k.startswith("pore.") else throats] for k, v in network.items()}
    part["throat.conns"] = number[part["throat.conns"]]
    return part


def to_openpnm(network: Network) -> object:
    """The network as an ``openpnm.network.Network``, in metres.

    ``pore.diameter``, ``throat.diameter`` and ``throat.spacing`` are set as OpenPNM's example of an extracted
    network sets them: equivalent sphere, inscribed sphere, length through the throat.
    """
    import openpnm

    arrays = {k: v * 1e-6 ** LENGTH_POWER.get(k, 0) if k in LENGTH_POWER else v for k, v in network.items()}
    pn = openpnm.network.Network(coords=arrays.pop("pore.coords"), conns=arrays.pop("throat.conns"))
    # OpenPNM would otherwise replace the lengths measured through the throats by straight ones.
    pn.models.clear()
    pn.update(arrays)
    pn["pore.diameter"] = pn["pore.equivalent_diameter"]
    pn["throat.diameter"] = pn["throat.inscribed_diameter"]
    pn["throat.spacing"] = pn["throat.total_length"]
    return pn


def save(network: Network, pores_csv: str | Path, throats_csv: str | Path) -> None:
    """Write a network as two tables (``network_pores.csv``, ``network_throats.csv``).

    Columns carry OpenPNM's names; a vector's components are ``pore.coords[0]``, ``[1]``, ``[2]``, as OpenPNM
    writes them. Units: um, um2, um3. Equal networks give equal bytes.
    """
    for kind, path in (("pore", pores_csv), ("throat", throats_csv)):
        columns: dict[str, np.ndarray] = {}
        names = [k for k in network if k.startswith(f"{kind}.")]
        for name in sorted(names, key=lambda k: (k not in ("pore.coords", "throat.conns"), k)):
            values = network[name]
            if values.ndim == 1:
                columns[name] = values
            else:
                columns |= {f"{name}[{i}]": values[:, i] for i in range(values.shape[1])}
        write_table(path, pd.DataFrame(columns))


def load(pores_csv: str | Path, throats_csv: str | Path) -> Network:
    """Read a network that :func:`save` wrote.

    Raises
    ------
    InputError
        When a table lacks coordinates or connections.
    """
    network: Network = {}
    for path, kind, needed in ((pores_csv, "pore", "pore.coords"), (throats_csv, "throat", "throat.conns")):
        table = read_table(path)
        vectors: dict[str, list[str]] = {}
        for column in table.columns:
            vectors.setdefault(column.split("[")[0], []).append(column)
        if needed not in vectors:
            raise InputError(
                path, f"no column {needed}[0]", f"a table of {kind}s written by grainfall is needed"
            )
        for name, columns in vectors.items():
            values = table[columns].to_numpy() if len(columns) > 1 else table[columns[0]].to_numpy()
            is_label = name not in LENGTH_POWER and name != "throat.conns"
            dtype = np.int64 if name == "throat.conns" else bool if is_label else float
            network[name] = values.astype(dtype)
    return network


def coordination_numbers(network: Network) -> np.ndarray:
    """Throats of every pore (n,) int; a throat to a boundary pore stands for the link beyond the face."""
    return np.bincount(network["throat.conns"].ravel(), minlength=len(network["pore.coords"]))


def element_sizes(network: Network) -> dict[str, np.ndarray]:
    """Sizes to compare networks by: of interior pores with a throat, and of throats between interior pores.

    Pores without throats are left out: nearly all are specks of a few voxels cut off by the resolution.

    Returns
    -------
    dict
        ``pore_radius_um``: of the largest sphere about the pore's centre in the whole pore space;
        ``throat_radius_um``: of the largest sphere in the throat; ``coordination``: throats a pore.
    """
    coordination = coordination_numbers(network)
    inner = ~network["pore.boundary"]
    linked = inner & (coordination > 0)
    return {
        "pore_radius_um": network["pore.extended_diameter"][linked] / 2,
        "throat_radius_um": network["throat.inscribed_diameter"][inner[network["throat.conns"]].all(axis=1)]
        / 2,
        "coordination": coordination[linked],
    }


def summarise(network: Network) -> pd.DataFrame:
    """Distribution of each of :func:`element_sizes` in one row.

    Returns
    -------
    DataFrame
        Columns element, n, mean, std, p10, median, p90; statistics of no elements are empty.
    """
    rows = []
    for element, values in element_sizes(network).items():
        row: dict[str, object] = {"element": element, "n": len(values)}
        if len(values):
            p10, median, p90 = np.percentile(values, [10, 50, 90])
            row |= {"mean": values.mean(), "std": values.std(), "p10": p10, "median": median, "p90": p90}
        rows.append(row)
    return pd.DataFrame(rows, columns=["element", "n", "mean", "std", "p10", "median", "p90"])
