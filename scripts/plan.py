"""Which effects the scene called for, why, and what each cost or saved."""

from _stage import stage

from grainfall import io, packing

with stage(snakemake):
    names = ("scene", "first", "deficit", "second", "correction", "cement")
    reports = [io.read_json(snakemake.input[name]) for name in names]
    io.write_json(snakemake.output.plan, packing.effects_plan(*reports))
