"""All twins in one table."""

import pandas as pd
from _stage import stage

from grainfall import io

with stage(snakemake):
    io.write_table(snakemake.output[0], pd.concat([io.read_table(path) for path in snakemake.input]))
