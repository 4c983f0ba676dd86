"""The two packings of a twin: grains alone, then whatever brings them to the section's porosity and pores."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from grainfall.errors import InputError
from grainfall.grains import VOID, Library
from grainfall.morphology import Intergranular
from grainfall.packing.densify import SLICK, match_density
from grainfall.packing.deposition import Box, deposit, solid_fraction
from grainfall.packing.mixing import Mixture, draw_zones
from grainfall.packing.overgrowth import STANDARD_ERRORS, Overgrowth
from grainfall.packing.parameters import Parameters
from grainfall.packing.placement import Place, move
from grainfall.packing.plan import decide
from grainfall.packing.rest import settle
from grainfall.packing.tail import PoreTail
from grainfall.packing.virtual import (
    EMPTY,
    THROAT,
    VirtualSizes,
    match_porosity,
    sphere_probability,
    virtual_sizes,
)
from grainfall.stereology import SizeDistribution

WIDEST_SPHERE = 0.25
"""Largest virtual-sphere radius over the edge of the region: a wider one would be the region, not in it."""

RESTED = (
    "steps",
    "at_rest",
    "drift_mean",
    "drift_p99",
    "drift_max",
    "net_force",
    "net_force_contacts",
    "energy_rise",
)
"""What a packing's report says of its rest, of what :func:`grainfall.packing.rest.relax` finds."""

MOST_OVERLAP = 0.02
"""Overlap, of the smaller radius, above which the solver is too coarse for the scene."""

Packing = tuple[pd.DataFrame, dict]
"""Bodies and report."""


def parameters_of(packing: Mapping, effects: Mapping) -> Parameters:
    """The parameters that the config's ``packing`` and ``effects`` ask for."""
    return Parameters.named(
        packing["parameters"],
        engine=packing["engine"],
        decomposition=effects["decomposition"],
        **packing["overrides"],
    )


def box_of(scene: Mapping) -> Box:
    """The container of a scene."""
    return Box((scene["edge_um"],) * 3, scene["margin_um"])


def pack(
    scene: Mapping,
    sizes: Mapping[tuple[int, str], SizeDistribution],
    library: Library,
    parameters: Parameters,
    rng: np.random.Generator,
    *,
    spheres: VirtualSizes | None = None,
    p_sphere: float = 0.0,
    void_shapes: bool = False,
    void_scale: float = 1.0,
    rest: bool = True,
    progress: Callable[[str], None] | None = None,
    checkpoints: Path | None = None,
) -> Packing:
    """Draw the bodies of a scene and pour them.

    Parameters
    ----------
    scene : mapping
        As :func:`grainfall.packing.plan_scene` gives it.
    sizes : mapping of (phase, kind) to SizeDistribution
    library : Library
    parameters : Parameters
    rng : numpy.random.Generator
    spheres : VirtualSizes, optional
        Sizes of virtual spheres poured among the grains.
    p_sphere : float
        Probability that the next body is one of them.
    void_shapes : bool
        Whether those as large as the voids of the library take their shapes.
    void_scale : float
        Radius (of equal volume) of such a body over that of its sphere: see :func:`size_voids`.
    rest : bool
        Whether they are set free at the end until they rest; :func:`let_rest` does it later.
    progress : callable, optional
        Called with a line of text as the bed grows.
    checkpoints : Path, optional
        Folder of the states from which a killed packing resumes.

    Returns
    -------
    bodies : DataFrame
        Columns of bodies.csv, um from the corner of the region of interest.
    report : dict
        Content of packing.json, and ``forces``: a DataFrame of normal forces between bodies, a, b (ids) and
        force_n.

    Raises
    ------
    InputError
        When pouring ended before the bed covered the region of interest.
    """
    mixture = Mixture(
        {n: sizes[n, "grain"] for n in range(1, len(scene["phases"]))},
        dict(enumerate(scene["fractions"], start=1)),
        scene["sizes_from"],
        spheres if p_sphere > 0 else None,
        p_sphere,
        _smallest_void(library) if void_shapes else np.inf,
        void_scale,
    )
    box = box_of(scene)
    share = scene["edge_um"] ** 2 / np.prod(box.sides_um)
    population = draw_zones(mixture, library, box.solid_um3(), share, rng)

    bodies = deposit(population, library, box, parameters, rng, progress, checkpoints, rest=rest)
    report = {**bodies.attrs.pop("report"), "p_sp": float(p_sphere)}
    if report["surface_um"] < scene["edge_um"]:
        raise InputError(
            "packing",
            f"the bed ends {report['surface_um']:.4g} um high in a region of {scene['edge_um']:.4g} um: "
            + "; ".join(report["notes"]),
            "more packing.overrides.max_idle_steps, or a faster sleep_speed",
        )
    report["forces"] = pd.DataFrame(bodies.attrs.pop("forces"))
    return bodies, report


