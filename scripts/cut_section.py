"""One plane of a volume as the section."""

from _stage import stage

from grainfall import io
from grainfall.section import plane_of, write_section

with stage(snakemake) as progress:
    phase, attributes = io.read_volume(snakemake.input.volume)
    section = plane_of(phase, attributes["voxel_size_um"], snakemake.params.row["slice"])
    write_section(snakemake.output.section, section)
    progress.say(f"porosity {section.porosity:.4f}, that of the volume is {(phase == 0).mean():.4f}")
