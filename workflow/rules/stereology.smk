"""Stereology: Wicksell inversion of every size distribution of the section."""


rule unfold_sizes:
    input:
        grains=f"{SAMPLE}/grains2d.csv",
        pores=f"{SAMPLE}/pores2d.csv",
        summary=f"{SAMPLE}/section.json",
        library=ancient(f"{SAMPLE}/grains3d"),
        library_record=f"{SAMPLE}/logs/grain_library.json",
    output:
        sizes=f"{SAMPLE}/sizes.csv",
        circles=f"{SAMPLE}/void_circles.npz",
    log:
        f"{SAMPLE}/logs/unfold_sizes.log",
    benchmark:
        f"{SAMPLE}/benchmarks/unfold_sizes.tsv"
    conda:
        ENVS["analysis"]
    resources:
        mem_mb=memory(2000),
        runtime=runtime(30),
    params:
        stream=stream,
        settings=settings(
            "stereology", "morphology.pore_persistence", "morphology.min_radius_px"
        ),
        science=science("stereology", "grains", "volume.voids"),
    script:
        "../../scripts/unfold_sizes.py"
