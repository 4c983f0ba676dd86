"""Physical and numerical parameters of a deposition, and the named sets of them."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

from grainfall.errors import InputError


@dataclass(frozen=True)
class Parameters:
    """Everything that governs how grains fall and come to rest.

    All lengths are scaled so that the mean grain radius is 1 in engine units. Rigid grains under gravity have
    no length of their own, so with gravity 9.8 one engine second stands for sqrt(R_mean / 1 m) real seconds:
    the packing depends on ratios only (friction, restitution, dt * sqrt(g / R), thresholds over sqrt(g R)).

    Parameters
    ----------
    engine : {"physx", "bullet"}
        Rigid-body engine.
    gravity : float
        Acceleration along -z, m / s^2. It sets what an engine second stands for, not the packing: in the
        engine it is always :data:`GRAVITY`.
    dt : float
        Time step, engine s; shortened where the smallest grain asks for it, see :meth:`suited`.
    friction_static, friction_dynamic : float
        Coulomb coefficients, grain on grain and grain on wall. Bullet has one coefficient: the dynamic one.
    restitution : float
        Fraction of the normal relative velocity kept in a bounce.
    bounce_speed : float
        Approach speed, engine units / s, below which a contact does not bounce (2 is PhysX's own default).
    linear_damping : float
        Rate, 1/s, at which speed decays.
    angular_damping : float
        Rate, 1/s, at which spin decays: the only rolling resistance a sphere has (0.05 is PhysX's own
        default).
    density : float
        Solid density, mass per cubed engine unit, of bodies that have none of their own. It scales forces,
        not the packing.
    heavy : float
        Radius, mean grain radii, from which bodies are heavy: they weigh what one of this radius does, and
        are not fixed before what they touch is; virtual ones sink instead of falling. An iterative solver
        passes a load on a little at a time, so that grains under one of thousands of times their mass are
        squeezed; what a rigid grain weighs decides how hard it presses, hardly where it comes to rest.
    inertia : {"exact", "paper"}
        ``exact``: the mesh's own principal moments; ``paper``: the diagonal (1, 1, 1) for every grain
        whatever its size, which makes a mean grain spin about four times too easily and a small one hardly at
        all.
    sleep_speed : float
        Translational speed, engine units / s, below which a body counts as resting.
    sleep_steps : int
        Consecutive steps at rest after which a body is fixed in place while others are poured. Fixing early
        spares steps; what it spares in rearrangement is made up for at the end, when all bodies are free.
    contact_manifold : {"full", "persistent"}
        How PhysX finds the contact points of two hulls while grains are poured: all of them anew in every
        step, or a few kept from step to step (as the paper says), which takes 0.6 to 0.9 of the time. Kept
        points let a bed of hulls shiver and creep together (``make bench-creep``): the demo's two first
        packings ended at porosities of 0.346 instead of 0.366. The poured bed comes to rest with full ones in
        any case, steps much shorter than the default have them too, and a ``sleep_speed`` much below the
        default wants them: shivering grains never fall asleep.
    contact_breaking : float
        Distance, engine units, at which Bullet drops a contact point that it keeps from step to step. At its
        own 0.02, points that no longer touch go on bearing: beds end looser, with fewer contacts, and creep
        more than at 0.0005. Much below that, points that bear are dropped, and beds creep most of all.
    solver_iterations : int
        Iterations of the contact solver per step; 100 in Bullet unless given (:data:`ENGINES`).
    hull_vertices : int
        Most vertices of a grain's convex collision shape. Facets lock: rounded grains of 24, 48 and 128
        vertices packed to 0.625(2), 0.636(3) and 0.644(3). And a coarse hull is not the grain: largest
        overlaps of the true hulls were 0.09 of the smaller radius at 48 vertices, 0.04 at 96. A
        packing at 128 vertices takes three times as long as at 8 (``make accuracy``).
    collision_shape : {"auto", "sphere"}
        ``sphere``: every grain collides as the sphere of its volume, which is quick and shows what its shape
        is worth (``make accuracy``); ``auto``: as what it is (:func:`grainfall.packing.shapes.choose_kind`).
    decomposition : {"auto", "on", "off"}
        Whether grains collide as several convex parts: where their hull's excess calls for it, all that the
        library has pieces of, or none.
    hull_excess : float
        Volume of the convex hull over the grain's own, minus 1, above which ``auto`` decomposes. What a hull
        has in excess stays empty and counts as porosity. Decomposed grains of a thin section keep an excess
        of 0.066 (``grains.decomposition.CONCAVITY``), so a tolerance below that would gain little.
    contact_offset : float
        Distance, engine units, at which PhysX starts to build a contact (speculative: it does not hold grains
        apart). Every pair within it is examined in every step: 0.1 costs a third more time than 0.02.
    drop_height : float
        Clear height above the bed from which grains are released, mean grain radii.
    batch_layers : float
        Solid poured in one batch, as a bed thickness in mean grain diameters.
    max_idle_steps : int
        Steps without any body coming to rest after which the deposition is ended as it is; those that a new
        batch takes to fall and to bounce out are not counted.
    rest_windows : int
        Most windows of 300 finer steps in which the poured bed, all bodies free, may come to rest.
    checkpoint_steps : int
        Steps between two checkpoints.
    """

    engine: str = "physx"
    gravity: float = 9.8
    dt: float = 0.01
    friction_static: float = 0.5
    friction_dynamic: float = 0.5
    restitution: float = 0.5
    bounce_speed: float = 2.0
    linear_damping: float = 0.0
    angular_damping: float = 0.05
    density: float = 2.6
    heavy: float = 5.0
    inertia: str = "exact"
    sleep_speed: float = 0.05
    sleep_steps: int = 100
    contact_manifold: str = "full"
    contact_breaking: float = 0.0005
    solver_iterations: int = 20
    hull_vertices: int = 64
    collision_shape: str = "auto"
    decomposition: str = "auto"
    hull_excess: float = 0.1
    contact_offset: float = 0.02
    drop_height: float = 4.0
    batch_layers: float = 1.0
    max_idle_steps: int = 1000
    rest_windows: int = 10
    checkpoint_steps: int = 2000

    def __post_init__(self) -> None:
        for name, choices in CHOICES.items():
            if getattr(self, name) not in choices:
                raise InputError(
                    f"packing.{name}",
                    f"{getattr(self, name)!r} is unknown",
                    f"choose from {', '.join(choices)}",
                )
        for name in (
            "gravity",
            "dt",
            "density",
            "heavy",
            "sleep_speed",
            "drop_height",
            "batch_layers",
            "contact_offset",
            "contact_breaking",
        ):
            if not getattr(self, name) > 0:
                raise InputError(
                    f"packing.{name}", f"{getattr(self, name)!r} is not positive", "give a number > 0"
                )
        for name in (
            "friction_static",
            "friction_dynamic",
            "bounce_speed",
            "linear_damping",
            "angular_damping",
            "hull_excess",
        ):
            if not getattr(self, name) >= 0:
                raise InputError(
                    f"packing.{name}", f"{getattr(self, name)!r} is negative", "give a number >= 0"
                )
        if not 0 <= self.restitution < 1:
            raise InputError(
                "packing.restitution", f"{self.restitution!r} is outside [0, 1)", "0.5 is the paper's"
            )
        least_steps = {
            "sleep_steps": 1,
            "solver_iterations": 1,
            "max_idle_steps": 1,
            "rest_windows": 1,
            "checkpoint_steps": 10,
        }
        for name, least in least_steps.items():
            if getattr(self, name) < least:
                raise InputError(
                    f"packing.{name}", f"{getattr(self, name)!r} is too few", f"at least {least}"
                )
        if self.engine == "physx" and self.solver_iterations > MOST_ITERATIONS:
            raise InputError(
                "packing.solver_iterations",
                f"{self.solver_iterations!r} is more than PhysX counts to",
                f"at most {MOST_ITERATIONS}",
            )
        if not 8 <= self.hull_vertices <= MOST_VERTICES:
            raise InputError(
                "packing.hull_vertices", f"{self.hull_vertices!r} is out of range", f"8 to {MOST_VERTICES}"
            )

    def lubricated(self, factor: float) -> Parameters:
        """These with both friction coefficients times ``factor``."""
        return replace(
            self,
            friction_static=factor * self.friction_static,
            friction_dynamic=factor * self.friction_dynamic,
        )

    def refined(self) -> Parameters:
        """These with half the time step and twice the solver iterations, or as many as PhysX takes."""
        iterations = 2 * self.solver_iterations
        if self.engine == "physx":
            iterations = min(iterations, MOST_ITERATIONS)
        return replace(self, dt=self.dt / 2, solver_iterations=iterations)

    def suited(self, smallest: float, contrast: float = 1.0) -> Parameters:
        """The same packing in numbers that suit its grains.

        Gravity is :data:`GRAVITY`; the step is at most :data:`LONGEST_STEP` of the time in which the smallest
        grain falls its own radius, sqrt(R / g) but for a factor. Numbers of steps that stand for a time are
        those of the default step, and more of shorter ones. Much shorter ones (:data:`KEEPING_STEP`) find all
        contact points anew: kept ones shake a bed the harder the shorter the step is. Bullet's iterations
        rise with the contrast of density: a light grain under a heavy one learns of its load a little at a
        time. PhysX needs no more.

        Parameters
        ----------
        smallest : float
            Least grain radius, mean grain radii.
        contrast : float
            Greatest density over the least.
        """
        dt = min(self.dt, LONGEST_STEP * (smallest / GRAVITY) ** 0.5)
        more = max(1.0, type(self).dt / dt)
        manifold = self.contact_manifold if dt >= KEEPING_STEP * type(self).dt else "full"
        iterations = self.solver_iterations
        if self.engine == "bullet":
            iterations = round(iterations * contrast**0.5)
        counts = ("sleep_steps", "max_idle_steps", "rest_windows")
        return replace(
            self,
            gravity=GRAVITY,
            dt=dt,
            contact_manifold=manifold,
            solver_iterations=iterations,
            **{name: round(more * getattr(self, name)) for name in counts},
        )

    @classmethod
    def named(cls, name: str = "default", **overrides: object) -> Parameters:
        """A named set, with single values replaced.

        Parameters
        ----------
        name : {"default", "paper"}
            ``paper`` is the paper's appendix table.
        **overrides
            Fields of this class.

        Raises
        ------
        InputError
            On an unknown set, field or value.
        """
        if name not in NAMED:
            raise InputError("packing.parameters", f"{name!r} is unknown", f"choose from {', '.join(NAMED)}")
        known = {field.name for field in fields(cls)}
        for key in overrides:
            if key not in known:
                raise InputError(
                    f"packing.{key}", "is no packing parameter", f"choose from {', '.join(sorted(known))}"
                )
        chosen = {**NAMED[name], **overrides}
        return cls(**{**ENGINES.get(chosen.get("engine", cls.engine), {}), **chosen})


MOST_ITERATIONS = 255
"""PhysX keeps their number in eight bits: 256 are none, and crash, 257 are one."""

GRAVITY = 9.8
"""Acceleration in the engine, engine units / s^2: under another, rigid grains do the same in another time."""

LONGEST_STEP = 0.08
"""Longest time step over sqrt(R / g) of the smallest grain."""

KEEPING_STEP = 0.75
"""Shortest step, of the default, with which contact points may be kept from one to the next.

Kept at 0.85 of the default step, 174 grains gave back 1e-5 of their energy and slept after as long a time as
at the default; at 0.7 they gave back 4e-4, at 0.5 they shivered for five times as long, and at a tenth 464
grains got four times the energy that they were poured with.
"""

CHOICES = {
    "engine": ("physx", "bullet"),
    "inertia": ("exact", "paper"),
    "contact_manifold": ("full", "persistent"),
    "collision_shape": ("auto", "sphere"),
    "decomposition": ("auto", "on", "off"),
}

MOST_VERTICES = 128
"""A hull of n vertices has up to 2 n - 4 facets, and PhysX holds 255: of a larger one it cuts corners without
saying so. Rounded grains of 160 and 255 vertices sank into the floor by up to 0.03 of a radius."""

ENGINES = {"bullet": {"solver_iterations": 100}}
"""What an engine needs otherwise: with 20 of its iterations, 439 hulls at rest in Bullet overlapped by up to
0.05 of a radius and were carried to 2 % of their weight, with 100 to 0.008 and 0.4 %."""

NAMED: dict[str, dict] = {
    "default": {},
    "paper": {
        "engine": "physx",
        "gravity": 9.8,
        "dt": 0.01,
        "friction_static": 0.5,
        "friction_dynamic": 0.5,
        "restitution": 0.5,
        "density": 2.6,
        "inertia": "paper",
        "contact_manifold": "persistent",
        "sleep_speed": 0.01,
        "sleep_steps": 300,
    },
}
