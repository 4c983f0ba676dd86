"""Grains grown together: a section that shows less surface than grains which touch in points have."""

from __future__ import annotations

from dataclasses import dataclass

from grainfall.surface import SolidSurface

STANDARD_ERRORS = 2.33
"""Standard errors by which a packing must exceed the section: 99 % on one side."""


@dataclass(frozen=True)
class Overgrowth:
    """Surface of the solid in a section and in the first packing.

    Attributes
    ----------
    section, first : SolidSurface
        On pixels and voxels of one size.
    filled : float
        Share of the first packing's pores that rims filled when its grains had the section's surface, see
        :func:`grainfall.volume.fill_to_surface`; 0 where they have no more than it.
    """

    section: SolidSurface
    first: SolidSurface
    filled: float

    @property
    def exceeds(self) -> bool:
        """Whether the packing has more surface than chance explains."""
        error = (self.section.error**2 + self.first.error**2) ** 0.5
        return self.filled > 0 and self.first.per_um - self.section.per_um > STANDARD_ERRORS * error

    @property
    def words(self) -> str:
        """The comparison in a sentence."""
        how = "exceed" if self.exceeds else "do not exceed"
        return (
            f"grains that touch in points (the first packing's, {self.first.per_um:.4g} µm² of surface a µm³ "
            f"of solid) {how} the section's {self.section.per_um:.4g} beyond sampling"
        )

    def porosity_before(self, target: float, first: float) -> float:
        """Porosity of a bed that has the target's once rims have filled their share of it.

        What the target has beyond a first packing with rims is voids, which rims hardly fill: of the volume
        share v that the spheres hold open, with grains as in the first packing about it.
        """
        left = first * (1 - self.filled)
        if target <= left:
            return target / (1 - self.filled)
        voids = (target - left) / (1 - left)
        return voids + (1 - voids) * first
