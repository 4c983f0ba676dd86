"""Pore network of a volume."""

from _stage import stage

from grainfall import io, network, volume

with stage(snakemake) as progress:
    phase, attributes = io.read_volume(snakemake.input.volume)
    settings = dict(snakemake.params.settings["network"])
    pore, voxel_size_um = volume.coarsen(phase == 0, attributes["voxel_size_um"], settings.pop("coarsen"))
    del phase
    found = network.extract(pore, voxel_size_um, **settings)
    network.save(found, snakemake.output.pores, snakemake.output.throats)
