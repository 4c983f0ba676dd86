"""Permeability and formation factor along three axes, by every method asked for."""

import pandas as pd
from _stage import stage

from grainfall import flow, io, network, volume

files, settings = snakemake.input, snakemake.params.settings
extraction = settings["network"]

with stage(snakemake) as progress:
    known = pd.concat([pd.DataFrame({"method": []}), *map(io.read_table, files.get("on_voxels", []))])
    with io.open_volume(files.volume, "phase") as (phase, attributes):
        pore, voxel_size_um = volume.read_pore_space(
            phase, attributes["voxel_size_um"], extraction["coarsen"]
        )
    through_network = {}
    if files.get("pores"):
        through_network = {
            "conductance": "pyramids" if extraction["method"] == "snow2" else settings["flow"]["conductance"],
            "network": network.load(files.pores, files.throats),
            "persistence": extraction["persistence"],
            "threads": snakemake.threads,
        }
    tables = []
    for method in snakemake.params.methods:
        table = known[known["method"] == method]
        if table.empty:
            table = flow.permeability(pore, voxel_size_um, method, **through_network, progress=progress)
            values = ", ".join(f"{k:.4g}" for k in table.k_md)
            progress.say(f"K by {method} along x, y, z: {values} mD")
        tables.append(table)
    io.write_table(snakemake.output.flow, pd.concat(tables))
