"""The section on the coarser of its pixels and the twin's voxels, on which both are measured."""

from dataclasses import asdict

from _stage import stage

from grainfall import io, morphology
from grainfall.section import load_section, resample
from grainfall.surface import solid_surface

with stage(snakemake):
    section = load_section(snakemake.input.section)
    phase, _ = io.read_volume(snakemake.input.labels, "phase")
    resolution = io.read_json(snakemake.input.scene)["resolution_um"]
    instances = section.instances
    phase = resample(phase, section.pixel_size_um, resolution)
    found = morphology.analyse(
        phase,
        resolution,
        instances=None if instances is None else resample(instances, section.pixel_size_um, resolution),
        **snakemake.params.settings["morphology"],
    )
    io.write_table(snakemake.output.grains, found.grains)
    io.write_table(snakemake.output.pores, found.pores)
    between = morphology.intergranular([phase == 0], resolution, morphology.solid_radius(found.grains))
    io.write_json(snakemake.output.intergranular, {} if between is None else asdict(between))
    io.write_json(snakemake.output.surface, asdict(solid_surface(phase, resolution)))
