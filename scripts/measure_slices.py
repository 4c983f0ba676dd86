"""Grains and pore circles on slices of the twin, measured as on the section."""

from functools import partial

from _stage import stage

from grainfall import io, morphology, random, volume

twin = snakemake.input.twin

with (
    stage(snakemake),
    io.open_volume(twin, "phase") as (phase, attributes),
    io.open_volume(twin, "body") as (body, _),
):
    grains, pores = morphology.measure_slices(
        phase,
        attributes["voxel_size_um"],
        random.slices(
            random.generator(**snakemake.params.stream, chapter="morphology/slices"),
            phase.shape,
            snakemake.params.settings["correlation"]["slices"],
        ),
        body=body,
        outlined=io.read_json(snakemake.input.summary)["outlined"],
        shown=partial(volume.as_minerals, bodies=io.read_table(snakemake.input.bodies)),
        **snakemake.params.settings["morphology"],
    )
    io.write_table(snakemake.output.grains, grains)
    io.write_table(snakemake.output.pores, pores)
