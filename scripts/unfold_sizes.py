"""Wicksell inversion of the grain sizes of each mineral and of the pore circles."""

import numpy as np
from _stage import stage

from grainfall import grains, io, random, stereology, volume
from grainfall.errors import InputError

with stage(snakemake) as progress:
    sections = io.read_table(snakemake.input.grains)
    pores = io.read_table(snakemake.input.pores)
    summary = io.read_json(snakemake.input.summary)
    library = grains.Library.load(snakemake.input.library)
    names, options = summary["phases"], dict(snakemake.params.settings["stereology"])
    shapes = stereology.own_shapes(options["method"], options.pop("particles"), summary["outlined"])
    rng = random.generator(**snakemake.params.stream, chapter="stereology")
    samples = {(n, "grain"): sections[sections.phase == n] for n in range(1, len(names))}
    samples[0, "pore"] = pores
    progress.say(shapes["reason"])
    dists, circles = {}, np.empty(0)
    for (phase, kind), table in samples.items():
        # A pore circle is no section of a body of its size: what pores are left out says little of circles.
        smallest, particle = 0.0, stereology.SPHERE
        if kind == "grain":
            smallest = summary["smallest_grain_um"]
            if shapes["on"]:
                particle = grains.random_profiles(library.meshes(phase))
        elif options["method"] == "adaptive":
            circles = volume.void_circles(library, **snakemake.params.settings["morphology"])
            particle = stereology.particle_of(circles)
            by = "by what voids show" if len(circles) else "as those of spheres"
            progress.say(f"pore circles were unfolded {by}")
        found = stereology.unfold_table(table, smallest_um=smallest, particle=particle, rng=rng, **options)
        if found is None and kind == "grain":
            raise InputError(
                snakemake.input.grains,
                f"the section shows no whole grain of {names[phase]}",
                "a larger section, or leave the phase out",
            )
        if found is None:
            continue
        dists[phase, kind] = found
        progress.say(
            f"{names[phase]} {kind}: {(table.weight > 0).sum()} sections, mean radius "
            f"{dists[phase, kind].mean('f2d'):.2f} um in 2D, {dists[phase, kind].mean('f3d'):.2f} um in 3D"
        )
    io.write_table(snakemake.output.sizes, stereology.to_table(dists))
    io.write_arrays(snakemake.output.circles, {"radii": circles})
