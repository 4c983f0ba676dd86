"""Mineral of a grain by a simple rule on one of its measured features."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from grainfall.errors import InputError
from grainfall.rules import check_rules


def classify_grains(
    table: pd.DataFrame,
    labels: np.ndarray,
    phase: np.ndarray,
    rules: Sequence[Mapping],
    phases: Sequence[str],
) -> tuple[pd.DataFrame, np.ndarray]:
    """Assign minerals to grains; the first rule that matches a grain decides, without one it keeps its own.

    Parameters
    ----------
    table : DataFrame
        One row a grain, from :func:`measure_grains`.
    labels : (y, x) ndarray of int
        Grains of the table.
    phase : (y, x) ndarray of uint8
        0 pore, 1…M minerals. Pixels of no grain (specks) keep theirs.
    rules : sequence of mapping
        In order, each ``{phase, feature, above and/or below}``: the feature, one of
        :data:`grainfall.rules.FEATURES`, lies above and below these values (both strictly). ``r_um`` (µm) and
        ``area_um2`` (µm²) are those of the section.
    phases : sequence of str
        Names of the phases, index 0 the pore.

    Returns
    -------
    table : DataFrame
        With the new ``phase``.
    phase : (y, x) ndarray of uint8

    Raises
    ------
    InputError
        A rule names no phase, feature or bound, mean grey is asked without a grey image, or a phase is left
        without a grain.
    """
    check_rules(rules, phases)
    minerals = table["phase"].to_numpy(np.uint8).copy()
    open_ = np.ones(len(table), bool)
    for number, rule in enumerate(rules, start=1):
        feature = rule["feature"]
        if feature not in table:
            raise InputError(f"rules[{number}]", f"{feature} needs a grey image of the section", "give grey")
        value = table[feature].to_numpy(float)
        lower, upper = rule.get("above"), rule.get("below")
        match = open_ & np.isfinite(value)
        match &= value > (-np.inf if lower is None else lower)
        match &= value < (np.inf if upper is None else upper)
        minerals[match] = list(phases).index(rule["phase"])
        open_ &= ~match

    mineral_of = np.zeros(int(labels.max(initial=0)) + 1, np.uint8)
    mineral_of[table["grain"].to_numpy()] = minerals
    classified = np.where(labels > 0, mineral_of[labels], phase)
    absent = [name for k, name in enumerate(phases[1:], start=1) if not (minerals == k).any()]
    if absent:
        raise InputError("rules", f"no grain is {', '.join(absent)}", "move the bounds, or do not declare it")
    return table.assign(phase=minerals), classified
