"""Morphology: grain masks, equivalent radii and pore circles of the section."""


rule morphology:
    input:
        section=f"{SAMPLE}/section.zarr.zip",
    output:
        labels=f"{SAMPLE}/labels.zarr.zip",
        grains=f"{SAMPLE}/grains2d.csv",
        pores=f"{SAMPLE}/pores2d.csv",
        summary=f"{SAMPLE}/section.json",
    log:
        f"{SAMPLE}/logs/morphology.log",
    benchmark:
        f"{SAMPLE}/benchmarks/morphology.tsv"
    conda:
        ENVS["analysis"]
    resources:
        mem_mb=memory(4000),
        runtime=runtime(30),
    params:
        settings=settings("morphology", "section.rules"),
        science=science("morphology", "section.read"),
    script:
        "../../scripts/morphology.py"


rule measure_slices:
    input:
        twin=f"{TWIN}/twin.zarr.zip",
        bodies=f"{TWIN}/bodies.csv",
        summary=f"{SAMPLE}/section.json",
        scene=f"{VARIANT}/scene.json",
    output:
        grains=f"{TWIN}/grains2d.csv",
        pores=f"{TWIN}/pores2d.csv",
    log:
        f"{TWIN}/logs/measure_slices.log",
    benchmark:
        f"{TWIN}/benchmarks/measure_slices.tsv"
    conda:
        ENVS["analysis"]
    resources:
        mem_mb=memory(4000),
        runtime=runtime(30),
    params:
        stream=stream,
        settings=settings("morphology", "correlation.slices"),
        science=science("morphology", "section.resample", "volume.cement"),
    script:
        "../../scripts/measure_slices.py"


rule section_as_resolved:
    input:
        section=f"{SAMPLE}/section.zarr.zip",
        labels=f"{SAMPLE}/labels.zarr.zip",
        scene=f"{VARIANT}/scene.json",
    output:
        grains=f"{VARIANT}/section_grains2d.csv",
        pores=f"{VARIANT}/section_pores2d.csv",
        surface=f"{VARIANT}/section_surface.json",
        intergranular=f"{VARIANT}/section_intergranular.json",
    log:
        f"{VARIANT}/logs/section_as_resolved.log",
    benchmark:
        f"{VARIANT}/benchmarks/section_as_resolved.tsv"
    conda:
        ENVS["analysis"]
    resources:
        mem_mb=memory(4000),
        runtime=runtime(30),
    params:
        settings=settings("morphology"),
        science=science("morphology", "section.read", "section.resample", "surface"),
    script:
        "../../scripts/section_as_resolved.py"
