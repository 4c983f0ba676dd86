"""Grains and pore circles on slices of the twin, measured as on the section."""

from functools import partial

from _stage import stage

from grainfall import io, morphology, random, volume
from grainfall.section import resample

twin = snakemake.input.twin

with (
    stage(snakemake),
    io.open_volume(twin, "phase") as (phase, attributes),
    io.open_volume(twin, "body") as (body, _),
):
    resolution = io.read_json(snakemake.input.scene)["resolution_um"]
    phase, body = (resample(voxels, attributes["voxel_size_um"], resolution) for voxels in (phase, body))
    grains, pores = morphology.measure_slices(
        phase,
        resolution,
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
