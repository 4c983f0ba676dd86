"""Spheres removed, porosity met: the twin."""

from _stage import stage

from grainfall import grains, io, volume

with stage(snakemake) as progress:
    scene = io.read_json(snakemake.input.scene)
    settings = snakemake.params.settings
    bodies, slabs, scaling, cement = volume.finish(
        io.read_table(snakemake.input.bodies),
        grains.Library.load(snakemake.input.library),
        scene,
        io.read_json(snakemake.input.packing)["densification"],
        settings["effects"],
        settings["feedback"]["limit"],
    )
    with io.create_volume(
        snakemake.output.twin,
        tuple(scene["shape_zyx"]),
        {"phase": "uint8", "body": "int32"},
        scene["voxel_size_um"],
        {
            "phases": scene["phases"] + (["cement"] if cement["on"] else []),
            "seed": snakemake.params.stream["seed"],
        },
    ) as twin:
        for z, phase, body in slabs:
            twin["phase"][z : z + len(phase)] = phase
            twin["body"][z : z + len(body)] = body
    io.write_table(snakemake.output.bodies, bodies)
    io.write_json(snakemake.output.correction, scaling)
    io.write_json(snakemake.output.cement, cement)
    progress.say(f"porosity {cement['after']:.4f}, target {scene['porosity_target']:.4f}")
