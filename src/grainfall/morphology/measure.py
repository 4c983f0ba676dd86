"""Sizes, shapes and sampling weights of grain sections."""

from __future__ import annotations

import numpy as np
import pandas as pd
import skimage  # its parts load when they are first used

from grainfall.errors import InputError


def sampling_weights(
    width: np.ndarray, height: np.ndarray, cut: np.ndarray, frame: tuple[float, float]
) -> np.ndarray:
    r"""Miles–Lantuéjoul weights: unbiased size statistics from the objects that a frame does not cut.

    Of the objects of the size :math:`w \times h` that lie in a frame :math:`W \times H` by one of their
    points, the share :math:`(W-w)(H-h)/(WH)` lies wholly in it: large ones are cut more often. Each uncut one
    counts with the inverse, those that are cut count nothing. So a sum of weights estimates how many objects
    frames hold, and tables of several frames may be joined.

    Parameters
    ----------
    width, height : (n,) ndarray
        Extent of the objects along x and y.
    cut : (n,) ndarray of bool
        Objects that the frame cuts.
    frame : tuple of float
        (W, H), in the same unit.

    Returns
    -------
    (n,) ndarray
        How many objects each stands for: 0 where it is cut, 1 or more where it is not.
    """
    weight = np.zeros(len(cut))
    whole = ~np.asarray(cut, bool)
    if whole.any():
        free = (frame[0] - np.asarray(width)[whole]) * (frame[1] - np.asarray(height)[whole])
        weight[whole] = frame[0] * frame[1] / free
    return weight


def measure_grains(
    labels: np.ndarray, phase: np.ndarray, pixel_size_um: float, grey: np.ndarray | None = None
) -> pd.DataFrame:
    r"""Measure every grain section.

    Parameters
    ----------
    labels : (y, x) ndarray of int
        Grains 1…n, each of one mineral.
    phase : (y, x) ndarray of uint8
        Minerals.
    pixel_size_um : float
        Edge of a pixel, µm.
    grey : (y, x) ndarray, optional
        Grey values of the section.

    Returns
    -------
    DataFrame
        One row a grain, in order of the labels: ``grain``, ``phase``, ``y_um``, ``x_um`` (centroid),
        ``area_um2``, ``r_um`` = √(S/π), ``width_um``, ``height_um`` (extents along x and y), ``border`` (the
        grain reaches the image's edge), ``weight`` (:func:`sampling_weights`), ``aspect_ratio`` (major over
        minor axis of the ellipse of equal second moments), ``circularity`` :math:`4\pi S/P^2` with Crofton's
        perimeter, ``solidity`` (area over that of the convex hull), ``orientation_rad`` (major axis, from x
        towards y, in (−π/2, π/2]) and, with `grey`, ``mean_grey``.

    Raises
    ------
    InputError
        When the pixel size is not positive.
    """
    if not pixel_size_um > 0:
        raise InputError(
            "pixel_size_um", f"{pixel_size_um} is not a length", "a positive number of micrometres"
        )
    labels = np.asarray(labels)
    shape = "centroid area bbox axis_major_length axis_minor_length perimeter_crofton solidity orientation"
    properties = ["label", *shape.split(), "coords"] + (["intensity_mean"] if grey is not None else [])
    found = skimage.measure.regionprops_table(labels, intensity_image=grey, properties=properties)
    first = np.array([c[0] for c in found["coords"]], dtype=np.intp).reshape(-1, 2)
    rows, columns = labels.shape
    top, left, bottom, right = (found[f"bbox-{i}"] for i in range(4))
    area = found["area"]
    width, height = right - left, bottom - top
    border = (top == 0) | (left == 0) | (bottom == rows) | (right == columns)
    # A section one pixel wide has no minor axis by moments of pixel centres; a pixel's own moment is 1/12.
    major, minor = (np.sqrt(found[f"axis_{a}_length"] ** 2 + 16 / 12) for a in ("major", "minor"))
    # skimage counts the angle from axis 0 towards axis 1.
    angle = np.pi / 2 - found["orientation"]
    table = pd.DataFrame(
        {
            "grain": found["label"],
            "phase": phase[tuple(first.T)],
            "y_um": (found["centroid-0"] + 0.5) * pixel_size_um,
            "x_um": (found["centroid-1"] + 0.5) * pixel_size_um,
            "area_um2": area * pixel_size_um**2,
            "r_um": np.sqrt(area / np.pi) * pixel_size_um,
            "width_um": width * pixel_size_um,
            "height_um": height * pixel_size_um,
            "border": border,
            # What reaches the outermost pixels counts as cut: it is whole as seldom as one a pixel wider.
            "weight": sampling_weights(width + 1, height + 1, border, (columns, rows)),
            "aspect_ratio": major / minor,
            "circularity": 4 * np.pi * area / found["perimeter_crofton"] ** 2,
            "solidity": found["solidity"],
            "orientation_rad": np.where(angle > np.pi / 2, angle - np.pi, angle),
        }
    )
    if grey is not None:
        table["mean_grey"] = found["intensity_mean"]
    return table


def grain_masks(labels: np.ndarray, table: pd.DataFrame) -> list[np.ndarray]:
    """Masks of the grains that the image's edge does not cut.

    Parameters
    ----------
    labels : (y, x) ndarray of int
        Grains.
    table : DataFrame
        From :func:`measure_grains`.

    Returns
    -------
    list of (h + 2, w + 2) ndarray of bool
        In the order of the table's rows with ``border`` false, each with a rim of one empty pixel and with
        its holes filled.
    """
    images = {region.label: region.image_filled for region in skimage.measure.regionprops(labels)}
    return [np.pad(images[grain], 1) for grain in table.loc[~table["border"], "grain"]]
