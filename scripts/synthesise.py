"""The demo's own rock: its section, the reference cube and the true grain sizes."""

from _stage import stage

from grainfall import io, random
from grainfall.section import Mineral, Section, synthesise, write_section

with stage(snakemake) as progress:
    spec = snakemake.params.settings["synthetic"]
    truth = synthesise(
        random.generator(**snakemake.params.stream, chapter="section/synthetic"),
        spec["shape"],
        snakemake.params.row["pixel_size_um"],
        [Mineral(**mineral) for mineral in spec["minerals"]],
        solid_fraction=spec["solid_fraction"],
        dissolved=spec["dissolved"],
    )
    write_section(
        snakemake.output.section,
        Section(truth.section(), truth.voxel_size_um, truth.phases, None, None, {"source": "synthetic"}),
    )
    edge = spec["reference_edge"]
    io.write_volume(
        snakemake.output.reference,
        {"phase": truth.phase[:edge, :edge, :edge]},
        truth.voxel_size_um,
        {"phases": list(truth.phases), "seed": snakemake.params.stream["seed"]},
    )
    io.write_table(snakemake.output.sizes, truth.sizes())
    progress.say(f"{len(truth.sizes())} grains, porosity {(truth.phase == 0).mean():.4f}")
