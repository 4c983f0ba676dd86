"""Report: every twin's metrics, the summary over all twins, figures and the page that judges them."""

TWIN_JOBS = [
    "first_packing",
    "first_volume",
    "deficit",
    "second_packing",
    "twin",
    "measure_slices",
    "s2_slices",
    *gather.grainfall_slices("s2_slices_{scatteritem}"),
    "s2_volume",
    "network",
    "flow",
    "contacts",
]
if SLABS > 1:
    TWIN_JOBS += [
        "twin_joined",
        *gather.grainfall_slabs("first_volume_{scatteritem}"),
        *gather.grainfall_slabs("twin_{scatteritem}"),
        *gather.grainfall_slabs("s2_volume_{scatteritem}"),
    ]
NETWORK_JOBS = [
    "network_pores",
    "network_throats",
    *gather.grainfall_slabs("network_columns_{scatteritem}"),
    *gather.grainfall_slabs("network_distances_{scatteritem}"),
    *gather.grainfall_slabs("network_basins_{scatteritem}"),
    *gather.grainfall_slabs("network_parts_{scatteritem}"),
    *gather.grainfall_slabs("network_measures_{scatteritem}"),
]
FIGURES = [
    "twin",
    "s2",
    "sizes",
    "network",
    "section",
    "gallery",
    "packings",
    "virtual",
    "forces",
]


rule plan:
    input:
        summary=f"{SAMPLE}/section.json",
        scene=f"{VARIANT}/scene.json",
        first=f"{TWIN}/first/packing.json",
        deficit=f"{TWIN}/deficit.json",
        second=f"{TWIN}/second/packing.json",
        correction=f"{TWIN}/correction.json",
        cement=f"{TWIN}/cement.json",
    output:
        plan=f"{TWIN}/plan.json",
    log:
        f"{TWIN}/logs/plan.log",
    benchmark:
        f"{TWIN}/benchmarks/plan.tsv"
    conda:
        ENVS["report"]
    resources:
        mem_mb=memory(1000),
        runtime=runtime(1),
    params:
        asked=ASKED,
        settings=settings("stereology.method", "stereology.particles"),
        science=science("packing", "stereology"),
    script:
        "../../scripts/plan.py"


rule metrics:
    input:
        scene=f"{VARIANT}/scene.json",
        labels=f"{SAMPLE}/labels.zarr.zip",
        section_grains=f"{VARIANT}/section_grains2d.csv",
        section_pores=f"{VARIANT}/section_pores2d.csv",
        section_surface=f"{VARIANT}/section_surface.json",
        second=f"{TWIN}/second/packing.json",
        deficit=f"{TWIN}/deficit.json",
        correction=f"{TWIN}/correction.json",
        twin=f"{TWIN}/twin.zarr.zip",
        bodies=f"{TWIN}/bodies.csv",
        grains=f"{TWIN}/grains2d.csv",
        pores=f"{TWIN}/pores2d.csv",
        s2_volume=f"{TWIN}/s2_volume.csv",
        envelope_test=f"{VARIANT}/s2_envelope.json",
        network_pores=f"{TWIN}/network_pores.csv",
        network_throats=f"{TWIN}/network_throats.csv",
        flow=f"{TWIN}/flow.csv",
        contacts=f"{TWIN}/contacts.json",
        resettling=where_checked("resettling.json"),
        reference_flow=where_measured_alike("reference_flow.csv"),
        reference_s2=where_referenced("reference_s2.csv"),
        reference_pores=where_measured_alike("reference_network_pores.csv"),
        reference_throats=where_measured_alike("reference_network_throats.csv"),
        benchmarks=timed_jobs_of_twin,
    output:
        metrics=f"{TWIN}/metrics.csv",
        row=f"{TWIN}/summary_row.csv",
    log:
        f"{TWIN}/logs/metrics.log",
    benchmark:
        f"{TWIN}/benchmarks/metrics.tsv"
    conda:
        ENVS["analysis"]
    resources:
        mem_mb=memory(2000),
        runtime=runtime(2),
    params:
        stream=stream,
        settings=settings("packing.engine", "flow.methods", "network.coarsen"),
        asked=ASKED,
        science=science(
            "report.metrics",
            "report.ensembles",
            "accuracy.observe",
            "correlation",
            "network",
            "surface",
            "volume.cement",
        ),
    script:
        "../../scripts/metrics.py"


