"""Files: atomic writes, tables, and volumes as one Zarr zip whose bytes depend on its content only."""

from __future__ import annotations

import fcntl
import json
import math
import os
import shutil
import tempfile
import time
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import lazy_loader
import numpy as np
import pandas as pd

from grainfall import __version__
from grainfall.errors import InputError

zarr = lazy_loader.load("zarr")  # a third of a second, for jobs that open a volume

CHUNK = 128
ZIP_EPOCH = (1980, 1, 1, 0, 0, 0)


@contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """A temporary name beside ``path``, renamed to it when the block ends well, removed when it does not.

    The name depends on ``path`` only: what a killed process leaves is what the next one writes over.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.part")
    part.unlink(missing_ok=True)
    try:
        yield part
        # A full or remote disk may say so only now; and no rename before the content is safe.
        with part.open("rb") as written:
            os.fsync(written.fileno())
        os.replace(part, path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise


class Scratch:
    """A temporary folder for as long as its process lives; what killed ones left is swept first."""

    PREFIX = "grainfall-scratch-"

    def __init__(self):
        place = Path(tempfile.gettempdir())
        for left in place.glob(f"{self.PREFIX}*"):
            with suppress(OSError):
                if time.time() - left.stat().st_mtime > 60 and (handle := _held(left)) is not None:
                    shutil.rmtree(left, ignore_errors=True)
                    os.close(handle)
        self._folder = tempfile.TemporaryDirectory(prefix=self.PREFIX)
        self.path = Path(self._folder.name)
        # The system lets go of it when the process ends, however it ends.
        self._handle = _held(self.path)

    def close(self) -> None:
        self._folder.cleanup()
        if self._handle is not None:
            os.close(self._handle)
            self._handle = None


def _held(folder: Path) -> int | None:
    """A descriptor with a lock on the folder, or None where another process has it."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(handle)
        return None
    return handle


def write_text(path: str | Path, text: str) -> None:
    """Write ``text`` atomically, UTF-8."""
    with atomic_path(path) as part:
        part.write_text(text, encoding="utf-8")


def write_json(path: str | Path, content: object) -> None:
    """Write JSON atomically, keys in the order given; a figure that is not a number becomes null."""
    write_text(path, json.dumps(_plain(content), indent=2, allow_nan=False) + "\n")


def read_json(path: str | Path) -> dict:
    """Read JSON.

    Raises
    ------
    InputError
        When the file is missing or no JSON.
    """
    with _reading(path, "JSON file"):
        return json.loads(Path(path).read_text(encoding="utf-8"))


