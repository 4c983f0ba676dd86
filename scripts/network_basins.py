"""Basins of the distance maxima of a slab, ways out of it, and saddles."""

from _stage import part, stage

from grainfall import io
from grainfall.network import slabs

with stage(snakemake):
    near = [io.read_arrays(path) for path in snakemake.input.distances]
    places = [slabs.Slab.of(arrays) for arrays in near]
    slab = places[0 if part(snakemake.wildcards)[0] == 1 else 1]
    squared = slabs.window_of(slab, zip(places, (arrays["squared"] for arrays in near), strict=True))
    del near
    field, graph = slabs.grow_basins(squared, slab)
    io.write_arrays(snakemake.output.field, field, compressed=False)
    io.write_arrays(snakemake.output.graph, graph)
