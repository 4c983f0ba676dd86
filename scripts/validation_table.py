"""What is finished of the validation cases, in one table beside the paper's figures."""

from _stage import results_folder, stage

from grainfall import io
from grainfall.report.validation import validation_table

with stage(snakemake) as progress:
    table, left_out = validation_table(results_folder(snakemake), snakemake.params.cases)
    io.write_table(snakemake.output.table, table)
    io.write_json(snakemake.output.left_out, left_out)
    for sample in left_out:
        progress.say(f"left out: {sample}")
    progress.say(f"{len(table)} rows of {table['case'].nunique()} cases")
