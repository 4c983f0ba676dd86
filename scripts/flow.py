"""Permeability and formation factor along three axes, by every method asked for."""

import pandas as pd
from _stage import stage

from grainfall import flow, io, network, volume

settings = snakemake.params.settings
extraction, conductance = settings["network"], settings["flow"]["conductance"]

with stage(snakemake) as progress:
    with io.open_volume(snakemake.input.volume, "phase") as (phase, attributes):
        pore, voxel_size_um = volume.read_pore_space(
            phase, attributes["voxel_size_um"], extraction["coarsen"]
        )
    found = network.load(snakemake.input.pores, snakemake.input.throats)
    tables = [
        flow.permeability(
            pore,
            voxel_size_um,
            method,
            conductance="pyramids" if extraction["method"] == "snow2" else conductance,
            network=found,
            persistence=extraction["persistence"],
            threads=snakemake.threads,
            progress=progress,
        )
        for method in settings["flow"]["methods"]
    ]
    io.write_table(snakemake.output.flow, pd.concat(tables))
    for table in tables:
        values = ", ".join(f"{k:.4g}" for k in table.k_md)
        progress.say(f"K by {table.method.iloc[0]} along x, y, z: {values} mD")
