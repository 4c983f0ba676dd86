"""Which grains touch, how many others each leans on, and which lost what they lay on."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from grainfall.contacts.distance import Hulls, bounding_radii, closest_points, collided
from grainfall.packing.parameters import Parameters
from grainfall.volume import adjacent_pairs

if TYPE_CHECKING:
    from grainfall.grains import Library

TOLERANCE = 1e-3
"""Largest gap of a contact over the mean grain diameter.

Rigid-body engines hold resting grains within some 1e-4 of a diameter of touching, on either side: a tolerance
ten times that loses no contact of theirs and adds few neighbours that merely come near.
"""

RATTLER_CONTACTS = 3
"""Contacts below which a grain is a rattler: three hold a grain up against gravity.

Four, as for frictionless packings without gravity, will not do: grains of the free surface rest on three
others, and once they are taken away so do the next, until nothing is left of the bed.
"""


def find_contacts(
    bodies: pd.DataFrame,
    library: Library,
    body_volume: np.ndarray | None,
    voxel_size_um: float,
    tolerance: float = TOLERANCE,
    parameters: Parameters | None = None,
    packed: pd.DataFrame | None = None,
    forces: pd.DataFrame | None = None,
) -> pd.DataFrame:
    """Pairs of grains in contact, wherever they lie.

    Parameters
    ----------
    bodies : DataFrame
        Columns of ``bodies.csv`` (lengths in um).
    library : Library
        Shapes; a pair is judged by their convex hulls.
    body_volume : (nz, ny, nx) array of int or None
        Body id + 1 of every voxel of the region of interest, 0 in pores.
    voxel_size_um : float
        Edge of a voxel.
    tolerance : float
        Largest gap of a contact over the mean grain diameter (of equal-volume spheres).
    parameters : Parameters, optional
        Judge by the shapes that the engine collided, not by the hulls of the meshes. A simplified hull
        differs from the mesh's by some percent of a radius, many times the tolerance: grains at rest on each
        other show a gap, or a deep overlap, between their meshes.
    packed : DataFrame, optional
        The bodies as they came to rest, before positions were scaled to the target porosity or room was made
        for rims. The first moves neighbours apart (or into each other) by up to half a percent of their
        distance, again more than the tolerance: contacts and gaps are then those of the packing, in its own
        um, located in the twin.
    forces : DataFrame, optional
        Normal forces in the packing as it came to rest, virtual spheres included: a < b (ids), force_n.

    Returns
    -------
    DataFrame
        A row a pair, by ids: grain_a < grain_b, phase_a, phase_b; x, y, z (um, midway between the closest
        points); nx, ny, nz (unit normal from a to b); area_um2 (of the voxel faces that the two share within
        the volume, so too little where a face of the volume cuts the contact; empty where none of it is
        inside); force_n (normal force, under the weights that heavy bodies were given in the packing, 0 where
        the two touch and carry nothing; empty without ``forces``);
        gap_um (negative: depth of penetration).
    """
    grains = bodies[bodies["kind"] == "grain"]
    rest = grains if packed is None else packed[packed["id"].isin(grains["id"])]
    limit = tolerance * 2 * rest["scale"].mean() if len(rest) else 0.0
    shapes = library if parameters is None else collided(library, grains["shape"], parameters)
    pairs = closest_points(rest, shapes, limit)
    pairs = pairs[pairs["gap_um"] <= limit].reset_index(drop=True)
    phase = grains.set_index("id")["phase"]
    table = pd.DataFrame({"grain_a": pairs["a"], "grain_b": pairs["b"]})
    table["phase_a"], table["phase_b"] = (phase.loc[table[g]].to_numpy() for g in ("grain_a", "grain_b"))
    table[["x", "y", "z"]] = _carried(pairs, rest.set_index("id"), grains.set_index("id"))
    table[["nx", "ny", "nz"]] = pairs[["nx", "ny", "nz"]]
    table["area_um2"] = np.nan
    if body_volume is not None:
        shared = adjacent_pairs(body_volume, voxel_size_um)
        area = shared.set_index([shared["body_a"] - 1, shared["body_b"] - 1])["area_um2"]
        found = area.reindex(pd.MultiIndex.from_frame(table[["grain_a", "grain_b"]])).to_numpy()
        size = voxel_size_um * np.array(body_volume.shape[::-1], float)
        inside = _inside(table, size)
        table["area_um2"] = np.where(np.isnan(found) & inside, 0.0, found)
    table["force_n"] = np.nan
    if forces is not None:
        known = forces.set_index(["a", "b"])["force_n"]
        found = known.reindex(pd.MultiIndex.from_frame(table[["grain_a", "grain_b"]]))
        table["force_n"] = found.fillna(0.0).to_numpy()
    table["gap_um"] = pairs["gap_um"]
    return table.sort_values(["grain_a", "grain_b"], ignore_index=True)


def _carried(pairs: pd.DataFrame, rest: pd.DataFrame, grains: pd.DataFrame) -> np.ndarray:
    """Points between pairs of grains at rest, where they are when the grains have moved: as far on the way
    from centre to centre as before."""
    names = ["x", "y", "z"]
    points = pairs[names].to_numpy(float)
    (a, b), (a_now, b_now) = (
        [table.loc[pairs[end], names].to_numpy(float) for end in ("a", "b")] for table in (rest, grains)
    )
    way = b - a
    share = ((points - a) * way).sum(axis=1) / np.maximum((way**2).sum(axis=1), np.finfo(float).tiny)
    share = np.clip(share, 0, 1)[:, None]
    return points + (1 - share) * (a_now - a) + share * (b_now - b)


def _inside(table: pd.DataFrame, size_um: np.ndarray) -> np.ndarray:
    """Rows whose x, y, z lie in the box [0, size_um)."""
    points = table[["x", "y", "z"]].to_numpy()
    return ((points >= 0) & (points < size_um)).all(axis=1)


def coordination(
    contacts: pd.DataFrame,
    bodies: pd.DataFrame,
    size_um: tuple[float, float, float] | None = None,
    minimum: int = RATTLER_CONTACTS,
) -> pd.DataFrame:
    """Mean coordination without rattlers, and their fraction, of grains centred in the region of interest.

    A rattler has fewer than ``minimum`` contacts with grains that are no rattlers themselves (found by
    removing grains until none is left to remove). Grains outside the region take part as neighbours and are
    judged alike; only those inside are counted.

    Parameters
    ----------
    contacts : DataFrame
        See :func:`find_contacts`; of all the grains, not only those inside.
    bodies : DataFrame
        Columns of ``bodies.csv``.
    size_um : (float, float, float), optional
        Size of the region of interest along x, y, z; everywhere if omitted.
    minimum : int
        Contacts that make a grain part of the skeleton.

    Returns
    -------
    DataFrame
        Columns phase (0 stands for all grains, then every phase), n_grains, coordination (mean number of
        contacts with skeleton grains over the skeleton grains; empty where there is none), rattlers (fraction
        of the grains; empty without grains).
    """
    grains = bodies[bodies["kind"] == "grain"].sort_values("id")
    row = pd.Series(np.arange(len(grains)), index=grains["id"])
    a, b = (row.loc[contacts[g]].to_numpy(int) for g in ("grain_a", "grain_b"))
    skeleton = np.ones(len(grains), bool)
    while True:
        live = skeleton[a] & skeleton[b]
        degree = np.bincount(np.concatenate([a[live], b[live]]), minlength=len(grains))
        keep = skeleton & (degree >= minimum)
        if np.array_equal(keep, skeleton):
            break
        skeleton = keep
    inside = np.ones(len(grains), bool) if size_um is None else _inside(grains, np.asarray(size_um, float))
    phase = grains["phase"].to_numpy()
    rows = []
    for which in (0, *np.unique(phase)):
        counted = inside & (phase == which) if which else inside
        n, bearing = np.count_nonzero(counted), counted & skeleton
        mean = degree[bearing].mean() if bearing.any() else np.nan
        rows.append((int(which), n, mean, 1 - np.count_nonzero(bearing) / n if n else np.nan))
    return pd.DataFrame(rows, columns=["phase", "n_grains", "coordination", "rattlers"])


def lost_support(
    forces: pd.DataFrame, packed: pd.DataFrame, size_um: tuple[float, float, float] | None = None
) -> dict:
    """How many grains leaned on virtual spheres and cannot stand without them.

    A grain is carried by bodies that press on it; :data:`RATTLER_CONTACTS` of them hold it up. A grain that
    had so many and has fewer once the spheres are gone has lost its support (what it leans on may itself
    fall: :func:`grainfall.packing.settle` shows what becomes of that).

    Parameters
    ----------
    forces : DataFrame
        a, b (ids), force_n of the packing as it came to rest, spheres included.
    packed : DataFrame
        Its bodies (columns of bodies.csv).
    size_um : (float, float, float), optional
        Size of the region of interest along x, y, z: grains centred in it are counted.

    Returns
    -------
    dict
        on_spheres: share of grains that touch a sphere with force; lost_support: share of grains that lost
        theirs. None without grains.
    """
    grains = packed[packed["kind"] == "grain"]
    if size_um is not None:
        grains = grains[_inside(grains, np.asarray(size_um, float))]
    if grains.empty:
        return {"on_spheres": None, "lost_support": None}
    pressing = forces[forces["force_n"] > 0]
    pairs = np.vstack([pressing[["a", "b"]].to_numpy(int), pressing[["b", "a"]].to_numpy(int)])
    virtual = np.isin(pairs[:, 1], packed.loc[packed["kind"] == "virtual", "id"])
    n = int(packed["id"].max()) + 1
    every, spheres = (np.bincount(pairs[which, 0], minlength=n) for which in (slice(None), virtual))
    every, spheres = every[grains["id"]], spheres[grains["id"]]
    lost = (every >= RATTLER_CONTACTS) & (every - spheres < RATTLER_CONTACTS)
    return {"on_spheres": float((spheres > 0).mean()), "lost_support": float(lost.mean())}


def max_overlap(
    bodies: pd.DataFrame,
    library: Library,
    size_um: tuple[float, float, float] | None = None,
    parameters: Parameters | None = None,
) -> float:
    """Deepest penetration of two grains over the smaller one's radius, 0 where none overlap.

    Parameters
    ----------
    bodies : DataFrame
        Columns of ``bodies.csv``; radius is that of the equal-volume sphere.
    library : Library
        Shapes; the convex hulls of their meshes are compared, an upper bound where they are not convex. The
        simplified hulls of the engine overlap far less; their difference from the mesh is counted here.
    size_um : (float, float, float), optional
        Size of the region of interest along x, y, z: only grains whose bounding spheres meet it are compared.
    parameters : Parameters, optional
        Of grains that the engine collided as several parts, compare those parts in place of the hull.
    """
    grains = bodies[bodies["kind"] == "grain"]
    if parameters is not None:
        parts = collided(library, grains["shape"], parameters).parts
        library = Hulls({s: p if len(p) > 1 else (library.vertices[s],) for s, p in parts.items()})
    if size_um is not None:
        points = grains[["x", "y", "z"]].to_numpy(float)
        outside = points - np.clip(points, 0, np.asarray(size_um, float))
        grains = grains[np.linalg.norm(outside, axis=1) <= bounding_radii(grains, library)]
    pairs = closest_points(grains, library, 0.0)
    scale = grains.set_index("id")["scale"]
    smaller = np.minimum(scale.loc[pairs["a"]].to_numpy(), scale.loc[pairs["b"]].to_numpy())
    return float(np.max(-pairs["gap_um"].to_numpy() / smaller, initial=0.0))
