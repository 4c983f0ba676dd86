"""Pore network of a volume."""

from _stage import stage

from grainfall import io, network

with stage(snakemake) as progress:
    phase, attributes = io.read_volume(snakemake.input.volume)
    pore = phase == 0
    del phase
    found = network.extract(pore, attributes["voxel_size_um"], **snakemake.params.settings["network"])
    network.save(found, snakemake.output.pores, snakemake.output.throats)
