"""Volume: bodies become voxels; porosity, topology and contacts of the result; cement; exports."""

from grainfall.volume.cement import as_minerals, cement, fill_to_surface, grow_rims, with_rims
from grainfall.volume.coarsen import coarse_shape, coarsen, read_pore_space
from grainfall.volume.compaction import compact
from grainfall.volume.correction import correct_porosity
from grainfall.volume.export import export_metaimage, export_raw, export_vti
from grainfall.volume.finish import finish, make_room, size_factor, write_twin
from grainfall.volume.measures import adjacent_pairs, describe, euler_number, porosity
from grainfall.volume.scan import (
    VIRTUAL,
    claimed_slabs,
    packed_porosity,
    porosity_about,
    voxelise,
    voxelise_slabs,
)
from grainfall.volume.voids import bed_between_voids, void_circles, void_width

__all__ = [
    "VIRTUAL",
    "adjacent_pairs",
    "as_minerals",
    "bed_between_voids",
    "cement",
    "claimed_slabs",
    "coarse_shape",
    "coarsen",
    "compact",
    "correct_porosity",
    "describe",
    "euler_number",
    "export_metaimage",
    "export_raw",
    "export_vti",
    "fill_to_surface",
    "finish",
    "grow_rims",
    "make_room",
    "packed_porosity",
    "porosity",
    "porosity_about",
    "read_pore_space",
    "size_factor",
    "void_circles",
    "void_width",
    "voxelise",
    "voxelise_slabs",
    "with_rims",
    "write_twin",
]
