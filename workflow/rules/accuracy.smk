"""What accuracy costs in time: every setting of a sweep measured, errors against cost, the front between them."""

SWEEP = CONFIG["accuracy_sweep"]
POURED = [
    *(variant for settings in SWEEP["packing"].values() for variant in settings),
    *filter(None, [SWEEP["against"]]),
    *SWEEP["chance"],
    *SWEEP["chance"].values(),
]
WHOLE_TWIN = [
    "first_packing",
    "first_volume",
    "deficit",
    "second_packing",
    "twin",
    "network",
    "flow",
    *(f"flow_{method}" for method in CONFIG["flow"]["methods"] if method in ON_VOXELS),
    "contacts",
]


TWINS = max(len(REALIZATIONS), SWEEP["twins"])


rule accuracy_sweep:
    input:
        expand(
            f"{TWIN}/first/observed.json",
            sample=list(SAMPLES)[: SWEEP["repeats"]],
            variant=sorted(set(POURED)),
            realization=REALIZATIONS,
        ),
        expand(
            f"{TWIN}/observed.json",
            sample=list(SAMPLES),
            variant=SWEEP["presets"],
            realization=range(TWINS),
        ),
        expand(
            f"{SAMPLE}/observed.json",
            sample=REFERENCED if SWEEP["presets"] else [],
        ),
        expand(
            "results/accuracy/{knob}/{repeat}.csv",
            knob=list(SWEEP["known"]),
            repeat=range(SWEEP["repeats"]),
        ),
    localrule: True


rule observe_first:
    input:
        scene=f"{VARIANT}/scene.json",
        library=ancient(f"{SAMPLE}/grains3d"),
        library_record=f"{SAMPLE}/logs/grain_library.json",
        bodies=f"{TWIN}/first/bodies.csv",
        forces=f"{TWIN}/first/forces.csv",
        benchmarks=timed("first_packing"),
    output:
        observed=f"{TWIN}/first/observed.json",
    log:
        f"{TWIN}/logs/observe_first.log",
    benchmark:
        f"{TWIN}/benchmarks/observe_first.tsv"
    conda:
        ENVS["analysis"]
    resources:
        mem_mb=4000,
        runtime=30,
    params:
        settings=settings("packing", "effects.decomposition", "contacts.tolerance"),
        science=science("accuracy.observe", "contacts", "packing", "volume"),
    script:
        "../../scripts/observe.py"


use rule observe_first as observe_twin with:
    input:
        volume=f"{TWIN}/twin.zarr.zip",
        contacts=f"{TWIN}/contacts.json",
        flow=f"{TWIN}/flow.csv",
        benchmarks=timed(*WHOLE_TWIN),
    output:
        observed=f"{TWIN}/observed.json",
    log:
        f"{TWIN}/logs/observe_twin.log",
    benchmark:
        f"{TWIN}/benchmarks/observe_twin.tsv"
    params:
        settings={},
        science=science("accuracy.observe"),


use rule observe_first as observe_reference with:
    input:
        volume=f"{SAMPLE}/reference.zarr.zip",
        cubes=cubes_of,
    output:
        observed=f"{SAMPLE}/observed.json",
    log:
        f"{SAMPLE}/logs/observe_reference.log",
    benchmark:
        f"{SAMPLE}/benchmarks/observe_reference.tsv"
    wildcard_constraints:
        sample=any_of(REFERENCED),
    params:
        settings={},
        science=science("accuracy.observe"),


rule try_known:
    output:
        "results/accuracy/{knob}/{repeat}.csv",
    log:
        "results/accuracy/{knob}/logs/{repeat}.log",
    benchmark:
        "results/accuracy/{knob}/benchmarks/{repeat}.tsv"
    wildcard_constraints:
        knob=any_of(SWEEP["known"]),
        repeat=r"\d+",
    conda:
        ENVS["analysis"]
    resources:
        mem_mb=4000,
        runtime=60,
    params:
        seed=CONFIG["seed"],
        settings=known_settings,
        science=science("accuracy.known"),
    script:
        "../../scripts/try_known.py"


rule accuracy_table:
    output:
        table="results/accuracy/accuracy.csv",
        presets="results/accuracy/presets.csv",
        repeats="results/accuracy/repeats.csv",
    log:
        "results/accuracy/logs/table.log",
    benchmark:
        "results/accuracy/benchmarks/table.tsv"
    conda:
        ENVS["report"]
    resources:
        mem_mb=2000,
        runtime=10,
    params:
        sweep=SWEEP,
        samples=list(SAMPLES),
        found=observed_so_far,
        jobs=WHOLE_TWIN,
        poured=len(REALIZATIONS),
        twins=TWINS,
        science=science("accuracy.table"),
    script:
        "../../scripts/accuracy_table.py"


rule accuracy_figure:
    input:
        table="results/accuracy/accuracy.csv",
    output:
        svg=report(
            "results/accuracy/accuracy.svg",
            category="Accuracy",
            caption="../report/accuracy.rst",
            labels={"figure": "error against cost"},
        ),
        png="results/accuracy/accuracy.png",
    log:
        "results/accuracy/logs/figure.log",
    benchmark:
        "results/accuracy/benchmarks/figure.tsv"
    conda:
        ENVS["report"]
    resources:
        mem_mb=2000,
        runtime=10,
    params:
        sweep=SWEEP,
        science=science("accuracy"),
    script:
        "../../scripts/accuracy_figure.py"


rule accuracy:
    input:
        "results/accuracy/accuracy.csv",
        "results/accuracy/accuracy.svg",
    localrule: True
