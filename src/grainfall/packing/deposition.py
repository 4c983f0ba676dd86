"""Grains poured into a box until the region of interest lies well inside the settled bed."""

from __future__ import annotations

import hashlib
import json
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd

from grainfall import io
from grainfall.errors import InputError
from grainfall.packing.bed import Bed, Frame, in_units
from grainfall.packing.parameters import Parameters
from grainfall.packing.rest import relax
from grainfall.packing.scene import POURED
from grainfall.packing.shapes import SPHERE, collision_shapes

Packing = tuple[pd.DataFrame, dict]
"""Bodies and report."""


@dataclass(frozen=True)
class Box:
    """The container and the region of interest (ROI) inside it, micrometres, origin at the ROI's corner.

    Attributes
    ----------
    roi_um : (3,) tuple of float
        Edges of the ROI along x, y, z.
    margin_um : float
        Distance of the ROI from each wall, from the floor, and at least from the free surface.
    """

    roi_um: tuple[float, float, float]
    margin_um: float

    @property
    def sides_um(self) -> tuple[float, float]:
        """Inner width of the container along x and y."""
        return self.roi_um[0] + 2 * self.margin_um, self.roi_um[1] + 2 * self.margin_um

    @property
    def height_um(self) -> float:
        """Height of the free surface that is wanted, above the floor."""
        return self.roi_um[2] + 2 * self.margin_um

    def solid_um3(self, fraction: float = POURED) -> float:
        """Solid volume that fills the container to that height at this solid fraction."""
        return self.sides_um[0] * self.sides_um[1] * self.height_um * fraction


def container(roi_um: float | tuple[float, float, float], diameter_um: float, margin: float = 2.5) -> Box:
    """The container for a region of interest.

    Walls and floor order grains over two to three diameters (a random packing's oscillating density profile),
    so the ROI keeps that distance from them and from the free surface.

    Parameters
    ----------
    roi_um : float or (x, y, z)
        Edge(s) of the region of interest.
    diameter_um : float
        Mean grain diameter.
    margin : float
        Distance in mean diameters.

    Raises
    ------
    InputError
        When the ROI is not positive or narrower than two mean diameters.
    """
    edges = tuple(float(e) for e in np.broadcast_to(np.asarray(roi_um, float), 3))
    if not diameter_um > 0 or not margin >= 0:
        raise InputError(
            "packing.margin", f"margin {margin} of grains of {diameter_um} um", "both must be positive"
        )
    if min(edges) < 2 * diameter_um:
        raise InputError(
            "packing.roi_um",
            f"a region of {min(edges):.4g} um holds less than two mean grains of {diameter_um:.4g} um",
            "make the region of interest at least 8 mean grains wide",
        )
    return Box(edges, margin * diameter_um)


@dataclass
class Report:
    """What a deposition did, for packing.json.

    ``unit_um`` is one engine length (the mean grain radius), ``unit_s`` what one engine second stands for
    under the gravity given; energies are in engine units. Overlaps are of collision shapes, in radii of the
    smaller grain. ``n_spheres``, ``n_hulls`` and ``n_decomposed`` count the grains poured by how they
    collided. ``hull_excess`` is the mean of V_hull / V - 1 over those with a mesh, ``collision_excess`` the
    same of the shapes that collided, ``hull_deviation`` the mean of the largest distance between collision
    shape and hull, in grain radii. ``largest`` is the radius of the largest body, mean grain radii.
    ``rest`` is what :func:`grainfall.packing.rest.relax` found when all bodies were set free at the end, and
    ``settled`` the mean way that took them, in mean grain radii.
    """

    engine: str = ""
    parameters: dict = field(default_factory=dict)
    unit_um: float = 0.0
    unit_s: float = 0.0
    poured: int = 0
    poured_grains: int = 0
    supply: int = 0
    supply_rounds: int = 1
    asleep: int = 0
    escaped: int = 0
    steps: int = 0
    wall_s: float = 0.0
    surface_um: float = 0.0
    surface_needed_um: float = 0.0
    solid_fraction: float = 0.0
    max_overlap: float | None = None
    mean_overlap: float | None = None
    n_spheres: int = 0
    n_hulls: int = 0
    n_decomposed: int = 0
    hull_excess: float = 0.0
    collision_excess: float = 0.0
    hull_deviation: float = 0.0
    largest: float = 0.0
    mean_active: float = 0.0
    rest: dict = field(default_factory=dict)
    settled: float = 0.0
    notes: list[str] = field(default_factory=list)


