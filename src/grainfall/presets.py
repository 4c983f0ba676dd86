"""What the presets are worth, as measured, and the cheapest that holds the accuracy asked for."""

from __future__ import annotations

import csv
import difflib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files

from grainfall.errors import InputError

TABLE = files("grainfall") / "presets.csv"
SOURCE = "src/grainfall/presets.csv, measured by make accuracy"

ROCK = "a two-mineral rock in boxes five grains across, its porosity of 0.38 given"
"""What the table was measured on (``config/cases/accuracy.yaml``)."""

MEASURED = (
    "packing", "effects", "feedback", "morphology", "network", "flow", "scene.sizes_from",
    "stereology.method", "stereology.particles",
)  # fmt: skip
"""Parts of the config whose values the table is of."""

SMALLEST = {"edge_grains": 5, "voxels_per_grain": 16}
"""The scene of the table: a smaller box, or a coarser one, is worse than it says."""


@dataclass(frozen=True)
class Metric:
    """What an error is of, and how it is expressed."""

    label: str
    error: str


METRICS: dict[str, Metric] = {
    "porosity": Metric("the porosity asked for", "difference"),
    "grain_sizes": Metric("grain radii", "Wasserstein distance by number over the mean radius"),
    "pore_sizes": Metric("pore radii", "Wasserstein distance by pore volume over the mean radius"),
    "s2": Metric("S₂", "largest difference"),
    "coordination": Metric("coordination", "relative difference"),
    "overlap": Metric("largest overlap", "share of the smaller radius"),
    "k": Metric("permeability", "relative difference"),
}
"""Every metric whose error is measured, by its name in the config and in the table."""


@dataclass(frozen=True)
class Choice:
    """A preset, and what it was measured to do.

    Attributes
    ----------
    preset, metric : str
    error, upper : float
        Mean error of a twin over truths, and the upper end of its 95 % interval; NaN for a single one.
    n : int
        Truths behind it.
    cpu_s : float
        Of a twin in the table's scene.
    """

    preset: str
    metric: str
    error: float
    upper: float
    n: int
    cpu_s: float

    @property
    def words(self) -> str:
        """The expectation, as a clause."""
        return (
            f"{self.preset} is measured to miss {METRICS[self.metric].label} by {self.error:.2g} in the mean "
            f"over twins of {self.n} truths, 95 % interval up to {self.upper:.2g}; of {ROCK}"
        )


def measured() -> list[Choice]:
    """What presets are worth, the table that comes with the package: a row a preset and metric."""
    with TABLE.open(newline="") as file:
        return [
            Choice(
                row["preset"], row["metric"], float(row["error"]), float(row["upper"] or "nan"),
                int(row["n"]), float(row["cpu_s"] or "nan"),
            )
            for row in csv.DictReader(file)
        ]  # fmt: skip


def choose(metric: str, tolerance: float, table: Sequence[Choice], where: str = "config: accuracy") -> Choice:
    """The cheapest preset whose error is measured to lie within a tolerance.

    Measured means with the whole 95 % interval of the mean error: a preset with few repeats has a wide one.

    Parameters
    ----------
    metric : str
        One of those in the table.
    tolerance : float
        Largest mean error of a twin, as :data:`METRICS` expresses it; single twins miss by more.
    table : sequence of Choice
        As :func:`measured` gives it.
    where : str
        Name of the config key in messages.

    Raises
    ------
    InputError
        For a metric that the table does not hold, or a tolerance that no preset is measured to keep.
    """
    if not table:
        raise InputError(where, "no preset has been measured yet", SOURCE)
    known = list(dict.fromkeys(row.metric for row in table))
    if metric not in known:
        near = difflib.get_close_matches(str(metric), known, n=1)
        hint = f"did you mean '{near[0]}'?" if near else f"one of: {', '.join(known)}"
        raise InputError(f"{where}.metric", f"unknown metric '{metric}'", hint)
    rows = [row for row in table if row.metric == metric and math.isfinite(row.upper + row.cpu_s)]
    if not rows:
        raise InputError(f"{where}.metric", f"no preset's {metric} has an interval and a cost yet", SOURCE)
    held = [row for row in rows if row.upper <= tolerance]
    if not held:
        best = min(rows, key=lambda row: row.upper)
        raise InputError(
            f"{where}.tolerance",
            f"no preset is measured to hold {metric} within {tolerance:g}",
            f"at least {_up(best.upper)}, the best measured ({best.words}; {SOURCE}), or name a preset",
        )
    return min(held, key=lambda row: (row.cpu_s, row.upper))


def _up(value: float) -> str:
    """Two significant digits, rounded up: the tolerance suggested must be one that is kept."""
    step = 10.0 ** (math.floor(math.log10(value)) - 1)
    return f"{math.ceil(value / step - 1e-9) * step:.2g}"


def with_accuracy(config: Mapping, table: Sequence[Choice], where: str = "config") -> dict:
    """The user's config with the preset that its ``accuracy`` calls for.

    Parameters
    ----------
    config : mapping
        As the user wrote it, ``accuracy`` checked for its form.
    table : sequence of Choice
        As :func:`measured` gives it.
    where : str
        Name of the config in messages.

    Raises
    ------
    InputError
        As :func:`choose`, and where the config names another preset.
    """
    chosen = choose(**config["accuracy"], table=table, where=f"{where}: accuracy").preset
    if config.get("preset", chosen) != chosen:
        raise InputError(
            f"{where}: preset",
            f"'{config['preset']}' is named, and accuracy asks for '{chosen}'",
            "leave out one of the two",
        )
    return {**config, "preset": chosen}
