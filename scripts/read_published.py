"""A published volume, read."""

from _stage import stage

from grainfall import io
from grainfall.section import published_file, read_known_volume

with stage(snakemake) as progress:
    known, folder = snakemake.params.known, snakemake.input.published
    volume, voxel_size_um = read_known_volume(
        published_file(folder) or folder, known["voxel_size_um"], known["files"]
    )
    io.write_volume(
        snakemake.output.reference, {"phase": volume}, voxel_size_um, {"phases": ["pore", "solid"]}
    )
    progress.say(f"{volume.shape} voxels, porosity {(volume == 0).mean():.6f}")
