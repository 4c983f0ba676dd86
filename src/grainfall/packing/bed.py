"""Bodies in a box: their state, the engine that moves them, and what can be said of them at any time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from grainfall.packing.engine import WALL, Contacts, Engine, Solid, start
from grainfall.packing.parameters import Parameters
from grainfall.packing.shapes import CollisionShape, collision_shapes

COLUMNS = ["id", "kind", "phase", "shape", "scale", "x", "y", "z", "qw", "qx", "qy", "qz", "asleep"]

STATE = ("position", "quaternion", "velocity", "spin")
"""What an engine changes of a body."""

BURIED = 4.0
"""Depth, mean grain radii, below all that moves, from which fixed bodies need not be in the engine."""


@dataclass(frozen=True)
class Frame:
    """Engine units and micrometres: a length of 1 is ``unit_um``; the ROI's corner is ``margin_um`` from the
    box's."""

    unit_um: float
    margin_um: float


class Bed:
    """Bodies in a box, in engine units.

    Attributes
    ----------
    kind, phase, shape, radius : (n,) ndarray
        As in bodies.csv; equal-volume radius.
    bound : (n,) float
        Radius of the bounding sphere.
    density : (n,) float
        Mass per cubed engine unit.
    position, quaternion, velocity, spin : (n, 3 or 4) float
        As last read from the engine; quaternions turn the principal frame into the box's.
    fixed : (n,) bool
        Out of the dynamics.
    """

    def __init__(
        self,
        shapes: Mapping[int, CollisionShape],
        parameters: Parameters,
        sides: np.ndarray,
        frame: Frame,
    ):
        self.shapes, self.parameters, self.sides, self.frame = shapes, parameters, np.asarray(sides), frame
        self.kind = np.empty(0, object)
        self.phase, self.shape = np.empty(0, int), np.empty(0, int)
        self.radius, self.bound, self.density = np.empty(0), np.empty(0), np.empty(0)
        self.position, self.velocity, self.spin = np.empty((0, 3)), np.empty((0, 3)), np.empty((0, 3))
        self.quaternion = np.empty((0, 4))
        self.fixed = np.empty(0, bool)
        self.engine: Engine | None = None
        self._number = np.empty(0, int)  # of each body in the engine; -1: left out

    @classmethod
    def of(cls, bodies: pd.DataFrame, library, box, parameters: Parameters) -> Bed:
        """The bed of a table of bodies (columns of bodies.csv) in their box."""
        grains = bodies[bodies["kind"] == "grain"]
        unit = float((grains if len(grains) else bodies)["scale"].mean())
        shapes = collision_shapes(library, np.unique(bodies["shape"]), parameters)
        radius = in_units(bodies["scale"], unit)
        contrast = bodies["density"].max() / bodies["density"].min() if "density" in bodies else 1.0
        bed = cls(
            shapes,
            parameters.suited(radius.min(), contrast),
            in_units(box.sides_um, unit),
            Frame(unit, box.margin_um),
        )
        frames = Rotation.from_quat([shapes[s].frame.as_quat() for s in bodies["shape"]])
        lab = Rotation.from_quat(bodies[["qx", "qy", "qz", "qw"]].to_numpy(float))
        bed.enter(
            bodies["kind"].to_numpy(object),
            bodies["phase"].to_numpy(int),
            bodies["shape"].to_numpy(int),
            radius,
            in_units(bodies[["x", "y", "z"]].to_numpy(float) + box.margin_um, unit),
            (lab * frames).as_quat()[:, [3, 0, 1, 2]],
            density=bodies.get("density"),
        )
        return bed

    def some(self, ids: np.ndarray) -> Bed:
        """A bed of these bodies alone, as they are; :meth:`take` brings back what becomes of them."""
        bed = Bed(self.shapes, self.parameters, self.sides, self.frame)
        for name in ("kind", "phase", "shape", "radius", "bound", "density", "fixed", *STATE):
            setattr(bed, name, getattr(self, name)[ids])
        return bed

    def take(self, ids: np.ndarray, some: Bed) -> None:
        """The state of :meth:`some` of the bodies becomes theirs here."""
        self.close()
        for name in STATE:
            getattr(self, name)[ids] = getattr(some, name)

    def __len__(self) -> int:
        return len(self.radius)

    @property
    def mass(self) -> np.ndarray:
        """Mass that each body has in the engine."""
        return self.density * 4 / 3 * np.pi * self.radius**3 * self._share(self.radius)

    def _share(self, radius):
        """Mass in the engine over a body's own: a heavy one weighs what the least of them does."""
        return (np.minimum(radius, self.parameters.heavy) / radius) ** 3

    # --- in and out of the engine -------------------------------------------------------------------

    def enter(self, kind, phase, shape, radius, position, quaternion, velocity=None, density=None) -> None:
        """Add bodies, moving; into the engine too where one runs.

        Density is the parameters' where none is given.
        """
        first, n = len(self), len(radius)
        velocity = np.zeros((n, 3)) if velocity is None else velocity
        density = np.full(n, self.parameters.density) if density is None else np.asarray(density, float)
        self.density = np.append(self.density, density)
        self.kind = np.append(self.kind, kind)
        self.phase, self.shape = np.append(self.phase, phase), np.append(self.shape, shape)
        self.radius = np.append(self.radius, radius)
        self.bound = np.append(self.bound, np.array([self.shapes[s].bound for s in shape]) * radius)
        self.position = np.vstack([self.position, position])
        self.quaternion = np.vstack([self.quaternion, quaternion])
        self.velocity = np.vstack([self.velocity, velocity])
        self.spin = np.vstack([self.spin, np.zeros((n, 3))])
        self.fixed = np.append(self.fixed, np.zeros(n, bool))
        self._number = np.append(self._number, np.full(n, -1))
        if self.engine is not None:
            self._add(range(first, first + n))

    def start(self, parameters: Parameters | None = None, *, buried: bool = True) -> None:
        """A new engine with the bodies as they are: no solver cache outlives it.

        Without the ``buried`` ones, fixed bodies far below all that move are left out. They touch nothing, so
        the packing has the same bytes, but an engine goes through all its bodies in every step.
        :meth:`dig_up` brings them back where something comes near them.
        """
        self.close()
        self.parameters = parameters or self.parameters
        self.engine = start(self.parameters, *self.sides)
        self._number = np.full(len(self), -1)
        within = np.ones(len(self), bool)
        if not (buried or self.fixed.all()):
            within = ~self.fixed | (self.position[:, 2] + self.bound > self._lowest() - BURIED)
        self._add(np.flatnonzero(within))

    def dig_up(self, seconds: float) -> None:
        """Bring back the bodies that :meth:`start` left out, if a moving one could come to them so soon."""
        out = self.left_out
        if self._lowest(seconds) < (self.position[out, 2] + self.bound[out]).max(initial=-np.inf):
            self._add(out)

    @property
    def left_out(self) -> np.ndarray:
        """Bodies that are not in the engine."""
        return np.flatnonzero(self._number < 0)

    def _lowest(self, seconds: float = 0.0) -> float:
        """Lowest height that a moving body reaches, or could reach within so many engine seconds."""
        moving = ~self.fixed
        speed = np.linalg.norm(self.velocity[moving], axis=1) + self.parameters.gravity * seconds
        bottom = self.position[moving, 2] - self.bound[moving]
        return float((bottom - speed * seconds).min(initial=np.inf))

    def _add(self, ids: Iterable[int]) -> None:
        first = self._number.max(initial=-1) + 1
        for number, i in enumerate(ids, start=first):
            self._number[i] = number
            self.engine.add(
                self.solid(i),
                self.position[i],
                self.quaternion[i],
                self.velocity[i],
                self.spin[i],
                bool(self.fixed[i]),
            )

    def solid(self, i: int) -> Solid:
        """Body ``i`` as the engine needs it."""
        shape, r = self.shapes[self.shape[i]], self.radius[i]
        share = self._share(r)
        return Solid(
            parts=shape.parts,
            radius=self.bound[i],
            mass=self.density[i] * 4 / 3 * np.pi * r**3 * share,
            inertia=self._inertia(i),
            scale=r,
            drag=self.drag(i),
            # a void's direction is none of gravity's doing
            turns=self.kind[i] != "virtual" or not shape.parts,
        )

    def _inertia(self, i: int) -> np.ndarray:
        """Principal moments that body ``i`` has in the engine."""
        if self.parameters.inertia != "exact":
            return np.ones(3)
        r = self.radius[i]
        return self.density[i] * self.shapes[self.shape[i]].inertia * r**5 * self._share(r)

    def drag(self, i: int) -> float:
        """Rate, 1/s, at which body ``i`` loses speed while bodies are poured: a heavy virtual sphere's."""
        p = self.parameters
        if self.kind[i] != "virtual" or self.radius[i] < p.heavy:
            return 0.0
        return p.gravity * self.radius[i] / (2 * p.gravity * p.drop_height) ** 0.5

    def read(self) -> None:
        """Take the moving bodies' state from the engine."""
        state, moving = self.engine.state(), ~self.fixed
        self.position[moving], self.quaternion[moving] = state.position, state.quaternion
        self.velocity[moving], self.spin[moving] = state.velocity, state.spin

    def fix(self, ids: np.ndarray) -> None:
        """Take moving bodies out of the dynamics where they are."""
        self.engine.fix(self._number[ids])
        self.fixed[ids] = True
        self.velocity[ids] = self.spin[ids] = 0.0

    def close(self) -> None:
        """End the engine."""
        if self.engine is not None:
            self.engine.close()
            self.engine = None

    # --- what can be said of it ---------------------------------------------------------------------

    def energy(self) -> float:
        """Potential energy above the floor and kinetic energy of all bodies."""
        turn = Rotation.from_quat(self.quaternion[:, [1, 2, 3, 0]])
        spin = turn.apply(self.spin, inverse=True) if len(self) else self.spin
        inertia = np.array([self._inertia(i) for i in range(len(self))]).reshape(-1, 3)
        speed2 = (self.velocity**2).sum(axis=1)
        potential = self.mass * self.parameters.gravity * self.position[:, 2]
        return float((potential + self.mass * speed2 / 2).sum() + (inertia * spin**2).sum() / 2)

    def overlaps(self) -> tuple[float, float]:
        """Largest and mean penetration of touching collision shapes, in radii of the smaller of the two."""
        pairs, gaps = self._gaps()
        if not len(gaps):
            return 0.0, 0.0
        depth = np.maximum(-gaps, 0) / self.radius[pairs].min(axis=1)
        touching = gaps < 1e-3
        return float(depth.max()), float(depth[touching].mean()) if touching.any() else 0.0

    def deep_pairs(self, limit: float) -> np.ndarray:
        """Pairs (n, 2) of bodies, ascending, that penetrate by more than ``limit`` radii of the smaller one.

        Centres nearer to each other than that are counted too: the direction out of a common centre is one
        that a narrow phase may not find.
        """
        pairs, gaps = self._gaps()
        deep = pairs[-gaps > limit * self.radius[pairs].min(axis=1)]
        near = cKDTree(self.position).query_pairs(limit * self.radius.min(), output_type="ndarray")
        return np.unique(np.sort(np.vstack([deep, near]), axis=1), axis=0)

    def _gaps(self) -> tuple[np.ndarray, np.ndarray]:
        """Pairs (n, 2) of bodies near each other and the gaps (n,) between their collision shapes.

        The poses are given to the engine's own narrow phase as they are, all bodies free, for one step too
        short to move them.
        """
        still = replace(self.parameters, dt=1e-6, gravity=1e-6, contact_manifold="full")
        engine = start(still, *self.sides)
        for i in range(len(self)):
            engine.add(self.solid(i), self.position[i], self.quaternion[i])
        engine.step(1)
        found = engine.contacts()
        engine.close()
        bodies = (found.pairs != WALL).all(axis=1)
        return found.pairs[bodies], found.gap[bodies]

    def around(self, chosen: np.ndarray) -> np.ndarray:
        """The chosen bodies (mask) and all whose bounding spheres touch one of theirs."""
        found = chosen.copy()
        tree = cKDTree(self.position)
        for i in np.flatnonzero(chosen):
            near = np.array(tree.query_ball_point(self.position[i], self.bound[i] + self.bound.max()))
            gap = np.linalg.norm(self.position[near] - self.position[i], axis=1) - self.bound[near]
            found[near[gap < self.bound[i]]] = True
        return found

    def escaped(self) -> int:
        """Bodies whose centre is outside the walls or below the floor."""
        outside = (self.position[:, :2] < 0) | (self.position[:, :2] > self.sides)
        lost = outside.any(axis=1) | (self.position[:, 2] < 0) | ~np.isfinite(self.position).all(axis=1)
        return int(lost.sum())

    def table(self, asleep: np.ndarray) -> pd.DataFrame:
        """Columns of bodies.csv, um from the ROI's corner."""
        principal = Rotation.from_quat(self.quaternion[:, [1, 2, 3, 0]])
        frames = Rotation.from_quat(np.array([self.shapes[s].frame.as_quat() for s in self.shape]))
        q = (principal * frames.inv()).as_quat()
        q *= np.where(q[:, 3:] < 0, -1.0, 1.0)
        xyz = self.position * self.frame.unit_um - self.frame.margin_um
        return pd.DataFrame(
            {
                "id": np.arange(len(self)),
                "kind": self.kind,
                "phase": self.phase,
                "shape": self.shape,
                "scale": self.radius * self.frame.unit_um,
                "x": xyz[:, 0],
                "y": xyz[:, 1],
                "z": xyz[:, 2],
                "qw": q[:, 3],
                "qx": q[:, 0],
                "qy": q[:, 1],
                "qz": q[:, 2],
                "asleep": asleep,
            }
        )[COLUMNS]

    def forces(self, contacts: Contacts) -> pd.DataFrame:
        """Normal forces between bodies, in newtons for solids of ``density`` g/cm3 under Earth's gravity.

        Columns a < b (ids), force_n.
        """
        p, metre = self.parameters, self.frame.unit_um * 1e-6
        newton = 1e3 * 9.8 * metre**3 / p.gravity  # an engine mass is 1e3 kg/m3 times a cubed unit
        between = (contacts.pairs != WALL).all(axis=1)
        a, b = np.sort(contacts.pairs[between], axis=1).T
        table = pd.DataFrame({"a": a, "b": b, "force_n": contacts.force[between] * newton})
        return table.groupby(["a", "b"], as_index=False).sum()


def in_units(length_um, unit_um: float) -> np.ndarray:
    """Lengths over the unit, without the division's noise: a scene in other units is the same bytes."""
    return np.round(np.asarray(length_um, float) / unit_um, 12)
