"""What kind of image a file holds, judged from its pixels."""

from __future__ import annotations

import contextlib
import re
from pathlib import Path

import numpy as np
from skimage.measure import label

from grainfall.errors import InputError
from grainfall.section.raster import read_raster
from grainfall.units import LENGTHS_UM

MOST_PHASES = 16
"""Segmented images name few phases; photographs have many grey levels."""
PIECES = 1.5
"""Most connected pieces a value of an outlined section has on average: a grain is one, cut ones are a few."""
WINDOW = 2048
"""Pixels along each axis that the judgement looks at."""

UNITS_UM = LENGTHS_UM | {r"\u00b5m": 1.0, "micron": 1.0, "microns": 1.0, "cm": 1e4}
"""Units of length as ImageJ and OME write them, too."""


def stated_pixel_um(path: str | Path) -> tuple[float, float] | None:
    """Edges x and y (um) of a pixel by a TIFF's own account, ImageJ's or OME's; None where it gives none.

    Resolutions in dots are of no use: most are a printer's.
    """
    path = Path(path)
    if path.suffix.lower() not in (".tif", ".tiff"):
        return None
    import tifffile

    # what cannot be understood is nobody's mistake here
    with contextlib.suppress(KeyError, ValueError, ZeroDivisionError), tifffile.TiffFile(path) as tif:
        if tif.ome_metadata:
            given = dict(re.findall(r'PhysicalSize([XY](?:Unit)?)="([^"]*)"', tif.ome_metadata))
            edges = {
                axis: float(given[axis]) * UNITS_UM[given.get(f"{axis}Unit", "µm")]
                for axis in "XY"
                if axis in given
            }
            x = edges.get("X") or edges["Y"]
            return x, edges.get("Y", x)
        if tif.imagej_metadata:
            unit = UNITS_UM[str(tif.imagej_metadata["unit"]).lower()]
            x, y = (unit / per for per in tif.pages.first.get_resolution())
            return x, y
    return None


def guess_kind(path: str | Path, array: str | None = None) -> tuple[str, str]:
    """Kind of a section image (see :func:`grainfall.section.read_section`) and the reason in plain words.

    Two values are a binary image. Values that each fill about one connected piece number grains, since phases
    and grey levels recur all over a section. Few values are phases, many are grey.

    Parameters
    ----------
    path : str or Path
        PNG, TIFF, NPY, NPZ or Zarr.
    array : str, optional
        Name of the array in an NPZ or Zarr that holds several.

    Returns
    -------
    kind : {"instances", "phases", "binary", "grey"}
    reason : str

    Raises
    ------
    InputError
        When the image cannot be read, or has one value only.
    """
    image = read_raster(path, array=array, prefer=("labels", "instances", "phase", "phases", "mask", "grey"))
    values, numbers = np.unique(image, return_inverse=True)
    if len(values) < 2:
        raise InputError(path, "has one value only", "an image with pore and grains is needed")
    if len(values) == 2:
        return "binary", f"two values, {values[0]:g} and {values[1]:g}"
    if image.dtype.kind == "f" and (image != np.rint(image)).any():
        return "grey", "fractional values"
    seen = numbers.reshape(image.shape)[:WINDOW, :WINDOW]
    background = int(np.searchsorted(values, 0)) if values[0] <= 0 else -1
    pieces = label(seen, background=background, connectivity=1, return_num=True)[1]
    inside = np.setdiff1d(np.unique(seen), [background])
    if pieces <= PIECES * len(inside):
        return "instances", f"{len(values) - 1} values, nearly each of one connected piece"
    if len(values) <= MOST_PHASES:
        return "phases", f"{len(values)} values that recur all over the image"
    return "grey", f"{len(values)} values that recur all over the image"
