"""Errors and costs of settings in one table, and the front between them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import scipy  # its stats take half a second to load, and do so when they are first used

from grainfall import io
from grainfall.accuracy.observe import DISTANCES, differences
from grainfall.report.ensembles import read_costs, t_interval

PRESETS = "preset"
"""The knob whose settings are the presets."""

COSTS = ("wall_s", "cpu_s", "peak_rss_mb")

COLUMNS = (
    "scene", "knob", "setting", "against", "metric", "n", "error", "lower", "upper",
    "bias", "bias_lower", "bias_upper", *COSTS, "front",
)  # fmt: skip
"""Columns of results/accuracy/accuracy.csv."""

CHANCE = "chance"
"""The knob whose settings are another again."""

PACKING, TWIN = "packing", "twin"
"""Scenes: grains poured once, and whole twins; a knob of the analysis is a scene of its own."""


def gather(
    results: str | Path,
    sweep: Mapping,
    samples: Sequence[str],
    jobs: Sequence[str],
    poured: int = 1,
    twins: int = 1,
) -> pd.DataFrame:
    """Every difference that is measured so far, of those that the sweep asks for.

    Parameters
    ----------
    results : path
    sweep : mapping
        The config's ``accuracy_sweep``.
    samples : sequence of str
    jobs : sequence of str
        What a whole twin takes.
    poured, twins : int
        Packings of a setting and twins of a preset, of each sample.

    Returns
    -------
    DataFrame
        scene, knob, setting, against, repeat, metric, difference, wall_s, cpu_s, peak_rss_mb.
    """
    root = Path(results)
    against = sweep["against"]
    pairs = []
    if against is not None:
        pairs = [(knob, v, against) for knob, found in sweep["packing"].items() for v in found]
        pairs.append((against, against, against))
    pairs += [(CHANCE, setting, against) for setting, against in sweep["chance"].items()]
    rows: list[dict] = []
    for sample in samples:
        for knob, setting, against in pairs:
            for number in range(poured):
                first = f"{number}/first/observed.json"
                path, held = (root / sample / of / first for of in (setting, against))
                rows += _paired((PACKING, knob, setting, against), path, held, ["first_packing"])
        for preset in sweep["presets"]:
            for number in range(twins):
                path, held = (root / sample / of / "observed.json" for of in (f"{preset}/{number}", ""))
                rows += _paired((TWIN, PRESETS, preset, "truth"), path, held, jobs)
    known = [
        pd.read_csv(path)
        for knob in sweep["known"]
        for path in sorted((root / "accuracy" / knob).glob("*.csv"))
    ]
    return pd.concat([pd.DataFrame(rows, columns=list(REPEATS)), *known], ignore_index=True)


REPEATS = ("scene", "knob", "setting", "against", "repeat", "metric", "difference", *COSTS)


def _paired(about: tuple, path: Path, held: Path, jobs: Sequence[str]) -> list[dict]:
    """Differences of a volume to the one it is held against, with its cost; nothing while one is missing."""
    if not (path.exists() and held.exists()):
        return []
    twin = next(folder for folder in path.parents if folder.name.isdigit())
    written = [twin / f"benchmarks/{job}.tsv" for job in jobs]
    spent = (np.nan,) * len(COSTS)
    if all(file.exists() for file in written):  # what is not known of one job is not known of all
        costs = read_costs(written)
        spent = costs["wall_s"].sum(), costs["cpu_s"].sum(skipna=False), costs["peak_rss_mb"].max()
    repeat = f"{twin.parent.parent.name}/{twin.name}"
    errors = differences(io.read_json(path), io.read_json(held))
    if path == held:  # nothing to tell its error by; but no overlap is right
        errors = {name: error if name == "overlap" else np.nan for name, error in errors.items()}
    return [dict(zip(REPEATS, (*about, repeat, *error, *spent), strict=True)) for error in errors.items()]


def summarise(repeats: pd.DataFrame) -> pd.DataFrame:
    """Error and cost of every setting over its repeats.

    A repeat draws the same numbers under every setting, so a difference is that of two settings in one
    repeat, never of two means. The error of a setting is the mean size of its differences: what one run is
    off by. Its bias is their mean with the sign left on: what no number of runs averages out. Repeats of one
    truth (``truth/number``) share its section, so they count as one, by their mean: intervals are over
    truths.

    Parameters
    ----------
    repeats : DataFrame
        As :func:`gather` gives it: a row a setting, repeat and metric.

    Returns
    -------
    DataFrame
        Columns :data:`COLUMNS`, ``n`` truths, knobs and settings in the order of the repeats. Bounds are 95 %
        t-intervals, not below 0 for an error, empty for a single repeat; costs are medians. What others are
        held against has costs alone. ``front``: nothing in the same scene, held against the same, is as cheap
        and as near and better in one (:func:`front`, CPU seconds).
    """
    rows = []
    keys = ["scene", "knob", "setting", "against", "metric"]
    for key, group in repeats.groupby(keys, sort=False):
        truth = group["repeat"].astype(str).str.partition("/")[0]
        values = group["difference"]
        sizes, signed = (v.groupby(truth).mean().dropna().to_numpy() for v in (values.abs(), values))
        error = bias = (np.nan,) * 3
        if len(sizes):
            error, bias = t_interval(sizes)[1:], t_interval(signed)[1:]
        costs = (group[cost].median() for cost in COSTS)
        n = truth.nunique()
        rows.append((*key, n, error[0], np.maximum(error[1], 0.0), error[2], *bias, *costs, False))
    table = pd.DataFrame(rows, columns=list(COLUMNS))
    for _, group in table.groupby(["scene", "against", "metric"], sort=False):
        group = group[group["error"].notna()]
        table.loc[group.index, "front"] = front(group["cpu_s"].to_numpy(), group["error"].to_numpy())
    return table


def front(cost: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Whether each point is on the Pareto front: no other is as cheap and as near, and better in one of them.

    Parameters
    ----------
    cost, error : (n,) arrays

    Returns
    -------
    (n,) array of bool
    """
    cost, error = np.asarray(cost, float), np.asarray(error, float)
    no_worse = (cost[None] <= cost[:, None]) & (error[None] <= error[:, None])
    better = (cost[None] < cost[:, None]) | (error[None] < error[:, None])
    return ~(no_worse & better).any(axis=1)


