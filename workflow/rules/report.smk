"""Report: every twin's metrics, the summary over all twins, figures and the page that judges them."""

BENCHMARKED = {
    "twin": [
        "first_packing",
        "first_volume",
        "virtual_spheres",
        "second_packing",
        "second_volume",
        "twin",
    ]
    + ["measure_slices", "s2_slices", "s2_volume", "network", "flow", "contacts"],
}


rule plan:
    input:
        scene=f"{VARIANT}/scene.json",
        first=f"{TWIN}/first/packing.json",
        spheres=f"{TWIN}/virtual_spheres.json",
        second=f"{TWIN}/second/packing.json",
        correction=f"{TWIN}/correction.json",
        benchmarks=expand(
            f"{TWIN}/benchmarks/{{rule}}.tsv",
            rule=["first_packing", "virtual_spheres", "second_packing", "twin"],
            allow_missing=True,
        ),
    output:
        plan=f"{TWIN}/plan.json",
    log:
        f"{TWIN}/logs/plan.log",
    benchmark:
        f"{TWIN}/benchmarks/plan.tsv"
    conda:
        ENVS["report"]
    resources:
        mem_mb=1000,
        runtime=5,
    params:
        settings=settings("packing", "virtual_spheres", "correction"),
        science=science("report"),
    script:
        "../../scripts/plan.py"


rule metrics:
    input:
        scene=f"{VARIANT}/scene.json",
        section=f"{SAMPLE}/section.zarr.zip",
        section_grains=f"{VARIANT}/section_grains2d.csv",
        section_pores=f"{VARIANT}/section_pores2d.csv",
        first=f"{TWIN}/first/volume.zarr.zip",
        second=f"{TWIN}/second/packing.json",
        spheres=f"{TWIN}/virtual_spheres.json",
        correction=f"{TWIN}/correction.json",
        twin=f"{TWIN}/twin.zarr.zip",
        bodies=f"{TWIN}/bodies.csv",
        second_bodies=f"{TWIN}/second/bodies.csv",
        grains=f"{TWIN}/grains2d.csv",
        pores=f"{TWIN}/pores2d.csv",
        s2_slices=f"{TWIN}/s2_slices.csv",
        s2_volume=f"{TWIN}/s2_volume.csv",
        envelope=f"{VARIANT}/s2_envelope.csv",
        envelope_test=f"{VARIANT}/s2_envelope.json",
        network_pores=f"{TWIN}/network_pores.csv",
        network_throats=f"{TWIN}/network_throats.csv",
        flow=f"{TWIN}/flow.csv",
        contacts=f"{TWIN}/contacts.json",
        plan=f"{TWIN}/plan.json",
        reference_flow=where_referenced("reference_flow.csv"),
        reference_pores=where_referenced("reference_network_pores.csv"),
        reference_throats=where_referenced("reference_network_throats.csv"),
        benchmarks=expand(
            f"{TWIN}/benchmarks/{{rule}}.tsv",
            rule=BENCHMARKED["twin"],
            allow_missing=True,
        ),
    output:
        metrics=f"{TWIN}/metrics.csv",
        summary=temp(f"{TWIN}/summary.csv"),
    log:
        f"{TWIN}/logs/metrics.log",
    benchmark:
        f"{TWIN}/benchmarks/metrics.tsv"
    conda:
        ENVS["analysis"]
    resources:
        mem_mb=2000,
        runtime=10,
    params:
        stream=stream,
        settings=settings("packing", "flow", "correlation"),
        science=science("report"),
    script:
        "../../scripts/metrics.py"


rule summary:
    input:
        twins("summary.csv"),
    output:
        report(
            "results/summary.csv",
            category="Summary",
            caption="../report/summary.rst",
            labels={"table": "one row a twin"},
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
    script:
        "../../scripts/summary.py"
