"""Grains: closed 3D shapes from the masks of a section, and their exact mass properties."""

from grainfall.grains.contours import Unusable
from grainfall.grains.export import export_bodies, export_lammps
from grainfall.grains.library import SPHERE, Library, build_library, cut, sphere
from grainfall.grains.profiles import random_profiles, spread_planes
from grainfall.grains.shape import Grain, grain_from_contours, grain_from_masks, mass_properties, unit_contour
from grainfall.grains.voids import VOID, void_shapes

__all__ = [
    "SPHERE",
    "VOID",
    "Grain",
    "Library",
    "Unusable",
    "build_library",
    "cut",
    "export_bodies",
    "export_lammps",
    "grain_from_contours",
    "grain_from_masks",
    "mass_properties",
    "random_profiles",
    "sphere",
    "spread_planes",
    "unit_contour",
    "void_shapes",
]
