"""Morphology: grains and pores of a section, their sizes, shapes and sampling weights."""

from grainfall.morphology.analyse import Analysis, analyse, measure_slices
from grainfall.morphology.classify import classify_grains
from grainfall.morphology.measure import grain_masks, measure_grains, sampling_weights
from grainfall.morphology.pores import inscribed_circles
from grainfall.morphology.split import coverage, split_grains, split_pores
from grainfall.morphology.voids import NARROWEST_PX, Intergranular, intergranular, solid_radius, voids

__all__ = [
    "NARROWEST_PX",
    "Analysis",
    "Intergranular",
    "analyse",
    "classify_grains",
    "coverage",
    "grain_masks",
    "inscribed_circles",
    "intergranular",
    "measure_grains",
    "measure_slices",
    "sampling_weights",
    "solid_radius",
    "split_grains",
    "split_pores",
    "voids",
]
