"""The last small step to the target porosity: grain positions scaled about the region's centre."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
import pandas as pd

from grainfall.volume.measures import describe
from grainfall.volume.scan import Meshes, claimed_slabs, packed_porosity

TOLERANCE = 0.0005
"""Largest porosity error that is left where the correction is applied."""

UNBRACKETED = 4
"""Steps (each twice the last) after which the target is given up as out of reach."""


def correct_porosity(
    bodies: pd.DataFrame,
    library: Meshes,
    shape: tuple[int, int, int],
    voxel_size_um: float,
    target: float,
    limit: float = 0.01,
    *,
    switch: str = "auto",
    max_passes: int = 12,
) -> tuple[pd.DataFrame, dict]:
    """Scale grain positions isotropically about the region's centre until the porosity is the target.

    Grains keep their size, shape and orientation; bodies outside the region move with the rest (they come
    in on contraction). Virtual bodies are removed first. Positions scaled by s make n / s^3 grains per
    volume, so s = ((1 - porosity) / (1 - target))^(1/3) is the first guess; the voxel porosity, a step
    function of s, is then bracketed and met by regula falsi.

    Parameters
    ----------
    bodies : DataFrame
        Bodies in um from the region's corner (columns as :func:`grainfall.volume.voxelise` takes).
    library : Library
        Meshes of the shapes.
    shape : (nz, ny, nx)
        Voxels of the region.
    voxel_size_um : float
        Edge of a voxel.
    target : float
        Porosity wanted.
    limit : float
        Largest ``|target - porosity|`` that position scaling may bridge, whatever the switch.
    switch : {"auto", "on", "off"}
    max_passes : int
        Scales tried at most.

    Returns
    -------
    bodies : DataFrame
        The grains, moved where the correction was applied.
    report : dict
        applied, forced, reason, target, limit, scale_factor, passes (scales tried), wall_s, before and
        after: porosity, euler (of the pore space, 6-connected), contacts (pairs of grains that share voxel
        faces), contact_area_um2, shared_share (of the solid, claimed by several grains).

    Notes
    -----
    Paper, section "Dual-Stage Gravitational Packing". ``applied`` is False, with the reason, where the
    porosity is there already, the step would exceed ``limit``, or no scale tried gets within 0.0005 of the
    target; the grains then stay where they were. Contraction is out of reach where no grains lie around the
    region: the emptied rim outweighs the denser core.
    """
    started = time.perf_counter()
    grains, report = _corrected(bodies, library, shape, voxel_size_um, target, limit, switch, max_passes)
    return grains, {**report, "forced": switch != "auto", "wall_s": time.perf_counter() - started}


def _corrected(
    bodies, library, shape, voxel_size_um, target, limit, switch, max_passes
) -> tuple[pd.DataFrame, dict]:
    grains = bodies[bodies["kind"] != "virtual"].reset_index(drop=True)
    centre = 0.5 * voxel_size_um * np.asarray(shape[::-1], float)

    def described(moved: pd.DataFrame) -> dict:
        shared = 0

        def slabs() -> Iterator[np.ndarray]:
            nonlocal shared
            for body, more in claimed_slabs(moved, library, shape, voxel_size_um):
                shared += more
                yield body

        found = describe(slabs(), voxel_size_um)
        solid = round((1 - found["porosity"]) * np.prod(shape))
        return {**found, "shared_share": shared / solid if solid else 0.0}

    def gap_at(s: float) -> float:
        return packed_porosity(scale_positions(grains, centre, s), library, shape, voxel_size_um) - target

    before = described(grains)
    gap = before["porosity"] - target
    report = {
        "applied": False,
        "reason": "",
        "target": float(target),
        "limit": float(limit),
        "scale_factor": 1.0,
        "passes": 1,
        "before": before,
        "after": before,
    }
    if switch == "off":
        report["reason"] = f"switched off in the config, {abs(gap):.4f} from the target"
        return grains, report
    if abs(gap) > limit:
        report["reason"] = f"target not reachable by position scaling: |dphi| = {abs(gap):.4f} > {limit:g}"
        return grains, report

    # Aim well inside the tolerance, but no finer than the steps that one voxel makes.
    aim = max(TOLERANCE / 5, 1.0 / np.prod(shape, dtype=float))
    best, best_s = gap, 1.0
    s = ((1.0 - before["porosity"]) / (1.0 - target)) ** (1 / 3)
    step = s - 1.0
    points = [(1.0, gap)]
    while len(points) < max_passes and abs(best) > aim:
        trial = gap_at(s)
        points.append((s, trial))
        if abs(trial) < abs(best):
            best, best_s = trial, s
        below = max((p for p in points if p[1] < 0), default=None)
        above = min((p for p in points if p[1] > 0), default=None)
        if below is None or above is None:
            # Not bracketed: grains that leave or enter made less of a difference than 1 / s^3. Walk on.
            if len(points) > UNBRACKETED:
                break
            s += step
            step *= 2.0
        elif below[0] < above[0]:
            # Regula falsi, kept off the ends so that the bracket shrinks on both sides.
            share = np.clip(below[1] / (below[1] - above[1]), 0.1, 0.9)
            s = below[0] + share * (above[0] - below[0])
        else:
            break  # steps of a coarse grid have crossed: the best seen is what the grid can resolve
    report["passes"] = len(points)
    if abs(best) > TOLERANCE:
        nearest = best + target
        report["reason"] = (
            f"no scale within {100 * abs(s - 1):.1f} % comes within {TOLERANCE:g} of the target "
            f"(nearest porosity {nearest:.5f}); contraction needs grains around the region to move in"
        )
        return grains, report
    reason = "already within the tolerance" if best_s == 1.0 else "positions scaled"
    if best_s != 1.0:
        grains = scale_positions(grains, centre, best_s)
        report["after"] = described(grains)
    report |= {"applied": bool(best_s != 1.0), "reason": reason, "scale_factor": float(best_s)}
    return grains, report


def scale_positions(bodies: pd.DataFrame, centre_um: np.ndarray, factor: float) -> pd.DataFrame:
    """Positions scaled about a centre (x, y, z) in um; size, shape and orientation stay."""
    if factor == 1.0:
        return bodies
    xyz = bodies[["x", "y", "z"]].to_numpy(np.float64)
    moved = centre_um + factor * (xyz - centre_um)
    return bodies.assign(x=moved[:, 0], y=moved[:, 1], z=moved[:, 2])
