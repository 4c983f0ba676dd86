"""The twin, its grains and its pore network for other tools."""

from pathlib import Path

from _stage import stage

from grainfall.export import Twin, export_twin

with stage(snakemake):
    twin = Twin(Path(snakemake.input.twin).parent, Path(snakemake.input.library))
    export_twin(twin, Path(snakemake.output[0]).parent)
