"""A simulated X-ray tomogram of the reference, segmented."""

import numpy as np
from _stage import stage

from grainfall import io, random
from grainfall.section import simulate_tomogram

with stage(snakemake) as progress:
    phase, attributes = io.read_volume(snakemake.input.rock)
    scan = simulate_tomogram(
        phase > 0,
        attributes["voxel_size_um"],
        random.generator(**snakemake.params.stream, chapter="section/tomogram"),
        **snakemake.params.settings["tomogram"],
    )
    io.write_volume(
        snakemake.output.tomogram,
        {"phase": scan.solid.astype(np.uint8)},
        scan.voxel_size_um,
        {"phases": ["pore", "solid"]},
    )
    io.write_volume(snakemake.output.grey, {"grey": scan.grey.astype(np.float16)}, scan.voxel_size_um)
    porosity = 1 - scan.solid.mean()
    io.write_json(snakemake.output.report, {"porosity": porosity, "phantom": scan.phantom})
    progress.say(
        f"porosity {porosity:.4f}, of the rock {(phase == 0).mean():.4f}; phantom {scan.phantom:.4f}"
    )
