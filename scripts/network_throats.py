"""Throats of the volume from their parts in the slabs."""

from _stage import stage

from grainfall import io
from grainfall.network import slabs

with stage(snakemake):
    asked, known = slabs.glue_slabs([io.StoredArrays(path) for path in snakemake.input.graphs])
    for path, arrays in zip(snakemake.output.asked, asked, strict=True):
        io.write_arrays(path, arrays)
    io.write_arrays(snakemake.output.known, known)
