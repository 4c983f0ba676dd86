"""Read the user's segmented image."""

from _stage import stage

from grainfall import config
from grainfall.section import read_section, write_section

with stage(snakemake) as progress:
    row = snakemake.params.row
    section = read_section(
        snakemake.input.image,
        row["kind"],
        row["pixel_size_um"],
        config.phase_values(row.get("phases")),
        max_pixels=snakemake.params.settings["section"]["max_pixels"],
        grey_classes=snakemake.params.settings["section"]["grey_classes"],
    )
    write_section(snakemake.output.section, section)
    progress.say(f"{section.phase.shape[1]} x {section.phase.shape[0]} pixels, phases {', '.join(section.phases)}")
