"""A packing as voxels, or a slab of it, virtual spheres included."""

from _stage import part, stage

from grainfall import grains, io, volume

with stage(snakemake) as progress:
    scene = io.read_json(snakemake.input.scene)
    slabs = volume.voxelise_slabs(
        io.read_table(snakemake.input.bodies),
        grains.Library.load(snakemake.input.library),
        scene["shape_zyx"],
        scene["voxel_size_um"],
        slab=io.CHUNK,
        planes=io.slab(scene["shape_zyx"][0], *part(snakemake.wildcards)),
    )
    with io.create_volume(
        snakemake.output.volume,
        tuple(scene["shape_zyx"]),
        {"phase": "uint8"},
        scene["voxel_size_um"],
        {"phases": scene["phases"], "seed": snakemake.params.stream["seed"], "virtual_label": volume.VIRTUAL},
    ) as packed:
        for z, phase, _ in slabs:
            packed["phase"][z : z + len(phase)] = phase