def _smallest_void(library: Library) -> float:
    return float(library.table.loc[library.table["phase"] == VOID, "r2d_um"].min())


def mean_void_volume(spheres: VirtualSizes, library: Library, void_scale: float) -> float:
    """Mean volume (um^3) of the virtual bodies, of which those in the shapes of voids are so scaled.

    Parameters
    ----------
    spheres : VirtualSizes
    library : Library
        With shapes of voids: spheres smaller than all of these stay spheres, and as large as they are.
    void_scale : float
        As :func:`pack` takes it.
    """
    return Mixture(
        {}, {}, spheres=spheres, void_from_um=_smallest_void(library), void_scale=void_scale
    ).mean_sphere_volume


def let_rest(
    packing: Packing,
    scene: Mapping,
    library: Library,
    parameters: Parameters,
    taps: int = 0,
    *,
    progress: Callable[[str], None] | None = None,
) -> Packing:
    """A packing of :func:`pack`, tapped so many times and set free until it rests.

    Parameters
    ----------
    packing : (bodies, report)
        Left as it is.
    scene, library, parameters, progress
        Those it was packed with.
    taps : int

    Returns
    -------
    bodies : DataFrame
    report : dict
        That of the packing with its rest, forces, overlaps and solid fraction; ``wall_s`` of both. The height
        of the surface is that of the bed as poured.
    """
    bodies, report = packing
    bodies, found = settle(bodies, library, box_of(scene), parameters, taps=taps, progress=progress)
    return bodies, {
        **report,
        "rest": {k: found[k] for k in RESTED},
        "settled": found["moved_mean"],
        "solid_fraction": solid_fraction(bodies, box_of(scene)),
        "asleep": int(bodies["asleep"].sum()),
        "wall_s": report["wall_s"] + found["wall_s"],
        **{k: found[k] for k in ("forces", "escaped", "max_overlap", "mean_overlap")},
    }


def pack_first(
    pack_with: Callable[[Parameters], Packing],
    parameters: Parameters,
    switch: str,
    progress: Callable[[str], None] | None = None,
) -> Packing:
    """The first packing, repeated with a finer solver where grains came to rest too deep in each other.

    Parameters
    ----------
    pack_with : callable
        Parameters to (bodies, report), with the same random numbers each time.
    parameters : Parameters
    switch : {"auto", "on", "off"}
        Of the refinement.
    progress : callable, optional
        Called with a line of text before all is poured again.

    Returns
    -------
    bodies : DataFrame
    report : dict
        That of the packing kept, ``wall_s`` of both, with ``refinement``: on, forced, reason, cost_s.
    """
    bodies, report = pack_with(parameters)
    overlap = report["max_overlap"]
    words = "exceeds" if overlap > MOST_OVERLAP else "is within"
    refinement = decide(
        switch,
        overlap > MOST_OVERLAP,
        f"the largest overlap of the collision shapes, {overlap:.4f} of the smaller radius, {words} "
        f"{MOST_OVERLAP:g}",
    ) | {"cost_s": None}
    if refinement["on"]:
        coarse_s = report["wall_s"]
        if progress:
            progress(f"poured again with half the time step: {refinement['reason']}")
        bodies, report = pack_with(parameters.refined())
        refinement["cost_s"] = report["wall_s"]
        refinement["reason"] += (
            f"; with half the time step and twice the solver iterations it is {report['max_overlap']:.4f}"
        )
        report = {**report, "wall_s": coarse_s + report["wall_s"]}
    return bodies, {**report, "refinement": refinement}


