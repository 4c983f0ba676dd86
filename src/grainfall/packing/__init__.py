"""Grains dropped under gravity by a rigid-body engine: what is poured, how it settles."""

from grainfall.packing.deposition import Box, container, deposit
from grainfall.packing.mixing import Mixture, draw_population, draw_zones, phase_probabilities
from grainfall.packing.parameters import NAMED, Parameters
from grainfall.packing.plan import effects_plan
from grainfall.packing.rest import settle
from grainfall.packing.scene import plan_scene
from grainfall.packing.stages import pack, pack_again, plan_spheres
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
    "draw_zones",
    "effects_plan",
    "match_porosity",
    "pack",
    "pack_again",
    "phase_probabilities",
    "plan_scene",
    "plan_spheres",
    "settle",
    "sphere_probability",
    "virtual_sizes",
]
