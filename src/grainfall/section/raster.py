"""Image files to arrays: PNG, TIFF, NPY, NPZ, Zarr and raw; a size is checked before it is decoded.

The file's content decides how it is read, not its name. Whatever a decoder does with a damaged file, the
caller sees one :class:`~grainfall.errors.InputError`.
"""

from __future__ import annotations

import logging
import os
import struct
import sys
import warnings
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from math import prod
from pathlib import Path

import numpy as np

from grainfall.errors import InputError

FORMATS = "a PNG, TIFF, NPY, NPZ or Zarr file is needed"
INTACT = "an intact file is needed; copy or export it again"
MAX_PIXELS = 200_000_000
"""Default limit on the pixels of a section."""
MAX_VOXELS = 2_000_000_000
"""Default limit on the voxels of a reference volume."""
SPARE_MEMORY = 2**30
"""Bytes a decoder may take beside eight times the declared size."""

_PNG = b"\x89PNG\r\n\x1a\n"
_PNG_COLOUR = {2: "an RGB", 4: "a grey + alpha", 6: "an RGBA"}
_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_NPY = b"\x93NUMPY"
_ZIP = b"PK\x03\x04"
_ZARR_METADATA = ("zarr.json", ".zgroup", ".zarray")
# TIFF compressions that tifffile decodes by itself (none, deflate, LZMA, PackBits); Pillow does the others
# that keep all values: fax, LZW, Zstandard.
_TIFFFILE_CODECS = (1, 8, 32946, 34925, 32773)
_PILLOW_CODECS = (2, 3, 4, 5, 32771, 50000)


def read_raster(
    path: str | Path,
    *,
    ndim: int = 2,
    array: str | None = None,
    prefer: Sequence[str] = (),
    indexed: bool = True,
    max_pixels: int = MAX_PIXELS,
) -> np.ndarray:
    """Read one image or volume of plain numbers.

    Parameters
    ----------
    path : str or Path
        PNG, TIFF, NPY, NPZ or Zarr (directory, or zip file).
    ndim : int
        2 for an image (y, x), 3 for a volume (z, y, x). Further axes of length 1 are dropped.
    array : str, optional
        Name of the array in an NPZ or Zarr that holds several.
    prefer : sequence of str
        Names to try, in order, where ``array`` is not given.
    indexed : bool
        Whether the stored numbers are meant, also where the file has viewers show them otherwise: by a
        palette, or 0 as white. So it is for labels; where dark and bright decide, such a file is refused.
    max_pixels : int
        Largest size accepted; compared with the declared size before anything is decoded.

    Returns
    -------
    ndarray
        ``ndim`` axes; boolean files become uint8, any byte order becomes the native one. Values are
        those stored, also in a TIFF that asks viewers to show 0 as white.

    Raises
    ------
    InputError
        Missing, damaged or truncated file, unknown format, colour, wrong number of axes, too large.
    """
    path = Path(path)
    with _decoding(path):
        if path.is_dir():
            if not any((path / name).is_file() for name in _ZARR_METADATA):
                raise InputError(path, "a directory without Zarr metadata", FORMATS)
            image = _read_zarr(path, path, ndim, array, prefer, max_pixels)
        else:
            image = _read_file(path, ndim, array, prefer, indexed, max_pixels)
        if image.dtype.kind == "b":
            image = image.astype(np.uint8)
        image = np.require(image, image.dtype.newbyteorder("="), ["C", "W"])
        return image.reshape(_plain_shape(path, image.shape, ndim))


