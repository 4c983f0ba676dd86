"""A twin in the files of other programs: every format this package writes, by name.

Chapters are loaded by the formats that need them, so that the names alone cost nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from grainfall import io
from grainfall.errors import InputError


@dataclass(frozen=True)
class Twin:
    """Files of one twin.

    Attributes
    ----------
    folder : Path
        Holds twin.zarr.zip, bodies.csv, network_pores.csv and network_throats.csv.
    library : Path
        Folder of the sample's grain library.
    coarsen : int
        The config's ``network.coarsen``, by which the pore network was measured.
    """

    folder: Path
    library: Path
    coarsen: int = 1

    @cached_property
    def phase(self):
        """(z, y, x) uint8, and the voxel size in um."""
        phase, attributes = io.read_volume(self.folder / "twin.zarr.zip", "phase")
        return phase, attributes["voxel_size_um"]

    @cached_property
    def bodies(self):
        """Grains with their places."""
        return io.read_table(self.folder / "bodies.csv")

    @cached_property
    def network(self):
        """The pore network."""
        from grainfall import network

        return network.load(self.folder / "network_pores.csv", self.folder / "network_throats.csv")


def _mhd(twin: Twin, path: Path) -> None:
    from grainfall.volume import export_metaimage

    export_metaimage(path, *twin.phase)


def _vti(twin: Twin, path: Path) -> None:
    from grainfall.volume import export_vti

    phase, size = twin.phase
    export_vti(path, {"phase": phase}, size)


def _meshes(twin: Twin, path: Path) -> None:
    from grainfall.grains import Library, export_bodies

    export_bodies(twin.bodies, Library.load(twin.library), path)


def _lammps(twin: Twin, path: Path) -> None:
    from grainfall.grains import export_lammps

    export_lammps(twin.bodies, path)


def _vtp(twin: Twin, path: Path) -> None:
    from grainfall.network import save_vtp

    save_vtp(twin.network, path)


def _openpnm(twin: Twin, path: Path) -> None:
    from grainfall.network import save_openpnm

    save_openpnm(twin.network, path)


def _statoil(twin: Twin, path: Path) -> None:
    from grainfall.network import save_statoil
    from grainfall.volume import coarse_shape

    phase, size = twin.phase
    voxels = coarse_shape(phase.shape, twin.coarsen)  # what no whole block holds is not in the network
    box = tuple(n * twin.coarsen * size for n in voxels[::-1])
    save_statoil(twin.network, path.with_name("network"), box)


@dataclass(frozen=True)
class Format:
    """A format: what it is, which files it makes, and how.

    Attributes
    ----------
    about : str
    files : tuple of str
        Names of the files.
    write : callable
        Twin and the path of the first file.
    """

    about: str
    files: tuple[str, ...]
    write: Callable[[Twin, Path], None]


_STATOIL = tuple(f"network_{part}.dat" for part in ("node1", "node2", "link1", "link2"))
_SPHERES = "grains as equal-volume spheres (LAMMPS, LIGGGHTS: atom_style sphere, units si)"
_CSV = "pore network as one CSV (openpnm.io.network_from_csv), metres"
FORMATS = {
    "mhd": Format("voxels as MetaImage and RAW (ITK, 3D Slicer, Fiji)", ("twin.mhd", "twin.raw"), _mhd),
    "vti": Format("voxels as VTK image (ParaView, PyVista)", ("twin.vti",), _vti),
    "glb": Format("grains, the margin's too, as coloured meshes (any 3D viewer)", ("grains.glb",), _meshes),
    "stl": Format("grains, the margin's too, as bare meshes (CAD, 3D printing)", ("grains.stl",), _meshes),
    "lammps": Format(_SPHERES, ("grains.data",), _lammps),
    "vtp": Format("pore network as VTK polydata (ParaView, PyVista)", ("network.vtp",), _vtp),
    "openpnm": Format(_CSV, ("network.csv",), _openpnm),
    "statoil": Format("pore network as Statoil files (pnflow), metres, flow along x", _STATOIL, _statoil),
}
"""Every format by its name."""


def export_twin(twin: Twin, folder: str | Path, formats: Iterable[str] = tuple(FORMATS)) -> list[Path]:
    """Write a twin in other programs' formats.

    Parameters
    ----------
    twin : Twin
    folder : str or Path
        Made if needed; files of these names in it are replaced.
    formats : iterable of str
        Keys of ``FORMATS``; all if omitted.

    Returns
    -------
    list of Path
        The files written.

    Raises
    ------
    InputError
        For an unknown format, or where the twin lacks a file.
    """
    formats = list(formats)
    for name in formats:
        if name not in FORMATS:
            raise InputError("format", f"'{name}' is not known", f"one of: {', '.join(FORMATS)}")
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    for name in formats:
        try:
            FORMATS[name].write(twin, folder / FORMATS[name].files[0])
        except FileNotFoundError as fault:
            raise InputError(fault.filename, "no such file", "run the study to its end first") from None
    return [folder / file for name in formats for file in FORMATS[name].files]