def deposit(
    population: pd.DataFrame,
    library,
    box: Box,
    parameters: Parameters,
    rng: np.random.Generator,
    progress: Callable[[str], None] | None = None,
    checkpoints: Path | None = None,
    *,
    rest: bool = True,
) -> pd.DataFrame:
    """Pour grains into the box and let them settle.

    Grains are released in batches, at random positions and orientations, a few radii above the bed. A body
    that stays below ``sleep_speed`` for ``sleep_steps`` consecutive steps (looked at every :data:`LOOK`
    steps) is fixed in place; only the bodies above the fixed bed are simulated, so a step costs the same at
    any depth. Pouring goes on until the settled surface over the ROI is ``box.margin_um`` above it. Then all
    bodies are set free together and come to rest once more (:func:`grainfall.packing.rest.relax`).

    Every ``checkpoint_steps`` steps the engine is built anew from the bodies' state, since its caches do not
    survive a save: a packing that was killed and resumed then has the same bytes as one that was not.

    Parameters
    ----------
    population : DataFrame
        The supply in pour order: kind (``grain`` or ``virtual``), phase, shape (-1: sphere), scale
        (equal-volume radius, um); optional over_roi: whether the body is released over the ROI or around it
        (anywhere if omitted), and density (the parameters' if omitted). It is poured as far as needed and,
        should it run out, again from its start.
    library : grainfall.grains.Library
        Shapes: ``vertices``, ``faces``, equal-volume radius 1, centre of mass at the origin.
    box : Box
    parameters : Parameters
    rng : numpy.random.Generator
    progress : callable, optional
        Called with a line of text as the bed grows and comes to rest.
    checkpoints : Path, optional
        Folder for the state at each checkpoint, under a name that depends on all the arguments: a packing
        that is found there is resumed. Remove it when the result is safe.
    rest : bool
        Whether the bodies are set free at the end. :func:`grainfall.packing.rest.settle` does it later.

    Returns
    -------
    DataFrame
        Columns of bodies.csv; lengths in um from the ROI's corner; every body poured, inside the ROI or not.
        ``attrs["report"]`` is the deposition's :class:`Report` as a dict; ``attrs["forces"]`` the normal
        forces between bodies at rest, as lists a, b (ids) and force_n. Without ``rest`` the report says
        nothing of rest and overlaps, and there are no forces.

    Raises
    ------
    InputError
        When the population is empty or has a grain that does not fit the box.
    """
    return _Deposition(population, library, box, parameters, rng, progress, checkpoints).run(rest)


def solid_fraction(bodies: pd.DataFrame, box: Box) -> float:
    """Volume of the bodies centred in the region of interest over the region's."""
    roi, xyz = np.array(box.roi_um), bodies[["x", "y", "z"]].to_numpy()
    within = ((xyz >= 0) & (xyz < roi)).all(axis=1)
    return float(4 / 3 * np.pi * (bodies["scale"][within] ** 3).sum() / roi.prod())


LOOK = 10
"""Steps between two looks at the speeds of the moving bodies."""

RELEASE_FRACTION = 0.12
"""Bounding-sphere fraction of the zone that a batch is released into: random addition stays easy."""

TRIES, TRIES_AT_ONCE = 200, 20
"""Random places tried for one grain before it waits for the next batch."""

LEAST_AROUND = 0.05
"""Share of the floor around the ROI below which a grain is released anywhere: its random places would all be
over the ROI, and it would block the line."""

BOUNCY = 0.8
"""Coefficient of restitution up to which grains are waited for until they have bounced out: that takes
(1 + e) / (1 - e) times as long as their fall, without bound."""

