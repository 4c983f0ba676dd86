"""What accuracy costs in time: settings held against the truth or the finest, and the cheapest that does.

``known`` tries settings of the analysis on volumes whose truth is known, ``observe`` holds one volume against
another, ``table`` gathers errors and costs, finds the front between them and picks a preset from it.
"""

from grainfall.accuracy.observe import METRICS, Metric, differences, observe
from grainfall.accuracy.table import (
    COLUMNS,
    Choice,
    choose,
    committed,
    front,
    gather,
    presets_of,
    rounded,
    summarise,
    with_accuracy,
)

__all__ = [
    "COLUMNS",
    "METRICS",
    "Choice",
    "Metric",
    "choose",
    "committed",
    "differences",
    "front",
    "gather",
    "observe",
    "presets_of",
    "rounded",
    "summarise",
    "with_accuracy",
]
