"""What a twin will cost, from what twins have cost: a fit to costs.csv, which ``make bench-costs`` measures.

Packing takes a power of the number of grains, with a factor for each preset; everything else grows with the
number of voxels, and so does the memory of the largest job.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from importlib.resources import files

import numpy as np
import pandas as pd

from grainfall.packing import poured_grains

TABLE = files("grainfall.cli") / "costs.csv"
SOURCE = "src/grainfall/cli/costs.csv (make bench-costs)"


@dataclass(frozen=True)
class Cost:
    """Expected cost of one twin.

    Attributes
    ----------
    grains : int
        Grains poured, in the region and in the margin around it.
    voxels : int
    cpu_s : float
        CPU seconds of all its jobs, which run one after another.
    factor : float
        Measured twins are within this factor of what a fit to the others lets expect of them.
    memory_mb : float
        Of its largest job.
    measured : bool
        Whether the table holds twins of half as many grains, and of half as many voxels, or more; beyond, the
        fit is carried on.
    """

    grains: int
    voxels: int
    cpu_s: float
    factor: float
    memory_mb: float
    measured: bool


class Costs:
    """The fit.

    Parameters
    ----------
    table : DataFrame
        Columns preset, grains, voxels, solid_fraction, packing_cpu_s, other_cpu_s, peak_rss_mb: a row a twin.
    """

    def __init__(self, table: pd.DataFrame):
        self.table = table
        self.presets = list(dict.fromkeys(table["preset"]))

    @classmethod
    def measured(cls) -> Costs:
        """The fit to the table that comes with the package."""
        with TABLE.open() as file:
            return cls(pd.read_csv(file))

    @cached_property
    def _packing(self) -> np.ndarray:
        """Logarithm of each preset's factor, then the exponent they share."""
        shared = [(self.table["preset"] == p).to_numpy(float) for p in self.presets]
        matrix = np.column_stack([*shared, np.log(self.table["grains"])])
        return np.linalg.lstsq(matrix, np.log(self.table["packing_cpu_s"]), rcond=None)[0]

    def _on_voxels(self, column: str) -> np.ndarray:
        """Slope and intercept over the voxels."""
        return np.polyfit(self.table["voxels"], self.table[column], 1)

    def _seconds(self, preset: str, grains, voxels):
        packing = np.exp(self._packing[self.presets.index(preset)]) * np.power(grains, self._packing[-1])
        return packing + np.polyval(self._on_voxels("other_cpu_s"), voxels)

    @cached_property
    def factor(self) -> float:
        """Largest ratio, either way, of a measured twin to what the others let expect; NaN for too few."""
        found = []
        for row in self.table.itertuples():
            others = Costs(self.table.drop(index=row.Index))
            if row.preset in others.presets and len(others.table) > len(others.presets):
                expected = others._seconds(row.preset, row.grains, row.voxels)
                found.append(abs(np.log((row.packing_cpu_s + row.other_cpu_s) / expected)))
        return float(np.exp(max(found, default=np.nan)))

    def twin(self, preset: str, scene: dict) -> Cost:
        """Cost of a twin of a scene.

        Parameters
        ----------
        preset : str
            One of ``presets``.
        scene : dict
            As :func:`grainfall.packing.plan_scene` lays it out.
        """
        grains = poured_grains(scene, self.table["solid_fraction"].mean())
        voxels = int(np.prod(scene["shape_zyx"]))
        return Cost(
            grains=round(grains),
            voxels=voxels,
            cpu_s=float(self._seconds(preset, grains, voxels)),
            factor=self.factor,
            memory_mb=float(np.polyval(self._on_voxels("peak_rss_mb"), voxels)),
            measured=bool(
                grains <= 2 * self.table["grains"].max() and voxels <= 2 * self.table["voxels"].max()
            ),
        )
