"""Spheres of one spread of sizes, packed from their true sizes and from what their section tells."""

from functools import partial

import pandas as pd
from _stage import stage

from grainfall import io, random
from grainfall.size_bias import packs

with stage(snakemake) as progress:
    cv, truth = float(snakemake.wildcards.cv), int(snakemake.wildcards.truth)
    stream = partial(
        random.generator,
        snakemake.params.seed,
        f"cv_sweep/{snakemake.wildcards.cv}",
        truth,
    )
    rows = []
    for pack in packs(cv, stream, **snakemake.params.sweep):
        rows.append({"cv": cv, "truth": truth, **pack})
        progress.say("{variant}: mean radius {r_um:.3f}, K {k_md:.4g} mD".format(**pack))
    io.write_table(snakemake.output[0], pd.DataFrame(rows))
