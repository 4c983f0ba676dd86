"""Grains and pores of the section, one by one."""

from _stage import stage

from grainfall import io, morphology
from grainfall.section import load_section

with stage(snakemake) as progress:
    section = load_section(snakemake.input.section)
    found = morphology.analyse(
        section.phase,
        section.pixel_size_um,
        instances=section.instances,
        grey=section.grey_as_given,
        phases=section.phases,
        rules=snakemake.params.settings["section"]["rules"],
        **snakemake.params.settings["morphology"],
    )
    summary = found.summary(section.phases) | {
        "pixel_size_um": section.pixel_size_um,
        "shape_yx": list(section.phase.shape),
        "outlined": section.instances is not None,
        "notes": section.notes,
    }
    io.write_volume(
        snakemake.output.labels,
        {"grains": found.grain_labels, "pores": found.pore_labels, "phase": found.phase},
        section.pixel_size_um,
    )
    io.write_table(snakemake.output.grains, found.grains)
    io.write_table(snakemake.output.pores, found.pores)
    io.write_json(snakemake.output.summary, summary)
    progress.say("{n_grains} grains, {n_pores} pores, porosity {porosity:.4f}".format(**summary))
