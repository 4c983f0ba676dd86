"""What one job needs of a machine, from what such jobs have needed: needs.csv (`make bench-needs`).

Between the sizes measured, memory and CPU time of a job go along straight lines: a start, large for what it
imports, and a share for every voxel or grain, that is smaller where it works block by block.
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

from grainfall import io, packing
from grainfall.errors import InputError

TABLE = files("grainfall.cli") / "needs.csv"

PER = {"Mvoxel": 1e6, "kgrain": 1e3}
"""Units of size: million voxels (or pixels of a section), thousand grains."""

VOLUMES = dict.fromkeys(("reference_network", "reference_flow", "reference_s2"), "reference.zarr.zip")
"""Whose jobs' size is not that of the section, but of another volume of the sample."""

FULL = 0.85
"""Share of the memory asked for that the hungriest measured job of a size uses."""

SLOWER = 4.0
"""Time asked for over the measured: another machine, other work on it."""

SHORTEST_MIN = 10
"""Time asked for at least: it costs nothing to ask for, and a busy file system may take it."""

COARSENED = ("network", "flow")
"""How rules end that may work on blocks of voxels."""


THREAD_S = 120
"""CPU seconds that are worth a thread: less, and other jobs make better use of it."""

MOST_THREADS = 8
"""What more would gain is lost to what goes on in one thread."""


@dataclass(frozen=True)
class Need:
    """What to ask for: memory in MB, time in minutes, threads where a job can use more than one."""

    mem_mb: int
    runtime_min: int
    threads: int


class Needs:
    """What jobs of a size have used, and what that says of other sizes.

    Parameters
    ----------
    table : DataFrame
        Rows of every rule, by growing size: rule, per (a key of :data:`PER`), size (in that unit), mb, s
        (memory and CPU seconds of a job of this size).
    """

    def __init__(self, table: pd.DataFrame):
        self.table = table.set_index("rule")

    @classmethod
    def measured(cls) -> Needs:
        """What comes with the package."""
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
        rows = self.table.loc[[rule]]
        per = rows["per"].iloc[0]
        if per not in size:
            return None
        memory, seconds = (_carried(rows["size"], rows[used], size[per]) for used in ("mb", "s"))
        return Need(
            math.ceil(memory / FULL),
            max(SHORTEST_MIN, math.ceil(SLOWER * seconds / 60)),
            min(MOST_THREADS, math.ceil(max(1.0, seconds) / THREAD_S)),
        )


def _carried(sizes: pd.Series, used: pd.Series, size: float) -> float:
    """What was used at some sizes, carried to another; a larger job never needs less than a smaller one."""
    sizes, used = sizes.to_numpy(), np.maximum.accumulate(used.to_numpy())
    if size <= sizes[-1]:
        return float(np.interp(size, sizes, used))
    share = used[-1] / sizes[-1]
    if len(sizes) > 1:  # the last two may happen to lie level
        share = max((used[-1] - used[k]) / (sizes[-1] - sizes[k]) for k in (0, -2))
    return float(used[-1] + share * (size - sizes[-1]))


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


def cemented(twin: str | Path) -> bool:
    """Whether the twin of this folder is to have rims, as far as its packings have told yet."""
    with suppress(InputError, KeyError, TypeError, ValueError):
        overgrowth = io.read_json(Path(twin) / "deficit.json")["overgrowth"]
        second = io.read_json(Path(twin) / "second/packing.json")
        return bool(overgrowth["on"] or second["densification"]["too_loose"])
    return False


def of_scene(scene: Mapping) -> dict[str, float]:
    """Voxels of a twin's region, as ``plan_scene`` lays it out; grains in it and in the margin around it."""
    return of_shape(scene["shape_zyx"]) | {"kgrain": packing.poured_grains(scene) / PER["kgrain"]}


def of_shape(shape: Sequence[int]) -> dict[str, float]:
    """Elements of an array of this shape."""
    return {"Mvoxel": math.prod(shape) / PER["Mvoxel"]}


def hungriest(runs: pd.DataFrame, per: Mapping[str, str]) -> pd.DataFrame:
    """The table behind :class:`Needs`: the most that a job of each rule and size has used.

    Parameters
    ----------
    runs : DataFrame
        A row a job: rule, a column for each unit of size, peak_rss_mb, cpu_s.
    per : mapping
        Rule to the unit that its need grows with.
    """
    rows = []
    for rule, unit in per.items():
        jobs = runs[runs["rule"] == rule].dropna(subset=[unit])
        largest = jobs.groupby(unit)[["peak_rss_mb", "cpu_s"]].max()
        rows += [
            {"rule": rule, "per": unit, "size": size, "mb": most["peak_rss_mb"], "s": most["cpu_s"]}
            for size, most in largest.iterrows()
        ]
    return pd.DataFrame(rows).round({"size": 6, "mb": 0, "s": 1})
