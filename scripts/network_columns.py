"""First and last solid plane of every column of a slab."""

from _stage import part, stage

from grainfall import io
from grainfall.network import distance, slabs

with stage(snakemake), io.open_volume(snakemake.input.volume) as (phase, _):
    coarsen = snakemake.params.settings["network"]["coarsen"]
    pore, slab = slabs.read_slab(phase, *part(snakemake.wildcards), coarsen)
    first, last = distance.solid_columns(pore, slab.start)
    io.write_arrays(snakemake.output.columns, {"first": first, "last": last})
