"""The report: what was measured, figures, and one self-contained HTML page that judges the twins.

``metrics``, ``judgement`` and ``ensembles`` need pandas and SciPy only; matplotlib, plotly and jinja2 are
loaded by the modules that draw.
"""

from grainfall.report.ensembles import intervals, paired_differences, read_costs, sweep_table
from grainfall.report.judgement import Judgement, judge, verdict
from grainfall.report.metrics import (
    METRICS,
    SUMMARY_COLUMNS,
    accuracy_values,
    bodies_within,
    envelope_values,
    flow_values,
    metrics_table,
    network_values,
    packing_values,
    phase_values,
    resettling_values,
    sampling_values,
    section_comparison,
    summary_row,
    surface_values,
)

__all__ = [
    "METRICS",
    "SUMMARY_COLUMNS",
    "Judgement",
    "accuracy_values",
    "bodies_within",
    "build_report",
    "envelope_values",
    "figure_files",
    "flow_values",
    "intervals",
    "judge",
    "metrics_table",
    "network_values",
    "packing_values",
    "paired_differences",
    "phase_values",
    "read_costs",
    "resettling_values",
    "sampling_values",
    "save_figure",
    "section_comparison",
    "summary_row",
    "surface_values",
    "sweep_table",
    "verdict",
]


def __getattr__(name: str):
    """Load what draws only when it is asked for."""
    if name in ("build_report", "figure_files"):
        from grainfall.report import html

        return getattr(html, name)
    if name == "save_figure":
        from grainfall.report.figures import save_figure

        return save_figure
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
