"""Shapes and packed bodies as GLB (glTF, y up) or STL (z up) in micrometres, and as LAMMPS data."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import lazy_loader
import numpy as np
import pandas as pd
import scipy  # its parts load when they are first used

from grainfall import io
from grainfall.errors import InputError
from grainfall.grains.library import Library

trimesh = lazy_loader.load("trimesh")  # 0.3 s, for jobs that make or write meshes

PHASE_COLOURS = (
    (0xD8, 0xB3, 0x65),
    (0x5A, 0xB4, 0xAC),
    (0xC5, 0x6B, 0x6B),
    (0x7F, 0x8F, 0xC9),
    (0x8D, 0xA8, 0x5E),
    (0xB5, 0x86, 0xC0),
)
"""RGB of the minerals 1, 2, …; they repeat."""

VIRTUAL_COLOUR = (0xC8, 0xC8, 0xC8)
QUARTZ_KG_M3 = 2650.0
_Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])


def export_bodies(
    bodies: pd.DataFrame,
    library: Library,
    path: str | Path,
    colours: Mapping[int, tuple[int, int, int]] | None = None,
) -> None:
    """Write packed bodies, coloured by phase, as ``.glb`` or ``.stl`` (which has no colours).

    Parameters
    ----------
    bodies : DataFrame
        Columns kind, phase, shape, scale, x, y, z, qw, qx, qy, qz as in ``bodies.csv``.
    library : Library
    path : str or Path
        In GLB each shape is stored once for each colour and placed many times.
    colours : mapping of phase to RGB (0 … 255), optional

    Raises
    ------
    InputError
        Where the path ends in anything else, or there is no body.
    """
    kind = Path(path).suffix.lower()
    if kind not in (".glb", ".stl"):
        raise InputError(path, f"cannot export to {kind or 'a file without ending'}", "use .glb or .stl")
    if bodies.empty:
        raise InputError("bodies", "there is nothing to export", "give at least one body")
    poses = np.tile(np.eye(4), (len(bodies), 1, 1))
    turn = scipy.spatial.transform.Rotation.from_quat(
        bodies[["qw", "qx", "qy", "qz"]].to_numpy(float), scalar_first=True
    )
    poses[:, :3, :3] = turn.as_matrix() * bodies["scale"].to_numpy(float)[:, None, None]
    poses[:, :3, 3] = bodies[["x", "y", "z"]]
    if kind == ".stl":
        data = _stl(bodies, library, poses)
    else:
        data = _glb(bodies, library, _Y_UP @ poses, colours or {})
    with io.atomic_path(path) as part:
        part.write_bytes(data)


def export_lammps(bodies: pd.DataFrame, path: str | Path, density_kg_m3: float = QUARTZ_KG_M3) -> None:
    """Write packed bodies as a data file that LAMMPS and LIGGGHTS read (``atom_style sphere``, ``units si``).

    Each body is the sphere of its volume at its centre of mass, its type the phase (of virtual spheres, the
    one after the last phase): shapes and orientations are lost, and where grains are not round their spheres
    overlap. The box holds all spheres.

    Parameters
    ----------
    bodies : DataFrame
        Columns kind, phase, scale (equal-volume radius), x, y, z as in ``bodies.csv``; um.
    path : str or Path
    density_kg_m3 : float
        Of every body.

    Raises
    ------
    InputError
        When there is no body.
    """
    if bodies.empty:
        raise InputError("bodies", "there is nothing to export", "give at least one body")
    virtual = (bodies["kind"] == "virtual").to_numpy()
    phases = int(bodies.loc[~virtual, "phase"].max()) if not virtual.all() else 0
    kinds = np.where(virtual, phases + 1, bodies["phase"])
    centre = bodies[["x", "y", "z"]].to_numpy(float) * 1e-6
    radius = bodies["scale"].to_numpy(float) * 1e-6
    low, high = (centre - radius[:, None]).min(axis=0), (centre + radius[:, None]).max(axis=0)
    lines = [
        "grainfall: equal-volume spheres; atom_style sphere, units si: id type diameter density x y z",
        "",
        f"{len(bodies)} atoms",
        f"{phases + int(virtual.any())} atom types",
        "",
        *(f"{a:.9e} {b:.9e} {axis}lo {axis}hi" for a, b, axis in zip(low, high, "xyz", strict=True)),
        "",
        "Atoms",
        "",
    ]
    rows = zip(kinds, 2 * radius, *centre.T, strict=True)
    lines += [
        f"{n} {kind} {d:.9e} {density_kg_m3:.9e} {x:.9e} {y:.9e} {z:.9e}"
        for n, (kind, d, x, y, z) in enumerate(rows, start=1)
    ]
    io.write_text(path, "\n".join(lines) + "\n")


def _stl(bodies: pd.DataFrame, library: Library, poses: np.ndarray) -> bytes:
    meshes = []
    for shape, pose in zip(bodies["shape"], poses, strict=True):
        vertices, faces = library.mesh(shape)
        meshes.append(trimesh.Trimesh(vertices @ pose[:3, :3].T + pose[:3, 3], faces, process=False))
    return trimesh.exchange.stl.export_stl(trimesh.util.concatenate(meshes))


def _glb(
    bodies: pd.DataFrame, library: Library, poses: np.ndarray, colours: Mapping[int, tuple[int, int, int]]
) -> bytes:
    scene = trimesh.Scene()
    for i, body in enumerate(bodies.itertuples()):
        virtual = body.kind == "virtual"
        name = f"{'virtual' if virtual else f'phase{body.phase}'}_shape{body.shape}"
        if name not in scene.geometry:
            vertices, faces = library.mesh(body.shape)
            paint = PHASE_COLOURS[(body.phase - 1) % len(PHASE_COLOURS)]
            paint = VIRTUAL_COLOUR if virtual else colours.get(body.phase, paint)
            mesh = trimesh.Trimesh(vertices, faces, process=False)
            mesh.visual = trimesh.visual.TextureVisuals(
                material=trimesh.visual.material.PBRMaterial(
                    name=name, baseColorFactor=[*paint, 255], metallicFactor=0.0, roughnessFactor=0.9
                )
            )
            scene.add_geometry(mesh, node_name=f"body{i}", geom_name=name, transform=poses[i])
        else:
            scene.graph.update(frame_to=f"body{i}", matrix=poses[i], geometry=name)
    return trimesh.exchange.gltf.export_glb(scene)
