"""Read the user's 3D reference volume."""

from _stage import stage

from grainfall import io
from grainfall.section import read_reference

with stage(snakemake):
    row = snakemake.params.row
    shape = row.get("reference_shape")
    volume, voxel_size_um = read_reference(
        snakemake.input.image,
        row["reference_voxel_size_um"],
        pore_value=row["reference_pore"],
        shape=None if shape is None else shape.split(";"),
        dtype=row.get("reference_dtype"),
    )
    io.write_volume(
        snakemake.output.reference, {"phase": volume}, voxel_size_um, {"phases": ["pore", "solid"]}
    )
