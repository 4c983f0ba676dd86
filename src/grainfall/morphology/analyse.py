"""A whole section, or slices of a volume, taken through every step of this chapter in the same way."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from grainfall.morphology.classify import classify_grains
from grainfall.morphology.measure import measure_grains
from grainfall.morphology.pores import inscribed_circles
from grainfall.morphology.split import (
    MIN_RADIUS_PX,
    PERSISTENCE,
    coverage,
    smallest_radius,
    split_grains,
    split_pores,
)


@dataclass(frozen=True)
class Analysis:
    """What an image shows.

    Attributes
    ----------
    phase : (y, x) ndarray of uint8
        0 pore, 1…M minerals; as given, or by the feature rules.
    grain_labels, pore_labels : (y, x) ndarray of int32
    grains, pores : DataFrame
        As :func:`measure_grains` and :func:`inscribed_circles` give them.
    smallest_um : float
        Equivalent radius below which sections of grains are specks and left out.
    """

    phase: np.ndarray
    grain_labels: np.ndarray
    pore_labels: np.ndarray
    grains: pd.DataFrame
    pores: pd.DataFrame
    smallest_um: float

    def summary(self, phases: Sequence[str]) -> dict:
        """Counts and area fractions; every pixel counts, specks and cut grains too."""
        count = np.bincount(self.phase.ravel(), minlength=len(phases))[: len(phases)]
        return {
            "phases": list(phases),
            "porosity": float(count[0] / count.sum()),
            "fractions": (count[1:] / count[1:].sum()).tolist(),
            "n_grains": len(self.grains),
            "n_grains_uncut": int((self.grains.weight > 0).sum()),
            "n_pores": len(self.pores),
            "smallest_grain_um": self.smallest_um,
            "grain_speck_fraction": coverage(self.grain_labels, self.phase > 0)["speck_fraction"],
            "pore_speck_fraction": coverage(self.pore_labels, self.phase == 0)["speck_fraction"],
        }


def analyse(
    phase: np.ndarray,
    pixel_size_um: float,
    *,
    instances: np.ndarray | None = None,
    grey: np.ndarray | None = None,
    phases: Sequence[str] = (),
    rules: Sequence[Mapping] = (),
    grain_persistence: float = PERSISTENCE,
    pore_persistence: float = PERSISTENCE,
    min_radius_px: float = MIN_RADIUS_PX,
) -> Analysis:
    """Split and measure the grains and the pores of one image.

    Parameters
    ----------
    phase : (y, x) ndarray of uint8
        0 pore, 1…M minerals.
    pixel_size_um : float
    instances, grey : (y, x) ndarray, optional
        Outlined grains; grey values.
    phases : sequence of str
        Names, index 0 the pore; needed by ``rules`` only.
    rules : sequence of mapping
        Mineral of a grain by its features, see :func:`classify_grains`.
    grain_persistence, pore_persistence, min_radius_px : float
        See :func:`split_grains`.

    Returns
    -------
    Analysis
    """
    labels = split_grains(phase, instances, persistence=grain_persistence, min_radius_px=min_radius_px)
    grains = measure_grains(labels, phase, pixel_size_um, grey)
    if rules:
        grains, phase = classify_grains(grains, labels, phase, rules, phases)
    pore_labels = split_pores(phase, persistence=pore_persistence, min_radius_px=min_radius_px)
    pores = inscribed_circles(pore_labels, pixel_size_um)
    smallest_um = smallest_radius(min_radius_px) * pixel_size_um
    return Analysis(phase, labels, pore_labels, grains, pores, smallest_um)


def measure_slices(
    phase: np.ndarray,
    voxel_size_um: float,
    slices: Iterable[tuple[int, int]],
    *,
    body: np.ndarray | None = None,
    outlined: bool = True,
    shown: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None,
    **settings: float,
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Grains and pore circles on plane slices of a volume, by the steps that a section goes through.

    Parameters
    ----------
    phase : (z, y, x) ndarray of uint8
        An open volume file will do: nothing but the slices is taken from it.
    voxel_size_um : float
    slices : iterable of (axis, index)
    body : (z, y, x) ndarray of int, optional
        Body of each voxel, likewise.
    outlined : bool
        Whether the section came with its grains outlined: by ``body`` those of slices are known too.
    shown : callable, optional
        (phase, body) of a slice to the phases that a section would show.
    **settings
        Persistences and resolution limit, as :func:`analyse` takes them.

    Returns
    -------
    grains, pores : DataFrame
        As of a section, with the columns slice, axis and index in front.
    """
    grains, pores = [], []
    for number, (axis, index) in enumerate(slices):
        at = (slice(None),) * axis + (index,)
        image = np.ascontiguousarray(phase[at])
        owner = None if body is None else np.ascontiguousarray(body[at])
        image = image if shown is None else shown(image, owner)
        found = analyse(image, voxel_size_um, instances=owner if outlined else None, **settings)
        for tables, table in ((grains, found.grains), (pores, found.pores)):
            table.insert(0, "slice", number)
            table.insert(1, "axis", "zyx"[axis])
            table.insert(2, "index", index)
            tables.append(table)
    return pd.concat(grains, ignore_index=True), pd.concat(pores, ignore_index=True)
