"""Where the twin lives: region of interest, voxels, target porosity, phase fractions."""

from _stage import stage

from grainfall import io, packing, stereology

with stage(snakemake) as progress:
    scene = packing.plan_scene(
        stereology.from_table(io.read_table(snakemake.input.sizes)),
        io.read_json(snakemake.input.summary),
        porosity_of_sample=snakemake.params.row.get("porosity"),
        phase_mixing=snakemake.params.settings["effects"]["phase_mixing"],
        **snakemake.params.settings["scene"],
    )
    io.write_json(snakemake.output.scene, scene)
    progress.say(
        "{shape_zyx} voxels of {voxel_size_um:.4g} um, {across:.3g} across the mean grain, target porosity "
        "{porosity_target:.4f}".format(**scene, across=scene["mean_diameter_um"] / scene["voxel_size_um"])
    )
