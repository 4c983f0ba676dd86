"""Grains poured into a box until the region of interest lies well inside the settled bed."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from grainfall.errors import InputError
from grainfall.packing.engine import Solid, start
from grainfall.packing.parameters import Parameters
from grainfall.packing.shapes import SPHERE, collision_shapes

COLUMNS = ["id", "kind", "phase", "shape", "scale", "x", "y", "z", "qw", "qx", "qy", "qz", "asleep"]

Progress = Callable[[int, int, int, int], None]
"""Called with (bodies poured, bodies settled, bodies expected in all, simulation steps)."""


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

    def solid_um3(self, fraction: float = 0.65) -> float:
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
    under Earth's gravity; energies are in engine units. Overlaps are of collision shapes, in radii of the
    smaller grain. ``n_spheres``, ``n_hulls`` and ``n_decomposed`` count the grains poured by how they
    collided. ``hull_excess`` is the mean of V_hull / V - 1 over those with a mesh, ``collision_excess`` the
    same of the shapes that collided, ``hull_deviation`` the mean of the largest distance between collision
    shape and hull, in grain radii.
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
    kinetic_energy_end: float = 0.0
    max_overlap: float | None = None
    mean_overlap: float | None = None
    n_spheres: int = 0
    n_hulls: int = 0
    n_decomposed: int = 0
    decomposition_s: float = 0.0
    hull_excess: float = 0.0
    collision_excess: float = 0.0
    hull_deviation: float = 0.0
    mean_active: float = 0.0
    notes: list[str] = field(default_factory=list)


def deposit(
    population: pd.DataFrame,
    library,
    box: Box,
    parameters: Parameters,
    rng: np.random.Generator,
    progress: Progress | None = None,
) -> pd.DataFrame:
    """Pour grains into the box and let them settle.

    Grains are released in batches, at random positions and orientations, a few radii above the bed. A body
    that stays below ``sleep_speed`` for ``sleep_steps`` consecutive steps (looked at every :data:`LOOK`
    steps) is fixed in place; only the bodies above the fixed bed are simulated, so a step costs the same at
    any depth. Pouring goes on until the settled surface over the ROI is ``box.margin_um`` above it.

    Parameters
    ----------
    population : DataFrame
        The supply in pour order: kind (``grain`` or ``virtual``), phase, shape (-1: sphere), scale
        (equal-volume radius, um); optional over_roi: whether the body is released over the ROI or around it
        (anywhere if omitted). It is poured as far as needed and, should it run out, again from its start.
    library : grainfall.grains.Library
        Shapes: ``vertices``, ``faces``, equal-volume radius 1, centre of mass at the origin.
    box : Box
    parameters : Parameters
    rng : numpy.random.Generator
    progress : callable, optional
        See :data:`Progress`.

    Returns
    -------
    DataFrame
        Columns of bodies.csv; lengths in um from the ROI's corner; every body poured, inside the ROI or not.
        ``attrs["report"]`` is the deposition's :class:`Report` as a dict.

    Raises
    ------
    InputError
        When the population is empty or has a grain that does not fit the box.
    """
    return _Deposition(population, library, box, parameters, rng, progress).run()


LOOK = 10
"""Steps between two looks at the speeds of the moving bodies."""

RELEASE_FRACTION = 0.12
"""Bounding-sphere fraction of the zone that a batch is released into: random addition stays easy."""

TRIES = 200
"""Random places tried for one grain before it waits for the next batch."""


class _Deposition:
    def __init__(self, population, library, box, parameters, rng, progress):
        started = time.perf_counter()
        self.started = started
        if not len(population):
            raise InputError("population", "is empty", "draw at least one grain")
        self.box, self.parameters, self.rng, self.progress = box, parameters, rng, progress
        grains = population[population["kind"] == "grain"]
        self.unit = float((grains if len(grains) else population)["scale"].mean())
        self.kind = population["kind"].to_numpy()
        self.phase = population["phase"].to_numpy(int)
        self.shape = population["shape"].to_numpy(int)
        self.radius = population["scale"].to_numpy(float) / self.unit
        self.over = population["over_roi"].to_numpy(bool) if "over_roi" in population else None
        self.shapes = collision_shapes(library, np.unique(self.shape), parameters)
        self.bound = self.radius * np.array([self.shapes[s].bound for s in self.shape])
        self.sides = np.array(box.sides_um) / self.unit
        if 2 * self.bound.max() >= self.sides.min():
            raise InputError(
                "population",
                f"a grain {2 * self.bound.max() * self.unit:.4g} um wide does not fit a box of "
                f"{self.sides.min() * self.unit:.4g} um",
                "enlarge the region of interest",
            )
        self.margin = box.margin_um / self.unit
        self.height = box.height_um / self.unit
        self.engine = start(parameters, *self.sides)
        self.next = 0  # place in the endless supply
        self.rows: list[int] = []  # body -> population row
        self.position = np.empty((0, 3))
        self.quaternion = np.empty((0, 4))
        self.speed = np.empty(0)
        self.still = np.empty(0, int)  # consecutive steps at rest
        self.fixed = np.empty(0, bool)
        self.size = np.empty(0)  # bounding radius
        self.steps = self.idle = self.activity = 0

    def run(self) -> pd.DataFrame:
        report = Report(
            engine=self.engine.version,
            parameters=asdict(self.parameters),
            unit_um=self.unit,
            unit_s=(self.unit * 1e-6 * self.parameters.gravity / 9.8) ** 0.5,
            supply=len(self.kind),
        )
        expected = max(1, self._expected())
        while True:
            active = np.flatnonzero(~self.fixed)
            if self._wanted(active):
                self._release()
            elif not len(active):
                break
            self._advance()
            if self.progress:
                done = int(self.fixed.sum())
                self.progress(len(self.fixed), done, max(expected, len(self.fixed)), self.steps)
            if self.idle >= self.parameters.max_idle_steps:
                report.notes.append(
                    f"ended with {int((~self.fixed).sum())} bodies still moving: none came to rest in "
                    f"{self.idle} steps"
                )
                break
        self._read(np.flatnonzero(~self.fixed), orientations=True)
        self.engine.close()
        report.max_overlap, report.mean_overlap = self._overlaps()
        bodies = self._table()
        self._describe(report, bodies)
        bodies.attrs["report"] = asdict(report)
        return bodies

    # --- the supply -------------------------------------------------------------------------------

    def _expected(self) -> int:
        volume = 4 / 3 * np.pi * (self.radius**3).mean()
        return int(self.sides.prod() * self.height * 0.6 / volume)

    def _wanted(self, active: np.ndarray) -> bool:
        """Whether another batch is needed and the zone of release is clear."""
        if len(active):
            falling = self.speed[active] > FALLING
            tops = self.position[active, 2] + self.size[active]
            if (tops[falling] > self._bed() + self.parameters.drop_height).any():
                return False
        in_flight = 4 / 3 * np.pi * (np.array([self.radius[self.rows[i]] for i in active]) ** 3).sum()
        return self.surface(self.fixed) + in_flight / (0.6 * self.sides.prod()) < self.height

    def _bed(self) -> float:
        """Top of the bed above which grains are released; one high grain does not raise it."""
        resting = self.fixed | (self.speed <= FALLING)
        if not resting.any():
            return 0.0
        cells = np.maximum(1, (self.sides / 4).astype(int))
        tops = _column_tops(
            self.position[resting, :2] / self.sides, self.position[resting, 2] + self.size[resting], cells
        )
        return float(np.quantile(tops, 0.9))

    def _release(self) -> None:
        """Place the next batch at random in the zone of release, without overlap."""
        p = self.parameters
        batch, volume, bounds = [], 0.0, 0.0
        wanted = p.batch_layers * 2 * self.sides.prod() * 0.6
        while volume < wanted:
            row = (self.next + len(batch)) % len(self.kind)
            batch.append(row)
            volume += 4 / 3 * np.pi * self.radius[row] ** 3
            bounds += 4 / 3 * np.pi * self.bound[row] ** 3
        depth = max(bounds / (RELEASE_FRACTION * self.sides.prod()), 2.2 * self.bound[batch].max())
        floor = self._bed() + p.drop_height
        high = np.flatnonzero(self.position[:, 2] + self.size > floor)
        places, radii = list(self.position[high]), list(self.size[high])
        velocity = np.array([0, 0, -2.0 * FALLING])
        released = []
        for row in batch:
            r = self.bound[row]
            tries = self._places(row, floor, depth)
            quaternion = random_quaternion(self.rng)
            if places:
                gaps = np.linalg.norm(tries[:, None] - np.array(places), axis=2) - (np.array(radii) + r)
                free = np.flatnonzero(gaps.min(axis=1) > p.contact_offset)
                if not len(free):
                    break  # it waits for the next batch, first in line
                place = tries[free[0]]
            else:
                place = tries[0]
            places.append(place)
            radii.append(r)
            released.append((row, place, quaternion))
            self.engine.add(self._solid(row), place, quaternion, velocity)
        if not released:
            return
        self.next += len(released)
        self.idle = 0
        rows, places, quaternions = zip(*released, strict=True)
        n = len(rows)
        self.rows += rows
        self.position = np.vstack([self.position, places])
        self.quaternion = np.vstack([self.quaternion, quaternions])
        self.speed = np.append(self.speed, np.full(n, np.linalg.norm(velocity)))
        self.still = np.append(self.still, np.zeros(n, int))
        self.fixed = np.append(self.fixed, np.zeros(n, bool))
        self.size = np.append(self.size, self.bound[list(rows)])

    def _places(self, row: int, floor: float, depth: float) -> np.ndarray:
        """Random places (n, 3) for one body in the zone of release, over the ROI or around it as it asks."""
        r = self.bound[row]
        low = np.array([r, r, floor + r])
        room = np.array([*(self.sides - 2 * r), max(depth - 2 * r, 0.0)])
        roi = np.array(self.box.roi_um[:2]) / self.unit
        if self.over is None or self.margin <= r:
            return low + self.rng.random((TRIES, 3)) * room
        if self.over[row]:
            low[:2], room[:2] = self.margin, roi
            return low + self.rng.random((TRIES, 3)) * room
        tries = low + self.rng.random((4 * TRIES, 3)) * room
        around = ((tries[:, :2] < self.margin) | (tries[:, :2] > self.margin + roi)).any(axis=1)
        return tries[around][:TRIES]

    def _solid(self, row: int) -> Solid:
        shape, r = self.shapes[self.shape[row]], self.radius[row]
        mass = self.parameters.density * 4 / 3 * np.pi * r**3
        exact = self.parameters.density * shape.inertia * r**5
        return Solid(
            parts=tuple(part * r for part in shape.parts),
            radius=self.bound[row],
            mass=mass,
            inertia=exact if self.parameters.inertia == "exact" else np.ones(3),
        )

    # --- the dynamics -----------------------------------------------------------------------------

    def _advance(self) -> None:
        active = np.flatnonzero(~self.fixed)
        self.engine.step(LOOK)
        self.steps += LOOK
        self.idle += LOOK
        self.activity += LOOK * len(active)
        self._read(active)
        resting = self.speed[active] < self.parameters.sleep_speed
        self.still[active] = np.where(resting, self.still[active] + LOOK, 0)
        tired = active[self.still[active] >= self.parameters.sleep_steps]
        if len(tired):
            self._read(tired, orientations=True)
            self.engine.fix(tired)
            self.fixed[tired] = True
            self.idle = 0

    def _read(self, ids: np.ndarray, orientations: bool = False) -> None:
        if orientations:
            self.position[ids], self.quaternion[ids] = self.engine.poses(ids)
            return
        before = self.position[ids]
        self.position[ids] = self.engine.positions(ids)
        # The mean velocity since the last look. Solvers leave a jitter of about g dt / 2 in the velocity
        # itself of bodies that do not move at all.
        self.speed[ids] = np.linalg.norm(self.position[ids] - before, axis=1) / (LOOK * self.parameters.dt)

    def surface(self, among: np.ndarray) -> float:
        """Height of the bed over the ROI: the lowest tenth of its columns, two mean diameters wide."""
        if not among.any():
            return 0.0
        roi = np.array(self.box.roi_um[:2]) / self.unit
        cells = np.maximum(1, (roi / 4).astype(int))
        # centres: a lone grain's top is not yet a bed
        tops = _column_tops((self.position[among, :2] - self.margin) / roi, self.position[among, 2], cells)
        return float(np.quantile(tops, 0.1))

    def _overlaps(self) -> tuple[float, float]:
        """Largest and mean penetration of touching collision shapes, in radii of the smaller of the two.

        The final poses are given to the engine's own narrow phase as they are, all bodies free, for one step
        too short to move them.
        """
        still = replace(self.parameters, dt=1e-6, gravity=1e-6)
        engine = start(still, *self.sides)
        zero = np.zeros(3)
        for row, place, quaternion in zip(self.rows, self.position, self.quaternion, strict=True):
            engine.add(self._solid(row), place, quaternion, zero)
        engine.step(1)
        pairs, gaps = engine.contacts()
        engine.close()
        if not len(gaps):
            return 0.0, 0.0
        radius = self.radius[self.rows]
        depth = np.maximum(-gaps, 0) / radius[pairs].min(axis=1)
        touching = gaps < 1e-3
        return float(depth.max()), float(depth[touching].mean()) if touching.any() else 0.0

    # --- the result -------------------------------------------------------------------------------

    def _table(self) -> pd.DataFrame:
        rows = np.array(self.rows)
        principal = Rotation.from_quat(self.quaternion[:, [1, 2, 3, 0]])
        frames = Rotation.from_quat(np.array([self.shapes[s].frame.as_quat() for s in self.shape[rows]]))
        q = (principal * frames.inv()).as_quat()
        q *= np.where(q[:, 3:] < 0, -1.0, 1.0)
        origin = self.box.margin_um
        xyz = self.position * self.unit - origin
        return pd.DataFrame(
            {
                "id": np.arange(len(rows)),
                "kind": self.kind[rows],
                "phase": self.phase[rows],
                "shape": self.shape[rows],
                "scale": self.radius[rows] * self.unit,
                "x": xyz[:, 0],
                "y": xyz[:, 1],
                "z": xyz[:, 2],
                "qw": q[:, 3],
                "qx": q[:, 0],
                "qy": q[:, 1],
                "qz": q[:, 2],
                "asleep": self.fixed,
            }
        )[COLUMNS]

    def _describe(self, report: Report, bodies: pd.DataFrame) -> None:
        rows = np.array(self.rows)
        radius = self.radius[rows]
        report.poured = len(rows)
        report.poured_grains = int((self.kind[rows] == "grain").sum())
        report.supply_rounds = -(-self.next // len(self.kind))
        report.asleep = int(self.fixed.sum())
        outside = (self.position[:, :2] < 0) | (self.position[:, :2] > self.sides)
        report.escaped = int((outside.any(axis=1) | (self.position[:, 2] < 0)).sum())
        report.steps = self.steps
        report.surface_um = self.surface(self.fixed) * self.unit - self.box.margin_um
        report.surface_needed_um = self.box.roi_um[2] + self.box.margin_um
        roi = np.array(self.box.roi_um)
        within = ((bodies[["x", "y", "z"]].to_numpy() >= 0) & (bodies[["x", "y", "z"]].to_numpy() < roi)).all(
            axis=1
        )
        report.solid_fraction = float(4 / 3 * np.pi * (bodies["scale"][within] ** 3).sum() / roi.prod())
        moving = ~self.fixed
        mass = self.parameters.density * 4 / 3 * np.pi * radius**3
        report.kinetic_energy_end = float(0.5 * (mass * self.speed**2)[moving].sum())
        kinds = Counter(self.shapes[s].kind for s in self.shape[rows][self.kind[rows] == "grain"])
        report.n_spheres, report.n_hulls, report.n_decomposed = (
            kinds[kind] for kind in ("sphere", "hull", "parts")
        )
        report.decomposition_s = sum(shape.seconds for shape in self.shapes.values())
        used = [self.shapes[s] for s in self.shape[rows] if s != SPHERE]
        if used:
            report.hull_excess = float(np.mean([s.hull_excess for s in used]))
            report.collision_excess = float(np.mean([s.excess for s in used]))
            report.hull_deviation = float(np.mean([s.deviation for s in used]))
        report.mean_active = self.activity / max(1, self.steps)
        report.wall_s = time.perf_counter() - self.started


FALLING = 1.0
"""Speed, engine units / s, above which a body still falls: that of a fall over a twentieth of a radius."""


def _column_tops(place: np.ndarray, height: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Greatest height in each column of a grid over the unit square; 0 where there is none."""
    index = np.floor(place * cells).astype(int)
    inside = ((index >= 0) & (index < cells)).all(axis=1)
    tops = np.zeros(cells)
    np.maximum.at(tops, tuple(index[inside].T), height[inside])
    return tops


def random_quaternion(rng: np.random.Generator) -> np.ndarray:
    """A uniformly random orientation, (w, x, y, z)."""
    q = rng.standard_normal(4)
    return q / np.linalg.norm(q)
