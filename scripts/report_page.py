"""The report: one page that opens offline."""

from _stage import stage

from grainfall import report

with stage(snakemake):
    report.build_report(
        "results",
        out=snakemake.output[0],
        drawn=True,
        **{name: snakemake.params[name] for name in ("samples", "title", "variants", "realizations")},
    )
