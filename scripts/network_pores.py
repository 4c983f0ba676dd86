"""Basins of all slabs joined to pores."""

from _stage import stage

from grainfall import io
from grainfall.network import slabs

with stage(snakemake):
    graphs = [io.StoredArrays(path) for path in snakemake.input.graphs]
    joined = slabs.join_slabs(graphs, snakemake.params.settings["network"]["persistence"])
    for path, arrays in zip(snakemake.output.pores, joined, strict=True):
        io.write_arrays(path, arrays)
