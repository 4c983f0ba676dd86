"""Packing: the scene, two gravity packings with temporary virtual spheres between them."""


rule scene:
    input:
        sizes=f"{SAMPLE}/sizes.csv",
        summary=f"{SAMPLE}/section.json",
        section=f"{SAMPLE}/section.zarr.zip",
    output:
        scene=f"{VARIANT}/scene.json",
    params:
        row=sample_row,
        settings=settings("scene", "packing"),
        science=science("packing"),
    log:
        f"{VARIANT}/logs/scene.log",
    benchmark:
        f"{VARIANT}/benchmarks/scene.tsv"
    resources:
        mem_mb=1000,
        runtime=5,
    conda:
        ENVS["analysis"]
    script:
        "../../scripts/scene.py"


rule first_packing:
    input:
        scene=f"{VARIANT}/scene.json",
        sizes=f"{SAMPLE}/sizes.csv",
        library=f"{SAMPLE}/grains3d",
    output:
        bodies=f"{TWIN}/first/bodies.csv",
        packing=f"{TWIN}/first/packing.json",
    params:
        stream=stream,
        settings=settings("scene", "packing"),
        science=science("packing"),
    log:
        f"{TWIN}/logs/first_packing.log",
    benchmark:
        f"{TWIN}/benchmarks/first_packing.tsv"
    resources:
        mem_mb=3000,
        runtime=240,
    cache: "omit-software"
    conda:
        ENVS["packing"]
    script:
        "../../scripts/first_packing.py"


rule virtual_spheres:
    input:
        scene=f"{VARIANT}/scene.json",
        sizes=f"{SAMPLE}/sizes.csv",
        volume=f"{TWIN}/first/volume.zarr.zip",
    output:
        sizes=f"{TWIN}/virtual_spheres.csv",
        plan=f"{TWIN}/virtual_spheres.json",
        pores=f"{TWIN}/first/pores2d.csv",
    params:
        stream=stream,
        settings=settings(
            "scene", "virtual_spheres", "correction", "morphology", "stereology", "correlation"
        ),
        science=science("packing", "morphology", "stereology"),
    log:
        f"{TWIN}/logs/virtual_spheres.log",
    benchmark:
        f"{TWIN}/benchmarks/virtual_spheres.tsv"
    resources:
        mem_mb=3000,
        runtime=30,
    conda:
        ENVS["analysis"]
    script:
        "../../scripts/virtual_spheres.py"


rule second_packing:
    input:
        scene=f"{VARIANT}/scene.json",
        sizes=f"{SAMPLE}/sizes.csv",
        library=f"{SAMPLE}/grains3d",
        first=f"{TWIN}/first/bodies.csv",
        spheres=f"{TWIN}/virtual_spheres.csv",
        plan=f"{TWIN}/virtual_spheres.json",
    output:
        bodies=f"{TWIN}/second/bodies.csv",
        packing=f"{TWIN}/second/packing.json",
    params:
        stream=stream,
        settings=settings("scene", "packing", "virtual_spheres", "correction"),
        science=science("packing", "volume"),
    log:
        f"{TWIN}/logs/second_packing.log",
    benchmark:
        f"{TWIN}/benchmarks/second_packing.tsv"
    resources:
        mem_mb=4000,
        runtime=480,
    cache: "omit-software"
    conda:
        ENVS["packing"]
    script:
        "../../scripts/second_packing.py"
