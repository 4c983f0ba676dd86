"""What accuracy costs in time: settings held against the truth or the finest.

``known`` tries settings of the analysis on volumes whose truth is known, ``observe`` holds one volume against
another, ``table`` gathers errors and costs and finds the front between them. What comes of it for the presets
is in :mod:`grainfall.presets`.
"""

from grainfall.accuracy.observe import differences, from_tables, observe, pooled
from grainfall.accuracy.table import COLUMNS, beyond_chance, front, gather, presets_of, rounded, summarise

__all__ = [
    "COLUMNS",
    "beyond_chance",
    "differences",
    "from_tables",
    "front",
    "gather",
    "observe",
    "pooled",
    "presets_of",
    "rounded",
    "summarise",
]
