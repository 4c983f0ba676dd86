"""The twin, its grains and its pore network for other tools."""

from pathlib import Path

from _stage import stage

from grainfall.export import Twin, export_twin

with stage(snakemake):
    coarsen = snakemake.params.settings["network"]["coarsen"]
    twin = Twin(Path(snakemake.input.twin).parent, Path(snakemake.input.library), coarsen)
    export_twin(twin, Path(snakemake.output[0]).parent)
