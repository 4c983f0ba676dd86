"""Grains and pore circles on slices of the twin, measured as on the section."""

from _stage import stage

from grainfall import io, morphology, random, volume

with stage(snakemake):
    phase, attributes = io.read_volume(snakemake.input.twin, "phase")
    outlined = io.read_json(snakemake.input.summary)["outlined"]
    body, _ = io.read_volume(snakemake.input.twin, "body")
    phase = volume.as_minerals(phase, body, io.read_table(snakemake.input.bodies))
    grains, pores = morphology.measure_slices(
        phase,
        attributes["voxel_size_um"],
        random.slices(
            random.generator(**snakemake.params.stream, chapter="morphology/slices"),
            phase.shape,
            snakemake.params.settings["correlation"]["slices"],
        ),
        body=body if outlined else None,
        **snakemake.params.settings["morphology"],
    )
    io.write_table(snakemake.output.grains, grains)
    io.write_table(snakemake.output.pores, pores)
