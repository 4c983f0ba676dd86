"""Correlation: S2 on slices and in 3D, and the envelope test of the section against the slices."""


rule s2_chunk:
    input:
        volume=f"{TWIN}/twin.zarr.zip",
    output:
        s2=temp(f"{TWIN}/s2_slices/{{scatteritem}}.csv"),
    log:
        f"{TWIN}/logs/s2_slices_{{scatteritem}}.log",
    benchmark:
        f"{TWIN}/benchmarks/s2_slices_{{scatteritem}}.tsv"
    conda:
        ENVS["analysis"]
    resources:
        mem_mb=memory(2000),
        runtime=runtime(30),
    params:
        stream=stream,
        settings=settings("correlation.slices"),
        science=science("correlation"),
    script:
        "../../scripts/s2_chunk.py"


rule s2_slices:
    input:
        gather.grainfall_slices(
            f"{TWIN}/s2_slices/{{scatteritem}}.csv", allow_missing=True
        ),
    output:
        s2=f"{TWIN}/s2_slices.csv",
    log:
        f"{TWIN}/logs/s2_slices.log",
    benchmark:
        f"{TWIN}/benchmarks/s2_slices.tsv"
    conda:
        ENVS["analysis"]
    resources:
        mem_mb=memory(1000),
        runtime=runtime(1),
    params:
        science=science("correlation"),
    script:
        "../../scripts/s2_slices.py"


rule s2_volume:
    input:
        volume=f"{TWIN}/twin.zarr.zip",
    output:
        s2=f"{TWIN}/s2_volume.csv",
    log:
        f"{TWIN}/logs/s2_volume.log",
    benchmark:
        f"{TWIN}/benchmarks/s2_volume.tsv"
    conda:
        ENVS["analysis"]
    threads: many_threads
    resources:
        mem_mb=memory(4000),
        runtime=runtime(30),
    params:
        science=science("correlation"),
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
    wildcard_constraints:
        sample=any_of(MEASURED),


if SLABS > 1:

    ruleorder: s2_volume_joined > s2_volume
    ruleorder: reference_s2_joined > reference_s2

    rule s2_volume_slab:
        input:
            volume=f"{TWIN}/twin.zarr.zip",
        output:
            counts=temp(f"{TWIN}/slabs/s2_{{scatteritem}}.npz"),
        log:
            f"{TWIN}/logs/s2_volume_{{scatteritem}}.log",
        benchmark:
            f"{TWIN}/benchmarks/s2_volume_{{scatteritem}}.tsv"
        conda:
            ENVS["analysis"]
        resources:
            mem_mb=memory(4000),
            runtime=runtime(30),
        params:
            science=science("correlation"),
        script:
            "../../scripts/s2_volume_slab.py"

    use rule s2_volume_slab as reference_s2_slab with:
        input:
            volume=f"{SAMPLE}/reference.zarr.zip",
        output:
            counts=temp(f"{SAMPLE}/reference_s2_{{scatteritem}}.npz"),
        log:
            f"{SAMPLE}/logs/reference_s2_{{scatteritem}}.log",
        benchmark:
            f"{SAMPLE}/benchmarks/reference_s2_{{scatteritem}}.tsv"
        wildcard_constraints:
            sample=any_of(MEASURED),

    rule s2_volume_joined:
        input:
            volume=f"{TWIN}/twin.zarr.zip",
            counts=gather.grainfall_slabs(
                f"{TWIN}/slabs/s2_{{scatteritem}}.npz", allow_missing=True
            ),
        output:
            s2=f"{TWIN}/s2_volume.csv",
        log:
            f"{TWIN}/logs/s2_volume.log",
        benchmark:
            f"{TWIN}/benchmarks/s2_volume.tsv"
        conda:
            ENVS["analysis"]
        resources:
            mem_mb=1000,
            runtime=10,
        params:
            science=science("correlation"),
        script:
            "../../scripts/s2_volume_joined.py"

    use rule s2_volume_joined as reference_s2_joined with:
        input:
            volume=f"{SAMPLE}/reference.zarr.zip",
            counts=gather.grainfall_slabs(
                f"{SAMPLE}/reference_s2_{{scatteritem}}.npz", allow_missing=True
            ),
        output:
            s2=f"{SAMPLE}/reference_s2.csv",
        log:
            f"{SAMPLE}/logs/reference_s2.log",
        benchmark:
            f"{SAMPLE}/benchmarks/reference_s2.tsv"
        wildcard_constraints:
            sample=any_of(MEASURED),


rule s2_envelope:
    input:
        labels=f"{SAMPLE}/labels.zarr.zip",
        twins=expand(
            f"{TWIN}/twin.zarr.zip", realization=REALIZATIONS, allow_missing=True
        ),
    output:
        envelope=f"{VARIANT}/s2_envelope.csv",
        test=f"{VARIANT}/s2_envelope.json",
    log:
        f"{VARIANT}/logs/s2_envelope.log",
    benchmark:
        f"{VARIANT}/benchmarks/s2_envelope.tsv"
    conda:
        ENVS["analysis"]
    resources:
        mem_mb=memory(2000),
        runtime=runtime(10),
    params:
        stream=stream,
        settings=settings("correlation.envelope_slices"),
        science=science("correlation"),
    script:
        "../../scripts/s2_envelope.py"
