"""Correlation: the two-point probability S2 of images and volumes, and tests of a section against slices."""

from grainfall.correlation.envelope import fraction_inside, global_envelope
from grainfall.correlation.s2 import (
    along_axes,
    pair_counts,
    s2_along,
    s2_image,
    s2_of_counts,
    s2_of_slices,
    s2_volume,
    surface_from_s2,
)
from grainfall.correlation.sections import (
    Window,
    common_window,
    compare_section,
    section_curves,
    section_windows,
    slice_curves,
)

__all__ = [
    "Window",
    "along_axes",
    "common_window",
    "compare_section",
    "fraction_inside",
    "global_envelope",
    "pair_counts",
    "s2_along",
    "s2_image",
    "s2_of_counts",
    "s2_of_slices",
    "s2_volume",
    "section_curves",
    "section_windows",
    "slice_curves",
    "surface_from_s2",
]
