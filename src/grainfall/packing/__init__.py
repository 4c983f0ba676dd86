"""Grains dropped under gravity by a rigid-body engine: what is poured, how it settles.

What moves bodies is loaded when it is asked for: to plan a scene takes neither meshes nor an engine.
"""

from grainfall.packing.densify import match_density
from grainfall.packing.mixing import Mixture, draw_population, draw_zones, phase_probabilities
from grainfall.packing.overgrowth import Overgrowth
from grainfall.packing.parameters import NAMED, Parameters
from grainfall.packing.placement import Place, as_placed, move, nearest_place, reach_voxels
from grainfall.packing.plan import decide, effects_plan
from grainfall.packing.scene import plan_scene, poured_grains
from grainfall.packing.tail import PoreTail, pore_tail
from grainfall.packing.virtual import VirtualSizes, match_porosity, sphere_probability, virtual_sizes

__all__ = [
    "NAMED",
    "RESETTLED",
    "Box",
    "Mixture",
    "Overgrowth",
    "Parameters",
    "Place",
    "PoreTail",
    "VirtualSizes",
    "as_placed",
    "box_of",
    "container",
    "decide",
    "deposit",
    "draw_population",
    "draw_zones",
    "effects_plan",
    "let_rest",
    "match_between",
    "match_density",
    "match_porosity",
    "mean_void_volume",
    "move",
    "moved_share",
    "nearest_place",
    "pack",
    "pack_again",
    "pack_first",
    "parameters_of",
    "phase_probabilities",
    "plan_deficit",
    "plan_scene",
    "pore_tail",
    "poured_grains",
    "reach_voxels",
    "settle",
    "size_voids",
    "sphere_probability",
    "virtual_sizes",
]


def __getattr__(name: str):
    # written out, not by lazy_loader: the graph of imports, by which edits rerun jobs, must see these
    if name == "plan_deficit":
        import grainfall.packing.deficit as late
    elif name in ("Box", "container", "deposit"):
        import grainfall.packing.deposition as late
    elif name in ("RESETTLED", "moved_share", "settle"):
        import grainfall.packing.rest as late
    elif name in (
        "box_of",
        "let_rest",
        "pack",
        "pack_again",
        "pack_first",
        "parameters_of",
    ):
        import grainfall.packing.stages as late
    elif name in ("match_between", "mean_void_volume", "size_voids"):
        import grainfall.packing.voids as late
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(late, name)