def read_raw(
    path: str | Path, shape: Sequence[int], dtype: str, *, max_pixels: int = MAX_VOXELS
) -> np.ndarray:
    """Read headerless numbers in C order.

    Parameters
    ----------
    path : str or Path
        The file; its size must be exactly that of ``shape`` and ``dtype``.
    shape : sequence of int
        (z, y, x).
    dtype : str
        NumPy type name, for example ``uint8`` or ``>u2``.
    max_pixels : int
        Largest size accepted.

    Raises
    ------
    InputError
        Missing file, unusable shape or type, or a file of another size.
    """
    path = Path(path)
    try:
        kind = np.dtype(dtype)
    except TypeError:
        raise InputError(f"{path}: dtype", f"{dtype!r} is no number type", "uint8, uint16, >u2 ...") from None
    try:
        shape = tuple(int(n) for n in shape)
    except (TypeError, ValueError):
        shape = ()
    if len(shape) != 3 or min(shape) < 1:
        raise InputError(f"{path}: shape", "not three positive numbers", "give [z, y, x] in voxels")
    _check_declared(path, shape, kind, 3, max_pixels)
    with _decoding(path):
        size = path.stat().st_size
        if size != prod(shape) * kind.itemsize:
            raise InputError(
                path,
                f"{size} bytes, but {_by(shape)} voxels of {kind.name} are {prod(shape) * kind.itemsize}",
                "give the true shape and dtype, or an intact file",
            )
        return np.fromfile(path, dtype=kind).reshape(shape).astype(kind.newbyteorder("="), copy=False)


