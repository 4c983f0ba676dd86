"""Correlation: S2 on slices and in 3D, and the envelope test of the section against the slices."""


rule s2_chunk:
    input:
        volume=f"{TWIN}/twin.zarr.zip",
        section=f"{SAMPLE}/section.zarr.zip",
    output:
        s2=temp(f"{TWIN}/s2_slices/{{scatteritem}}.csv"),
    params:
        stream=stream,
        slices=slices_per_twin(),
        science=science("correlation"),
    log:
        f"{TWIN}/logs/s2_slices_{{scatteritem}}.log",
    benchmark:
        f"{TWIN}/benchmarks/s2_slices_{{scatteritem}}.tsv"
    resources:
        mem_mb=2000,
        runtime=30,
    conda:
        ENVS["analysis"]
    script:
        "../../scripts/s2_chunk.py"


rule s2_slices:
    input:
        gather.slices(f"{TWIN}/s2_slices/{{scatteritem}}.csv"),
    output:
        s2=f"{TWIN}/s2_slices.csv",
    params:
        science=science("correlation"),
    log:
        f"{TWIN}/logs/s2_slices.log",
    benchmark:
        f"{TWIN}/benchmarks/s2_slices.tsv"
    resources:
        mem_mb=1000,
        runtime=5,
    conda:
        ENVS["analysis"]
    script:
        "../../scripts/s2_slices.py"


rule s2_volume:
    input:
        volume=f"{TWIN}/twin.zarr.zip",
    output:
        s2=f"{TWIN}/s2_volume.csv",
    params:
        science=science("correlation"),
    log:
        f"{TWIN}/logs/s2_volume.log",
    benchmark:
        f"{TWIN}/benchmarks/s2_volume.tsv"
    resources:
        mem_mb=4000,
        runtime=30,
    conda:
        ENVS["analysis"]
    script:
        "../../scripts/s2_volume.py"


use rule s2_volume as reference_s2 with:
    input:
        volume=f"{SAMPLE}/reference.zarr.zip",
    output:
        s2=f"{SAMPLE}/reference_s2.csv",
    log:
        f"{SAMPLE}/logs/reference_s2.log",
    benchmark:
        f"{SAMPLE}/benchmarks/reference_s2.tsv"


rule s2_envelope:
    input:
        section=f"{SAMPLE}/section.zarr.zip",
        scene=f"{VARIANT}/scene.json",
        s2=expand(f"{TWIN}/s2_slices.csv", realization=REALIZATIONS, allow_missing=True),
    output:
        envelope=f"{VARIANT}/s2_envelope.csv",
        test=f"{VARIANT}/s2_envelope.json",
    params:
        science=science("correlation"),
    log:
        f"{VARIANT}/logs/s2_envelope.log",
    benchmark:
        f"{VARIANT}/benchmarks/s2_envelope.tsv"
    resources:
        mem_mb=2000,
        runtime=10,
    conda:
        ENVS["analysis"]
    script:
        "../../scripts/s2_envelope.py"
