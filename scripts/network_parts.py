"""Pores of a slab's voxels, and its parts of throats."""

from _stage import stage

from grainfall import io
from grainfall.network import slabs

with stage(snakemake):
    field, graph = slabs.find_throat_parts(
        io.read_arrays(snakemake.input.field), io.read_arrays(snakemake.input.pores)
    )
    io.write_arrays(snakemake.output.field, field, compressed=False)
    io.write_arrays(snakemake.output.graph, graph)
