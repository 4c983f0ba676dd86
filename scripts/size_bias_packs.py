"""Spheres packed from what a section tells of their sizes, with the inversion and without."""

from functools import partial

import pandas as pd
from _stage import stage

from grainfall import io, random, size_bias, stereology

with stage(snakemake) as progress:
    sizes = stereology.from_table(io.read_table(snakemake.input.sizes))[1, "grain"]
    stream = partial(random.generator, **snakemake.params.stream)
    rows = []
    for variant, which in (("full", "f3d"), ("no_inversion", "f2d")):
        pack = size_bias.pack(sizes, which, stream, **snakemake.params.pack)
        found = size_bias.measured(pack, pack.phase)
        rows.append({"variant": variant, "realization": int(snakemake.wildcards.realization), **found})
        progress.say("{variant}: mean radius {r_um:.3f}, K {k_md:.4g} mD".format(variant=variant, **found))
    io.write_table(snakemake.output[0], pd.DataFrame(rows))
