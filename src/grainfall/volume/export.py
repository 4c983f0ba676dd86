"""Volumes for other programs: MetaImage, RAW, VTI. Equal content gives equal bytes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from grainfall.io import atomic_path, write_text

META_TYPES = {
    "bool": "MET_UCHAR",
    "uint8": "MET_UCHAR",
    "int8": "MET_CHAR",
    "uint16": "MET_USHORT",
    "int16": "MET_SHORT",
    "uint32": "MET_UINT",
    "int32": "MET_INT",
    "float32": "MET_FLOAT",
    "float64": "MET_DOUBLE",
}


def export_raw(path: str | Path, volume: np.ndarray) -> None:
    """Write the bare voxels, little-endian, x fastest, then y, then z."""
    volume = np.ascontiguousarray(volume, dtype=volume.dtype.newbyteorder("<"))
    with atomic_path(path) as part:
        volume.tofile(part)


def export_metaimage(path: str | Path, volume: np.ndarray, voxel_size_um: float) -> None:
    """Write a MetaImage header ``*.mhd`` and its voxels ``*.raw`` beside it (ITK, 3D Slicer, ParaView, Fiji).

    Parameters
    ----------
    path : str or Path
        The header, ``*.mhd``.
    volume : (nz, ny, nx) array
    voxel_size_um : float
        Spacing; the offset is the centre of the first voxel, half a voxel from the corner. Both in um.

    Raises
    ------
    ValueError
        When the format has no name for the array's type.
    """
    if volume.dtype.name not in META_TYPES:
        raise ValueError(f"MetaImage cannot hold {volume.dtype}; use one of {', '.join(META_TYPES)}")
    path = Path(path)
    voxels = path.with_suffix(".raw")
    header = {
        "ObjectType": "Image",
        "NDims": volume.ndim,
        "Comment": "lengths in micrometres",
        "BinaryData": "True",
        "BinaryDataByteOrderMSB": "False",
        "CompressedData": "False",
        "Offset": " ".join([repr(0.5 * float(voxel_size_um))] * volume.ndim),
        "ElementSpacing": " ".join([repr(float(voxel_size_um))] * volume.ndim),
        "DimSize": " ".join(map(str, volume.shape[::-1])),
        "ElementType": META_TYPES[volume.dtype.name],
        "ElementDataFile": voxels.name,
    }
    export_raw(voxels, volume)
    write_text(path, "".join(f"{key} = {value}\n" for key, value in header.items()))


def export_vti(path: str | Path, arrays: Mapping[str, np.ndarray], voxel_size_um: float) -> None:
    """Write a VTK image ``*.vti`` with the arrays as cell data, lengths in um (ParaView, PyVista).

    Parameters
    ----------
    path : str or Path
        Target, ``*.vti``.
    arrays : mapping of str to (nz, ny, nx) array
        Written in the order given.
    voxel_size_um : float
        Spacing; the origin is the volume's corner.
    """
    from pyevtk.hl import imageToVTK

    cells = {}
    for name, array in arrays.items():
        array = np.ascontiguousarray(array)
        cells[name] = (array.view(np.uint8) if array.dtype == bool else array).T
    with atomic_path(path) as part:
        written = part.with_name(f"{part.name}.vti")  # it gives the name its own ending
        try:
            imageToVTK(str(part), spacing=(float(voxel_size_um),) * 3, cellData=cells)
            written.replace(part)
        finally:
            written.unlink(missing_ok=True)