FRESH = 0.6
"""Solid fraction that grains are reckoned with until they lie: how high a volume of them will come."""

FALLING = 1.0
"""Speed, engine units / s, above which a body still falls: that of a fall over a twentieth of a radius."""


class _Deposition:
    def __init__(self, population, library, box, parameters, rng, progress, checkpoints):
        self.started = time.perf_counter()
        if not len(population):
            raise InputError("population", "is empty", "draw at least one grain")
        self.box, self.given, self.rng, self.progress = box, parameters, rng, progress
        grains = population[population["kind"] == "grain"]
        unit = float((grains if len(grains) else population)["scale"].mean())
        self.kind = population["kind"].to_numpy(object)
        self.phase = population["phase"].to_numpy(int)
        self.shape = population["shape"].to_numpy(int)
        self.radius = in_units(population["scale"], unit)
        self.over = population["over_roi"].to_numpy(bool) if "over_roi" in population else None
        self.density = np.full(len(population), parameters.density)
        if "density" in population:
            self.density = population["density"].to_numpy(float)
        contrast = self.density.max() / self.density.min()
        self.parameters = parameters = parameters.suited(self.radius.min(), contrast)
        shapes = collision_shapes(library, np.unique(self.shape), parameters)
        self.bound = self.radius * np.array([shapes[s].bound for s in self.shape])
        self.sides = in_units(box.sides_um, unit)
        if 2 * self.bound.max() >= self.sides.min():
            widest = self.bound.argmax()
            what = "virtual sphere" if self.kind[widest] == "virtual" else "grain"
            raise InputError(
                "scene.edge_um",
                f"a {what} {2 * self.bound[widest] * unit:.4g} um wide does not fit "
                f"a box of {self.sides.min() * unit:.4g} um",
                "a larger region of interest, or margin around it",
            )
        self.unit = unit
        self.margin, self.height = in_units((box.margin_um, box.height_um), unit)
        self.roi = in_units(box.roi_um[:2], unit)
        self.bed = Bed(shapes, parameters, self.sides, Frame(unit, box.margin_um))
        self.next = 0  # place in the endless supply
        self.speed = np.empty(0)
        self.still = np.empty(0, int)  # consecutive steps at rest
        self.steps = self.idle = self.activity = 0
        self.poured = False
        self.notes: list[str] = []
        if parameters.dt < self.given.dt:
            self.notes.append(f"time step {parameters.dt:.3g} for {self.given.dt:.3g}: the smallest grain's")
        self._survey()
        self.file = None
        if checkpoints is not None:
            self.file = Path(checkpoints) / f"{self._fingerprint(population, shapes)}.npz"

    def run(self, rest: bool) -> pd.DataFrame:
        bed = self.bed
        if self.file is not None and self.file.exists():
            try:
                self._load(io.read_arrays(self.file))
            except InputError as fault:
                # A damaged checkpoint costs its time, not the packing.
                if self.progress:
                    self.progress(f"starts anew: {fault}")
        bed.start(buried=False)
        saved, expected = self.steps, max(1, self._expected())
        while not self.poured:
            active = np.flatnonzero(~bed.fixed)
            if self._wanted(active):
                self._release()
            elif not len(active):
                break
            self._advance()
            if self.progress:
                self.progress(
                    f"{bed.fixed.sum()} of about {max(expected, len(bed))} bodies settled, "
                    f"{len(bed)} poured, step {self.steps}"
                )
            if self.idle >= self.parameters.max_idle_steps:
                self.notes.append(
                    f"ended with {int((~bed.fixed).sum())} bodies still moving: none came to rest in "
                    f"{self.idle} steps"
                )
                break
            if self.steps - saved >= self.parameters.checkpoint_steps:
                saved = self.steps
                self._save()
                bed.start(buried=False)
        if not self.poured:
            self.poured = True
            self._save()
        report = Report(
            engine=bed.engine.version,
            parameters=asdict(self.given),
            unit_um=self.unit,
            unit_s=(self.unit * 1e-6 * self.parameters.gravity / self.given.gravity) ** 0.5,
            supply=len(self.kind),
            notes=self.notes,
        )
        asleep, forces = bed.fixed.copy(), pd.DataFrame({"a": [], "b": [], "force_n": []})
        if rest:
            before = bed.position.copy()
            report.rest = relax(bed, progress=self.progress)
            report.settled = float(np.linalg.norm(bed.position - before, axis=1).mean())
            asleep, forces = report.rest.pop("asleep_each"), report.rest.pop("forces")
            report.max_overlap, report.mean_overlap = bed.overlaps()
        bed.close()
        report.asleep = int(asleep.sum())
        bodies = bed.table(asleep)
        self._describe(report, bodies, rest)
        bodies.attrs |= {"report": asdict(report), "forces": forces.to_dict("list")}
        return bodies

    # --- checkpoints ------------------------------------------------------------------------------

    def _fingerprint(self, population, shapes) -> str:
        """A name that tells packings apart by everything that decides them."""
        digest = hashlib.blake2b(digest_size=12)
        digest.update(population.to_csv().encode())
        digest.update(repr((asdict(self.parameters), self.box, self.rng.bit_generator.state)).encode())
        for shape in shapes.values():
            for part in (*shape.parts, shape.inertia, shape.frame.as_quat()):
                digest.update(np.ascontiguousarray(part).tobytes())
        return digest.hexdigest()

    def _save(self) -> None:
        if self.file is None:
            return
        bed = self.bed
        self.spent = time.perf_counter() - self.started
        plain = {name: getattr(self, name) for name in PLAIN}
        plain["rng"] = self.rng.bit_generator.state
        arrays = {name: getattr(bed, name) for name in BODY}
        arrays |= {"speed": self.speed, "still": self.still, "virtual": bed.kind == "virtual"}
        io.write_arrays(self.file, arrays | {"plain": np.array(json.dumps(plain))})

    def _load(self, found: dict[str, np.ndarray]) -> None:
        for name in BODY:
            setattr(self.bed, name, found[name])
        self.bed.kind = np.where(found["virtual"], "virtual", "grain").astype(object)
        self.speed, self.still = found["speed"], found["still"]
        plain = json.loads(str(found["plain"]))
        self.rng.bit_generator.state = plain.pop("rng")
        for name, value in plain.items():
            setattr(self, name, value)
        self.started = time.perf_counter() - self.spent
        self._survey()

    # --- the supply -------------------------------------------------------------------------------

    def _expected(self) -> int:
        volume = 4 / 3 * np.pi * (self.radius**3).mean()
        return int(self.sides.prod() * self.height * FRESH / volume)

    def _wanted(self, active: np.ndarray) -> bool:
        """Whether another batch is needed and the zone of release is clear."""
        bed = self.bed
        if len(active):
            falling = self.speed[active] > FALLING
            tops = bed.position[active, 2] + bed.bound[active]
            if (tops[falling] > self._top() + self.parameters.drop_height).any():
                return False
        in_flight = 4 / 3 * np.pi * (bed.radius[active] ** 3).sum()
        return self._surface() + in_flight / (FRESH * self.sides.prod()) < self.height

    def _survey(self) -> None:
        """Heights of the fixed bed: tops over the whole box, centres over the ROI (a lone grain's top is not
        yet a bed)."""
        self.tops = np.zeros(np.maximum(1, (self.sides / 4).astype(int)))
        self.centres = np.zeros(np.maximum(1, (self.roi / 4).astype(int)))
        self._raise(np.flatnonzero(self.bed.fixed))

    def _raise(self, ids: np.ndarray) -> None:
        bed = self.bed
        xy, z = bed.position[ids, :2], bed.position[ids, 2]
        _raise(self.tops, xy / self.sides, z + bed.bound[ids])
        _raise(self.centres, (xy - self.margin) / self.roi, z)

    def _top(self) -> float:
        """Top of the bed above which grains are released; one high grain does not raise it."""
        bed = self.bed
        resting = np.flatnonzero(~bed.fixed & (self.speed <= FALLING))
        tops = self.tops.copy()
        _raise(tops, bed.position[resting, :2] / self.sides, bed.position[resting, 2] + bed.bound[resting])
        return float(np.quantile(tops, 0.9))

    def _surface(self) -> float:
        """Height of the fixed bed over the ROI: the lowest tenth of its columns, two mean diameters wide."""
        return float(np.quantile(self.centres, 0.1))

    def _release(self) -> None:
        """Place the next batch at random in the zone of release, without overlap."""
        p, bed = self.parameters, self.bed
        batch, volume, bounds = [], 0.0, 0.0
        wanted = p.batch_layers * 2 * self.sides.prod() * FRESH
        while volume < wanted:
            row = (self.next + len(batch)) % len(self.kind)
            batch.append(row)
            volume += 4 / 3 * np.pi * self.radius[row] ** 3
            bounds += 4 / 3 * np.pi * self.bound[row] ** 3
        depth = max(bounds / (RELEASE_FRACTION * self.sides.prod()), 2.2 * self.bound[batch].max())
        floor = self._top() + p.drop_height
        high = np.flatnonzero(bed.position[:, 2] + bed.bound > floor)
        places = np.empty((len(high) + len(batch), 3))
        radii = np.empty(len(places))
        places[: len(high)], radii[: len(high)] = bed.position[high], bed.bound[high]
        n = len(high)
        rows, quaternions = [], []
        for row in batch:
            quaternion = random_quaternion(self.rng)
            place = self._place(row, floor, depth, places[:n], radii[:n])
            if place is None:
                break  # it waits for the next batch, first in line
            places[n], radii[n] = place, self.bound[row]
            n += 1
            rows.append(row)
            quaternions.append(quaternion)
        if not rows:
            return
        velocity = np.tile([0, 0, -2.0 * FALLING], (len(rows), 1))
        bed.enter(
            self.kind[rows],
            self.phase[rows],
            self.shape[rows],
            self.radius[rows],
            places[n - len(rows) : n],
            np.array(quaternions),
            velocity,
            self.density[rows],
        )
        self.next += len(rows)
        height = places[n - len(rows) : n, 2]
        sinking = height * [bed.drag(i) for i in range(len(bed) - len(rows), len(bed))] / p.gravity
        fall = max((2 * height.max() / p.gravity) ** 0.5, sinking.max())
        e = min(p.restitution, BOUNCY)
        self.idle = -round(fall * (1 + e) / (1 - e) / p.dt)  # until it has bounced out
        self.speed = np.append(self.speed, np.full(len(rows), 2.0 * FALLING))
        self.still = np.append(self.still, np.zeros(len(rows), int))

    def _place(self, row: int, floor: float, depth: float, places, radii) -> np.ndarray | None:
        """A random place for one body in the zone of release, over the ROI or around it as it asks."""
        r = self.bound[row]
        low = np.array([r, r, floor + r])
        room = np.array([*(self.sides - 2 * r), max(depth - 2 * r, 0.0)])
        around = 1 - (self.roi / (self.sides - 2 * r)).prod()
        zoned = self.over is not None and self.margin > r and around >= LEAST_AROUND
        if zoned and self.over[row]:
            low[:2], room[:2] = self.margin, self.roi
        for _ in range(TRIES // TRIES_AT_ONCE):
            tries = low + self.rng.random((TRIES_AT_ONCE, 3)) * room
            if zoned and not self.over[row]:
                beside = (tries[:, :2] < self.margin) | (tries[:, :2] > self.margin + self.roi)
                tries = tries[beside.any(axis=1)]
            square = ((tries[:, None] - places) ** 2).sum(axis=2)
            free = (square > (radii + r + self.parameters.contact_offset) ** 2).all(axis=1)
            if free.any():
                return tries[free.argmax()]
        return None

    # --- the dynamics -----------------------------------------------------------------------------

    def _advance(self) -> None:
        bed = self.bed
        active = np.flatnonzero(~bed.fixed)
        before = bed.position[active]
        bed.engine.step(LOOK)
        bed.read()
        bed.dig_up(2 * LOOK * self.parameters.dt)
        self.steps += LOOK
        self.idle += LOOK
        self.activity += LOOK * len(active)
        # The mean velocity since the last look. Solvers leave a jitter of about g dt / 2 in the velocity
        # itself of bodies that do not move at all.
        way = np.linalg.norm(bed.position[active] - before, axis=1)
        self.speed[active] = way / (LOOK * self.parameters.dt)
        resting = self.speed[active] < self.parameters.sleep_speed
        self.still[active] = np.where(resting, self.still[active] + LOOK, 0)
        tired = self._unburdened(active[self.still[active] >= self.parameters.sleep_steps], active)
        if len(tired):
            bed.fix(tired)
            self._raise(tired)
            self.idle = 0

    def _unburdened(self, tired: np.ndarray, active: np.ndarray) -> np.ndarray:
        """Bodies that can be fixed: of the tired ones, all but the heavy that touch one which still moves.

        Fixed before what it lies on, a grain clamps it: PhysX pressed a fine out of the few thousandths of
        its radius that it was squeezed by with 640 times its weight, and friction as strong spun it up.
        """
        bed, p = self.bed, self.parameters
        heavy = tired[bed.radius[tired] >= p.heavy]
        if not len(heavy):
            return tired
        awake = np.setdiff1d(active, tired)

        def waits(i: int) -> bool:
            distance = np.linalg.norm(bed.position[awake] - bed.position[i], axis=1)
            return bool((distance < bed.bound[awake] + bed.bound[i] + p.contact_offset).any())

        return np.setdiff1d(tired, [i for i in heavy if waits(i)])

    # --- the result -------------------------------------------------------------------------------

    def _describe(self, report: Report, bodies: pd.DataFrame, rest: bool) -> None:
        bed = self.bed
        report.poured = len(bed)
        report.poured_grains = int((bed.kind == "grain").sum())
        report.supply_rounds = -(-self.next // len(self.kind))
        report.escaped = bed.escaped()
        report.steps = self.steps
        # where pouring was given up, what still falls is no part of the bed
        bed.fixed |= True if rest else self.speed <= FALLING
        self._survey()
        report.surface_um = self._surface() * self.unit - self.box.margin_um
        report.surface_needed_um = self.box.roi_um[2] + self.box.margin_um
        report.solid_fraction = solid_fraction(bodies, self.box)
        report.largest = float(bed.radius.max(initial=0.0))
        kinds = Counter(bed.shapes[s].kind for s in bed.shape[bed.kind == "grain"])
        report.n_spheres, report.n_hulls, report.n_decomposed = (
            kinds[kind] for kind in ("sphere", "hull", "parts")
        )
        used = [bed.shapes[s] for s in bed.shape[bed.kind == "grain"] if s != SPHERE]
        if used:
            report.hull_excess = float(np.mean([s.hull_excess for s in used]))
            report.collision_excess = float(np.mean([s.excess for s in used]))
            report.hull_deviation = float(np.mean([s.deviation for s in used]))
        report.mean_active = self.activity / max(1, self.steps)
        report.wall_s = time.perf_counter() - self.started


PLAIN = ("next", "steps", "idle", "activity", "poured", "notes", "spent")
BODY = ("phase", "shape", "radius", "bound", "density", "position", "quaternion", "velocity", "spin", "fixed")
"""What a checkpoint holds of the deposition and of each body."""


def _raise(tops: np.ndarray, place: np.ndarray, height: np.ndarray) -> None:
    """Raise the greatest heights in the columns of a grid over the unit square."""
    index = np.floor(place * tops.shape).astype(int)
    inside = ((index >= 0) & (index < tops.shape)).all(axis=1)
    np.maximum.at(tops, tuple(index[inside].T), height[inside])


def random_quaternion(rng: np.random.Generator) -> np.ndarray:
    """A uniformly random orientation, (w, x, y, z)."""
    q = rng.standard_normal(4)
    return q / np.linalg.norm(q)
