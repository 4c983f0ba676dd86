"""The section measured at the twin's voxel size, so that both are compared at one resolution.

Its surface is that on the coarser of pixel and voxel: finer voxels do not make what the pixels hid.
"""

from dataclasses import asdict

from _stage import stage

from grainfall import io, morphology
from grainfall.section import load_section, resample
from grainfall.surface import solid_surface

with stage(snakemake):
    section = load_section(snakemake.input.section)
    phase, _ = io.read_volume(snakemake.input.labels, "phase")
    scene = io.read_json(snakemake.input.scene)
    voxel, resolution = scene["voxel_size_um"], scene["resolution_um"]
    instances = section.instances
    surface = solid_surface(resample(phase, section.pixel_size_um, resolution), resolution)
    found = morphology.analyse(
        resample(phase, section.pixel_size_um, voxel),
        voxel,
        instances=None if instances is None else resample(instances, section.pixel_size_um, voxel),
        **snakemake.params.settings["morphology"],
    )
    io.write_table(snakemake.output.grains, found.grains)
    io.write_table(snakemake.output.pores, found.pores)
    io.write_json(snakemake.output.surface, asdict(surface))
