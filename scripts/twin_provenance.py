"""What one twin rests on: config, seed, versions, and every file behind it."""

from pathlib import Path

from _stage import stage

from grainfall import io, provenance

with stage(snakemake):
    out, given = snakemake.output.provenance, snakemake.params
    document = provenance.of_twin(Path(out).parent, snakemake.input, given.settings, given.row, given.seed)
    io.write_json(out, document)
