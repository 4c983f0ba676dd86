"""Which effects the scene called for, why, and what each cost."""

from pathlib import Path

import pandas as pd
from _stage import stage

from grainfall import io, packing

with stage(snakemake):
    files = snakemake.input
    cost = {Path(path).stem: float(pd.read_csv(path, sep="\t").s.sum()) for path in files.benchmarks}
    reports = [io.read_json(files[n]) for n in ("scene", "first", "spheres", "second", "correction")]
    io.write_json(snakemake.output.plan, packing.effects_plan(*reports, cost))
