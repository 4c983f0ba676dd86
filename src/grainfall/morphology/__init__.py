"""Morphology: grains and pores of a section, their sizes, shapes and sampling weights."""

from grainfall.morphology.measure import grain_masks, measure_grains, sampling_weights
from grainfall.morphology.pores import inscribed_circles
from grainfall.morphology.split import coverage, split_grains, split_pores

__all__ = [
    "coverage",
    "grain_masks",
    "inscribed_circles",
    "measure_grains",
    "sampling_weights",
    "split_grains",
    "split_pores",
]
