"""S2 of the solid in 3D."""

from _stage import stage

from grainfall import correlation, io

with stage(snakemake):
    phase, attributes = io.read_volume(snakemake.input.volume)
    s2 = correlation.s2_volume(phase, attributes["voxel_size_um"], threads=snakemake.threads)
    io.write_table(snakemake.output.s2, s2)
