"""What was measured against what was asked for, in plain words."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import pandas as pd

from grainfall.report.ensembles import ensemble_mean
from grainfall.report.metrics import METRICS, Metric, metric
from grainfall.report.numbers import as_float, number
from grainfall.surface import Alignment, left_open, lies_aligned

POROSITY_TOLERANCE = 0.0005
"""Allowed distance of the twin's porosity from the section's where the correction is on."""
PERMEABILITY_TOLERANCE = 0.10
"""Relative distance from the reference (same method) up to which a permeability counts as met."""
FEW_VOXELS = 8
"""Voxels across the mean grain below which a twin's figures are the grid's: the porosity of spheres is off by
0.034 at 4, by 0.007 at 8 (``make accuracy``)."""


class Judgement(NamedTuple):
    """One metric against its target, in words a reader needs no key for."""

    metric: str
    value: float | None
    target: str
    words: str
    status: str
    """met, missed, reported (no target) or not computed."""
    label: str
    unit: str
    lower: float | None
    upper: float | None


def judge(metrics: pd.DataFrame, phases: Sequence[str] = ()) -> list[Judgement]:
    """Hold every metric of one twin against its target.

    Parameters
    ----------
    metrics : DataFrame
        As :func:`metrics_table` gives it. A row ``<metric>_target`` is the target of ``<metric>``, its bounds
        the accepted interval; ``k_ref_*`` rows are the targets of ``k_*``; other bounds are in
        :data:`METRICS`.
    phases : sequence of str
        Names of the phases, index 0 the pore; minerals are numbered without them.
    """
    rows = {r.metric: r for r in metrics.itertuples()}
    verdicts = []
    for name, row in rows.items():
        if name.endswith("_target") or name.startswith("k_ref_"):
            continue
        known, value = metric(name), as_float(row.value)
        mineral = re.search(r"mineral (\d+)", known.label)
        if mineral and int(mineral[1]) < len(phases):
            label = known.label.replace(mineral[0], phases[int(mineral[1])])
            known = dataclasses.replace(known, label=label)
        target, words, status = _verdict(name, known, value, rows)
        verdicts.append(
            Judgement(name, value, target, words, status, known.label, known.unit,
                      as_float(row.lower), as_float(row.upper))
        )  # fmt: skip
    return verdicts


def _verdict(name: str, known: Metric, value: float | None, rows: Mapping) -> tuple[str, str, str]:
    target = rows.get(f"{name}_target")
    aim = as_float(target.value) if target else None
    low, high = (as_float(target.lower), as_float(target.upper)) if target else (known.low, known.high)
    if name == "porosity" and aim is not None and low is None:
        low, high = aim - POROSITY_TOLERANCE, aim + POROSITY_TOLERANCE
    if name.startswith("k_") and name.replace("k_", "k_ref_") in rows:
        aim = as_float(rows[name.replace("k_", "k_ref_")].value)
        if aim is not None:
            low, high = (1 - PERMEABILITY_TOLERANCE) * aim, (1 + PERMEABILITY_TOLERANCE) * aim
    wanted = _wanted(name, aim, low, high)
    if value is None:
        return wanted, "not computed", "not computed"
    shown = number(value)
    if low is None and high is None:
        words = "nothing flows through: K = 0" if name.startswith("k_") and value == 0 else "reported"
        return wanted, words, "reported"
    # bounds are met up to rounding, so that 0.31 ± 0.0005 does not fail on its last binary digit
    slack = 1e-9 * max(abs(b) for b in (low, high, value) if b is not None)
    if (low is None or value >= low - slack) and (high is None or value <= high + slack):
        return wanted, "not told apart" if name == "s2_envelope_p" else "met", "met"
    if name == "porosity":
        gap = number(abs(value - aim), 2)
        words = f"porosity {number(value, 4)} misses {number(aim, 4)} by {gap}"
        return wanted, f"{words}: the plan says what kept position scaling from closing it", "missed"
    if name.startswith("k_"):
        how = "nothing flows through the twin" if value == 0 else _relative(value, aim)
        return wanted, f"{known.label} {shown} mD misses {number(aim)} mD: {how}", "missed"
    if name.startswith("w1_"):
        unit = "" if known.unit == "1" else f" {known.unit}"
        what = known.label.removesuffix(", distance to the section")
        words = f"{what}: {shown}{unit} from the section, where chance explains {number(high)}{unit}"
        return wanted, words, "missed"
    if name == "solid_surface_per_um":
        change = value / aim - 1
        words = f"{abs(change):.0%} {'more' if change > 0 else 'less'} surface than the section's solid has"
        return wanted, f"{words}: beyond two standard errors", "missed"
    if name == "accuracy_error":
        words = f"{known.label}: {shown}, above {number(high)}, which is asked of twins on average"
        return wanted, words, "missed"
    if name.startswith("phase_fraction_"):
        return wanted, f"{known.label} {shown} misses {number(aim)}: beyond two standard errors", "missed"
    below = low is not None and value < low
    bound = f"below {number(low)}" if below else f"above {number(high)}"
    # a label may end in what the figure is a share of, or counted in
    what, comma, of = known.label.rpartition(", ")
    return wanted, f"{what}: {shown} {of}, {bound}" if comma else f"{of}: {shown}, {bound}", "missed"


def _wanted(name: str, aim: float | None, low: float | None, high: float | None) -> str:
    if name.startswith("w1_") and high is not None:
        return f"at most {number(high)} (chance)"
    if aim is not None and low is not None and high is not None:
        return f"{number(aim, 4)} ({number(low, 4)} to {number(high, 4)})"
    if aim is not None:
        return number(aim)
    if low is not None:
        return f"at least {number(low)}"
    return f"at most {number(high)}" if high is not None else ""


def _relative(value: float, aim: float | None) -> str:
    if not aim:
        return "the reference does not conduct"
    change = value / aim - 1
    if abs(change) < 0.005:
        return "within 1% of the reference"
    return f"{abs(change):.0%} {'above' if change > 0 else 'below'} the reference"


def verdict(judgements: Sequence[Judgement]) -> str:
    """One sentence over all judgements of a twin."""
    judged = [j for j in judgements if j.status in ("met", "missed")]
    missed = [j for j in judged if j.status == "missed"]
    if not judged:
        return "No metric with a target has been computed yet."
    if not missed:
        return f"{len(judged)} of {len(judged)} targets are met."
    return f"{len(judged) - len(missed)} of {len(judged)} targets are met, {len(missed)} missed."


def headline(tables: Sequence[pd.DataFrame]) -> list[str]:
    """What the twins of one variant are like, in sentences; figures are means over realizations, of
    permeabilities geometric ones.

    Parameters
    ----------
    tables : sequence of DataFrame
        metrics.csv of each realization.
    """
    values = pd.concat(tables).dropna(subset="value").groupby("metric")["value"]
    mean = {name: ensemble_mean(name, of.to_numpy(float)) for name, of in values}

    def of(name: str) -> float | None:
        return as_float(mean.get(name))

    said = []
    if of("porosity") is not None:
        aim = "" if of("porosity_target") is None else f", {number(of('porosity_target'))} was asked for"
        first = (
            "" if of("porosity_first") is None else f"; grains alone poured to {number(of('porosity_first'))}"
        )
        said.append(f"Porosity is {number(of('porosity'))}{aim}{first}.")
    k = [of(f"k_{a}_md") for a in "xyz"]
    if all(v is not None for v in k):
        reference = [of(f"k_ref_{a}_md") for a in "xyz"]
        against = ""
        if all(reference):
            against = f", {_relative(sum(k) / sum(reference), 1.0)} by the same method on average"
            if of("porosity_ref") is not None:
                against += f" (the reference is {number(of('porosity_ref'))} porous)"
        blocked = "" if all(k) else " (0: nothing percolates)"
        said.append(f"Permeability along x, y, z is {', '.join(map(number, k))} mD{blocked}{against}.")
    if of("k_sampling_error") is not None:
        said.append(f"{left_open(of('k_sampling_error'), of('porosity_sampling_error'))}.")
    if of("section_alignment") is not None:
        lies = Alignment(*map(of, ("section_alignment", "section_alignment_deg", "section_alignment_p")))
        said += [f"{words}." for words in [lies_aligned(lies)] if words]
    across, joined = of("voxels_per_grain"), of("network_coarsen") or 1
    if across is not None and across < FEW_VOXELS:
        said.append(
            f"A mean grain is {number(across, 2)} voxels across: with fewer than {FEW_VOXELS}, pores close "
            "or merge, which biases porosity and permeability (scene.voxel_size_um)."
        )
    elif across is not None and across / joined < FEW_VOXELS:
        said.append(
            f"Network and flow see {number(across / joined, 2)} voxels across a mean grain: with fewer than "
            f"{FEW_VOXELS}, pores close or merge, which biases permeability (network.coarsen)."
        )
    inside, p = of("s2_inside_envelope"), of("s2_envelope_p")
    if inside is not None:
        said.append(
            f"The section's S₂ lies inside the cloud of the twins' slices at {inside:.0%} of the lags."
        )
    if p is not None:
        level = METRICS["s2_envelope_p"].low
        can, told = "cannot" if p >= level else "can", of("s2_windows_rejected")
        test = f"envelope test, p = {number(p, 2)}"
        if told is not None:
            test = (
                f"envelope test of its middle window, p = {number(p, 2)}; of all its windows {told:.0%} "
                f"are rejected, where some {level:.0%} would be by chance"
            )
        said.append(f"By S₂ the section {can} be told from a slice of the twins ({test}).")
    return said
