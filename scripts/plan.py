"""Which effects the scene called for, why, and what each cost or saved."""

from _stage import stage

from grainfall import io, packing, stereology

with stage(snakemake):
    names = ("scene", "first", "deficit", "second", "correction", "cement")
    reports = [io.read_json(snakemake.input[name]) for name in names]
    outlined = io.read_json(snakemake.input.summary)["outlined"]
    shapes = stereology.own_shapes(**snakemake.params.settings["stereology"], outlined=outlined)
    plan = packing.effects_plan(shapes, *reports)
    if asked := snakemake.params.asked:
        reason = f"{asked['metric']} within {asked['tolerance']:g} asked for: {asked['words']}"
        plan["preset"] = {"on": True, "forced": False, "reason": reason, "cost_s": None, "saved_s": None}
    io.write_json(snakemake.output.plan, plan)
