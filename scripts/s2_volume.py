"""S2 of the solid in 3D."""

from _stage import stage

from grainfall import correlation, io

with stage(snakemake):
    phase, attributes = io.read_volume(snakemake.input.volume)
    io.write_table(snakemake.output.s2, correlation.s2_volume(phase, attributes["voxel_size_um"]))
