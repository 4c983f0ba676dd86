"""Read the user's 3D reference volume."""

from _stage import stage

from grainfall import io
from grainfall.section import read_reference

with stage(snakemake):
    row = snakemake.params.row
    volume, voxel_size_um = read_reference(
        snakemake.input.image, row["reference_voxel_size_um"], pore_value=row["reference_pore"]
    )
    io.write_volume(
        snakemake.output.reference, {"phase": volume}, voxel_size_um, {"phases": ["pore", "solid"]}
    )