def plan_deficit(
    scene: Mapping,
    target: SizeDistribution | None,
    first: SizeDistribution | None,
    tail: PoreTail,
    overgrowth: Overgrowth,
    porosity_first: float,
    mean_grain_volume: float,
    *,
    voids: int = 0,
    between: Intergranular | None = None,
    switch: str = "auto",
    cement: str = "auto",
    void_shapes: str = "auto",
    limit: float = 0.01,
) -> tuple[VirtualSizes, dict]:
    """What the first packing lacks of the target, and the virtual spheres that would make up for it.

    Spheres are called for by the porosity or by the large pores. Where the porosity calls for them, they have
    all the radii that the first packing is short of, as many as the porosity wants. Where only the large
    pores do (vugs in a dense rock), they have the radii of the tail alone and keep their share, and the
    grains about them may have to be packed denser.

    Where the section's grains have grown together, cement is to take the surface that a packing has beyond
    theirs, and the packings aim above the target by what it will fill; above what grains pour to only where
    the target is, too, since nothing but spheres would open the bed so far.

    Parameters
    ----------
    scene : mapping
    target, first : SizeDistribution or None
        Pore circles of the section and of slices of the first packing, unfolded; None without circles.
    tail : PoreTail
        Large pores of the two compared.
    overgrowth : Overgrowth
        Surfaces of the two compared.
    porosity_first : float
        Porosity of the first packing.
    mean_grain_volume : float
        Mean grain volume over all phases, um^3.
    voids : int
        Shapes of voids in the library.
    between : Intergranular, optional
        How porous the section is between its voids.
    switch, cement, void_shapes : {"auto", "on", "off"}
        Of the virtual spheres, of the cement, and of the shapes of voids in place of large spheres.
    limit : float
        Porosity that the final scaling of positions can mend.

    Returns
    -------
    sizes : VirtualSizes
    deficit : dict
        porosity_first, porosity_target, mean_sphere_volume_um3, mean_grain_volume_um3, tail (of
        :class:`PoreTail`), overgrowth: on, forced, called_for, reason, filled, section_per_um,
        porosity (before the rims, what the packings aim for: the target where there are none); and
        virtual_spheres: on, forced, called_for, reason, p_sp (first guess), for_tail (whether the tail alone
        called for them, so that they keep their share); void_shapes: on, forced, called_for, reason; and
        between, where spheres are to hold voids open that the section has: radius_um, porosity and error
        (of the section between them), wanted (the same before the rims).
    """
    target_porosity = scene["porosity_target"]
    wanted = overgrowth.porosity_before(target_porosity, porosity_first)
    if target_porosity <= porosity_first + limit:
        wanted = min(wanted, max(target_porosity, porosity_first))
    fill = wanted - target_porosity
    rims = decide(
        cement,
        overgrowth.exceeds and fill > 0,
        f"{overgrowth.words}; rims that closed their contacts would fill {fill:.4f} of the region",
        possible=fill > 0,
    )
    wanted = wanted if rims["on"] else target_porosity
    aim = f"porosity {wanted:.4f} before the rims" if rims["on"] else f"target porosity {wanted:.4f}"
    short = wanted - porosity_first
    # Pores of the volume share v in a matrix of the first packing's porosity.
    with_tail = tail.share + (1 - tail.share) * porosity_first
    for_tail = tail.exceeds and short <= limit
    radius = (3 * mean_grain_volume / (4 * np.pi)) ** (1 / 3)
    sizes = virtual_sizes(
        target,
        first,
        smallest_um=max(THROAT * radius, tail.first_um if for_tail else 0.0),
        largest_um=WIDEST_SPHERE * scene["edge_um"],
    )
    if short > limit:
        reason = f"the {aim} exceeds the first packing's {porosity_first:.4f}"
    elif short >= -limit:
        reason = f"the first packing's {porosity_first:.4f} is within {limit:g} of the {aim}"
    else:
        reason = f"the {aim} is below the first packing's {porosity_first:.4f}"
    reason += f"; {tail.words}"
    reason += f"; {sizes.reason}" if sizes.reason else ""
    spheres = decide(
        switch,
        (short > limit or for_tail) and sizes.called_for,
        reason,
        possible=(short > 0 or for_tail) and sizes.called_for,
    )
    holding = "virtual spheres hold" if spheres["on"] else "no virtual spheres hold"
    shaped = decide(
        void_shapes,
        spheres["on"] and tail.exceeds and voids > 0,
        f"{holding} voids open, {voids or 'no'} shapes of the section's voids were made; {tail.words}",
        possible=spheres["on"] and voids > 0,
    )
    held = None
    if between is not None and spheres["on"] and tail.exceeds and not for_tail:
        # rims fill pores between the voids, which have 1 - v = (1 - phi) / (1 - phi_between) of the region
        fill = (wanted - target_porosity) * (1 - between.porosity) / (1 - target_porosity)
        held = {
            "radius_um": between.radius_um,
            "porosity": between.porosity,
            "error": between.error,
            "wanted": between.porosity + fill,
        }
    return sizes, {
        "porosity_first": float(porosity_first),
        "porosity_target": float(target_porosity),
        "mean_sphere_volume_um3": sizes.mean_volume,
        "mean_grain_volume_um3": float(mean_grain_volume),
        "tail": {
            "target_um": tail.target_um,
            "first_um": tail.first_um,
            "excess_um": tail.excess_um,
            "share": tail.share,
            "exceeds": tail.exceeds,
        },
        "overgrowth": {
            **rims,
            "filled": float(overgrowth.filled),
            "porosity": float(wanted),
            "section_per_um": float(overgrowth.section.per_um),
        },
        "virtual_spheres": {
            **spheres,
            "for_tail": bool(for_tail),
            "p_sp": sphere_probability(
                with_tail if for_tail else wanted, porosity_first, sizes.mean_volume, mean_grain_volume
            )
            if spheres["on"]
            else 0.0,
        },
        "void_shapes": shaped,
        "between": held,
    }


