"""What gravity would do to the skeleton without its virtual spheres: a check, not a stage of the twin."""

from _stage import stage

from grainfall import correlation, grains, io, packing, volume

with stage(snakemake) as progress:
    scene = io.read_json(snakemake.input.scene)
    settings = snakemake.params.settings
    library = grains.Library.load(snakemake.input.library)
    packed = io.read_table(snakemake.input.packed)
    skeleton = packed[packed.kind == "grain"].reset_index(drop=True)
    moved = io.read_json(snakemake.input.packing)["placement"]["moved_um"]
    # the friction of the config, whatever it was lubricated by; the steps that the packing took
    parameters = packing.parameters_of(settings["packing"], settings["effects"])
    if io.read_json(snakemake.input.first_report)["refinement"]["on"]:
        parameters = parameters.refined()
    settled, report = packing.settle(
        packing.move(skeleton, [-along for along in moved]),  # where it lies in its box
        library,
        packing.box_of(scene),
        parameters,
        rest=packing.RESETTLED,
        every=False,  # porosity and S2 do not wait for the last grain
        progress=progress,
    )
    settled = packing.move(settled, moved)
    before, after = (
        volume.voxelise(bodies, library, scene["shape_zyx"], scene["voxel_size_um"])[0] > 0
        for bodies in (skeleton, settled)
    )
    s2 = [correlation.s2_volume(solid, scene["voxel_size_um"])["s2"] for solid in (before, after)]
    io.write_json(
        snakemake.output.change,
        {
            "porosity_before": 1 - before.mean(),
            "porosity_after": 1 - after.mean(),
            "s2_change": (s2[1] - s2[0]).abs().max(),
            **{k: report[k] for k in ("moved_mean", "moved_max", "at_rest", "steps", "max_overlap")},
            "moved_share": packing.moved_share(skeleton, settled),
        },
    )
    progress.say(f"porosity {1 - before.mean():.4f} becomes {1 - after.mean():.4f}")
