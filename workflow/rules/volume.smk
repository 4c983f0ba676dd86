"""Volume: bodies to voxels, spheres removed, the last of the porosity, cement; exports for other tools."""


rule packed_volume:
    input:
        scene=f"{VARIANT}/scene.json",
        library=ancient(f"{SAMPLE}/grains3d"),
        library_record=f"{SAMPLE}/logs/grain_library.json",
        bodies=f"{TWIN}/{{packing}}/bodies.csv",
    output:
        volume=f"{TWIN}/{{packing}}/volume.zarr.zip",
    log:
        f"{TWIN}/logs/{{packing}}_volume.log",
    benchmark:
        f"{TWIN}/benchmarks/{{packing}}_volume.tsv"
    conda:
        ENVS["analysis"]
    resources:
        mem_mb=memory(4000),
        runtime=runtime(30),
    params:
        stream=stream,
        science=science("volume"),
    script:
        "../../scripts/packed_volume.py"


rule twin:
    input:
        scene=f"{VARIANT}/scene.json",
        library=ancient(f"{SAMPLE}/grains3d"),
        library_record=f"{SAMPLE}/logs/grain_library.json",
        bodies=f"{TWIN}/second/bodies.csv",
        packing=f"{TWIN}/second/packing.json",
        deficit=f"{TWIN}/deficit.json",
    output:
        twin=(
            f"{TWIN}/twin.zarr.zip"
            if SLABS == 1
            else temp(f"{TWIN}/slabs/cemented.zarr.zip")
        ),
        bodies=f"{TWIN}/bodies.csv",
        correction=f"{TWIN}/correction.json",
        cement=f"{TWIN}/cement.json",
    log:
        f"{TWIN}/logs/twin.log",
    benchmark:
        f"{TWIN}/benchmarks/twin.tsv"
    conda:
        ENVS["analysis"]
    resources:
        mem_mb=memory(4000),
        runtime=runtime(60),
    params:
        stream=stream,
        settings=settings(
            "effects.position_scaling",
            "effects.cement",
            "effects.compaction",
            "feedback.limit",
        ),
        whole=SLABS == 1,
        science=science("packing", "volume"),
    script:
        "../../scripts/twin.py"


if SLABS > 1:

    ruleorder: packed_volume_joined > packed_volume

    use rule packed_volume as packed_volume_slab with:
        output:
            volume=temp(f"{TWIN}/{{packing}}/slabs/{{scatteritem}}.zarr.zip"),
        log:
            f"{TWIN}/logs/{{packing}}_volume_{{scatteritem}}.log",
        benchmark:
            f"{TWIN}/benchmarks/{{packing}}_volume_{{scatteritem}}.tsv"

    rule twin_slab:
        input:
            scene=f"{VARIANT}/scene.json",
            library=ancient(f"{SAMPLE}/grains3d"),
            library_record=f"{SAMPLE}/logs/grain_library.json",
            bodies=f"{TWIN}/bodies.csv",
            cement=f"{TWIN}/cement.json",
        output:
            volume=temp(f"{TWIN}/slabs/{{scatteritem}}.zarr.zip"),
        log:
            f"{TWIN}/logs/twin_{{scatteritem}}.log",
        benchmark:
            f"{TWIN}/benchmarks/twin_{{scatteritem}}.tsv"
        conda:
            ENVS["analysis"]
        resources:
            mem_mb=memory(4000),
            runtime=runtime(30),
        params:
            stream=stream,
            science=science("volume"),
        script:
            "../../scripts/twin_slab.py"

    # The bodies are what a joined volume was made of when its slabs are gone.
    rule packed_volume_joined:
        input:
            bodies=f"{TWIN}/{{packing}}/bodies.csv",
            slabs=gather.grainfall_slabs(
                f"{TWIN}/{{packing}}/slabs/{{scatteritem}}.zarr.zip",
                allow_missing=True,
            ),
        output:
            volume=f"{TWIN}/{{packing}}/volume.zarr.zip",
        log:
            f"{TWIN}/logs/{{packing}}_volume.log",
        benchmark:
            f"{TWIN}/benchmarks/{{packing}}_volume.tsv"
        conda:
            ENVS["analysis"]
        resources:
            mem_mb=1000,
            runtime=30,
        params:
            science=science(),
        script:
            "../../scripts/join_volume.py"

    use rule packed_volume_joined as twin_joined with:
        input:
            bodies=f"{TWIN}/bodies.csv",
            slabs=[
                f"{TWIN}/slabs/cemented.zarr.zip",
                *gather.grainfall_slabs(
                    f"{TWIN}/slabs/{{scatteritem}}.zarr.zip", allow_missing=True
                ),
            ],
        output:
            volume=f"{TWIN}/twin.zarr.zip",
        log:
            f"{TWIN}/logs/twin_joined.log",
        benchmark:
            f"{TWIN}/benchmarks/twin_joined.tsv"


rule export:
    input:
        library=ancient(f"{SAMPLE}/grains3d"),
        library_record=f"{SAMPLE}/logs/grain_library.json",
        bodies=f"{TWIN}/bodies.csv",
        twin=f"{TWIN}/twin.zarr.zip",
        pores=f"{TWIN}/network_pores.csv",
        throats=f"{TWIN}/network_throats.csv",
    output:
        [f"{TWIN}/export/{name}" for kind in FORMATS.values() for name in kind.files],
    log:
        f"{TWIN}/logs/export.log",
    benchmark:
        f"{TWIN}/benchmarks/export.tsv"
    conda:
        ENVS["analysis"]
    resources:
        mem_mb=4000,
        runtime=30,
    params:
        settings=settings("network.coarsen"),
        science=science("export"),
    script:
        "../../scripts/export.py"


rule exports:
    input:
        [
            p
            for kind in FORMATS.values()
            for name in kind.files
            for p in twins(f"export/{name}")
        ],
    localrule: True