def size_voids(
    deficit: Mapping,
    pour: Callable[[float], Packing],
    width_of: Callable[[pd.DataFrame], float | None],
    volume_of: Callable[[float], float],
    porosity_of: Callable[[pd.DataFrame], float],
    between_of: Callable[[pd.DataFrame], float | None] = lambda bodies: None,
) -> dict:
    """How large to pour bodies in the shapes of voids, for voids as wide as their spheres were to be.

    Grains touch such a body here and there and leave gaps between, so the void that it leaves is wider than a
    sphere of its volume. The section's circles were unfolded as if voids were spheres: it is the circles on
    sections that have to agree. They are found on a packing of bodies with the volumes of the spheres; bodies
    are then poured smaller by the width found.

    As many are poured as :func:`sphere_probability` says, with what grains and bodies together fill of that
    packing in place of what grains alone do. Beds of one share of bodies differ in how many of them the
    region has, a tenth of all with a hundred of them, and hardly in how much is filled, so the porosity of
    the grains alone would tell less.

    Parameters
    ----------
    deficit : mapping
        As :func:`plan_deficit` gives it.
    pour : callable
        Probability of a sphere to (bodies, report) as poured, with volumes kept.
    width_of : callable
        Bodies to the width of their voids over that of their spheres (:func:`grainfall.volume.void_width`).
    volume_of : callable
        Scale to the mean volume of a virtual body (:func:`mean_void_volume`).
    porosity_of : callable
        Bodies to the porosity that is left beside them.
    between_of : callable, optional
        Bodies to their grains' porosity between voids.

    Returns
    -------
    dict
        width (None where no void could be measured), scale (1 / width), volume_um3 (mean volume of a body so
        scaled), p_sp (next guess of the probability; the share is kept where the large pores alone call for
        bodies), and of that packing filled (porosity beside grains and bodies), between (porosity between
        voids, or None) and wall_s.
    """
    bodies, report = pour(deficit["virtual_spheres"]["p_sp"])
    width = width_of(bodies)
    scale = 1.0 if width is None else 1.0 / width
    filled, volume = float(porosity_of(bodies)), volume_of(scale)
    p_sp = _odds_times(deficit["virtual_spheres"]["p_sp"], volume_of(1.0) / volume)
    if not deficit["virtual_spheres"]["for_tail"]:
        p_sp = _share(deficit, filled, volume, p_sp)
    return {
        "width": width,
        "scale": scale,
        "volume_um3": volume,
        "p_sp": p_sp,
        "filled": filled,
        "between": between_of(bodies),
        "wall_s": report["wall_s"],
    }


