"""One plane of a volume as the section."""

import numpy as np
from _stage import stage

from grainfall import io
from grainfall.errors import InputError
from grainfall.section import Section, write_section

with stage(snakemake) as progress:
    where = snakemake.params.row["slice"]
    phase, attributes = io.read_volume(snakemake.input.volume)
    axis, plane = "zyx".index(where[0]), int(where[1:])
    if plane >= phase.shape[axis]:
        raise InputError(f"slice {where}", f"the volume has {phase.shape[axis]} planes", "a smaller number")
    section = Section(
        np.ascontiguousarray(phase.take(plane, axis)),
        attributes["voxel_size_um"],
        ("pore", "grain"),
        notes={"slice": where},
    )
    write_section(snakemake.output.section, section)
    progress.say(f"porosity {section.porosity:.4f}, that of the volume is {(phase == 0).mean():.4f}")
