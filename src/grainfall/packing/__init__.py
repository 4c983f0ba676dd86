"""Grains dropped under gravity by a rigid-body engine: what is poured, how it settles."""

from grainfall.packing.deposition import Box, container, deposit
from grainfall.packing.mixing import Mixture, draw_population, phase_probabilities
from grainfall.packing.parameters import NAMED, Parameters
from grainfall.packing.virtual import VirtualSizes, match_porosity, sphere_probability, virtual_sizes

__all__ = [
    "NAMED",
    "Box",
    "Mixture",
    "Parameters",
    "VirtualSizes",
    "container",
    "deposit",
    "draw_population",
    "match_porosity",
    "phase_probabilities",
    "sphere_probability",
    "virtual_sizes",
]
