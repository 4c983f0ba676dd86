"""Grains: a library of 3D grains, each from three masks of the section."""


# A folder has a date only, and one that was copied looks new. So who reads the library takes it for old, and goes by the
# record, which says what is in it.
rule grain_library:
    input:
        labels=f"{SAMPLE}/labels.zarr.zip",
        grains=f"{SAMPLE}/grains2d.csv",
    output:
        library=directory(f"{SAMPLE}/grains3d"),
        record=f"{SAMPLE}/logs/grain_library.json",
    log:
        f"{SAMPLE}/logs/grain_library.log",
    benchmark:
        f"{SAMPLE}/benchmarks/grain_library.tsv"
    cache: CACHEABLE
    conda:
        ENVS["analysis"]
    resources:
        mem_mb=memory(4000),
        runtime=runtime(60),
    params:
        stream=stream,
        settings=settings(
            "grains", "morphology.pore_persistence", "morphology.min_radius_px"
        ),
        voids=VOID_SHAPES,
        science=science("grains"),
    script:
        "../../scripts/grain_library.py"
