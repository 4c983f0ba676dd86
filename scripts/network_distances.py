"""Squared distances to the solid in a slab."""

from _stage import part, stage

from grainfall import io
from grainfall.network import distance, slabs


def ends(paths):
    """First and last solid planes of slabs, one after another."""
    for path in paths:
        columns = io.read_arrays(path)
        yield columns["first"], columns["last"]


with stage(snakemake), io.open_volume(snakemake.input.volume) as (phase, _):
    which, of = part(snakemake.wildcards)
    pore, slab = slabs.read_slab(phase, which, of, snakemake.params.settings["network"]["coarsen"])
    columns = list(snakemake.input.columns)
    beyond = distance.nearest_columns(ends(columns[: which - 1][::-1]), ends(columns[which:]))
    squared = distance.squared_distances(pore, slab.start, *beyond)
    io.write_arrays(snakemake.output.distances, {"slab": slab, "squared": squared}, compressed=False)
