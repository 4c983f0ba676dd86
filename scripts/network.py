"""Pore network of a volume."""

from _stage import stage

from grainfall import io, network, volume

with stage(snakemake) as progress:
    settings = dict(snakemake.params.settings["network"])
    with io.open_volume(snakemake.input.volume) as (phase, attributes):
        pore, voxel_size_um = volume.read_pore_space(
            phase, attributes["voxel_size_um"], settings.pop("coarsen")
        )
    found = network.extract(pore, voxel_size_um, **settings, threads=snakemake.threads)
    network.save(found, snakemake.output.pores, snakemake.output.throats)
