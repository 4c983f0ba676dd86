"""The twin and its pore network for other tools: MetaImage, VTI, GLB, STL; VTP and Statoil files."""

from pathlib import Path

from _stage import stage

from grainfall import grains, io, network, volume

with stage(snakemake):
    phase, attributes = io.read_volume(snakemake.input.twin, "phase")
    size = attributes["voxel_size_um"]
    volume.export_metaimage(snakemake.output.metaimage, phase, size)
    volume.export_vti(snakemake.output.vti, {"phase": phase}, size)
    library = grains.Library.load(snakemake.input.library)
    bodies = io.read_table(snakemake.input.bodies)
    for path in (snakemake.output.glb, snakemake.output.stl):
        grains.export_bodies(bodies, library, path)
    found = network.load(snakemake.input.pores, snakemake.input.throats)
    network.save_vtp(found, snakemake.output.vtp)
    prefix = Path(snakemake.output.vtp).with_suffix("")
    network.save_statoil(found, prefix, tuple(n * size for n in phase.shape[::-1]))
