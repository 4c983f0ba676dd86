"""Large pores: those of a section that a packing of grains does not have."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

QUANTILE = 0.95
"""Share of the first packing's pore area that lies in circles below the radius where its tail begins."""

CONFIDENCE = 0.99
"""Confidence at which the section's tail must reach further than the first packing's."""

RESAMPLES = 400
"""Bootstrap resamples of either side."""


@dataclass(frozen=True)
class PoreTail:
    """Upper end of the pore circles of a section and of slices of the first packing.

    Attributes
    ----------
    target_um, first_um : float or None
        Radius below which :data:`QUANTILE` of the area of the pore circles lies; None without circles.
    excess_um : float
        Bound that ``target_um - first_um`` exceeds at :data:`CONFIDENCE`, by bootstrap of both sides.
    share : float
        Volume of the pores beyond ``first_um`` that the section has and the first packing has not, as a
        fraction of the rock.
    """

    target_um: float | None
    first_um: float | None
    excess_um: float
    share: float

    @property
    def exceeds(self) -> bool:
        """Whether the section has larger pores than chance lets the first packing show."""
        return self.excess_um > 0 and self.share > 0

    @property
    def words(self) -> str:
        """The comparison in a sentence."""
        if self.target_um is None or self.first_um is None:
            return "no pore circles to compare"
        how = "exceeds" if self.exceeds else "does not exceed"
        return (
            f"the section's large-pore radius of {self.target_um:.4g} µm ({QUANTILE:.0%} of the pore area is "
            f"below) {how} the first packing's {self.first_um:.4g} µm beyond sampling"
        )


def pore_tail(
    section: pd.DataFrame,
    slices: pd.DataFrame,
    porosity_target: float,
    porosity_first: float,
    rng: np.random.Generator,
) -> PoreTail:
    """Compare the largest pores of a section with those on slices of the first packing.

    Pores are weighted by their area: it is the volume in large pores that counts (areal fractions are volume
    fractions, Delesse), not the number of small ones about them. Circles of the section are resampled one by
    one, those of the packing by whole slices, since circles of one slice depend on each other.

    Parameters
    ----------
    section, slices : DataFrame
        Pore circles: r_um, weight (0 for circles that a border cuts); those of the packing with ``slice``.
    porosity_target, porosity_first : float
        Porosity asked for (as a rule that of the section), and of the first packing.
    rng : numpy.random.Generator

    Returns
    -------
    PoreTail
    """
    radii, area = _circles(section)
    of_first = [_circles(circles) for _, circles in slices.groupby("slice")]
    of_first = [one for one in of_first if len(one[0])]
    if not len(radii) or not of_first:
        return PoreTail(None, None, 0.0, 0.0)
    first_radii, first_area = (np.concatenate(part) for part in zip(*of_first, strict=True))
    target, first = _quantile(radii, area), _quantile(first_radii, first_area)
    differences = np.empty(RESAMPLES)
    for k in range(RESAMPLES):
        one = rng.integers(0, len(radii), len(radii))
        chosen = [of_first[i] for i in rng.integers(0, len(of_first), len(of_first))]
        other = (np.concatenate(part) for part in zip(*chosen, strict=True))
        differences[k] = _quantile(radii[one], area[one]) - _quantile(*other)
    beyond = area[radii > first].sum() / area.sum()
    of_own = first_area[first_radii > first].sum() / first_area.sum()
    return PoreTail(
        target,
        first,
        float(np.quantile(differences, 1 - CONFIDENCE)),
        max(0.0, float(porosity_target * beyond - porosity_first * of_own)),
    )


def _circles(table: pd.DataFrame) -> tuple[np.ndarray, np.ndarray]:
    """Radii of the uncut circles, and the area that each stands for."""
    uncut = table[table["weight"] > 0]
    radii = uncut["r_um"].to_numpy(float)
    return radii, uncut["weight"].to_numpy(float) * radii**2


def _quantile(radii: np.ndarray, area: np.ndarray) -> float:
    """Smallest radius up to which :data:`QUANTILE` of the area lies."""
    return float(np.quantile(radii, QUANTILE, weights=area, method="inverted_cdf"))