FRICTIONS = 3
"""Beds tried at most between full friction and the least."""


def match_between(
    deficit: Mapping,
    rough: Mapping,
    pour: Callable[[float, float], Packing],
    porosity_of: Callable[[pd.DataFrame], float],
    between_of: Callable[[pd.DataFrame], float | None],
) -> dict:
    """Friction at which grains lie as densely between the voids as the section's do.

    Virtual spheres loosen the grains about them. Where the porosity is met, a bed that is too loose between
    its voids has too few of them:

        1 - phi = (1 - v) (1 - phi_between)

    for void share v. A bed is poured with as little friction as lubrication allows and as many spheres more
    as v has to grow, and the factor on friction is interpolated between the two: porosity goes about with the
    logarithm of friction, and so does what grains and spheres fill together, which tells how many spheres the
    target then takes (:func:`sphere_probability`). What is found there takes the place of one of the two,
    until it is what the section's is known to: bodies poured smaller are more, and loosen a bed further. Beds
    scatter about as much as that, so the best of :data:`FRICTIONS` has to do.

    Parameters
    ----------
    deficit : mapping
        As :func:`plan_deficit` gives it.
    rough : mapping
        Of a bed of ``p_sp`` at full friction: filled (porosity beside grains and spheres), between (porosity
        between voids), volume_um3 (mean volume of a sphere).
    pour : callable
        (probability of a sphere, factor on friction) to (bodies, report) as poured.
    porosity_of : callable
        Bodies to the porosity that is left beside them.
    between_of : callable
        Grains alone to their porosity between voids.

    Returns
    -------
    dict
        lubrication (factor on friction), p_sp (next guess of the probability), rough and slick (porosity
        between voids with full and with the least friction), tries (lubrication, p_sp and between of the beds
        between those), wall_s (of all beds but the last try where that is the best: it is then the first pass
        of what follows).
    """
    wanted, p_sp = deficit["between"]["wanted"], deficit["virtual_spheres"]["p_sp"]
    held, needed = (
        1 - (1 - deficit["overgrowth"]["porosity"]) / (1 - min(matrix, EMPTY))
        for matrix in (rough["between"], wanted)
    )
    p_sp = _odds_times(p_sp, needed / held if held > 0 and needed > 0 else 1.0)
    bodies, report = pour(p_sp, SLICK)
    slick, filled = between_of(bodies[bodies["kind"] == "grain"]), float(porosity_of(bodies))
    found = {"rough": float(rough["between"]), "slick": slick, "tries": []}
    wall_s = report["wall_s"]
    if slick is None or slick >= wanted:
        p_sp = _share(deficit, filled, rough["volume_um3"], p_sp)
        return found | {"lubrication": SLICK, "p_sp": p_sp, "wall_s": wall_s}
    looser, denser = (0.0, rough["between"], rough["filled"]), (1.0, slick, filled)
    for _ in range(FRICTIONS):
        share = (looser[1] - wanted) / (looser[1] - denser[1])
        way, filled = (a + share * (b - a) for a, b in zip(looser[::2], denser[::2], strict=True))
        lubrication, p_sp = float(SLICK**way), _share(deficit, filled, rough["volume_um3"], p_sp)
        wall_s += report["wall_s"] if found["tries"] else 0.0
        bodies, report = pour(p_sp, lubrication)
        between = between_of(bodies[bodies["kind"] == "grain"])
        found["tries"].append({"lubrication": lubrication, "p_sp": p_sp, "between": between})
        if between is None or abs(between - wanted) <= deficit["between"]["error"]:
            break
        there = way, between, float(porosity_of(bodies))
        looser, denser = (there, denser) if between > wanted else (looser, there)
    best = min(
        found["tries"], key=lambda one: np.inf if one["between"] is None else abs(one["between"] - wanted)
    )
    wall_s += 0.0 if best is found["tries"][-1] else report["wall_s"]
    return found | {"lubrication": best["lubrication"], "p_sp": best["p_sp"], "wall_s": wall_s}


