"""What accuracy is judged by, of one volume: porosity, S2, pores and K; of a packing, its contacts too."""

from _stage import stage

from grainfall import accuracy, contacts, grains, io, packing
from grainfall.volume import voxelise

with stage(snakemake) as progress:
    files = snakemake.input
    if files.get("volume"):  # a twin, or cubes of the truth
        seen = []
        for path in [files.volume, *files.get("cubes", [])]:
            phase, attributes = io.read_volume(path, "phase")
            seen.append(accuracy.observe(phase == 0, attributes["voxel_size_um"]))
        found = accuracy.pooled(seen)
        if files.get("contacts"):
            summary = io.read_json(files.contacts)
            found |= {"coordination": summary["coordination"], "overlap": summary["max_overlap"]}
    else:  # grains as they were poured
        scene, library = io.read_json(files.scene), grains.Library.load(files.library)
        bodies, forces = io.read_table(files.bodies), io.read_table(files.forces)
        settings = snakemake.params.settings
        parameters = packing.parameters_of(settings["packing"], settings["effects"])
        size = (scene["edge_um"],) * 3
        phase, _ = voxelise(bodies, library, scene["shape_zyx"], scene["voxel_size_um"])
        found = accuracy.observe(phase == 0, scene["voxel_size_um"])
        table = contacts.find_contacts(
            bodies,
            library,
            None,
            scene["voxel_size_um"],
            settings["contacts"]["tolerance"],
            parameters=parameters,
            forces=forces,
        )
        found |= {
            "coordination": contacts.coordination(table, bodies, size).iloc[0]["coordination"],
            "overlap": contacts.max_overlap(bodies, library, size, parameters),
        }
    io.write_json(snakemake.output.observed, found)
    progress.say("porosity {porosity:.4f}, K {k_md:.4g} mD".format(**found))
