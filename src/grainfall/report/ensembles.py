"""Twins side by side: means with intervals, differences between variants, sweeps, and what the jobs took."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import scipy  # its stats take half a second to load, and do so when they are first used

SHARES = ("porosity", "porosity_first", "porosity_second", "s2_inside_envelope", "s2_envelope_p", "rattlers")
"""Columns of summary.csv between 0 and 1."""


def intervals(
    summary: pd.DataFrame, columns: Sequence[str], by: Sequence[str] = ("sample", "variant", "engine")
) -> pd.DataFrame:
    """Mean and 95 % interval over realizations.

    Student's t; of permeabilities both are of their logarithms, carried back, since they scatter by factors
    (not where one is 0).
    Bounds stay where the figure can lie: none is negative, shares are at most 1. Two realizations would give
    twelve times their standard error: theirs is the range of the two.

    Parameters
    ----------
    summary : DataFrame
        Rows of summary.csv.
    columns : sequence of str
        Figures to average; absent and empty ones are left out.
    by : sequence of str
        Columns that name an ensemble.

    Returns
    -------
    DataFrame
        ``by`` columns, metric, n, mean, lower, upper (NaN bounds for a single realization, the range of two).
    """

    def bounded(name: str, values: np.ndarray) -> tuple[int, float, float, float]:
        n, mean, lower, upper = t_interval(values)
        if scatters_by_factors(name, values):
            mean, lower, upper = np.exp(t_interval(np.log(values))[1:]).tolist()
        if n == 2:
            lower, upper = values.min(), values.max()
        return n, mean, *np.clip([lower, upper], 0, 1 if name in SHARES else np.inf).tolist()

    rows = []
    for key, group in summary.groupby(list(by), sort=False, dropna=False):
        for column in columns:
            values = pd.to_numeric(group[column], errors="coerce").dropna() if column in group else []
            if len(values):
                rows.append((*key, column, *bounded(column, values.to_numpy(float))))
    return pd.DataFrame(rows, columns=[*by, "metric", "n", "mean", "lower", "upper"])


def paired_differences(
    summary: pd.DataFrame, columns: Sequence[str], baseline: str | None = None
) -> pd.DataFrame:
    """Differences to the baseline variant, paired by realization (variants share their random numbers).

    Of permeabilities, which scatter by factors, it is the ratio: the geometric mean, and what excludes 1 (a
    difference where one is 0). Two pairs have their range, and tell nothing.

    Parameters
    ----------
    summary : DataFrame
        Rows of summary.csv.
    columns : sequence of str
    baseline : str, optional
        Variant to compare with; the first one of each sample if omitted.

    Returns
    -------
    DataFrame
        sample, variant, baseline, metric, ratio (whether it is one), n, mean, lower, upper, differs (the 95 %
        interval excludes that there is no difference; None for one or two pairs).
    """
    rows = []
    for sample, group in summary.groupby("sample", sort=False):
        names = list(dict.fromkeys(group["variant"]))
        base = baseline if baseline in names else names[0]
        tables = {n: group[group["variant"] == n].set_index("realization") for n in names}
        for name in (n for n in names if n != base):
            for column in (c for c in columns if c in group):
                pair = pd.concat(
                    [pd.to_numeric(tables[n][column], errors="coerce") for n in (name, base)], axis=1
                ).dropna()
                if len(pair):
                    rows.append((sample, name, base, column, *_difference(column, *pair.to_numpy(float).T)))
    columns_out = [
        "sample", "variant", "baseline", "metric", "ratio", "n", "mean", "lower", "upper", "differs",
    ]  # fmt: skip
    return pd.DataFrame(rows, columns=columns_out)


def _difference(name: str, own: np.ndarray, other: np.ndarray) -> tuple:
    """Whether it is a ratio, n, mean, lower and upper of paired values, and whether they differ."""
    ratio = scatters_by_factors(name, np.concatenate([own, other]))
    change = np.log(own / other) if ratio else own - other
    n, mean, lower, upper = t_interval(change)
    differs = None if n < 3 else bool(lower > 0 or upper < 0)
    if n == 2:
        lower, upper = change.min(), change.max()
    found = np.array([mean, lower, upper])
    return ratio, n, *(np.exp(found) if ratio else found).tolist(), differs


def scatters_by_factors(name: str, values: np.ndarray) -> bool:
    """Whether a figure is to be averaged as its logarithm: a permeability, but where one is 0."""
    return name.startswith("k_") and name.endswith("_md") and values.min() > 0


def ensemble_mean(name: str, values: np.ndarray) -> float:
    """The mean of a figure over realizations; of permeabilities the geometric one."""
    return float(np.exp(np.log(values).mean()) if scatters_by_factors(name, values) else values.mean())


def t_interval(values: np.ndarray) -> tuple[int, float, float, float]:
    """Number, mean and 95 % Student-t interval of a sample; the bounds of a single value are NaN."""
    n, mean = len(values), float(values.mean())
    if n < 2:
        return n, mean, math.nan, math.nan
    half = scipy.stats.t.ppf(0.975, n - 1) * values.std(ddof=1) / math.sqrt(n)
    return n, mean, mean - half, mean + half


def sweep_table(summary: pd.DataFrame, parameters: Mapping[str, Mapping]) -> pd.DataFrame:
    """What came of every combination of parameters: the summary, with the parameters ahead.

    Parameters
    ----------
    summary : DataFrame
        Columns :data:`SUMMARY_COLUMNS`: one row per twin.
    parameters : mapping
        Variant to the values of its dotted config keys; None where the config does not give one.

    Returns
    -------
    DataFrame
        One row per twin: sample, variant, realization, the dotted keys, then the rest of the summary.
    """
    keys = list(dict.fromkeys(key for values in parameters.values() for key in values))
    given = pd.DataFrame.from_dict(dict(parameters), orient="index", columns=keys)
    names = ["sample", "variant", "realization"]
    return summary[names].join(given, on="variant").join(summary.drop(columns=names))


def read_costs(files: Iterable[str | Path]) -> pd.DataFrame:
    """Seconds and memory per rule from Snakemake benchmark files.

    Parameters
    ----------
    files : iterable of path
        ``<rule>.tsv`` files, at any depth; the file name is the rule's.

    Returns
    -------
    DataFrame
        rule, jobs, wall_s (sum), longest_s, cpu_s (sum), peak_rss_mb (largest), longest total first.
    """
    frames = []
    for file in map(Path, files):
        table = pd.read_csv(file, sep="\t", na_values=["-"])
        if {"s", "max_rss"} <= set(table.columns):
            # the parts of a scattered rule count as one rule: s2_slices_3-of-4 → s2_slices
            frames.append(table.assign(rule=re.sub(r"_\d+-of-\d+$", "", file.stem)))
    if not frames:
        return pd.DataFrame(columns=["rule", "jobs", "wall_s", "longest_s", "cpu_s", "peak_rss_mb"])
    table = pd.concat(frames, ignore_index=True)
    if "cpu_time" not in table:
        table["cpu_time"] = np.nan
    costs = table.groupby("rule", as_index=False).agg(
        jobs=("s", "size"), wall_s=("s", "sum"), longest_s=("s", "max"),
        cpu_s=("cpu_time", lambda c: c.sum(min_count=1)), peak_rss_mb=("max_rss", "max"),
    )  # fmt: skip
    return costs.sort_values(["wall_s", "rule"], ascending=[False, True], ignore_index=True)