@contextmanager
def _decoding(path: Path) -> Iterator[None]:
    """Turn anything a decoder raises, warns or logs about a broken file into one InputError."""
    problems: list[str] = []

    class Collect(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            problems.append(record.getMessage())

    # tifffile logs what it cannot read and goes on with what is left; a section must be whole.
    logger, handler = logging.getLogger("tifffile"), Collect(logging.ERROR)
    propagate, logger.propagate = logger.propagate, False
    logger.addHandler(handler)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
        if problems:
            raise InputError(path, f"damaged or truncated file ({problems[0][:120]})", INTACT)
    except InputError:
        raise
    except FileNotFoundError:
        raise InputError(path, "no such file", FORMATS) from None
    except PermissionError:
        raise InputError(path, "may not be read", "give read permission") from None
    except Exception as fault:  # the decoders raise nearly anything on bytes they did not expect
        detail = f"{type(fault).__name__}: {fault}"[:120]
        raise InputError(path, f"damaged or truncated file ({detail})", INTACT) from None
    finally:
        logger.removeHandler(handler)
        logger.propagate = propagate


@contextmanager
def _bounded(path: Path, shape: Sequence[int], dtype: np.dtype) -> Iterator[None]:
    """Memory for the declared size and what a decoder needs beside it, not for what a bomb unpacks to."""
    try:
        import resource

        held = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    except (ImportError, OSError):
        yield
        return
    limit = held + SPARE_MEMORY + 8 * prod(int(n) for n in shape) * dtype.itemsize
    within = limit if soft == resource.RLIM_INFINITY else min(limit, soft)
    resource.setrlimit(resource.RLIMIT_AS, (within, hard))
    try:
        yield
    except MemoryError:
        raise InputError(path, f"unpacks to far more than the {_by(shape)} it declares", INTACT) from None
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def _by(shape: Sequence[int]) -> str:
    return " x ".join(str(n) for n in shape)


def _plain_shape(path: Path, shape: Sequence[int], ndim: int) -> tuple[int, ...]:
    """The shape without superfluous axes of length 1, or an InputError."""
    shape = tuple(int(n) for n in shape)
    plain = tuple(n for n in shape if n != 1) if len(shape) > ndim else shape
    if len(plain) < ndim <= len(shape):
        plain = (1,) * (ndim - len(plain)) + plain
    if len(plain) == ndim:
        return plain
    if len(plain) == ndim + 1 and plain[-1] in (2, 3, 4):
        raise _colour(path, {2: "a grey + alpha", 3: "an RGB", 4: "an RGBA"}[plain[-1]])
    what = {2: "a 2D image (y, x)", 3: "a 3D volume (z, y, x)"}[ndim]
    raise InputError(path, f"an array of {_by(shape)} ({len(shape)} axes)", f"{what} is needed")


def _colour(path: Path, what: str) -> InputError:
    return InputError(
        path,
        f"{what} image, one grey or label channel is needed",
        "a number for each phase (kind phases), which config/README.md shows how to make of colours",
    )


def _check_declared(path: Path, shape: Sequence[int], dtype: np.dtype, ndim: int, max_pixels: int) -> None:
    """Judge what a header declares, before memory is taken for it."""
    if dtype.kind not in "buif":
        raise InputError(path, f"an array of {dtype}", "plain integers (or floats) are needed")
    size = prod(int(n) for n in shape)
    if size == 0:
        raise InputError(path, f"an empty image ({_by(shape)})", "an image with pixels is needed")
    if size > max_pixels:
        raise InputError(
            path,
            f"{_by(shape)} pixels are declared, more than the limit of {max_pixels:.3g}",
            "crop or downsample it, or raise the limit",
        )
    _plain_shape(path, shape, ndim)


def _read_file(
    path: Path, ndim: int, array: str | None, prefer: Sequence[str], indexed: bool, max_pixels: int
) -> np.ndarray:
    with path.open("rb") as file:
        head = file.read(33)
    if not head:
        raise InputError(path, "an empty file", FORMATS)
    if head.startswith(_PNG):
        return _read_png(path, head, ndim, indexed, max_pixels)
    if head.startswith(_TIFF):
        return _read_tiff(path, ndim, indexed, max_pixels)
    if head.startswith(_NPY):
        with path.open("rb") as file:
            return _read_npy(path, file, path.stat().st_size, ndim, max_pixels)
    if head.startswith(_ZIP):
        return _read_zip(path, ndim, array, prefer, max_pixels)
    if head.startswith(b"\xff\xd8\xff"):
        raise InputError(path, "a JPEG, whose compression alters the values", FORMATS)
    raise InputError(path, "not an image that can be read", FORMATS)


@contextmanager
def _unlimited_pillow() -> Iterator[None]:
    """Pillow without its own size limit: the caller has already compared the size with the user's."""
    from PIL import Image

    before, Image.MAX_IMAGE_PIXELS = Image.MAX_IMAGE_PIXELS, None
    try:
        yield
    finally:
        Image.MAX_IMAGE_PIXELS = before


def _read_png(path: Path, head: bytes, ndim: int, indexed: bool, max_pixels: int) -> np.ndarray:
    from PIL import Image

    if len(head) < 33 or head[12:16] != b"IHDR":
        raise InputError(path, "damaged or truncated file (no PNG header)", INTACT)
    width, height, depth, colour = struct.unpack(">IIBB", head[16:26])
    _check_declared(path, (height, width), np.dtype(np.uint8), ndim, max_pixels)
    if colour in _PNG_COLOUR:
        raise _colour(path, _PNG_COLOUR[colour])
    if colour == 3 and not indexed:
        raise _colour(path, "a palette")
    with _unlimited_pillow():
        with Image.open(path) as image:
            image.verify()  # every chunk is there and its checksum holds
        with Image.open(path) as image:
            # Pillow stretches grey of 2 or 4 bits over 0 to 255.
            stretched = {2: 85, 4: 17}.get(depth, 1) if colour == 0 else 1
            return np.array(image) // np.uint8(stretched) if stretched > 1 else np.array(image)


def _read_tiff(path: Path, ndim: int, indexed: bool, max_pixels: int) -> np.ndarray:
    import tifffile

    # OME metadata may point at other files; the pages of this one are all that is read.
    with tifffile.TiffFile(path, is_ome=False) as tif:
        if not len(tif.pages):
            raise InputError(path, "damaged or truncated file (a TIFF without an image)", INTACT)
        if len(tif.series) != 1:
            raise InputError(
                path, f"a TIFF of {len(tif.series)} different images", "keep the one that is meant"
            )
        series, page = tif.series[0], tif.pages.first
        if page.samplesperpixel > 1:
            raise _colour(
                path, {2: "a grey + alpha", 3: "an RGB", 4: "an RGBA"}.get(page.samplesperpixel, "a colour")
            )
        if page.photometric == tifffile.PHOTOMETRIC.PALETTE and not indexed:
            raise _colour(path, "a palette")
        if _shows_zero_white(page) and not indexed:
            raise InputError(
                path, "a TIFF that shows 0 as white", "convert it, or say which stored value is the pore"
            )
        if series.dtype is None or page.bitspersample not in (1, 8, 16, 32, 64):
            raise InputError(path, f"a TIFF of {page.bitspersample} bits a sample", "8 or 16 bits are needed")
        if page.compression not in _TIFFFILE_CODECS + _PILLOW_CODECS:
            name = getattr(page.compression, "name", page.compression)
            raise InputError(
                path, f"a TIFF of {name} compression, which may alter values", "save it with LZW or without"
            )
        _check_declared(path, series.shape, series.dtype, ndim, max_pixels)
        _check_declared(path, page.shape, series.dtype, len(page.shape), max_pixels)
        _check_declared(path, page.chunks, series.dtype, len(page.chunks), max_pixels)
        if any(0 in one.databytecounts for one in series.pages if one is not None):
            raise InputError(path, "damaged or truncated file (pixels are missing)", INTACT)
        if page.compression in _TIFFFILE_CODECS and page.predictor in (1, 2):
            with _bounded(path, series.shape, series.dtype):
                return series.asarray(maxworkers=1)
        inverted = page.photometric == tifffile.PHOTOMETRIC.MINISWHITE
        shape, dtype = series.shape, series.dtype
    with _bounded(path, shape, dtype):
        return _read_tiff_pillow(path, inverted)


def _shows_zero_white(page) -> bool:
    """Whether viewers show 0 as white; not of tifffile's own booleans, marked so whatever they mean."""
    own = page.bitspersample == 1 and page.software.startswith("tifffile")
    return page.photometric.name == "MINISWHITE" and not own


def lowest_is_darkest(path: str | Path, image: np.ndarray) -> bool:
    """Whether viewers show the lowest value of an image that was read from the file as its darkest."""
    path = Path(path)
    if path.is_dir():
        return True
    values = np.unique(image)
    with path.open("rb") as file:
        head = file.read(8)
    if head == _PNG:
        from PIL import Image

        with _unlimited_pillow(), Image.open(path) as png:
            palette = png.getpalette("RGB")
        colours = None if palette is None else np.reshape(palette, (-1, 3)).astype(float)
    elif head.startswith(_TIFF):
        import tifffile

        with tifffile.TiffFile(path, is_ome=False) as tif:
            page = tif.pages.first
            if _shows_zero_white(page):
                return False
            colours = None if page.colormap is None else page.colormap.T.astype(float)
    else:
        return True
    if colours is None:
        return True
    shown = colours[values[values < len(colours)]] @ (0.299, 0.587, 0.114)
    return not len(shown) or bool(shown[0] == shown.min())


@contextmanager
def _silent_libraries() -> Iterator[None]:
    """Nothing on the process's standard error: libtiff prints there what Pillow then raises."""
    sys.stderr.flush()
    before = os.dup(2)
    try:
        with open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), 2)
        yield
    finally:
        os.dup2(before, 2)
        os.close(before)


