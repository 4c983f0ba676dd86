"""3D grains, each from three masks of one size class and mineral; voids likewise, where asked for."""

from _stage import stage

from grainfall import grains, io, random

with stage(snakemake) as progress:
    labels, attributes = io.read_volume(snakemake.input.labels, "grains")
    found, settings = io.read_table(snakemake.input.grains), snakemake.params.settings
    library = grains.build_library(
        labels,
        found,
        rng=random.generator(**snakemake.params.stream, chapter="grains"),
        progress=progress,
        **settings["grains"],
    )
    if snakemake.params.voids:
        voids = grains.void_shapes(
            io.read_volume(snakemake.input.labels, "phase")[0],
            found,
            attributes["voxel_size_um"],
            random.generator(**snakemake.params.stream, chapter="grains/voids"),
            progress=progress,
            **settings["morphology"],
        )
        progress.say(
            f"{len(voids)} of voids"
            if voids
            else "no shapes of voids: too few that a grain would fit, or pixels too coarse"
        )
        library = library.with_shapes(voids) if voids else library
    library.save(snakemake.output.library)
    progress.say(f"{len(library.table)} shapes")
