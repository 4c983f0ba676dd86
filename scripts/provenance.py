"""What the whole run rests on."""

from pathlib import Path

from _stage import results_folder, stage

from grainfall import io, provenance

with stage(snakemake):
    document = provenance.of_run(
        results_folder(snakemake),
        [snakemake.input.summary, snakemake.input.page],
        Path(snakemake.scriptdir).parent,
        **{name: snakemake.params[name] for name in ("files", "overrides", "config", "samples")},
    )
    io.write_json(snakemake.output.provenance, document)
