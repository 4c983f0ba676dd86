"""A synthetic rock: its section and true grain sizes, or the cubes that judge its twins."""

from _stage import stage

from grainfall import io, random
from grainfall.section import Mineral, Section, synthesise, write_section

with stage(snakemake) as progress:
    rock = dict(snakemake.params.rock)
    pixel = snakemake.params.row["pixel_size_um"]
    edge, outlined = rock.pop("reference_edge", None), rock.pop("outlined", None)
    truth = synthesise(
        random.generator(**snakemake.params.stream, chapter="section/synthetic"),
        rock.pop("shape"),
        rock.pop("voxel_size_um") or pixel,
        [Mineral(**mineral) for mineral in rock.pop("minerals")],
        **rock,
    )
    if snakemake.output.get("section"):
        phase, grain = truth.section(pixel)
        write_section(
            snakemake.output.section,
            Section(phase, pixel, truth.phases, grain if outlined else None, None, {"source": "synthetic"}),
        )
        io.write_table(snakemake.output.sizes, truth.sizes())
        progress.say(f"{len(truth.sizes())} grains, porosity {(truth.phase == 0).mean():.4f}")
    else:
        first = snakemake.params.first
        paths = [path for path in snakemake.output if path != snakemake.output.record]
        about = {"phases": list(truth.phases), "seed": snakemake.params.stream["seed"]}
        for path, cube in zip(paths, truth.cubes(edge, first + len(paths))[first:], strict=True):
            io.write_volume(path, {"phase": cube}, truth.voxel_size_um, about)
            progress.say(f"porosity {(cube == 0).mean():.4f}")
