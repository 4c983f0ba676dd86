"""A user's image becomes a :class:`Section`: which pixels are pore, which are which mineral."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from grainfall import io
from grainfall.errors import InputError
from grainfall.section.raster import MAX_PIXELS, MAX_VOXELS, lowest_is_darkest, read_raster, read_raw

PORE = "pore"
LEAST_EDGE = 4
"""Voxels along the shortest edge of a reference: S2 to two voxels is what its surface is read from."""

KINDS = ("instances", "phases", "binary", "grey")
MAX_MINERALS = 200
"""Labels above are left to what later chapters add (cement, virtual spheres)."""
_ARRAY_NAMES = {
    "instances": ("labels", "instances"),
    "phases": ("phase", "phases"),
    "binary": ("phase", "binary", "mask"),
    "grey": ("grey", "gray"),
}

Phases = Sequence[str] | Mapping[str, int | Sequence[int] | None] | None


@dataclass(frozen=True)
class Section:
    """A segmented 2D section.

    Attributes
    ----------
    phase : (y, x) uint8
        0 pore, 1..M minerals.
    pixel_size_um : float
        Edge of a pixel in micrometres.
    phases : tuple of str
        Names; index 0 is ``"pore"``.
    instances : (y, x) int32 or None
        Grain instances 1..n (0 none) where the input outlines grains.
    grey : (y, x) uint8 or uint16, or None
        Where a greyscale image was given.
    notes : dict
        What reading decided (JSON): multi-Otsu thresholds, rescaled grey, renumbered instances.
    """

    phase: np.ndarray
    pixel_size_um: float
    phases: tuple[str, ...]
    instances: np.ndarray | None = None
    grey: np.ndarray | None = None
    notes: dict = field(default_factory=dict)

    @property
    def grey_as_given(self) -> np.ndarray | None:
        """(y, x) grey on the scale of the file, also where it was rescaled; None without."""
        return None if self.grey is None else _as_given(self.grey, self.notes)

    @property
    def porosity(self) -> float:
        """Areal fraction of pore, over every pixel."""
        return self.fractions[PORE]

    @property
    def fractions(self) -> dict[str, float]:
        """Areal fraction of each phase, over every pixel; they add up to 1."""
        counts = dict(zip(*_counts(self.phase), strict=True))
        return {name: float(counts.get(k, 0) / self.phase.size) for k, name in enumerate(self.phases)}


def read_section(
    path: str | Path,
    kind: str,
    pixel_size_um: float,
    phases: Phases = None,
    *,
    pore_value: int | None = None,
    classes: int | None = None,
    array: str | None = None,
    grey: str | Path | None = None,
    classified_later: bool = False,
    max_pixels: int = MAX_PIXELS,
) -> Section:
    """Read a section from an image of one of four kinds.

    Parameters
    ----------
    path : str or Path
        PNG, TIFF, NPY, NPZ or Zarr (directory or zip).
    kind : {"instances", "phases", "binary", "grey"}
        What the values are: grain numbers (0 is pore); phases; two values of which the lower is pore;
        grey levels, split by multi-Otsu.
    pixel_size_um : float
        Edge of a pixel, micrometres.
    phases : sequence or mapping, optional
        Names, ``"pore"`` among them; minerals are numbered in the order given. A mapping gives each name the
        image value(s) it has, ``{"pore": 0, "quartz": [1, 2]}``; for ``grey`` the value is the class, 0 the
        darkest. A sequence means: value = position (``phases``), darkest to brightest (``grey``), names only
        (``instances``, ``binary``: every solid pixel is the first mineral). Default: pore and ``grain``, or
        pore and ``mineral_1``... where there are more.
    pore_value : int, optional
        The value that is pore, for ``instances`` (default 0) and ``binary`` (default the lower one).
    classes : int, optional
        Grey classes, 2 to 5; default the number of phases, or 2.
    array : str, optional
        Name of the array in an NPZ or Zarr that holds several; ``labels`` is found by itself.
    grey : str or Path, optional
        A greyscale image of the same section, for the mean grey of grains.
    classified_later : bool
        Whether the grains' minerals are assigned after measuring them, so that phases may be absent here.
    max_pixels : int
        Largest image accepted; the declared size is judged before decoding.

    Returns
    -------
    Section

    Raises
    ------
    InputError
        Anything wrong with the file or the arguments, in one line.
    """
    if kind not in KINDS:
        raise InputError("kind", f"{kind!r} is unknown", f"one of {', '.join(KINDS)}")
    pixel_size_um = check_length(pixel_size_um, "pixel_size_um", "pixel size")
    names, values, positions = _declared(phases)
    if pore_value is not None and kind not in ("instances", "binary"):
        raise InputError("pore_value", f"is for instances and binary images, not for {kind}", "use phases")
    if classes is not None and kind != "grey":
        raise InputError("classes", f"is for grey images, not for {kind}", "leave it out")

    # Where nobody says which value is which, what the eye sees has to be what is stored.
    told = kind != "grey" and (kind != "binary" or pore_value is not None or values is not None)
    image = read_raster(path, array=array, prefer=_ARRAY_NAMES[kind], indexed=told, max_pixels=max_pixels)
    notes: dict = {}
    instances = levels = None
    if kind == "grey":
        levels = _grey_levels(image, path, notes)
        image, names, values = _multi_otsu(levels, names, values or positions, classes, path, notes)
    else:
        image = _whole_numbers(image, path)
        if kind == "phases" and phases is None and not lowest_is_darkest(path, image):
            raise InputError(
                path,
                f"its lowest value, {image.min()}, would be the pore, and is not the darkest that it shows",
                "say which value is which: phases, with the values of the pore and of each mineral",
            )

    if kind == "instances":
        if values is not None:
            raise InputError(
                "phases", "instances carry no mineral values", "give a list of names; rules assign the grains"
            )
        instances = _renumbered(image, pore_value or 0, path, notes)
        names, phase = names or (PORE, "grain"), (instances > 0).astype(np.uint8)
    elif kind == "binary" and values is None:
        phase = _two_valued(image, pore_value, path)
        names = names or (PORE, "grain")
    else:
        if pore_value is not None:
            raise InputError("pore_value", "is given twice", "phases already says which value is pore")
        names, phase = _mapped(image, names, values or positions, path)

    if grey is not None:
        if kind == "grey":
            raise InputError("grey", "the section is a grey image itself", "leave it out")
        levels = _grey_levels(
            read_raster(grey, prefer=_ARRAY_NAMES["grey"], indexed=False, max_pixels=max_pixels), grey, notes
        )
        if levels.shape != phase.shape:
            raise InputError(
                grey, f"{levels.shape} pixels, the section has {phase.shape}", "equal sizes are needed"
            )

    _check_present(phase, names, path, classified_later)
    return Section(phase, pixel_size_um, names, instances, levels, notes)


def read_reference(
    path: str | Path,
    voxel_size_um: float,
    *,
    pore_value: int = 0,
    phases: Phases = None,
    shape: Sequence[int] | None = None,
    dtype: str | None = None,
    array: str | None = None,
    max_voxels: int = MAX_VOXELS,
) -> tuple[np.ndarray, float]:
    """Read a segmented 3D volume to hold twins against.

    Parameters
    ----------
    path : str or Path
        TIFF stack, NPY, NPZ, Zarr, or raw numbers with ``shape`` and ``dtype``.
    voxel_size_um : float
        Edge of a voxel, micrometres.
    pore_value : int
        The value that is pore; every other one is solid (label 1).
    phases : sequence or mapping, optional
        As in :func:`read_section` for ``phases``; given, the minerals keep their labels.
    shape, dtype : optional
        (z, y, x) and number type of a raw file.
    array : str, optional
        Name of the array in an NPZ or Zarr that holds several.
    max_voxels : int
        Largest volume accepted.

    Returns
    -------
    volume : (z, y, x) uint8
        0 pore.
    voxel_size_um : float

    Raises
    ------
    InputError
        Anything wrong with the file or the arguments, in one line.
    """
    voxel_size_um = check_length(voxel_size_um, "voxel_size_um", "voxel size")
    names, values, positions = _declared(phases)
    if (shape is None) != (dtype is None):
        raise InputError(
            path,
            "raw numbers need both their shape and their type",
            "reference_shape and reference_dtype, or neither for a file with a header",
        )
    if shape is not None:
        volume = read_raw(path, shape, dtype, max_pixels=max_voxels)
    elif Path(path).suffix.lower() == ".raw" and Path(path).is_file():
        raise InputError(
            path,
            "a raw file has no header",
            "reference_shape and reference_dtype, or a TIFF stack, NPY or Zarr, which say theirs",
        )
    else:
        volume = read_raster(path, ndim=3, array=array, prefer=("phase", "labels"), max_pixels=max_voxels)
    volume = _whole_numbers(volume, path)
    if min(volume.shape) < LEAST_EDGE:
        raise InputError(
            path,
            f"{' x '.join(map(str, volume.shape))} voxels are no volume to judge a twin by",
            f"at least {LEAST_EDGE} along each axis",
        )
    if names is None:
        names, volume = (PORE, "solid"), (volume != pore_value).astype(np.uint8)
    else:
        names, volume = _mapped(volume, names, values or positions, path)
    _check_present(volume, names, path, classified_later=True)
    return volume, voxel_size_um


def write_section(path: str | Path, section: Section) -> None:
    """Write a section to ``*.zarr.zip``, atomically; equal sections give equal bytes."""
    arrays = {"phase": section.phase, "instances": section.instances, "grey": section.grey}
    arrays = {name: data for name, data in arrays.items() if data is not None}
    attributes = {"phases": list(section.phases), "arrays": list(arrays), "notes": section.notes}
    io.write_volume(path, arrays, section.pixel_size_um, attributes)


def load_section(path: str | Path) -> Section:
    """Read what :func:`write_section` wrote."""
    phase, attributes = io.read_volume(path, "phase")
    further = {name: io.read_volume(path, name)[0] for name in attributes["arrays"] if name != "phase"}
    return Section(
        phase,
        attributes["voxel_size_um"],
        tuple(attributes["phases"]),
        further.get("instances"),
        further.get("grey"),
        attributes["notes"],
    )


def check_length(value: object, key: str, what: str) -> float:
    """A positive finite length in micrometres, or an InputError that names ``key``."""
    right = f"give the {what} in micrometres, a positive number"
    if value is None:
        raise InputError(key, f"no {what}", right)
    if isinstance(value, bool) or not isinstance(value, int | float | np.number):
        raise InputError(key, f"{value!r} is not a number", right)
    if not (math.isfinite(value) and value > 0):
        raise InputError(key, f"{value} is no length", right)
    return float(value)


def _declared(
    phases: Phases,
) -> tuple[tuple[str, ...] | None, dict[int, int] | None, dict[int, int] | None]:
    """Names in label order (pore first); of a mapping image value -> label; of a list position -> label."""
    if phases is None:
        return None, None, None
    if isinstance(phases, str) or not isinstance(phases, Mapping | Sequence):
        raise InputError("phases", f"{phases!r} is no list", "give names, or names with their image values")
    given = list(phases)
    for name in given:
        if not isinstance(name, str) or not name.strip():
            raise InputError("phases", f"{name!r} is no name", "give each phase a name")
        if given.count(name) > 1:
            raise InputError("phases", f"{name!r} is there twice", "give each phase its own name")
    if PORE not in given or not 2 <= len(given) <= MAX_MINERALS + 1:
        raise InputError("phases", f"{given} lack pore or a mineral", "name pore and 1 to 200 minerals")
    names = (PORE, *(name for name in given if name != PORE))
    if not isinstance(phases, Mapping):
        return names, None, {position: names.index(name) for position, name in enumerate(given)}
    values: dict[int, int] = {}
    for label, name in enumerate(names):
        own = phases[name]
        own = [] if own is None else [own] if isinstance(own, int) else own
        if isinstance(own, str) or not isinstance(own, Sequence):
            raise InputError(f"phases: {name}", f"{own!r} is no value", "give an integer or a list of them")
        for value in own:
            if isinstance(value, bool) or not isinstance(value, int | np.integer):
                raise InputError(f"phases: {name}", f"{value!r} is no integer", "give the image value(s)")
            if value in values:
                raise InputError(
                    f"phases: {name}", f"{value} is also {names[values[value]]}", "give each value one phase"
                )
            values[int(value)] = label
    if not values:
        raise InputError("phases", "no phase has an image value", "give the values, or a list of names")
    return names, values, None


def _whole_numbers(image: np.ndarray, where: str | Path) -> np.ndarray:
    """The image as integers; floats are accepted where they are whole."""
    if image.dtype.kind != "f":
        return image
    image = _finite(image, where)
    if (image != np.rint(image)).any():
        raise InputError(
            where, "fractional values in a label image", "whole numbers are needed, or kind: grey"
        )
    if np.abs(image).max().astype(float) > 2.0**53:
        raise InputError(where, "values beyond 2^53", "smaller labels are needed")
    return image.astype(np.int64)


def _finite(image: np.ndarray, where: str | Path) -> np.ndarray:
    bad = ~np.isfinite(image)
    if bad.any():
        first = tuple(int(i) for i in np.argwhere(bad)[0])
        raise InputError(
            where,
            f"{int(bad.sum())} pixels are NaN or infinite, the first at {first}",
            "give every pixel a value",
        )
    return image


def _counts(image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distinct values, ascending, and how many pixels each has."""
    if image.dtype.kind != "u" or image.dtype.itemsize > 2:
        return np.unique(image, return_counts=True)
    flat, step = image.ravel(), 2**24  # bincount widens to 64 bits: in pieces
    counts = sum(
        np.bincount(flat[i : i + step], minlength=2 ** (8 * image.dtype.itemsize))
        for i in range(0, flat.size, step)
    )
    values = np.flatnonzero(counts)
    return values, counts[values]