def _read_tiff_pillow(path: Path, inverted: bool) -> np.ndarray:
    """TIFF whose compression (LZW, fax ...) tifffile leaves to an optional package."""
    from PIL import ExifTags, Image, ImageSequence

    turn = Image.Transpose
    ways = (turn.FLIP_LEFT_RIGHT, turn.ROTATE_180, turn.FLIP_TOP_BOTTOM, turn.TRANSPOSE)
    ways += (turn.ROTATE_90, turn.TRANSVERSE, turn.ROTATE_270)
    back = dict(enumerate(ways, 2))

    def stored(frame: Image.Image) -> np.ndarray:
        # Pillow turns what the file wants shown turned, as soon as it is loaded; tifffile does not
        way = back.get(frame.tag_v2.get(ExifTags.Base.Orientation))
        return np.array(frame if way is None else frame.transpose(way))

    with _unlimited_pillow(), _silent_libraries(), Image.open(path) as image:
        frames = [stored(frame) for frame in ImageSequence.Iterator(image)]
    volume = frames[0] if len(frames) == 1 else np.stack(frames)
    # Pillow shows 0 as white where the file asks for it; undo that, the stored values are the labels.
    return ~volume if inverted and volume.dtype in (bool, np.uint8) else volume


def _read_npy(path: Path, file, size: int, ndim: int, max_pixels: int) -> np.ndarray:
    """One NPY stream of ``size`` bytes, header included; nothing is ever unpickled."""
    version = np.lib.format.read_magic(file)
    header = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    shape, fortran, dtype = header[version](file)
    _check_declared(path, shape, dtype, ndim, max_pixels)
    if prod(shape) * dtype.itemsize != size - file.tell():
        raise InputError(path, f"damaged or truncated file ({_by(shape)} {dtype} do not fit it)", INTACT)
    data = file.read()  # to the end, so that a zip entry's checksum is compared
    return np.frombuffer(data, dtype=dtype).reshape(shape, order="F" if fortran else "C")


