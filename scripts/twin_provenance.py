"""What one twin rests on: config, seed, versions, and every file behind it."""

from pathlib import Path

from _stage import stage

from grainfall import io, provenance

with stage(snakemake):
    out = snakemake.output.provenance
    document = provenance.of_twin(
        Path(out).parent, snakemake.params.settings, snakemake.params.row, snakemake.params.seed
    )
    io.write_json(out, document)
