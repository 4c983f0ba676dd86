"""One segmented 2D section in, an ensemble of judged 3D twins out. The chapters follow the method."""

from snakemake.utils import min_version

min_version("9.10")


# A case is a whole config of its own: the demo's values must not shine through it.
if workflow.modifier.is_main_snakefile() and not workflow.overwrite_configfiles:

    configfile: "config/config.yaml"


include: "workflow/rules/common.smk"
include: "workflow/rules/section.smk"
include: "workflow/rules/morphology.smk"
include: "workflow/rules/stereology.smk"
include: "workflow/rules/grains.smk"
include: "workflow/rules/packing.smk"
include: "workflow/rules/volume.smk"
include: "workflow/rules/correlation.smk"
include: "workflow/rules/network.smk"
include: "workflow/rules/report.smk"
include: "workflow/rules/validation.smk"
include: "workflow/rules/accuracy.smk"


rule all:
    default_target: not AS_MODULE
    input:
        kept(),
        "results/summary.csv",
        []
        if STORED
        else ["results/report.html", "results/provenance.json", *figures_shown()],
        ["results/sweep.csv"] if CONFIG["sweep"] else [],
    localrule: True


OWN_RULES = [step for step in workflow.rules if is_own(step)]

if CACHING:
    for step in OWN_RULES:
        if own_name(step.name) in CACHED_JOBS:
            step._benchmark = None


# The Slurm plugin starts Snakemake in the allocation, which would start another for every step of the job (srun). What
# is local there runs under the first: all of a job is on one node, and no step asks for more than one of its cores. A
# task of a job array finds what it is to do by that start.
if workflow.remote_exec and "SLURM_ARRAY_TASK_ID" not in os.environ:
    workflow.localrules(*(step.name for step in OWN_RULES))
