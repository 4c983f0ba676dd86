"""The section's S2 against slices of all realizations: cloud and global envelope."""

from _stage import stage

from grainfall import correlation, io, random

with stage(snakemake) as progress:
    section, pixel = io.read_volume(snakemake.input.labels, "phase")
    with io.open_volume(snakemake.input.twins[0], "phase") as (_, attributes):
        voxel_size_um = attributes["voxel_size_um"]
    table, test = correlation.compare_section(
        section > 0,
        pixel["voxel_size_um"],
        io.Volumes(snakemake.input.twins, "phase"),
        voxel_size_um,
        snakemake.params.settings["correlation"]["envelope_slices"],
        random.generator(**snakemake.params.stream, chapter="correlation/envelope"),
    )
    io.write_table(snakemake.output.envelope, table)
    io.write_json(snakemake.output.test, test)
    progress.say(f"global envelope test p = {test['p']:.3f} over {test['n_slices']} slices")
