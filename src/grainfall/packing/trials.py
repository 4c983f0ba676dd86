"""Packings tried on the way to the porosity that is wanted."""

from __future__ import annotations

import numpy as np

from grainfall.packing.deposition import Packing
from grainfall.packing.placement import Place, move
from grainfall.packing.plan import decide


class Trials:
    """Packings tried on the way to the target; the best so far is kept, of the others what they came to.

    A pour that misses is not brought to rest: that takes as long again, and moves the porosity by a tenth of
    what it may miss by. Nor does one miss that a region moved a little would not.
    """

    def __init__(self, pour_with, rested, porosity_of, place_of, switch: str, target, limit, fillable: bool):
        self.pour_with, self.rested, self.porosity_of = pour_with, rested, porosity_of
        self.place_of, self.switch = place_of, switch
        self.target, self.limit, self.fillable = target, limit, fillable
        self.poured: tuple[tuple[float, float], Packing] | None = None  # the last one, and what with
        self.counted = False  # whether its time is in a pass
        self.passes: list[dict] = []
        self.packing: Packing | None = None
        self.place = Place.unmoved(np.inf)
        self.kept = (0.0, 1.0)  # what the best one was poured with
        self.at_rest = True
        self.words = ""

    @property
    def porosity(self) -> float:
        """Of the packing kept, where its region lies."""
        return self.place.porosity

    def keep(self, packing: Packing, place: Place, at_rest: bool, made_with: tuple[float, float]) -> None:
        """Keep the packing if it is nearer to the target."""
        if self.packing is None or self._miss(place.porosity) < self._miss(self.porosity):
            self.packing, self.place, self.at_rest, self.kept = packing, place, at_rest, made_with

    def _miss(self, porosity: float) -> tuple[int, float]:
        # Cement fills a bed whose grains are too loose, nothing opens one that is too dense.
        gap = porosity - self.target
        too_dense = self.fillable and gap < -self.limit
        return (0 if abs(gap) <= self.limit else 2 if too_dense else 1), abs(gap)

    def _meets(self, porosity: float) -> bool:
        return abs(porosity - self.target) <= self.limit

    def _place(self, packing: Packing) -> Place:
        """Where the region is to lie: in the middle, unless it misses there and a place near it does not."""
        grains = packing[0][packing[0]["kind"] == "grain"]
        middle = float(self.porosity_of(grains))
        stays = Place.unmoved(middle)
        if self.place_of is None or self.switch == "off" or (self.switch == "auto" and self._meets(middle)):
            return stays
        # contracting positions is gentler than pulling grains apart: the aim of all feedback
        found = self.place_of(grains, self.target + self.limit / 4)
        return found if self._meets(found.porosity) else stays

    def pour(self, p_sphere: float, lubrication: float = 1.0) -> Packing:
        """Pour, unless it is what was poured last."""
        made_with = p_sphere, lubrication
        if self.poured is None or self.poured[0] != made_with:
            self.poured, self.counted = (made_with, self.pour_with(*made_with)), False
        return self.poured[1]

    def __call__(self, p_sphere: float, lubrication: float = 1.0, taps: int = 0) -> float:
        """Pack, and give the porosity without the spheres."""
        poured = packing = self.pour(p_sphere, lubrication)
        at_rest = taps > 0
        if at_rest:
            packing = self.rested(poured, lubrication, taps)
        place = self._place(packing)
        if not at_rest and self._meets(place.porosity):
            packing, at_rest = self.rested(poured, lubrication, 0), True
            place = self._place(packing)
        self.passes.append(
            {
                "p_sphere": float(p_sphere),
                "lubrication": float(lubrication),
                "taps": int(taps),
                "porosity": place.porosity,
                "moved_um": list(place.moved_um),
                "at_rest": at_rest,
                "wall_s": packing[1]["wall_s"] - (poured[1]["wall_s"] if self.counted else 0.0),
            }
        )
        self.counted = True
        self.keep(packing, place, at_rest, (p_sphere, lubrication))
        return place.porosity

    def best(self) -> Packing:
        """The packing kept, at rest."""
        if any(abs(one["porosity"] - self.target) < abs(self.porosity - self.target) for one in self.passes):
            self.words = f"; kept one of {self.porosity:.4f}, since cement fills a bed that is too loose"
        if not self.at_rest:
            self.packing, self.at_rest = self.rested(self.packing, self.kept[1], 0), True
            self.place = self._place(self.packing)
            self.words += f", at rest {self.porosity:.4f}"
        return move(self.packing[0], self.place.moved_um), self.packing[1]

    def placement(self) -> dict:
        """Whether the region was moved, and why."""
        middle, moved = self.place.middle, any(self.place.moved_um)
        misses = not self._meets(middle)
        reason = (
            f"in the middle of the bed the porosity, {middle:.4f}, "
            f"{'misses' if misses else 'meets'} {self.target:.4f} to within {self.limit:g}"
        )
        if moved:
            way = ", ".join(f"{along:.3g}" for along in self.place.moved_um)
            reason += f"; moved by ({way}) µm along x, y and z the region has {self.porosity:.4f}"
        return decide(self.switch, misses, reason, possible=moved) | {"moved_um": list(self.place.moved_um)}