rule summary:
    input:
        twins("summary_row.csv"),
    output:
        report(
            "results/summary.csv",
            category="Summary",
            caption="../report/summary.rst",
            labels={"table": "one row per twin"},
        ),
    log:
        "results/logs/summary.log",
    benchmark:
        "results/benchmarks/rules/summary.tsv"
    conda:
        ENVS["report"]
    resources:
        mem_mb=1000,
        runtime=5,
    params:
        order=[list(SAMPLES), list(VARIANTS)],  # inputs alone are a set to Snakemake
    script:
        "../../scripts/summary.py"


rule sweep_table:
    input:
        summary="results/summary.csv",
    output:
        report(
            "results/sweep.csv",
            category="Summary",
            caption="../report/sweep.rst",
            labels={"table": "parameters and what came of them"},
        ),
    log:
        "results/logs/sweep_table.log",
    benchmark:
        "results/benchmarks/rules/sweep_table.tsv"
    conda:
        ENVS["report"]
    resources:
        mem_mb=1000,
        runtime=5,
    params:
        parameters=sheet.parameters(CONFIG),
        science=science("report.ensembles"),
    script:
        "../../scripts/sweep_table.py"


rule twin_provenance:
    input:
        metrics=f"{TWIN}/metrics.csv",
        plan=f"{TWIN}/plan.json",
    output:
        provenance=f"{TWIN}/provenance.json",
    log:
        f"{TWIN}/logs/twin_provenance.log",
    conda:
        ENVS["analysis"]
    resources:
        mem_mb=1000,
        runtime=1,
    params:
        seed=CONFIG["seed"],
        row=whole_row,
        settings=whole_settings,
    script:
        "../../scripts/twin_provenance.py"


rule provenance:
    input:
        twins("provenance.json"),
        summary="results/summary.csv",
        page="results/report.html",
    output:
        provenance="results/provenance.json",
    log:
        "results/logs/provenance.log",
    conda:
        ENVS["analysis"]
    resources:
        mem_mb=1000,
        runtime=5,
    params:
        files=CONFIG_FILES,
        overrides=OVERRIDES,
        config=CONFIG,
        samples=SAMPLES,
    script:
        "../../scripts/provenance.py"


rule figure:
    input:
        shown=shown,
        library=ancient(f"{SAMPLE}/grains3d"),
        library_record=f"{SAMPLE}/logs/grain_library.json",
        second=f"{TWIN}/second/volume.zarr.zip",
        reference_s2=where_referenced("reference_s2.csv"),
    output:
        svg=report(
            f"{TWIN}/figures/{{figure}}.svg",
            category="{sample}",
            subcategory="{variant} {realization}",
            caption="../report/figure.rst",
            labels={"figure": "{figure}"},
        ),
        png=f"{TWIN}/figures/{{figure}}.png",
    log:
        f"{TWIN}/logs/figure_{{figure}}.log",
    benchmark:
        f"{TWIN}/benchmarks/figure_{{figure}}.tsv"
    wildcard_constraints:
        figure="|".join(FIGURES),
    conda:
        ENVS["report"]
    resources:
        mem_mb=memory(3000),
        runtime=runtime(3),
    params:
        caption=figure_caption,
        science=science("report"),
    script:
        "../../scripts/figure.py"


rule ensembles_figure:
    input:
        summary="results/summary.csv",
    output:
        svg=report(
            f"{SAMPLE}/figures/{{figure}}.svg",
            category="{sample}",
            caption="../report/figure.rst",
            labels={"figure": "{figure}"},
        ),
        png=f"{SAMPLE}/figures/{{figure}}.png",
    log:
        f"{SAMPLE}/logs/figure_{{figure}}.log",
    benchmark:
        f"{SAMPLE}/benchmarks/figure_{{figure}}.tsv"
    wildcard_constraints:
        figure="ensembles",
    conda:
        ENVS["report"]
    resources:
        mem_mb=3000,
        runtime=10,
    params:
        caption=figure_caption,
        science=science("report"),
    script:
        "../../scripts/figure.py"


rule report_page:
    input:
        summary="results/summary.csv",
        shown=shown,
        second=twins("second/volume.zarr.zip"),
        figures=figures_shown(),
        reference_s2=where_referenced("reference_s2.csv"),
    output:
        report(
            "results/report.html",
            category="Summary",
            caption="../report/page.rst",
            labels={"table": "the whole report"},
        ),
    log:
        "results/logs/report_page.log",
    benchmark:
        "results/benchmarks/rules/report_page.tsv"
    conda:
        ENVS["report"]
    resources:
        mem_mb=4000,
        runtime=20,
    params:
        title=CONFIG["title"],
        samples=list(SAMPLES),
        variants=list(VARIANTS),
        realizations=list(REALIZATIONS),
        science=science("report"),
    script:
        "../../scripts/report_page.py"
