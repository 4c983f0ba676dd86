"""Validation: the paper's cases as studies, what is finished of them in one table, its figures and its page."""

PAPER_FIGURES = [
    "permeability",
    "motivation",
    "pipeline",
    "masks",
    "sizes2d",
    "grain",
    "two_packing",
    "virtual_sizes",
    "sample1_full",
    "sample1_no_inversion",
    "sample1_s2",
    "sample2",
    "sample2_analysis",
    "sample3",
    "sample3_analysis",
    "berea",
    "cv_sweep",
]


rule case:
    input:
        twins_of_case,
        references_of_case,
        sweep_of_case,
        tomograms_of_case,
    localrule: True


rule size_bias_truth:
    output:
        truth="results/cv_sweep/{cv}/{truth}/truth.csv",
        sizes="results/cv_sweep/{cv}/{truth}/sizes.csv",
    log:
        "results/cv_sweep/{cv}/{truth}/logs/truth.log",
    benchmark:
        "results/cv_sweep/{cv}/{truth}/benchmarks/truth.tsv"
    conda:
        ENVS["analysis"]
    resources:
        mem_mb=4000,
        runtime=60,
    params:
        stream=size_bias_stream,
        # not which others there are: one more makes no other anew
        sweep={k: v for k, v in CONFIG["cv_sweep"].items() if k not in ("cv", "truths")},
        cubes=CONFIG["reference_cubes"],
        science=science("size_bias"),
    script:
        "../../scripts/size_bias_truth.py"


rule size_bias_packs:
    input:
        sizes="results/cv_sweep/{cv}/{truth}/sizes.csv",
    output:
        "results/cv_sweep/{cv}/{truth}/{realization}.csv",
    log:
        "results/cv_sweep/{cv}/{truth}/logs/{realization}.log",
    benchmark:
        "results/cv_sweep/{cv}/{truth}/benchmarks/{realization}.tsv"
    conda:
        ENVS["analysis"]
    resources:
        mem_mb=2000,
        runtime=30,
    params:
        stream=size_bias_stream,
        pack={k: CONFIG["cv_sweep"][k] for k in ("porosity", "edge")},
        science=science("size_bias"),
    script:
        "../../scripts/size_bias_packs.py"


use rule s2_envelope as tomogram_envelope with:
    input:
        labels=f"{SAMPLE}/labels.zarr.zip",
        twins=[f"{SAMPLE}/tomogram/reference.zarr.zip"],
    output:
        envelope=f"{SAMPLE}/tomogram/s2_envelope.csv",
        test=f"{SAMPLE}/tomogram/s2_envelope.json",
    log:
        f"{SAMPLE}/logs/tomogram_envelope.log",
    benchmark:
        f"{SAMPLE}/benchmarks/tomogram_envelope.tsv"


# what the test says of the rock itself
use rule s2_envelope as reference_envelope with:
    input:
        labels=f"{SAMPLE}/labels.zarr.zip",
        twins=volumes_of_truth,
    output:
        envelope=f"{SAMPLE}/reference_envelope.csv",
        test=f"{SAMPLE}/reference_envelope.json",
    log:
        f"{SAMPLE}/logs/reference_envelope.log",
    benchmark:
        f"{SAMPLE}/benchmarks/reference_envelope.tsv"
    wildcard_constraints:
        sample=any_of(REFERENCED),


rule validation_table:
    output:
        table="results/validation.csv",
        left_out="results/validation/left_out.json",
    log:
        "results/validation/logs/table.log",
    benchmark:
        "results/validation/benchmarks/table.tsv"
    conda:
        ENVS["report"]
    resources:
        mem_mb=4000,
        runtime=30,
    params:
        cases=known_cases(),
        found=come_so_far,
        science=science("report.validation"),
    script:
        "../../scripts/validation_table.py"


rule paper_figures:
    input:
        "results/validation.csv",
    output:
        expand(
            "results/validation/{name}.{kind}",
            name=PAPER_FIGURES,
            kind=("svg", "pdf", "png"),
        ),
    log:
        "results/validation/logs/figures.log",
    benchmark:
        "results/validation/benchmarks/figures.tsv"
    conda:
        ENVS["report"]
    resources:
        mem_mb=6000,
        runtime=30,
    params:
        cases=known_cases(),
        science=science("report"),
    script:
        "../../scripts/paper_figures.py"


rule validation_page:
    input:
        table="results/validation.csv",
        left_out="results/validation/left_out.json",
        figures=expand("results/validation/{name}.svg", name=PAPER_FIGURES),
    output:
        page=report(
            "results/validation.html",
            category="Summary",
            caption="../report/validation.rst",
            labels={"table": "the paper's cases"},
        ),
    log:
        "results/validation/logs/page.log",
    benchmark:
        "results/validation/benchmarks/page.tsv"
    conda:
        ENVS["report"]
    resources:
        mem_mb=4000,
        runtime=15,
    params:
        benchmarks=benchmarks_so_far,
        science=science("report"),
    script:
        "../../scripts/validation_page.py"


rule validation:
    input:
        "results/validation.csv",
        "results/validation.html",
    localrule: True