def beyond_chance(rows: pd.DataFrame, chance: pd.DataFrame) -> pd.Series:
    """Whether a setting's error is more than chance explains, at 5 % over all settings of one metric.

    Its own 95 % interval has to say so, and more: three repeats that happen to lie close together make any
    difference look certain. So how much repeats scatter is pooled, too, over the settings, by the median of
    their variances, which a few that differ do not move, and the level is shared by all of them (Bonferroni).
    A difference with a sign is told from none; one without, a distance, is never 0 and has to lie above that
    of the same thing done again.

    Parameters
    ----------
    rows, chance : DataFrame
        Of one metric, as :func:`summarise` gives them; ``chance`` the rows of :data:`CHANCE`, perhaps none.

    Returns
    -------
    Series of bool
        True, too, where single repeats tell nothing.
    """
    whole = pd.concat([rows, chance])
    again = chance.nlargest(1, "error")[["error", "n"]]
    settings = max(1, rows["error"].notna().sum())
    known, repeats = (again[of].item() if len(again) else np.nan for of in ("error", "n"))
    once = np.sqrt(1 / rows["n"]), np.sqrt(1 / rows["n"] + 1 / repeats)
    signed = (rows["bias_lower"] <= 0) & (rows["bias_upper"] >= 0)
    signed |= rows["bias"].abs() <= _bound(whole, "bias", 0.025 / settings) * once[0]
    distance = rows["lower"] <= known
    distance |= rows["error"] - known <= _bound(whole, "error", 0.05 / settings) * once[1]
    return ~distance.where(rows["metric"].isin(DISTANCES), signed)


def _bound(rows: pd.DataFrame, figure: str, level: float) -> float:
    """What a single repeat exceeds at that level by the scatter of all; NaN where each is a single one."""
    upper = rows["upper" if figure == "error" else "bias_upper"]
    repeated = rows["n"][upper.notna()].to_numpy() - 1
    if not len(repeated):
        return np.nan
    half = (upper - rows[figure]).dropna().to_numpy()
    t, chi2 = scipy.stats.t, scipy.stats.chi2
    variance = (half / t.ppf(0.975, repeated)) ** 2 * (repeated + 1)
    pooled = np.median(variance * repeated / chi2.median(repeated))
    return t.isf(level, repeated.sum()) * np.sqrt(pooled)


def rounded(table: pd.DataFrame) -> pd.DataFrame:
    """The table with four significant digits, more than it is good for."""
    return table.map(lambda v: float(f"{v:.4g}") if isinstance(v, float) else v)


def presets_of(table: pd.DataFrame) -> pd.DataFrame:
    """The rows of :func:`summarise` that say what presets are worth, as they are committed."""
    rows = table[table["knob"] == PRESETS]
    kept = ["setting", "metric", "n", "error", "lower", "upper", *COSTS]
    return rows[kept].rename(columns={"setting": "preset"}).reset_index(drop=True)
