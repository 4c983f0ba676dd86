"""Section: read or synthesise the segmented image.

What comes from the user may be broken: ``update`` keeps the former output where the job fails.
"""


rule synthesise:
    output:
        section=f"{SAMPLE}/section.zarr.zip",
        sizes=f"{SAMPLE}/truth_sizes.csv",
        record=f"{SAMPLE}/logs/synthesise.json",
    log:
        f"{SAMPLE}/logs/synthesise.log",
    benchmark:
        f"{SAMPLE}/benchmarks/synthesise.tsv"
    wildcard_constraints:
        sample=any_of(SYNTHESES),
    cache: CACHEABLE
    conda:
        ENVS["analysis"]
    resources:
        mem_mb=memory(4000),
        runtime=runtime(30),
    params:
        stream=stream,
        row=row("pixel_size_um"),
        rock=synthesis_but("reference_edge"),
        science=science("section"),
    script:
        "../../scripts/synthesise.py"


# What judges a truth is cut from it made once more: other judges, or more, make neither the section nor a twin anew.
use rule synthesise as truth_cube with:
    output:
        reference=f"{SAMPLE}/reference.zarr.zip",
        record=f"{SAMPLE}/logs/truth_cube.json",
    log:
        f"{SAMPLE}/logs/truth_cube.log",
    benchmark:
        f"{SAMPLE}/benchmarks/truth_cube.tsv"
    params:
        rock=synthesis_but("outlined"),
        first=0,


# Each by its name, as the cache between workflows wants them.
use rule truth_cube as further_cubes with:
    output:
        **{cube: f"{SAMPLE}/{cube}/reference.zarr.zip" for cube in CUBES},
        record=f"{SAMPLE}/logs/further_cubes.json",
    log:
        f"{SAMPLE}/logs/further_cubes.log",
    benchmark:
        f"{SAMPLE}/benchmarks/further_cubes.tsv"
    params:
        first=1,


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
        sample=any_of(s for s in SAMPLES if s not in SYNTHESES and s not in SLICES),
    conda:
        ENVS["analysis"]
    resources:
        mem_mb=4000,
        runtime=30,
        # no parameter: a section that was read within a lower limit need not be read again
        max_pixels=CONFIG["section"]["max_pixels"],
    params:
        row=row("kind", "pixel_size_um", "pore_value", "array", "grey"),
        phases=phases_of,
        checksums=checksums("image", "grey"),
        settings=settings("section.grey_classes"),
        classified_later=bool(CONFIG["section"]["rules"]),
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
        sample=any_of(s for s in REFERENCED if s not in SYNTHESES and s not in SLICES),
    conda:
        ENVS["analysis"]
    resources:
        mem_mb=8000,
        runtime=60,
    params:
        row=row(
            "reference_voxel_size_um",
            "reference_pore",
            "reference_shape",
            "reference_dtype",
        ),
        checksums=checksums("reference"),
        science=science("section"),
    script:
        "../../scripts/read_reference.py"


# Only what is not kept yet: a finished study asks no server again, nor minds which copy its file came from.
rule fetch:
    input:
        published=data_source,
    output:
        kept=directory("results/data/{data}/published"),
    log:
        "results/data/{data}/logs/fetch.log",
    benchmark:
        "results/data/{data}/benchmarks/fetch.tsv"
    wildcard_constraints:
        data=any_of(TO_FETCH),
    conda:
        ENVS["analysis"]
    resources:
        mem_mb=1000,
        runtime=30,
    params:
        known=data_entry,
    script:
        "../../scripts/fetch.py"


rule read_published:
    input:
        published=ancient("results/data/{data}/published"),
    output:
        reference="results/data/{data}/reference.zarr.zip",
    log:
        "results/data/{data}/logs/read_published.log",
    benchmark:
        "results/data/{data}/benchmarks/read_published.tsv"
    conda:
        ENVS["analysis"]
    resources:
        mem_mb=4000,
        runtime=30,
    params:
        known=data_entry,
        science=science("section"),
    script:
        "../../scripts/read_published.py"


rule cut_section:
    input:
        volume=sliced_volume,
    output:
        section=f"{SAMPLE}/section.zarr.zip",
    log:
        f"{SAMPLE}/logs/cut_section.log",
    benchmark:
        f"{SAMPLE}/benchmarks/cut_section.tsv"
    wildcard_constraints:
        sample=any_of(SLICES),
    conda:
        ENVS["analysis"]
    resources:
        mem_mb=4000,
        runtime=30,
    params:
        row=row("slice"),
        science=science("section"),
    script:
        "../../scripts/cut_section.py"


rule shared_reference:
    input:
        sliced_measurements,
    output:
        [f"{SAMPLE}/{name}" for name in MEASUREMENTS],
    log:
        f"{SAMPLE}/logs/shared_reference.log",
    wildcard_constraints:
        sample=any_of(SLICES),
    localrule: True
    conda:
        ENVS["analysis"]
    params:
        folder=lambda wildcards, output: os.path.dirname(output[0]),
    shell:
        "cp -t {params.folder:q} {input:q} > {log:q} 2>&1"


rule tomogram:
    input:
        rock=f"{SAMPLE}/reference.zarr.zip",
    output:
        tomogram=f"{SAMPLE}/tomogram/reference.zarr.zip",
        grey=f"{SAMPLE}/tomogram/grey.zarr.zip",
        report=f"{SAMPLE}/tomogram/tomogram.json",
    log:
        f"{SAMPLE}/logs/tomogram.log",
    benchmark:
        f"{SAMPLE}/benchmarks/tomogram.tsv"
    wildcard_constraints:
        sample=any_of(TOMOGRAMS),
    conda:
        ENVS["analysis"]
    resources:
        mem_mb=4000,
        runtime=30,
    params:
        stream=stream,
        settings=settings("tomogram"),
        science=science("section"),
    script:
        "../../scripts/tomogram.py"
