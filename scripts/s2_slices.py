"""Gather the scattered slices into one table."""

import pandas as pd
from _stage import stage

from grainfall import io

with stage(snakemake):
    chunks = [chunk for chunk in map(io.read_table, snakemake.input) if not chunk.empty]
    table = pd.concat(chunks).sort_values(["slice", "lag_um"], kind="stable")
    io.write_table(snakemake.output.s2, table)
