"""Pore network of a volume from what was found in its slabs."""

from _stage import stage

from grainfall import io, network
from grainfall.network import slabs

with stage(snakemake):
    with io.open_volume(snakemake.input.volume) as (_, attributes):
        voxel_size_um = attributes["voxel_size_um"] * snakemake.params.settings["network"]["coarsen"]
    measured = [io.read_arrays(path) for path in snakemake.input.measured]
    found = slabs.finish(io.read_arrays(snakemake.input.known), measured, voxel_size_um)
    network.save(found, snakemake.output.pores, snakemake.output.throats)