def _replaced(image: np.ndarray, values: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """``labels[k]`` where the image is ``values[k]`` (ascending, all that occur)."""
    if image.dtype.kind == "u" and image.dtype.itemsize <= 2:
        table = np.zeros(2 ** (8 * image.dtype.itemsize), labels.dtype)
        table[values] = labels
        return table[image]
    return labels[np.searchsorted(values, image)]


def _mapped(
    image: np.ndarray, names: tuple[str, ...] | None, values: dict[int, int] | None, where: str | Path
) -> tuple[tuple[str, ...], np.ndarray]:
    """Phase labels from image values; without names, 0 is pore and the others are minerals, ascending."""
    found, counts = _counts(image)
    if names is None:
        if len(found) > 32:
            raise InputError(
                where, f"{len(found)} distinct values", "name the phases, or is it kind: instances or grey?"
            )
        minerals = [int(v) for v in found if v != 0]
        names = (PORE, *(f"mineral_{k}" for k in range(1, max(len(minerals), 1) + 1)))
        values = {0: 0} | {v: k for k, v in enumerate(minerals, start=1)}
    stray = [f"{v} ({n} pixels)" for v, n in zip(found, counts, strict=True) if int(v) not in values]
    if stray:
        listed = ", ".join(stray[:5]) + (f" and {len(stray) - 5} more" if len(stray) > 5 else "")
        declared = ", ".join(f"{names[k]}: {v}" for v, k in values.items())
        raise InputError(where, f"values without a phase: {listed}", f"declared are {declared}")
    labels = np.array([values[int(v)] for v in found], np.uint8)
    return names, _replaced(image, found, labels)


def _two_valued(image: np.ndarray, pore_value: int | None, where: str | Path) -> np.ndarray:
    """0 pore, 1 solid; the lower of the two values is pore unless said otherwise."""
    found = [int(v) for v in _counts(image)[0]]
    if len(found) > 2:
        raise InputError(
            where,
            f"{len(found)} distinct values in a binary image",
            "give phases with their values, or another kind",
        )
    if pore_value is None:
        # One value only: 0 is nothing but pore, anything else nothing but grain.
        pore_value = found[0] if len(found) == 2 else 0
    elif len(found) == 2 and pore_value not in found:
        raise InputError("pore_value", f"{pore_value} does not occur in {where}", f"one of {found}")
    return (image != pore_value).astype(np.uint8)


def _renumbered(image: np.ndarray, pore_value: int, where: str | Path, notes: dict) -> np.ndarray:
    """Grain instances 1..n in the order of their values, 0 where the image has the pore value."""
    found, _ = _counts(image)
    if found[0] < 0 and pore_value >= 0:
        raise InputError(where, f"negative grain number {int(found[0])}", "0 for pore, 1, 2 ... for grains")
    grains = found[found != pore_value]
    if len(grains) == 0:
        raise InputError(where, "no grain", "an image with at least one grain is needed")
    if int(grains[0]) != 1 or int(grains[-1]) != len(grains):
        notes["instances_renumbered"] = True
    labels = np.cumsum(found != pore_value, dtype=np.int32)
    labels[found == pore_value] = 0
    return _replaced(image, found, labels)


def _grey_levels(image: np.ndarray, where: str | Path, notes: dict) -> np.ndarray:
    """Grey as uint8 or uint16; other ranges are rescaled to uint16, and the notes say from what."""
    if image.dtype in (np.uint8, np.uint16):
        return image
    if image.dtype.kind == "f":
        image = _finite(image, where)
    low, high = image.min().item(), image.max().item()
    whole = image.dtype.kind != "f" or (high > 1 and (image == np.rint(image)).all())
    if whole and low >= 0 and high <= 65535:
        return image.astype(np.uint16)
    if not high > low:
        raise InputError(where, f"one grey level only ({low})", "an image with contrast is needed")
    notes["grey_rescaled_from"] = [low, high]
    return np.rint((image.astype(np.float64) - low) * (65535 / (high - low))).astype(np.uint16)


def _as_given(levels: np.ndarray, notes: Mapping) -> np.ndarray:
    """Grey levels of :func:`_grey_levels` on the scale of the file."""
    if "grey_rescaled_from" not in notes:
        return levels
    low, high = notes["grey_rescaled_from"]
    return low + levels * ((high - low) / 65535)


def _multi_otsu(
    grey: np.ndarray,
    names: tuple[str, ...] | None,
    values: dict[int, int] | None,
    classes: int | None,
    where: str | Path,
    notes: dict,
) -> tuple[np.ndarray, tuple[str, ...], dict[int, int]]:
    """Grey classes 0 (darkest)... by multi-Otsu (Liao et al. 2001), with names and class -> label."""
    from skimage.filters import threshold_multiotsu

    if classes is None:
        classes = 2 if names is None else len(names) if values is None else max(values, default=1) + 1
    if isinstance(classes, bool) or not isinstance(classes, int) or not 2 <= classes <= 5:
        raise InputError("classes", f"{classes!r} is not possible", "2 to 5 grey classes")
    if names is None:
        names = (PORE, "grain") if classes == 2 else (PORE, *(f"mineral_{k}" for k in range(1, classes)))
        values = {k: k for k in range(classes)}
    if sorted(values) != list(range(classes)):
        raise InputError("phases", f"{len(values)} classes named, {classes} asked", "give each class a phase")

    found, counts = _counts(grey)
    if len(found) < classes:
        raise InputError(
            where, f"{len(found)} grey levels for {classes} classes", "an image with contrast is needed"
        )
    # At most 256 bins of whole levels: the search is of that number to the power of the thresholds.
    low, high = int(found[0]), int(found[-1])
    if high - low >= 256:
        # The outermost thousandths are of the end bins: one hot pixel would leave one bin to all the rest.
        ends = np.quantile(found, (0.001, 0.999), weights=counts, method="inverted_cdf")
        low, high = ends.astype(int).tolist()
    width = -(-(high - low + 1) // 256)
    bins = (np.clip(found, low, high) - low) // width
    histogram = np.bincount(bins, weights=counts)
    if np.count_nonzero(histogram) < classes:
        raise InputError(where, "too little contrast for the classes", "ask for fewer classes")
    last = threshold_multiotsu(classes=classes, hist=(histogram, np.arange(len(histogram))))
    # A class ends with the highest level of its last bin.
    thresholds = (last.astype(np.int64) + 1) * width + low - 1
    notes["multi_otsu_thresholds"] = _as_given(thresholds, notes).tolist()
    labels = np.searchsorted(thresholds, found, side="left").astype(np.uint8)
    return _replaced(grey, found, labels), names, values


def _check_present(
    phase: np.ndarray, names: tuple[str, ...], where: str | Path, classified_later: bool
) -> None:
    """Pore, grain and every declared phase must occur."""
    present = np.isin(np.arange(len(names)), _counts(phase)[0])
    if not present[0]:
        raise InputError(
            where, "no pore", "an image with pore and grains is needed; is the pore value right?"
        )
    if not present[1:].any():
        raise InputError(
            where, "no grain", "an image with pore and grains is needed; is the pore value right?"
        )
    absent = [name for name, there in zip(names, present, strict=True) if not there]
    if absent and not classified_later:
        raise InputError(
            where,
            f"no pixel of {', '.join(absent)}",
            "declare the phases that occur, with the values they have",
        )
