"""A synthetic rock: its section, reference cubes and the true grain sizes."""

from _stage import stage

from grainfall import io, random
from grainfall.section import Mineral, Section, synthesise, write_section

with stage(snakemake) as progress:
    rock = dict(snakemake.params.rock)
    pixel = snakemake.params.row["pixel_size_um"]
    edge, outlined = rock.pop("reference_edge"), rock.pop("outlined")
    truth = synthesise(
        random.generator(**snakemake.params.stream, chapter="section/synthetic"),
        rock.pop("shape"),
        rock.pop("voxel_size_um") or pixel,
        [Mineral(**mineral) for mineral in rock.pop("minerals")],
        **rock,
    )
    phase, grain = truth.section(pixel)
    write_section(
        snakemake.output.section,
        Section(phase, pixel, truth.phases, grain if outlined else None, None, {"source": "synthetic"}),
    )
    further = [path for name, path in snakemake.output.items() if name.startswith("cube_")]
    files = [snakemake.output.reference, *further]
    about = {"phases": list(truth.phases), "seed": snakemake.params.stream["seed"]}
    for path, cube in zip(files, truth.cubes(edge, len(files)), strict=True):
        io.write_volume(path, {"phase": cube}, truth.voxel_size_um, about)
    io.write_table(snakemake.output.sizes, truth.sizes())
    progress.say(f"{len(truth.sizes())} grains, porosity {(truth.phase == 0).mean():.4f}")
