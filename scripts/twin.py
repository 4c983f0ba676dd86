"""Spheres removed, porosity met: the twin."""

from _stage import stage

from grainfall import grains, io, volume

with stage(snakemake) as progress:
    scene = io.read_json(snakemake.input.scene)
    settings = snakemake.params.settings
    bodies, phase, body, scaling, cement = volume.finish(
        io.read_table(snakemake.input.bodies),
        grains.Library.load(snakemake.input.library),
        scene,
        io.read_json(snakemake.input.packing)["densification"],
        settings["effects"],
        settings["feedback"]["limit"],
    )
    io.write_volume(
        snakemake.output.twin,
        {"phase": phase, "body": body},
        scene["voxel_size_um"],
        {
            "phases": scene["phases"] + (["cement"] if cement["on"] else []),
            "seed": snakemake.params.stream["seed"],
        },
    )
    io.write_table(snakemake.output.bodies, bodies)
    io.write_json(snakemake.output.correction, scaling)
    io.write_json(snakemake.output.cement, cement)
    progress.say(f"porosity {(phase == 0).mean():.4f}, target {scene['porosity_target']:.4f}")
