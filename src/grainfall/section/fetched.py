"""A volume that somebody else published, taken only if its checksum is known; one plane of it."""

from __future__ import annotations

import hashlib
import shutil
import tempfile
import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from grainfall import io
from grainfall.errors import InputError
from grainfall.section.read import Section, read_reference


def pore_of_known(path: str | Path, files: Mapping[str, int]) -> int:
    """The value that is pore in a published file, which its checksum tells.

    Parameters
    ----------
    path : str or Path
    files : mapping of str to int
        SHA-256 of every known form of the file, with the value that is pore in it.

    Raises
    ------
    InputError
        When the file is none of those known, or cannot be read.
    """
    try:
        with open(path, "rb") as stream:
            digest = hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as fault:
        raise InputError(path, fault.strerror or "cannot be read", "give the path of the volume") from None
    if digest not in files:
        raise InputError(
            path,
            f"has SHA-256 {digest}",
            f"another file, or a damaged one; known are {', '.join(files)}",
        )
    return files[digest]


def keep_published(path: str | Path, files: Mapping[str, int], folder: str | Path) -> None:
    """Copy a published file, if it is a known one, into a folder of its own.

    Raises
    ------
    InputError
        As :func:`pore_of_known`.
    """
    pore_of_known(path, files)
    with io.atomic_path(Path(folder) / Path(path).name) as copy:
        shutil.copyfile(path, copy)


def published_file(folder: str | Path) -> Path | None:
    """What :func:`keep_published` has left in a folder; None where that is not done."""
    return next((path for path in sorted(Path(folder).glob("[!.]*"))), None)


def read_known_volume(
    path: str | Path, voxel_size_um: float, files: Mapping[str, int]
) -> tuple[np.ndarray, float]:
    """Read a published volume, or a zip that holds just that one file.

    Parameters
    ----------
    path : str or Path
    voxel_size_um : float
        Edge of a voxel, micrometres.
    files : mapping of str to int
        As of :func:`pore_of_known`.

    Returns
    -------
    volume : (z, y, x) uint8
        0 pore, 1 solid.
    voxel_size_um : float

    Raises
    ------
    InputError
        When the file is none of those known, or cannot be read.
    """
    pore = pore_of_known(path, files)
    if not zipfile.is_zipfile(path) or Path(path).suffix != ".zip":
        return read_reference(path, voxel_size_um, pore_value=pore)
    with zipfile.ZipFile(path) as archive, tempfile.TemporaryDirectory() as folder:
        members = [m for m in archive.infolist() if not m.is_dir()]
        if len(members) != 1:
            raise InputError(path, f"holds {len(members)} files", "a zip with one volume in it")
        return read_reference(archive.extract(members[0], folder), voxel_size_um, pore_value=pore)


def plane_of(phase: np.ndarray, voxel_size_um: float, where: str) -> Section:
    """Cut one plane of voxels out of a volume.

    Parameters
    ----------
    phase : (z, y, x) uint8
        0 pore, 1 solid.
    voxel_size_um : float
        Edge of a voxel, micrometres: the section's pixel.
    where : str
        Axis that the plane stands on and its number: ``z200``.

    Returns
    -------
    Section
        ``notes`` say where it was cut.

    Raises
    ------
    InputError
        When the volume ends before that plane.
    """
    axis, plane = "zyx".index(where[0]), int(where[1:])
    if plane >= phase.shape[axis]:
        raise InputError(f"slice {where}", f"the volume has {phase.shape[axis]} planes", "a smaller number")
    image = np.ascontiguousarray(phase.take(plane, axis))
    return Section(image, voxel_size_um, ("pore", "grain"), notes={"slice": where})
