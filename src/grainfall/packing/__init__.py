"""Grains dropped under gravity by a rigid-body engine: what is poured, how it settles."""

from grainfall.packing.densify import match_density
from grainfall.packing.deposition import Box, container, deposit
from grainfall.packing.mixing import Mixture, draw_population, draw_zones, phase_probabilities
from grainfall.packing.parameters import NAMED, Parameters
from grainfall.packing.plan import SWITCHES, decide, effects_plan
from grainfall.packing.rest import RESETTLED, moved_share, settle
from grainfall.packing.scene import plan_scene
from grainfall.packing.stages import box_of, pack, pack_again, pack_first, parameters_of, plan_deficit
from grainfall.packing.tail import PoreTail, pore_tail
from grainfall.packing.virtual import VirtualSizes, match_porosity, sphere_probability, virtual_sizes

__all__ = [
    "NAMED",
    "RESETTLED",
    "SWITCHES",
    "Box",
    "Mixture",
    "Parameters",
    "PoreTail",
    "VirtualSizes",
    "box_of",
    "container",
    "decide",
    "deposit",
    "draw_population",
    "draw_zones",
    "effects_plan",
    "match_density",
    "match_porosity",
    "moved_share",
    "pack",
    "pack_again",
    "pack_first",
    "parameters_of",
    "phase_probabilities",
    "plan_deficit",
    "plan_scene",
    "pore_tail",
    "settle",
    "sphere_probability",
    "virtual_sizes",
]
