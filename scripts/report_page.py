"""The report: one page that opens offline."""

from _stage import results_folder, stage

from grainfall import report

with stage(snakemake):
    report.build_report(
        results_folder(snakemake),
        out=snakemake.output[0],
        drawn=True,
        **{name: snakemake.params[name] for name in ("samples", "title", "variants", "realizations")},
    )
