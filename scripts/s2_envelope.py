"""The section's S2 against slices of all realizations: cloud and global envelope."""

from contextlib import ExitStack

from _stage import stage

from grainfall import correlation, io, random

with stage(snakemake) as progress, ExitStack() as opened:
    section, pixel = io.read_volume(snakemake.input.labels, "phase")
    twins = [opened.enter_context(io.open_volume(path, "phase")) for path in snakemake.input.twins]
    table, test = correlation.compare_section(
        section > 0,
        pixel["voxel_size_um"],
        [phase for phase, _ in twins],
        twins[0][1]["voxel_size_um"],
        snakemake.params.settings["correlation"]["envelope_slices"],
        random.generator(**snakemake.params.stream, chapter="correlation/envelope"),
    )
    io.write_table(snakemake.output.envelope, table)
    io.write_json(snakemake.output.test, test)
    progress.say(f"global envelope test p = {test['p']:.3f} over {test['n_slices']} slices")
