"""Permeability and formation factor along three axes, by every method asked for."""

import pandas as pd
from _stage import stage

from grainfall import flow, io, network, volume

files, settings = snakemake.input, snakemake.params.settings
extraction = settings["network"]

with stage(snakemake) as progress:
    tables = {table["method"].iloc[0]: table for table in map(io.read_table, files.get("on_voxels", []))}
    left = [method for method in snakemake.params.methods if method not in tables]
    through_network = {}
    if left and files.get("pores"):
        through_network = {
            "conductance": "pyramids" if extraction["method"] == "snow2" else settings["flow"]["conductance"],
            "network": network.load(files.pores, files.throats),
            "persistence": extraction["persistence"],
            "threads": snakemake.threads,
        }
    if left:
        with io.open_volume(files.volume, "phase") as (phase, attributes):
            pore, voxel_size_um = volume.read_pore_space(
                phase, attributes["voxel_size_um"], extraction["coarsen"]
            )
    for method in left:
        tables[method] = flow.permeability(pore, voxel_size_um, method, **through_network, progress=progress)
        values = ", ".join(f"{k:.4g}" for k in tables[method].k_md)
        progress.say(f"K by {method} along x, y, z: {values} mD")
    io.write_table(snakemake.output.flow, pd.concat([tables[m] for m in snakemake.params.methods]))
