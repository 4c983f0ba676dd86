"""The twin for other tools: MetaImage, VTI, GLB and STL."""

from _stage import stage

from grainfall import grains, io, volume

with stage(snakemake):
    phase, attributes = io.read_volume(snakemake.input.twin, "phase")
    size = attributes["voxel_size_um"]
    volume.export_metaimage(snakemake.output.metaimage, phase, size)
    volume.export_vti(snakemake.output.vti, {"phase": phase}, size)
    library = grains.Library.load(snakemake.input.library)
    bodies = io.read_table(snakemake.input.bodies)
    for path in (snakemake.output.glb, snakemake.output.stl):
        grains.export_bodies(bodies, library, path)
