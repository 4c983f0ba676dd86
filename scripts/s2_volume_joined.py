"""S2 of the solid in 3D from the pairs counted in its slabs."""

from _stage import stage

from grainfall import correlation, io

with stage(snakemake), io.open_volume(snakemake.input.volume) as (phase, attributes):
    counts = [io.read_arrays(path) for path in snakemake.input.counts]
    table = correlation.s2_of_counts(counts, phase.shape, attributes["voxel_size_um"])
    io.write_table(snakemake.output.s2, table)
