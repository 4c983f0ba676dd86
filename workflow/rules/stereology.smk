"""Stereology: Wicksell inversion of every size distribution of the section."""


rule unfold_sizes:
    input:
        grains=f"{SAMPLE}/grains2d.csv",
        pores=f"{SAMPLE}/pores2d.csv",
        summary=f"{SAMPLE}/section.json",
    output:
        sizes=f"{SAMPLE}/sizes.csv",
    params:
        stream=stream,
        settings=settings("stereology"),
        science=science("stereology"),
    log:
        f"{SAMPLE}/logs/unfold_sizes.log",
    benchmark:
        f"{SAMPLE}/benchmarks/unfold_sizes.tsv"
    resources:
        mem_mb=2000,
        runtime=30,
    conda:
        ENVS["analysis"]
    script:
        "../../scripts/unfold_sizes.py"
