"""A packing as voxels, virtual spheres included."""

from _stage import stage

from grainfall import grains, io, volume

with stage(snakemake) as progress:
    scene = io.read_json(snakemake.input.scene)
    phase, _ = volume.voxelise(
        io.read_table(snakemake.input.bodies),
        grains.Library.load(snakemake.input.library),
        scene["shape_zyx"],
        scene["voxel_size_um"],
    )
    io.write_volume(
        snakemake.output.volume,
        {"phase": phase},
        scene["voxel_size_um"],
        {"phases": scene["phases"], "seed": snakemake.params.stream["seed"], "virtual_label": volume.VIRTUAL},
    )
