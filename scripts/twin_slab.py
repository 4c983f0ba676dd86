"""The voxels of a slab of the twin; none where it is cemented, which was done as a whole."""

from _stage import part, stage

from grainfall import grains, io, volume

with stage(snakemake):
    scene = io.read_json(snakemake.input.scene)
    cemented = io.read_json(snakemake.input.cement)["on"]
    slabs = volume.voxelise_slabs(
        io.read_table(snakemake.input.bodies),
        grains.Library.load(snakemake.input.library),
        scene["shape_zyx"],
        scene["voxel_size_um"],
        slab=io.CHUNK,
        planes=io.slab(scene["shape_zyx"][0], *part(snakemake.wildcards)),
    )
    volume.write_twin(
        snakemake.output.volume, () if cemented else slabs, scene, cemented, snakemake.params.stream["seed"]
    )
