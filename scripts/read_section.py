"""Read the user's segmented image."""

from _stage import stage

from grainfall.section import read_section, write_section

with stage(snakemake) as progress:
    given = snakemake.params
    row = given.row
    section = read_section(
        snakemake.input.image,
        row["kind"],
        row["pixel_size_um"],
        given.phases,
        pore_value=row.get("pore_value"),
        classes=given.settings["section"]["grey_classes"] if row["kind"] == "grey" else None,
        array=row.get("array"),
        grey=row.get("grey"),
        classified_later=given.classified_later,
        max_pixels=snakemake.resources.max_pixels,
    )
    write_section(snakemake.output.section, section)
    height, width = section.phase.shape
    pores, names = (section.phase == 0).mean(), ", ".join(section.phases)
    progress.say(f"{width} x {height} pixels, {pores:.1%} of them pore, phases {names}")