def _share(deficit: Mapping, filled: float, volume_um3: float, otherwise: float) -> float:
    """Probability of a body of this mean volume, where grains and bodies leave a porosity beside them."""
    wanted = deficit["overgrowth"]["porosity"]
    if not 0 < filled < wanted:
        return otherwise
    return sphere_probability(wanted, filled, volume_um3, deficit["mean_grain_volume_um3"])


def _odds_times(p: float, factor: float) -> float:
    """The probability whose odds are so many times those of another."""
    odds = p / (1 - p) * factor
    return odds / (1 + odds)


class _Trials:
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


def pack_again(
    deficit: Mapping,
    pour_with: Callable[[float, float], Packing],
    rested: Callable[[Packing, float, int], Packing],
    porosity_of: Callable[[pd.DataFrame], float],
    first: Packing,
    between_of: Callable[[pd.DataFrame], float | None] = lambda grains: None,
    *,
    voids: Mapping | None = None,
    place_of: Callable[[pd.DataFrame, float], Place] | None = None,
    densification: str = "auto",
    placement: str = "auto",
    limit: float = 0.01,
    passes: int = 8,
) -> Packing:
    """The second packing: virtual spheres, then densification, until the grains' porosity is what is wanted:
    the target's, or what leaves room for the rims of grains grown together.

    Where the spheres hold voids open that the section has, grains are first lubricated until they lie as
    densely between them as the section's do (:func:`match_between`).

    Of one share of spheres, beds differ in how many of them the region has, not in how much grains and
    spheres fill of it. So where the porosity misses in the middle of the bed, the region is moved to where it
    does not, if that is near enough.

    Parameters
    ----------
    deficit : mapping
        As :func:`plan_deficit` gives it.
    pour_with : callable
        (probability of a sphere, factor on friction) to (bodies, report) as poured, with the same random
        numbers each time.
    rested : callable
        (such a packing, factor on friction, taps) to the same, tapped so many times and come to rest.
    porosity_of : callable
        Grains alone to their porosity.
    first : (bodies, report)
        The first packing; it is the second where nothing is called for.
    between_of : callable, optional
        Grains to their porosity between voids; None where that cannot be told.
    voids : mapping, optional
        As :func:`size_voids` gives it, where bodies have the shapes of voids.
    place_of : callable, optional
        (grains alone, porosity) to the place near the middle where a region is nearest that
        (:func:`nearest_place`).
    placement : {"auto", "on", "off"}
        Whether the region is moved there: auto where it misses in the middle and not there.
    densification : {"auto", "on", "off"}
        auto where the target is below what the grains pour to, or grains between voids lie looser than the
        section's.
    limit : float
        Distance from the target that ends the passes.
    passes : int
        Most packings tried by the feedback of either effect.

    Returns
    -------
    bodies : DataFrame
    report : dict
        That of the packing kept (solid_fraction and surface_um of the middle), with ``passes`` (p_sphere,
        lubrication, taps, porosity, moved_um, at_rest, wall_s of each; one that misses as poured is not
        brought to rest), ``porosity``, ``reached``, ``reason`` (why not), ``placement``: on, forced,
        called_for, reason, moved_um (the bodies are counted from the corner of the region where it lies),
        ``densification``: on, forced, called_for, reason, too_loose (whether the grains were, not what their
        spheres opened), and ``between``: None, or what :func:`match_between` gives, with ``came_to``:
        porosity between voids of the packing kept.
    """
    target, spheres = deficit["overgrowth"]["porosity"], deficit["virtual_spheres"]
    aim = f"{'porosity' if deficit['overgrowth']['on'] else 'target porosity'} {target:.4f}"
    aim += " before the rims" if deficit["overgrowth"]["on"] else ""
    # Spheres that were to open the bed and opened it too far are a missed feedback, not a bed too loose.
    fillable = spheres["for_tail"] or not spheres["on"]
    trials = _Trials(pour_with, rested, porosity_of, place_of, placement, target, limit, fillable)
    missed, dense, between, lubrication = "", None, None, 1.0
    if spheres["on"]:
        p_sphere, loose = spheres["p_sp"], deficit["porosity_first"]
        if deficit["between"] is not None:
            dense, between = _denser_between(deficit, trials, between_of, voids, densification)
        if between is not None:
            p_sphere, lubrication = between["p_sp"], between["lubrication"]
        if spheres["for_tail"]:
            loose = trials(p_sphere)
        left = passes - len(trials.passes)
        if left and (loose < target - limit or not spheres["for_tail"]):
            guess = _odds_times(p_sphere, 2) if trials.passes else p_sphere
            missed = match_porosity(
                lambda p: trials(p, lubrication),
                float,
                target,
                guess,
                deficit["porosity_first"],
                limit,
                left,
            ).reason
            p_sphere, loose = trials.kept[0], trials.porosity
    else:
        p_sphere, loose = 0.0, deficit["porosity_first"]
        trials.keep(first, Place.unmoved(loose), at_rest=True, made_with=(0.0, 1.0))
    too_loose = loose - target if fillable else 0.0
    what = "with its virtual spheres" if spheres["on"] else "of grains alone"
    if too_loose > 0 or loose - target > limit:
        reason = f"the {aim} is below the {loose:.4f} of the packing {what}"
        reason += "" if fillable else ", which they opened, not its grains"
    else:
        reason = f"the packing {what} is no looser than the {aim}"
    if dense is None:
        dense = decide(densification, too_loose > limit, reason, possible=too_loose > 0)
    if dense["on"] and between is None:
        missed = match_density(
            lambda lubrication, taps: trials(p_sphere, lubrication, taps), loose, target, limit, passes
        )
        dense["reason"] += f"; {missed}" if missed else ""
    bodies, report = trials.best()
    if between is not None:
        between["came_to"] = between_of(bodies[bodies["kind"] == "grain"])
        dense["reason"] += f"; with friction times {lubrication:.2g}"
        dense["reason"] += "" if between["came_to"] is None else f" it is {between['came_to']:.3f} porous"
    dense["too_loose"] = bool(too_loose > limit)
    reached = abs(trials.porosity - target) <= limit
    return bodies, {
        **report,
        "passes": trials.passes,
        "porosity": trials.porosity,
        "reached": reached,
        "reason": "" if reached else (missed or dense["reason"]) + trials.words,
        "placement": trials.placement(),
        "densification": dense,
        "between": between,
    }


