"""Mineral of a grain by a simple rule on one of its measured features."""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from grainfall.errors import InputError

FEATURES = ("mean_grey", "r_um", "area_um2", "aspect_ratio", "circularity", "solidity")
_KEYS = ("phase", "feature", "above", "below")


def check_rules(rules: Sequence[Mapping], phases: Sequence[str]) -> None:
    """Raise an InputError for a rule that cannot be meant; needs no grains.

    Parameters
    ----------
    rules : sequence of mapping
        See :func:`classify_grains`.
    phases : sequence of str
        Names of the phases, index 0 the pore.
    """
    for number, rule in enumerate(rules, start=1):
        where = f"rules[{number}]"
        if not isinstance(rule, Mapping):
            raise InputError(where, f"{rule!r} is no rule", f"give {', '.join(_KEYS)}")
        for key in rule:
            _known(where, "key", key, _KEYS)
        _known(where, "phase", rule.get("phase"), tuple(phases[1:]))
        _known(where, "feature", rule.get("feature"), FEATURES)
        bounds = {key: rule[key] for key in ("above", "below") if rule.get(key) is not None}
        for key, value in bounds.items():
            if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
                raise InputError(f"{where}: {key}", f"{value!r} is no number", "give a finite number")
        if not bounds:
            raise InputError(where, "neither above nor below", "give one of them, or both")
        if len(bounds) == 2 and not bounds["above"] < bounds["below"]:
            raise InputError(
                where, f"nothing is above {bounds['above']} and below {bounds['below']}", "above must be less"
            )


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
        In order, each ``{phase, feature, above and/or below}``: the feature, one of ``FEATURES``, lies above
        and below these values (both strictly). ``r_um`` (µm) and ``area_um2`` (µm²) are those of the section.
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


def _known(where: str, what: str, name: object, names: Sequence[str]) -> None:
    if name not in names:
        near = difflib.get_close_matches(str(name), names, n=1)
        wrong = f"no {what}" if name is None else f"{what} {name!r} is unknown"
        raise InputError(where, wrong, f"{near[0]!r}?" if near else f"one of {', '.join(names)}")