def _plain(value: object) -> object:
    """NumPy scalars and arrays as JSON knows them; NaN and infinity, which it does not know, as null."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def write_table(path: str | Path, table: pd.DataFrame) -> None:
    """Write a table as CSV, atomically; missing figures are empty cells, never 0."""
    with atomic_path(path) as part:
        table.to_csv(part, index=False, lineterminator="\n")


NAMES = ("sample", "variant")
"""Columns of tables that hold names, whatever they look like: ``001``, ``1e3`` and ``NA`` are names, too."""


def read_table(path: str | Path) -> pd.DataFrame:
    """Read a CSV table with its columns as they are named in results/README.md.

    Raises
    ------
    InputError
        When the file is missing or no table.
    """
    with _reading(path, "table"):
        # missing figures are empty cells and nothing else
        return pd.read_csv(path, dtype=dict.fromkeys(NAMES, str), keep_default_na=False, na_values=[""])


def write_arrays(path: str | Path, arrays: Mapping[str, np.ndarray], *, compressed: bool = True) -> None:
    """Write named arrays as one NPZ, atomically; equal content gives equal bytes.

    Without compression, which for large arrays may take longer than what is in them did.
    """
    kind = zipfile.ZIP_DEFLATED if compressed else zipfile.ZIP_STORED
    with atomic_path(path) as part, zipfile.ZipFile(part, "w", kind) as archive:
        for name in sorted(arrays):
            entry = zipfile.ZipInfo(f"{name}.npy", ZIP_EPOCH)
            entry.compress_type = kind
            with archive.open(entry, "w", force_zip64=True) as stream:
                np.lib.format.write_array(stream, np.asarray(arrays[name]), allow_pickle=False)


def read_arrays(path: str | Path) -> dict[str, np.ndarray]:
    """Read what :func:`write_arrays` wrote.

    Raises
    ------
    InputError
        When the file is missing or truncated.
    """
    with _reading(path, "NPZ"), np.load(path, allow_pickle=False) as archive:
        return dict(archive)


class StoredArrays(Mapping):
    """What :func:`write_arrays` wrote, each array read when it is asked for.

    Raises
    ------
    InputError
        Then, when the file is missing or truncated.
    """

    def __init__(self, path: str | Path):
        self._path = path

    def __getitem__(self, name: str) -> np.ndarray:
        if name not in self._names():
            raise KeyError(name)
        with self._open() as archive:
            return archive[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._names())

    def __len__(self) -> int:
        return len(self._names())

    def _names(self) -> list[str]:
        with self._open() as archive:
            return archive.files

    @contextmanager
    def _open(self) -> Iterator[Mapping[str, np.ndarray]]:
        with _reading(self._path, "NPZ"), np.load(self._path, allow_pickle=False) as archive:
            yield archive


def write_volume(
    path: str | Path,
    arrays: Mapping[str, np.ndarray],
    voxel_size_um: float,
    attributes: Mapping[str, object] | None = None,
) -> None:
    """Write images or volumes of one grid as a Zarr group in one zip file.

    Parameters
    ----------
    path : str or Path
        Target, ``*.zarr.zip``; written under a temporary name and renamed.
    arrays : mapping of str to ndarray
        (y, x) or (z, y, x) arrays of equal shape; the first is the one that OME-NGFF viewers open.
    voxel_size_um : float
        Edge of a voxel (pixel) in micrometres.
    attributes : mapping, optional
        Further group attributes (JSON).

    Notes
    -----
    Entries are stored in sorted order with a fixed date, so equal content gives equal bytes.
    """
    shape = next(iter(arrays.values())).shape
    for name, data in arrays.items():
        if data.shape != shape:
            raise ValueError(f"{name} has shape {data.shape}, {next(iter(arrays))} has {shape}")
    kinds = {name: data.dtype for name, data in arrays.items()}
    with create_volume(path, shape, kinds, voxel_size_um, attributes) as target:
        for name, data in arrays.items():
            target[name][...] = data


@contextmanager
def create_volume(
    path: str | Path,
    shape: tuple[int, ...],
    kinds: Mapping[str, np.dtype],
    voxel_size_um: float,
    attributes: Mapping[str, object] | None = None,
) -> Iterator[dict[str, zarr.Array]]:
    """As :func:`write_volume`, slab by slab, where the whole volume should not be held at once.

    Parameters
    ----------
    path, voxel_size_um, attributes
        As there.
    shape : (ny, nx) or (nz, ny, nx)
    kinds : mapping of str to dtype
        Of the arrays, by name.

    Yields
    ------
    dict of str to zarr.Array
        To be filled, best by slabs of :data:`CHUNK` planes; the file is there when the block ends. Until then
        chunks are kept as they are stored, compressed. What is not filled is 0, and takes no room.
    """
    first, axes = next(iter(kinds)), ["z", "y", "x"][-len(shape) :]
    ome = {
        "version": "0.5",
        "multiscales": [
            {
                "name": first,
                "axes": [{"name": a, "type": "space", "unit": "micrometer"} for a in axes],
                "datasets": [
                    {
                        "path": first,
                        "coordinateTransformations": [
                            {"type": "scale", "scale": [float(voxel_size_um)] * len(shape)}
                        ],
                    }
                ],
            }
        ],
    }
    store: dict = {}
    group = zarr.open_group(zarr.storage.MemoryStore(store), mode="w", zarr_format=3)
    group.attrs.update(
        {
            "ome": ome,
            "voxel_size_um": float(voxel_size_um),
            "grainfall_version": __version__,
            **(attributes or {}),
        }
    )
    chunks = tuple(min(CHUNK, n) for n in shape)
    yield {
        name: group.create_array(name, shape=shape, dtype=kind, chunks=chunks, dimension_names=axes)
        for name, kind in kinds.items()
    }
    _write_entries(path, ((key, store[key].to_bytes()) for key in sorted(store)))


def _write_entries(path: str | Path, entries: Iterable[tuple[str, bytes]]) -> None:
    """The zip file of a volume, entry by entry: stored as they are, with a fixed date."""
    with atomic_path(path) as part, zipfile.ZipFile(part, "w", zipfile.ZIP_STORED) as archive:
        for key, content in entries:
            archive.writestr(zipfile.ZipInfo(key, ZIP_EPOCH), content)


def share(n: int, part: int, parts: int) -> tuple[int, int]:
    """Start and stop of one of ``parts`` shares of ``n`` things, as equal as can be; ``part`` from 1."""
    return (part - 1) * n // parts, part * n // parts


def slab(planes: int, part: int, parts: int) -> tuple[int, int]:
    """Start and stop of one of ``parts`` slabs of a volume that share no chunk of its file; ``part`` from 1.

    There are no more slabs than layers of chunks, :data:`CHUNK` planes each: the others are empty.
    """
    start, stop = share(math.ceil(planes / CHUNK), part, parts)
    return min(start * CHUNK, planes), min(stop * CHUNK, planes)


def join_volumes(path: str | Path, parts: Iterable[str | Path]) -> None:
    """One volume file of several of the same shape and attributes, each filled in other chunks.

    Chunks are copied as they are stored: the file has the bytes that it would have, were it written at once.

    Parameters
    ----------
    path : str or Path
        Target, ``*.zarr.zip``; written under a temporary name and renamed.
    parts : iterable of path
        Files that :func:`create_volume` wrote.

    Raises
    ------
    InputError
        When one of them is missing or damaged, or they are not parts of one volume.
    """
    with ExitStack() as opened:
        holder: dict[str, zipfile.ZipFile] = {}

        def read(archive: zipfile.ZipFile, key: str) -> bytes:
            with _reading(archive.filename, "volume"):
                return archive.read(key)

        for part in parts:
            with _reading(part, "volume"):
                archive = opened.enter_context(zipfile.ZipFile(part))
            for key in archive.namelist():
                first = holder.setdefault(key, archive)
                if first is not archive and read(first, key) != read(archive, key):
                    raise InputError(part, f"has another {key} than {first.filename}", "parts of one volume")
        _write_entries(path, ((key, read(holder[key], key)) for key in sorted(holder)))


def read_volume(path: str | Path, name: str | None = None) -> tuple[np.ndarray, dict]:
    """Read one array of a volume file and the group's attributes.

    Parameters
    ----------
    path : str or Path
        A ``*.zarr.zip`` written by :func:`write_volume`.
    name : str, optional
        Array to read; the first one (OME-NGFF's) if omitted.

    Returns
    -------
    array : ndarray
    attributes : dict

    Raises
    ------
    InputError
        When the file is missing, truncated or holds no such array.
    """
    with open_volume(path, name) as (array, attributes):
        return array[...], attributes


@contextmanager
def open_volume(path: str | Path, name: str | None = None) -> Iterator[tuple[Volume, dict]]:
    """As :func:`read_volume`, for those who want a few planes or one slab after the other.

    Yields
    ------
    array : Volume
        Read where it is indexed.
    attributes : dict
    """
    with _reading(path, "volume"):
        store = zarr.storage.ZipStore(path, mode="r")
        group = zarr.open_group(store, mode="r")
        attributes = dict(group.attrs)
        array = group[name or attributes["ome"]["multiscales"][0]["datasets"][0]["path"]]
    try:
        yield Volume(path, array), attributes
    finally:
        store.close()


class Volumes:
    """An array of several volume files; whoever goes through them has one open at a time.

    Parameters
    ----------
    paths : sequence of str or Path
    name : str
        Of the array.
    """

    def __init__(self, paths: Sequence[str | Path], name: str):
        self._paths, self._name = list(paths), name

    def __len__(self) -> int:
        return len(self._paths)

    def __iter__(self) -> Iterator[Volume]:
        for path in self._paths:
            with open_volume(path, self._name) as (array, _):
                yield array


class Volume:
    """An array in a volume file: read where it is indexed, with one line for a file that is damaged there."""

    def __init__(self, path: str | Path, array: zarr.Array):
        self._path, self._array = path, array
        self.shape, self.dtype, self.ndim = array.shape, array.dtype, array.ndim
        self.size = math.prod(self.shape)

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, index) -> np.ndarray:
        with _reading(self._path, "volume", (IndexError,)):  # who asks beyond its end is wrong, not the file
            return np.asarray(self._array[index])


@contextmanager
def _reading(path: str | Path, what: str, passed: tuple[type[Exception], ...] = ()) -> Iterator[None]:
    """One line for whatever a decoder makes of a file that is missing, truncated or damaged."""
    try:
        yield
    except FileNotFoundError:
        raise InputError(path, "no such file", f"a complete {what} is needed") from None
    except (MemoryError, *passed):
        raise
    except Exception as fault:
        if isinstance(fault, OSError) and fault.errno is not None:
            raise InputError(
                path, f"cannot be read ({fault.strerror})", "a file that can be opened"
            ) from None
        detail = f"{type(fault).__name__}: {fault}"[:200]
        raise InputError(
            path, f"not a readable {what} ({detail})", "delete it, so that it is made again"
        ) from None
