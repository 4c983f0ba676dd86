"""Morphology: grain masks, equivalent radii and pore circles of the section."""


rule morphology:
    input:
        section=f"{SAMPLE}/section.zarr.zip",
    output:
        labels=f"{SAMPLE}/labels.zarr.zip",
        grains=f"{SAMPLE}/grains2d.csv",
        pores=f"{SAMPLE}/pores2d.csv",
        summary=f"{SAMPLE}/section.json",
    params:
        settings=settings("morphology", "section"),
        science=science("morphology"),
    log:
        f"{SAMPLE}/logs/morphology.log",
    benchmark:
        f"{SAMPLE}/benchmarks/morphology.tsv"
    resources:
        mem_mb=4000,
        runtime=30,
    conda:
        ENVS["analysis"]
    script:
        "../../scripts/morphology.py"


rule measure_slices:
    input:
        twin=f"{TWIN}/twin.zarr.zip",
        section=f"{SAMPLE}/section.zarr.zip",
    output:
        grains=f"{TWIN}/grains2d.csv",
        pores=f"{TWIN}/pores2d.csv",
    params:
        stream=stream,
        settings=settings("morphology", "correlation"),
        science=science("morphology"),
    log:
        f"{TWIN}/logs/measure_slices.log",
    benchmark:
        f"{TWIN}/benchmarks/measure_slices.tsv"
    resources:
        mem_mb=4000,
        runtime=30,
    conda:
        ENVS["analysis"]
    script:
        "../../scripts/measure_slices.py"
