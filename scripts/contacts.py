"""Grain contacts of the twin, its coordination and its largest overlap."""

import numpy as np
from _stage import stage

from grainfall import contacts, grains, io, packing

with stage(snakemake) as progress, io.open_volume(snakemake.input.twin, "body") as (volume, attributes):
    library = grains.Library.load(snakemake.input.library)
    bodies = io.read_table(snakemake.input.bodies)
    voxel = attributes["voxel_size_um"]
    size = tuple(np.array(volume.shape[::-1]) * voxel)
    settings = snakemake.params.settings
    parameters = packing.parameters_of(settings["packing"], settings["effects"])
    packed, forces = io.read_table(snakemake.input.packed), io.read_table(snakemake.input.forces)
    table = contacts.find_contacts(
        bodies,
        library,
        volume,
        voxel,
        settings["contacts"]["tolerance"],
        parameters=parameters,
        packed=packed,
        forces=forces,
    )
    by_phase = contacts.coordination(table, bodies, size)
    summary = {
        "max_overlap": contacts.max_overlap(bodies, library, size, parameters),
        **by_phase.iloc[0].drop("phase").to_dict(),
        **contacts.lost_support(forces, packed, size),
        "by_phase": by_phase.iloc[1:].to_dict("records"),
    }
    io.write_table(snakemake.output.contacts, table)
    io.write_json(snakemake.output.summary, summary)
    progress.say("coordination {coordination:.2f}, largest overlap {max_overlap:.4f}".format(**summary))
