"""Spheres of one spread of sizes: the truth, and packs of the sizes that its section tells with and without
the inversion, all of one porosity."""

import numpy as np
import pandas as pd
from _stage import stage
from scipy import stats

from grainfall import flow, io, morphology, random, stereology
from grainfall.section import Mineral, synthesise

with stage(snakemake) as progress:
    sweep, origin = snakemake.params.sweep, snakemake.wildcards
    cv, radius, edge = float(origin.cv), sweep["voxels_per_radius"], sweep["edge"]
    where = {
        "seed": snakemake.params.seed,
        "sample": f"cv_sweep/{origin.cv}",
        "realization": int(origin.truth),
    }

    def room(radii):
        return max(edge, int(np.ceil(4.2 * radii.max())))  # two of the largest spheres fit beside each other

    def glass(radii):
        return Mineral("glass", 1.0, radii.mean(), 0.0, 0.0, radii)

    def spheres(chapter, shape, mineral):
        return synthesise(
            random.generator(**where, chapter=chapter),
            shape,
            1.0,
            [mineral],
            exponent=2,
            packed_porosity=sweep["porosity"],
        )

    # quantiles of a gamma distribution: the tail of a lognormal one would not fit into the box
    quantiles = stats.gamma.ppf((np.arange(1000) + 0.5) / 1000, 1 / cv**2, scale=radius * cv**2)
    truth = spheres("section/synthetic", (room(quantiles), *sweep["section"]), glass(quantiles))
    phase, grain = truth.section(0.5)
    seen = morphology.analyse(phase, 0.5, instances=grain).grains
    sizes = stereology.unfold_table(seen, method="adaptive", bootstrap=0)
    rows = []
    for name, which in (("truth", None), ("full", "f3d"), ("no_inversion", "f2d")):
        if which is None:
            pack = truth
        else:
            # one stream of numbers for both: the comparison is paired
            drawn = stereology.draw_radii(sizes, 20_000, random.generator(**where, chapter="sizes"), which)
            box = max(
                edge, int(np.ceil(4.2 * drawn.max()))
            )  # an unfolded tail may be longer than the truth's
            pack = spheres("packing", (box,) * 3, glass(np.sort(drawn)))
        # of a pack all of its periodic box, which has the porosity to a voxel
        cube, r = pack.cube(edge) if pack is truth else pack.phase, pack.sizes().r_um
        along = flow.permeability(cube == 0, 1.0, "network").k_md
        rows.append(
            {
                "cv": cv,
                "truth": int(origin.truth),
                "variant": name,
                "sections": int((seen.weight > 0).sum()),
                "porosity": (cube == 0).mean(),
                "r_um": r.mean(),
                "r_sauter_um": (r**3).sum() / (r**2).sum(),
                "k_md": along.mean(),
            }
        )
        progress.say("{variant}: mean radius {r_um:.3f}, K {k_md:.4g} mD".format(**rows[-1]))
    io.write_table(snakemake.output[0], pd.DataFrame(rows))
