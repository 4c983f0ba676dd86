"""What is finished of the sweep, repeat by repeat and in one table; what presets are worth in another."""

from _stage import results_folder, stage

from grainfall import accuracy, io

with stage(snakemake) as progress:
    asked = snakemake.params
    repeats = accuracy.gather(
        results_folder(snakemake), asked.sweep, asked.samples, asked.jobs, asked.poured, asked.twins
    )
    table = accuracy.summarise(repeats)
    io.write_table(snakemake.output.repeats, accuracy.rounded(repeats))
    io.write_table(snakemake.output.table, accuracy.rounded(table))
    io.write_table(snakemake.output.presets, accuracy.rounded(accuracy.presets_of(table)))
    progress.say(f"{len(table)} rows of {table['knob'].nunique()} knobs")
