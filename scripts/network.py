"""Pore network of a volume."""

from _stage import stage

from grainfall import io, network, volume

with stage(snakemake) as progress:
    phase, attributes = io.read_volume(snakemake.input.volume)
    settings = dict(snakemake.params.settings["network"])
    factor = settings.pop("coarsen")
    pore = volume.coarsen(phase == 0, factor)
    del phase
    found = network.extract(pore, attributes["voxel_size_um"] * factor, **settings)
    network.save(found, snakemake.output.pores, snakemake.output.throats)
