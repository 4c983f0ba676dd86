"""Section: read or synthesise the segmented image.

What comes from the user may be broken: ``update`` keeps the former output where the job fails.
"""


rule synthesise:
    output:
        section=f"{SAMPLE}/section.zarr.zip",
        reference=f"{SAMPLE}/reference.zarr.zip",
        sizes=f"{SAMPLE}/truth_sizes.csv",
        record=f"{SAMPLE}/logs/synthesise.json",
    log:
        f"{SAMPLE}/logs/synthesise.log",
    benchmark:
        f"{SAMPLE}/benchmarks/synthesise.tsv"
    wildcard_constraints:
        sample=any_of(SYNTHETIC),
    cache: CACHEABLE
    conda:
        ENVS["analysis"]
    resources:
        mem_mb=4000,
        runtime=30,
    params:
        stream=stream,
        row=sample_row,
        settings=settings("synthetic"),
        science=science("section"),
    script:
        "../../scripts/synthesise.py"


rule read_section:
    input:
        image=ancient(users_file("image")),
        grey=ancient(users_file("grey")),
    output:
        section=update(f"{SAMPLE}/section.zarr.zip"),
    log:
        f"{SAMPLE}/logs/read_section.log",
    benchmark:
        f"{SAMPLE}/benchmarks/read_section.tsv"
    wildcard_constraints:
        sample=any_of(s for s in SAMPLES if s not in SYNTHETIC),
    conda:
        ENVS["analysis"]
    resources:
        mem_mb=4000,
        runtime=30,
    params:
        row=sample_row,
        checksums=checksums("image", "grey"),
        settings=settings("section"),
        science=science("section"),
    script:
        "../../scripts/read_section.py"


rule read_reference:
    input:
        image=ancient(users_file("reference")),
    output:
        reference=update(f"{SAMPLE}/reference.zarr.zip"),
    log:
        f"{SAMPLE}/logs/read_reference.log",
    benchmark:
        f"{SAMPLE}/benchmarks/read_reference.tsv"
    wildcard_constraints:
        sample=any_of(s for s in REFERENCED if s not in SYNTHETIC),
    conda:
        ENVS["analysis"]
    resources:
        mem_mb=8000,
        runtime=60,
    params:
        row=sample_row,
        checksums=checksums("reference"),
        science=science("section"),
    script:
        "../../scripts/read_reference.py"