def _choose(path: Path, names: Sequence[str], array: str | None, prefer: Sequence[str]) -> str:
    """The array that is meant among those of a file."""
    if array is not None:
        if array not in names:
            raise InputError(path, f"no array {array!r}", f"it has: {', '.join(names) or 'none'}")
        return array
    for name in prefer:
        if name in names:
            return name
    if len(names) != 1:
        # a reference and a grey image have no key for it
        right = (
            f"one array in the file, or one named {' or '.join(prefer)}; of a sample's image its name: array"
        )
        raise InputError(path, f"{len(names)} arrays ({', '.join(names)})", right)
    return names[0]


def _read_zip(path: Path, ndim: int, array: str | None, prefer: Sequence[str], max_pixels: int) -> np.ndarray:
    with zipfile.ZipFile(path) as archive:
        entries = {entry.filename: entry for entry in archive.infolist()}
        if any(name in entries for name in _ZARR_METADATA):
            # 16 bytes a pixel: no array of numbers within the limit takes more.
            if sum(entry.file_size for entry in entries.values()) > 16 * max_pixels:
                raise InputError(
                    path, "the entries of this zip declare more bytes than the limit allows", INTACT
                )
        else:
            names = [name.removesuffix(".npy") for name in entries if name.endswith(".npy")]
            if not names:
                raise InputError(path, "a zip file with neither NumPy nor Zarr arrays", FORMATS)
            entry = entries[_choose(path, names, array, prefer) + ".npy"]
            with archive.open(entry) as file:
                return _read_npy(path, file, entry.file_size, ndim, max_pixels)
    import zarr

    store = zarr.storage.ZipStore(path, mode="r")
    try:
        return _read_zarr(path, store, ndim, array, prefer, max_pixels)
    finally:
        store.close()


def _read_zarr(
    path: Path, store, ndim: int, array: str | None, prefer: Sequence[str], max_pixels: int
) -> np.ndarray:
    import zarr

    node = zarr.open(store, mode="r")
    if isinstance(node, zarr.Group):
        # Not node.arrays(): of a damaged file it leaves tracebacks of its tasks on the screen.
        names = [name for name in _children(store) if isinstance(node[name], zarr.Array)]
        if array is None and not any(name in names for name in prefer):
            array = _ome_array(dict(node.attrs))
        if array is not None and "/" in array and array in node:
            node = node[array]
        else:
            node = node[_choose(path, names, array, prefer)]
    if not isinstance(node, zarr.Array):
        raise InputError(path, f"{array!r} is a group", "name an array")
    _check_declared(path, node.shape, node.dtype, ndim, max_pixels)
    _check_declared(path, node.shards or node.chunks, node.dtype, len(node.chunks), max_pixels)
    if isinstance(store, Path) and node.nchunks_initialized < node.nchunks:
        absent = node.nchunks - node.nchunks_initialized
        raise InputError(
            path,
            f"{absent} of {node.nchunks} chunks are absent and would read as 0",
            "copy it whole, or write it with empty chunks (zarr: write_empty_chunks) or as TIFF or NPZ",
        )
    with _bounded(path, node.shape, node.dtype):
        return np.asarray(node[...])


def _children(store) -> list[str]:
    """Names of the nodes directly below the root of a Zarr directory or zip."""
    if isinstance(store, Path):
        keys = [
            f"{folder.name}/{name}"
            for folder in store.iterdir()
            for name in _ZARR_METADATA
            if (folder / name).is_file()
        ]
    else:
        with zipfile.ZipFile(store.path) as archive:
            keys = archive.namelist()
    parts = [key.split("/") for key in keys]
    return sorted({part[0] for part in parts if len(part) == 2 and part[1] in _ZARR_METADATA})


def _ome_array(attributes: dict) -> str | None:
    """The full-resolution array that OME-NGFF metadata names, if there is any."""
    scales = attributes.get("ome", attributes).get("multiscales")
    return scales[0]["datasets"][0]["path"] if scales else None
