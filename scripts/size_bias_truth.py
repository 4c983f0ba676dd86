"""Spheres of one spread of sizes: what their section tells of it, and the permeability of cubes of them."""

from functools import partial

import pandas as pd
from _stage import stage

from grainfall import io, random, size_bias, stereology

with stage(snakemake) as progress:
    cv, sweep = float(snakemake.wildcards.cv), snakemake.params.sweep
    truth = size_bias.rock(cv, partial(random.generator, **snakemake.params.stream), **sweep)
    sizes, sections = size_bias.seen(truth)
    progress.say(f"{sections} whole grains on the section, mean radius {sizes.mean():.3f} voxels by them")
    rows = []
    for n, cube in enumerate(truth.cubes(sweep["edge"], snakemake.params.cubes)):
        found = size_bias.measured(truth, cube)
        rows.append({"variant": "truth", "realization": n, "sections": sections, **found})
        progress.say("cube {n} of it: mean radius {r_um:.3f}, K {k_md:.4g} mD".format(n=n, **found))
    io.write_table(snakemake.output.truth, pd.DataFrame(rows))
    io.write_table(snakemake.output.sizes, stereology.to_table({(1, "grain"): sizes}))
