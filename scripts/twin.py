"""Spheres removed, porosity met: the twin."""

from _stage import stage

from grainfall import grains, io, packing, volume

with stage(snakemake) as progress:
    scene = io.read_json(snakemake.input.scene)
    settings = snakemake.params.settings
    packed = io.read_json(snakemake.input.packing)
    bodies, slabs, scaling, cement = volume.finish(
        io.read_table(snakemake.input.bodies),
        grains.Library.load(snakemake.input.library),
        packing.as_placed(scene, packed["placement"]),
        io.read_json(snakemake.input.deficit)["overgrowth"],
        packed["densification"],
        settings["effects"],
        settings["feedback"]["limit"],
        progress=progress,
    )
    # Cement takes the whole region; other voxels are left to the jobs of the slabs, where there are any.
    here = slabs if snakemake.params.whole or cement["on"] else ()
    volume.write_twin(snakemake.output.twin, here, scene, cement["on"], snakemake.params.stream["seed"])
    io.write_table(snakemake.output.bodies, bodies)
    io.write_json(snakemake.output.correction, scaling)
    io.write_json(snakemake.output.cement, cement)
    progress.say(f"porosity {cement['after']:.4f}, target {scene['porosity_target']:.4f}")
