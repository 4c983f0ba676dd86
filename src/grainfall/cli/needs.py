"""What one job needs of a machine, from what such jobs have needed: a fit to needs.csv (`make bench-needs`).

Memory and CPU time of a job are a start, large for what it imports, and a share for every voxel or grain.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np
import pandas as pd
import scipy  # its parts load when they are first used

from grainfall import io, packing
from grainfall.errors import InputError

TABLE = files("grainfall.cli") / "needs.csv"

PER = {"Mvoxel": 1e6, "kgrain": 1e3}
"""Units of size: million voxels (or pixels of a section), thousand grains."""

VOLUMES = dict.fromkeys(("reference_network", "reference_flow", "reference_s2"), "reference.zarr.zip")
"""Whose jobs' size is not that of the section, but of another volume of the sample."""

FULL = 0.85
"""Share of the memory asked for that the hungriest measured job of a rule uses."""

SLOWER = 4.0
"""Time asked for over the measured: another machine, other work on it."""

SHORTEST_MIN = 10
"""Time asked for at least: it costs nothing to ask for, and a busy file system may take it."""

COARSENED = ("network", "flow")
"""How rules end that may work on blocks of voxels."""


LEAST = 0.01
"""MB or s that every job is taken to have used: a clock that looks each second may have seen none."""


@dataclass(frozen=True)
class Need:
    """What to ask for: memory in MB, time in minutes."""

    mem_mb: int
    runtime_min: int


class Needs:
    """The fit.

    Parameters
    ----------
    table : DataFrame
        A row a rule: rule, per (a key of :data:`PER`), start_mb, mb, start_s, s (memory and CPU seconds: at
        size 0, and for each unit of size).
    """

    def __init__(self, table: pd.DataFrame):
        self.table = table.set_index("rule")

    @classmethod
    def measured(cls) -> Needs:
        """The fit that comes with the package."""
        with TABLE.open() as file:
            return cls(pd.read_csv(file))

    def job(self, rule: str, size: Mapping[str, float]) -> Need | None:
        """What a job of a rule needs, or None where nothing is known of it.

        Parameters
        ----------
        rule : str
        size : mapping
            Unit to size of the job, in that unit; empty where it is not known.
        """
        if rule not in self.table.index:
            return None
        row = self.table.loc[rule]
        if row["per"] not in size:
            return None
        memory = row["start_mb"] + row["mb"] * size[row["per"]]
        seconds = row["start_s"] + row["s"] * size[row["per"]]
        return Need(math.ceil(memory / FULL), max(SHORTEST_MIN, math.ceil(SLOWER * seconds / 60)))


def size_of(rule: str, sample: str | Path, variant: str | None = None, coarsen: int = 1) -> dict[str, float]:
    """Size of a rule's jobs, from what earlier jobs have written.

    Parameters
    ----------
    rule : str
    sample : path
        The sample's folder of results.
    variant : str, optional
        Of a twin's jobs.
    coarsen : int
        Voxels along an axis that become one for network and flow.

    Returns
    -------
    dict
        Unit (:data:`PER`) to size; empty where nothing is written yet that would tell, or what is written is
        damaged: the job that needs it will say so.
    """
    size = {}
    with suppress(InputError, KeyError, TypeError, ValueError):
        if variant is not None:
            scene = Path(sample) / variant / "scene.json"
            size = of_scene(io.read_json(scene)) if scene.exists() else {}
        else:
            volume = Path(sample) / VOLUMES.get(rule, "section.zarr.zip")
            if volume.exists():
                with io.open_volume(volume) as (array, _):
                    size = of_shape(array.shape)
    if size and rule.endswith(COARSENED):
        size["Mvoxel"] /= coarsen**3
    return size


def of_scene(scene: Mapping) -> dict[str, float]:
    """Voxels of a twin's region, as ``plan_scene`` lays it out; grains in it and in the margin around it."""
    return of_shape(scene["shape_zyx"]) | {"kgrain": packing.poured_grains(scene) / PER["kgrain"]}


def of_shape(shape: Sequence[int]) -> dict[str, float]:
    """Elements of an array of this shape."""
    return {"Mvoxel": math.prod(shape) / PER["Mvoxel"]}


def fit(runs: pd.DataFrame, per: Mapping[str, str]) -> pd.DataFrame:
    """The table behind :class:`Needs`.

    Parameters
    ----------
    runs : DataFrame
        A row a job: rule, a column for each unit of size, peak_rss_mb, cpu_s.
    per : mapping
        Rule to the unit that its need grows with.

    Returns
    -------
    DataFrame
        As :class:`Needs` takes it: of the lines that no job exceeds, with neither a negative start nor a
        negative share, that which asks for least beyond what a job uses, as a multiple of it, where it asks
        for most.
    """
    rows = []
    for rule, unit in per.items():
        jobs = runs[runs["rule"] == rule].dropna(subset=[unit])
        if jobs.empty:
            continue
        largest = jobs.groupby(unit, as_index=False)[["peak_rss_mb", "cpu_s"]].max()
        matrix = np.column_stack([np.ones(len(largest)), largest[unit]])
        row = {"rule": rule, "per": unit}
        for column, (start, share) in {"peak_rss_mb": ("start_mb", "mb"), "cpu_s": ("start_s", "s")}.items():
            used = largest[[column]].to_numpy().clip(min=LEAST)
            asked = matrix / used
            one = np.ones((len(asked), 1))
            found = scipy.optimize.linprog(
                [0, 0, 1],
                A_ub=np.block([[-asked, 0 * one], [asked, -one]]),
                b_ub=np.concatenate([-one, 0 * one]),
            )
            row[start], row[share], _ = found.x
        rows.append(row)
    return pd.DataFrame(rows).round(3)
