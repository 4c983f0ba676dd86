"""Walls of pores and rims of throats in a slab."""

from _stage import stage

from grainfall import io
from grainfall.network import slabs

with stage(snakemake):
    measured = slabs.measure_slab(
        io.read_arrays(snakemake.input.field), io.read_arrays(snakemake.input.asked)
    )
    io.write_arrays(snakemake.output.measured, measured)
