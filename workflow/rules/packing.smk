"""Packing: the scene, the first gravity packing, what it lacks, and the second that makes up for it."""


rule scene:
    input:
        sizes=f"{SAMPLE}/sizes.csv",
        summary=f"{SAMPLE}/section.json",
    output:
        scene=f"{VARIANT}/scene.json",
    log:
        f"{VARIANT}/logs/scene.log",
    benchmark:
        f"{VARIANT}/benchmarks/scene.tsv"
    conda:
        ENVS["analysis"]
    resources:
        mem_mb=memory(1000),
        runtime=runtime(1),
    params:
        row=row("porosity"),
        settings=settings("scene", "effects.phase_mixing"),
        science=science("packing"),
    script:
        "../../scripts/scene.py"


rule first_packing:
    input:
        scene=f"{VARIANT}/scene.json",
        sizes=f"{SAMPLE}/sizes.csv",
        library=ancient(f"{SAMPLE}/grains3d"),
        library_record=f"{SAMPLE}/logs/grain_library.json",
    output:
        bodies=f"{TWIN}/first/bodies.csv",
        forces=f"{TWIN}/first/forces.csv",
        packing=f"{TWIN}/first/packing.json",
        record=f"{TWIN}/logs/first_packing.json",
    log:
        f"{TWIN}/logs/first_packing.log",
    benchmark:
        f"{TWIN}/benchmarks/first_packing.tsv"
    cache: CACHEABLE
    conda:
        ENVS["packing"]
    resources:
        mem_mb=memory(3000),
        runtime=runtime(240),
    params:
        stream=stream,
        settings=settings("packing", "effects.decomposition", "effects.refinement"),
        science=science("packing"),
    script:
        "../../scripts/first_packing.py"


rule deficit:
    input:
        scene=f"{VARIANT}/scene.json",
        library=ancient(f"{SAMPLE}/grains3d"),
        library_record=f"{SAMPLE}/logs/grain_library.json",
        circles=f"{SAMPLE}/void_circles.npz",
        section_pores=f"{VARIANT}/section_pores2d.csv",
        section_surface=f"{VARIANT}/section_surface.json",
        section_intergranular=f"{VARIANT}/section_intergranular.json",
        # the bodies decide: their volume made again otherwise, as in slabs, packs nothing anew
        bodies=f"{TWIN}/first/bodies.csv",
        volume=ancient(f"{TWIN}/first/volume.zarr.zip"),
    output:
        sizes=f"{TWIN}/virtual_spheres.csv",
        deficit=f"{TWIN}/deficit.json",
        pores=f"{TWIN}/first/pores2d.csv",
    log:
        f"{TWIN}/logs/deficit.log",
    benchmark:
        f"{TWIN}/benchmarks/deficit.tsv"
    conda:
        ENVS["analysis"]
    resources:
        mem_mb=memory(3000),
        runtime=runtime(30),
    params:
        stream=stream,
        settings=settings(
            "effects.virtual_spheres",
            "effects.void_shapes",
            "effects.cement",
            "feedback.limit",
            "morphology",
            "stereology.method",
            "correlation.slices",
        ),
        science=science(
            "packing", "morphology", "section.resample", "stereology", "volume"
        ),
    script:
        "../../scripts/deficit.py"


rule second_packing:
    input:
        scene=f"{VARIANT}/scene.json",
        sizes=f"{SAMPLE}/sizes.csv",
        library=ancient(f"{SAMPLE}/grains3d"),
        library_record=f"{SAMPLE}/logs/grain_library.json",
        first=f"{TWIN}/first/bodies.csv",
        first_report=f"{TWIN}/first/packing.json",
        first_forces=f"{TWIN}/first/forces.csv",
        spheres=f"{TWIN}/virtual_spheres.csv",
        deficit=f"{TWIN}/deficit.json",
    output:
        bodies=f"{TWIN}/second/bodies.csv",
        forces=f"{TWIN}/second/forces.csv",
        packing=f"{TWIN}/second/packing.json",
        record=f"{TWIN}/logs/second_packing.json",
    log:
        f"{TWIN}/logs/second_packing.log",
    benchmark:
        f"{TWIN}/benchmarks/second_packing.tsv"
    cache: CACHEABLE
    conda:
        ENVS["packing"]
    resources:
        mem_mb=memory(4000),
        runtime=runtime(480),
    params:
        stream=stream,
        settings=settings(
            "packing",
            "effects.decomposition",
            "effects.densification",
            "effects.placement",
            "feedback",
        ),
        science=science("packing", "volume"),
    script:
        "../../scripts/second_packing.py"
