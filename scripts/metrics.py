"""Everything measured on one twin against what was asked for, and its row of the summary."""

from functools import partial

from _stage import stage

from grainfall import correlation, io, network, random, report, volume
from grainfall.section import resample
from grainfall.surface import SolidSurface, core, solid_surface

with (
    stage(snakemake) as progress,
    io.open_volume(snakemake.input.twin, "phase") as (phase, _),
    io.open_volume(snakemake.input.twin, "body") as (body, _),
):
    files, settings = snakemake.input, snakemake.params.settings

    def table(name):
        return io.read_table(str(files[name])) if files.get(name) else None

    def surface(s2):
        return correlation.surface_from_s2(*correlation.along_axes(s2))

    def asked_for():
        """The error in what the config's ``accuracy`` asks for."""
        asked = snakemake.params.asked
        if not asked:
            return {}
        from grainfall import accuracy

        found = accuracy.from_tables(s2_volume, table("flow"), method, twin_network)
        found |= {"porosity": packing["porosity"], "overlap": io.read_json(files.contacts)["max_overlap"]}
        held = {"porosity": scene["porosity_target"]}
        if reference is not None:
            held |= accuracy.from_tables(reference_s2, table("reference_flow"), method, reference)
        return report.accuracy_values(asked, accuracy.differences(found, held))

    scene = io.read_json(files.scene)
    resolution = scene["resolution_um"]
    section, _ = io.read_volume(files.labels, "phase")
    method = settings["flow"]["methods"][0]
    reference = None
    if files.get("reference_pores"):
        reference = network.element_sizes(
            network.load(str(files.reference_pores), str(files.reference_throats))
        )
    twin_network = network.element_sizes(network.load(files.network_pores, files.network_throats))
    bodies = table("bodies")
    costs = report.read_costs(files.benchmarks)
    s2_volume = table("s2_volume")
    reference_s2 = table("reference_s2")
    packing = report.packing_values(
        scene,
        io.read_json(files.deficit),
        io.read_json(files.second),
        io.read_json(files.correction),
        bodies,
        phase,
    )
    values = {
        **packing,
        **report.phase_values(phase, section, body=body, shown=partial(volume.as_minerals, bodies=bodies)),
        **report.surface_values(
            solid_surface(core(resample(phase, scene["voxel_size_um"], resolution)), resolution),
            SolidSurface(**io.read_json(files.section_surface)),
        ),
        **report.sampling_values(section, scene["porosity_source"]),
        **report.section_comparison(
            table("section_grains"),
            table("section_pores"),
            table("grains"),
            table("pores"),
            random.generator(**snakemake.params.stream, chapter="report"),
            twin_bodies=report.bodies_within(bodies, scene),
        ),
        **report.envelope_values(io.read_json(files.envelope_test)),
        "specific_surface_per_um": surface(s2_volume),
        "porosity_ref": None if reference_s2 is None else 1 - float(reference_s2.s2[0]),
        "specific_surface_ref_per_um": None if reference_s2 is None else surface(reference_s2),
        **report.network_values(twin_network, reference),
        "network_coarsen": settings["network"]["coarsen"],
        **report.flow_values(table("flow"), table("reference_flow"), method),
        **{k: v for k, v in io.read_json(files.contacts).items() if k in report.METRICS},
        **report.resettling_values(io.read_json(str(files.resettling)) if files.get("resettling") else None),
        **asked_for(),
        "wall_s": costs.wall_s.sum(),
        "peak_rss_mb": costs.peak_rss_mb.max(),
    }
    metrics = report.metrics_table(values)
    io.write_table(snakemake.output.metrics, metrics)
    origin = snakemake.wildcards
    row = report.summary_row(
        origin.sample,
        origin.variant,
        int(origin.realization),
        settings["packing"]["engine"],
        phase.shape,
        scene["voxel_size_um"],
        metrics,
        method,
    )
    io.write_table(snakemake.output.row, row)
    progress.say(report.verdict(report.judge(metrics)))
