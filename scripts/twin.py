"""Spheres removed, porosity corrected: the twin."""

from _stage import stage

from grainfall import grains, io, volume

with stage(snakemake) as progress:
    scene = io.read_json(snakemake.input.scene)
    setting = snakemake.params.settings["correction"]
    library = grains.Library.load(snakemake.input.library)
    bodies = io.read_table(snakemake.input.bodies)
    bodies, report = volume.correct_porosity(
        bodies[bodies.kind == "grain"].reset_index(drop=True),
        library,
        scene["shape_zyx"],
        scene["voxel_size_um"],
        scene["porosity_target"],
        limit=setting["limit"] if setting["enabled"] else 0.0,
    )
    phase, body = volume.voxelise(bodies, library, scene["shape_zyx"], scene["voxel_size_um"])
    io.write_volume(
        snakemake.output.twin,
        {"phase": phase, "body": body},
        scene["voxel_size_um"],
        {"phases": scene["phases"], "seed": snakemake.params.stream["seed"]},
    )
    io.write_table(snakemake.output.bodies, bodies)
    io.write_json(snakemake.output.correction, report)
    progress.say(f"porosity {(phase == 0).mean():.4f}, target {scene['porosity_target']:.4f}")