def _denser_between(
    deficit: Mapping,
    trials: _Trials,
    between_of: Callable[[pd.DataFrame], float | None],
    voids: Mapping | None,
    switch: str,
) -> tuple[dict, dict | None]:
    """Whether grains are to lie denser between voids, and with what friction they do."""
    held, rough, wall_s = deficit["between"], voids, 0.0
    if rough is None:
        bodies, report = trials.pour(deficit["virtual_spheres"]["p_sp"])
        rough = {
            "filled": float(trials.porosity_of(bodies)),
            "between": between_of(bodies[bodies["kind"] == "grain"]),
            "volume_um3": deficit["mean_sphere_volume_um3"],
        }
        wall_s = report["wall_s"]
    if rough["between"] is None:
        return decide(switch, False, "nothing of the region lies between voids", possible=False), None
    exceeds = rough["between"] - held["wanted"] > STANDARD_ERRORS * held["error"]
    before = f", {held['wanted']:.3f} before the rims," if deficit["overgrowth"]["on"] else ""
    dense = decide(
        switch,
        exceeds,
        f"between voids the packing with its virtual spheres is {rough['between']:.3f} porous, which "
        f"{'exceeds' if exceeds else 'does not exceed'} the section's {held['porosity']:.3f}{before} beyond "
        "sampling",
        possible=rough["between"] > held["wanted"],
    )
    if not dense["on"]:
        return dense, None
    found = match_between(deficit, rough, trials.pour, trials.porosity_of, between_of)
    return dense, {**found, "wall_s": wall_s + found["wall_s"]}
