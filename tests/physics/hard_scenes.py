"""The scenes of hard_cases.yaml: built, run under audit and judged."""

from __future__ import annotations

import copy
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from unittest import mock

import numpy as np
import pandas as pd
import trimesh
import yaml
from engines import angular_grains

from grainfall import flow, grains, network, packing, section, stereology, surface, volume
from grainfall.errors import InputError
from grainfall.morphology import analyse
from grainfall.packing import bed as beds
from grainfall.packing import rest
from grainfall.packing.engine import State

ENGINES = ("physx", "bullet")
COLUMNS = ["scene", "engine", "expected", "verdict", "overlap", "escaped", "asleep", "steps", "wall_s"]

MOST_OVERLAP = 0.02
"""Of the smaller radius, collision shapes."""

MOST_ENERGY = 0.01
"""Most of the energy poured in that may come back once it has been dissipated, unless a scene has its own."""


def scenes(size: str) -> list[dict]:
    """Every scene of the file at one size, ``full`` or ``reduced``, ready for :func:`run`."""
    listed = yaml.safe_load(Path(__file__).with_name("hard_cases.yaml").read_text())
    return [{**{k: v for k, v in s.items() if k not in ("full", "reduced")}, **s[size]} for s in listed]


def engines(scene: dict) -> tuple[str, ...]:
    """The engines that take part in a scene; ``-`` where none does."""
    return ENGINES if scene["run"] in ("pour", "rest", "target") else ("-",)


def run(scene: dict, engine: str) -> dict:
    """Run a scene in an engine: a row of :data:`COLUMNS`, with ``why``: what refused it or what it broke."""
    audit = Audit(scene.get("steps", 0), scene.get("energy", MOST_ENERGY))
    began = time.perf_counter()
    figures, faults = {}, []
    try:
        with mock.patch.object(beds, "start", audit.start):
            figures, faults = RUNS[scene["run"]](scene, engine)
        faults = faults + audit.faults()
        verdict = "fails" if faults else "works"
    except InputError as refusal:
        faults = [str(refusal)]
        verdict = "fails" if audit.steps else "refused"
    except OverBudget as over:
        faults, verdict = [str(over)], "fails"
    row = {
        "scene": scene["scene"],
        "engine": engine,
        "expected": scene["expected"],
        "verdict": verdict,
        "overlap": None,
        "escaped": None,
        "asleep": None,
        "steps": audit.steps,
        "wall_s": round(time.perf_counter() - began, 2),
        **figures,
    }
    return {**row, "why": "; ".join(faults)}


# --- the audit ------------------------------------------------------------------------------------------


class OverBudget(Exception):
    """More steps than the scene allows."""


@dataclass
class Audit:
    """Watches every engine that a run starts, from outside: steps taken, energy, finite states.

    Energy enters with a body and leaves with one that is fixed; what is missing has been dissipated, and
    next to none of that may come back. A bed set free again is an engine of its own, which enters with what
    it has, so the bound holds for each stage and not only for the whole.

    Attributes
    ----------
    budget : int
        Steps allowed.
    most : float
        Excess allowed.
    steps : int
        Steps taken.
    excess : float
        Most that came back of what had been dissipated, over all the energy that entered the engine.
    """

    budget: int
    most: float = MOST_ENERGY
    steps: int = 0
    excess: float = 0.0
    finite: bool = True
    _real: Callable = field(default=beds.start, repr=False)

    def start(self, parameters, *sides):
        """In place of :func:`grainfall.packing.engine.start`."""
        engine = self._real(parameters, *sides)
        # overlaps are measured in an engine of its own, for one step without gravity: nothing moves there
        return engine if parameters.gravity < 1e-3 else Watched(engine, parameters.gravity, self)

    def faults(self) -> list[str]:
        """The invariants broken, in words."""
        found = [] if self.finite else ["positions or speeds that are not finite"]
        if self.excess > self.most:
            found.append(f"energy rose by {self.excess:.2g} of what was poured in")
        return found


class Watched:
    """An engine that reports to an :class:`Audit`."""

    def __init__(self, engine, gravity: float, audit: Audit):
        self._engine, self._gravity, self._audit = engine, gravity, audit
        self._mass, self._inertia, self._moving = [], [], []
        self._entered = 0.0
        self._left = 0.0  # with the bodies that were fixed
        self._dissipated = 0.0

    def __getattr__(self, name):
        return getattr(self._engine, name)

    def _energy(self, ids, state) -> float:
        mass, inertia = np.array(self._mass)[ids], np.array(self._inertia)[ids]
        w, v = state.quaternion[:, :1], state.quaternion[:, 1:]
        # the spin in the body's frame: turned back by the quaternion
        cross = 2 * np.cross(state.spin, v)
        spin = state.spin + w * cross + np.cross(cross, v)
        height = state.position[:, 2]
        speed2 = (state.velocity**2).sum(axis=1)
        return float((mass * (self._gravity * height + speed2 / 2)).sum() + (inertia * spin**2).sum() / 2)

    def add(self, solid, position, quaternion, velocity=(0, 0, 0), spin=(0, 0, 0), fixed=False) -> None:
        self._engine.add(solid, position, quaternion, velocity, spin, fixed)
        self._moving.append(not fixed)
        self._mass.append(solid.mass)
        self._inertia.append(solid.inertia)
        if not fixed:
            rows = (np.array(a, float)[None] for a in (position, quaternion, velocity, spin))
            self._entered += self._energy([len(self._mass) - 1], State(*rows))

    def fix(self, ids) -> None:
        self._look()
        moving = np.flatnonzero(self._moving)
        state = self._engine.state()
        chosen = np.isin(moving, ids)
        parts = (a[chosen] for a in (state.position, state.quaternion, state.velocity, state.spin))
        self._left += self._energy(moving[chosen], State(*parts))
        self._engine.fix(ids)
        for i in ids:
            self._moving[i] = False

    def step(self, n: int) -> None:
        self._audit.steps += n
        if self._audit.steps > self._audit.budget:
            raise OverBudget(f"not at rest within {self._audit.budget} steps")
        self._engine.step(n)
        self._look()

    def _look(self) -> None:
        state = self._engine.state()
        energy = self._energy(np.flatnonzero(self._moving), state)
        self._audit.finite &= bool(np.isfinite(energy))
        dissipated = self._entered - self._left - energy
        if self._entered > 0:
            self._audit.excess = max(self._audit.excess, (self._dissipated - dissipated) / self._entered)
        self._dissipated = max(self._dissipated, dissipated)


def judged(bodies: pd.DataFrame, report: dict) -> tuple[dict, list[str]]:
    """Figures and faults of a finished packing."""
    figures = {
        "overlap": report["max_overlap"],
        "escaped": report["escaped"],
        "asleep": float(bodies["asleep"].mean()),
    }
    faults = []
    if not np.isfinite(bodies.select_dtypes("number").to_numpy()).all():
        faults.append("figures that are not finite")
    if figures["escaped"]:
        faults.append(f"{figures['escaped']} bodies left the box")
    if figures["asleep"] < 1:
        faults.append(f"{(~bodies['asleep']).sum()} of {len(bodies)} bodies still awake")
    if not figures["overlap"] < MOST_OVERLAP:
        faults.append(f"overlap {figures['overlap']:.3g}")
    return figures, faults


# --- scenes that are packings ---------------------------------------------------------------------------


def pour(scene: dict, engine: str) -> tuple[dict, list[str]]:
    """Grains poured into a box."""
    bodies, report, library, _ = poured(scene, engine)
    figures, faults = judged(bodies, report)
    return figures, faults + coarse_porosity(scene, bodies, library)


def poured(scene: dict, engine: str) -> tuple[pd.DataFrame, dict, grains.Library, packing.Box]:
    """A scene that is poured, anew in finer steps where overlaps call for it, as a first packing is.

    Bodies, report, shapes and box.
    """
    rng = np.random.default_rng(1)
    um = scene.get("um", 50.0)
    library = SHAPES[scene["shapes"]](np.random.default_rng(5))
    population = supply(scene, len(library), rng)
    population["scale"] *= um
    box = packing.Box(tuple(2.0 * um * edge for edge in scene["region"]), 2.0 * um * scene["margin"])
    parameters = packing.Parameters.named(engine=engine, **scene.get("parameters", {}))

    def pack_with(parameters):
        bodies = packing.deposit(population, library, box, parameters, copy.deepcopy(rng))
        return bodies, bodies.attrs["report"]

    return *packing.pack_first(pack_with, parameters, "auto"), library, box


def supply(scene: dict, shapes: int, rng: np.random.Generator, n: int = 2000) -> pd.DataFrame:
    """Grains in pour order, mean radius 1."""
    radii = scene.get("radii", [1, 1])
    if "sections" in scene:
        sections = np.full(scene["sections"]["number"], float(scene["sections"]["radius"]))
        drawn = stereology.draw_radii(stereology.unfold(sections, bootstrap=20, rng=rng), n, rng)
    elif isinstance(radii, dict):
        sizes, share = np.array(list(radii)), np.array(list(radii.values()), float)
        # by quota and in the order given, so that the rare size is there whatever the seed, and on top
        drawn = np.resize(np.repeat(sizes, share.astype(int)), n).astype(float)
    else:
        drawn = np.geomspace(*radii, n)[rng.permutation(n)]
    table = pd.DataFrame(
        {
            "kind": "grain",
            "phase": 1,
            "shape": rng.integers(0, shapes, n) if shapes else -1,
            "scale": drawn / drawn.mean(),
        }
    )
    if "densities" in scene:
        table["density"] = np.resize(scene["densities"], n)
    if "virtual" in scene:
        given = scene["virtual"]
        every = round(given["radius"] ** 3 * (1 - given["share"]) / given["share"])
        chosen = np.arange(n) % every == min(every, 60) - 1
        table.loc[chosen, ["phase", "shape"]] = 0, -1
        table["kind"] = np.where(chosen, "virtual", "grain")
        table.loc[chosen, "scale"] = given["radius"]
    return table


def coarse_porosity(scene: dict, bodies: pd.DataFrame, library: grains.Library) -> list[str]:
    """Whether coarse voxels give the solid of the bodies: coarse by coarse, without a bias."""
    if "voxels_per_grain" not in scene:
        return []
    fractions = []
    for per_grain in (scene["voxels_per_grain"], 8 * scene["voxels_per_grain"]):
        voxel = 100.0 / per_grain
        shape = tuple(round(edge * per_grain) for edge in scene["region"][::-1])
        fractions.append(float((volume.voxelise(bodies, library, shape, voxel)[0] > 0).mean()))
    # points drawn at random, one a voxel, would scatter by sqrt(p (1 - p) / n); a lattice of them less
    n = np.prod(scene["region"]) * scene["voxels_per_grain"] ** 3
    chance = 3 * (fractions[1] * (1 - fractions[1]) / n) ** 0.5
    off = abs(fractions[0] - fractions[1])
    return [] if off < chance else [f"coarse voxels change the solid fraction by {off:.3g}"]


def at_rest(scene: dict, engine: str) -> tuple[dict, list[str]]:
    """Bodies put somewhere, set free and left to themselves."""
    bodies, library, box = placed(scene)
    parameters = packing.Parameters.named(engine=engine, **scene.get("parameters", {}))
    bodies, report = rest.settle(bodies, library, box, parameters)
    return judged(bodies, report)


def placed(scene: dict, um: float = 50.0) -> tuple[pd.DataFrame, grains.Library, packing.Box]:
    """The bodies of a scene that starts from given places."""
    rng = np.random.default_rng(1)
    library = SHAPES[scene["shapes"]](np.random.default_rng(5))
    if scene["arrange"] == "lattice":
        n = np.array(scene["n"])
        places = 2.0 * (np.stack(np.meshgrid(*map(np.arange, n), indexing="ij"), -1).reshape(-1, 3) + 0.5)
        box = packing.Box(tuple(2.0 * um * n), 0.0)
    else:
        box = packing.Box(tuple(2.0 * um * np.array(scene["box"])), 0.0)
        places = np.broadcast_to(np.array(scene["box"], float), (scene["n"], 3))  # the box's middle
    count = len(places)
    quaternion = rng.standard_normal((count, 4))
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    table = pd.DataFrame({"id": np.arange(count), "kind": "grain", "phase": 1})
    table["shape"] = rng.integers(0, len(library), count) if len(library) else -1
    table["scale"] = um
    table[["x", "y", "z"]] = places * um
    table[["qw", "qx", "qy", "qz"]] = quaternion if len(library) else np.eye(4)[0]
    return table.assign(asleep=True), library, box


def target(scene: dict, engine: str) -> tuple[dict, list[str]]:
    """Both packings of a twin that is to have a given porosity, and the scaling of positions after them."""
    um = 50.0
    library = pebbles(np.random.default_rng(5))
    sizes = {(1, "grain"): equal(um)}
    edge = 2.0 * um * scene["region"]
    voxels = 8 * scene["region"]
    plan = {
        "edge_um": edge,
        "margin_um": 2.0 * um * scene["margin"],
        "mean_diameter_um": 2 * um,
        "phases": ["pore", "grain"],
        "fractions": [1.0],
        "sizes_from": "f3d",
        "porosity_target": scene["target"],
        "shape_zyx": [voxels] * 3,
    }
    parameters = packing.Parameters.named(engine=engine)
    shown: list[tuple[dict, list[str]]] = []

    def pack_with(p: float, lubrication: float = 1.0, spheres=None, rest: bool = False):
        found = packing.pack(
            plan,
            sizes,
            library,
            parameters.lubricated(lubrication),
            np.random.default_rng(1),
            spheres=spheres,
            p_sphere=p,
            rest=rest,
        )
        if rest:
            shown.append(judged(*found))
        return found

    def rested(poured, lubrication: float, taps: int):
        found = packing.let_rest(poured, plan, library, parameters.lubricated(lubrication), taps)
        shown.append(judged(*found))
        return found

    def porosity(bodies: pd.DataFrame) -> float:
        return float((volume.voxelise(bodies, library, plan["shape_zyx"], edge / voxels)[0] == 0).mean())

    first = pack_with(0.0, rest=True)
    spheres, deficit = packing.plan_deficit(
        plan,
        equal(1.5 * um),
        equal(0.5 * um),
        packing.PoreTail(None, None, 0.0, 0.0),
        packing.Overgrowth(surface.SolidSurface(1.0, 0.0), surface.SolidSurface(1.0, 0.0), 0.0),
        porosity(first[0]),
        4 / 3 * np.pi * um**3,
    )
    bodies, report = packing.pack_again(
        deficit,
        lambda p, lubrication: pack_with(p, lubrication, spheres),
        rested,
        porosity,
        first,
        passes=scene["passes"],
    )
    alone = bodies[bodies["kind"] == "grain"].reset_index(drop=True)
    _, corrected = volume.correct_porosity(
        alone, library, plan["shape_zyx"], edge / voxels, scene["target"], limit=0.01
    )
    figures = {
        "overlap": max(f["overlap"] for f, _ in shown),
        "escaped": sum(f["escaped"] for f, _ in shown),
        "asleep": min(f["asleep"] for f, _ in shown),
    }
    faults = [fault for _, some in shown for fault in some]
    left = corrected["after"]["porosity"]
    nearest = f"nearest {left:.3f}"
    words = (nearest, f"nearest {left:.4f}", f"came to {left:.4f}", f"at rest {left:.4f}")
    said = any(w in report["reason"] for w in words)
    if abs(left - scene["target"]) > 0.01 and not said:
        faults.append(f"porosity {left:.3f} is not what the report says ({report['reason']!r})")
    return figures, faults


def equal(radius: float) -> stereology.SizeDistribution:
    """Radii equal to a hundredth."""
    edges = radius * np.array([0.99, 1.01])
    density = 1 / np.diff(edges)
    return stereology.SizeDistribution(edges, density, density, density, density, "given", float("nan"))


# --- scenes of other chapters ---------------------------------------------------------------------------


def one_valued_section(scene: dict, engine: str) -> tuple[dict, list[str]]:
    """A section that is all pore or all solid, read as a user's file and as the user's array."""
    image = np.full((scene["pixels"],) * 2, scene["value"], np.uint8)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "section.npy"
        np.save(path, image)
        section.read_section(path, "phases", 1.0, {"pore": 0, "grain": 1})
    return {}, ["an image of one value was read without a word"]


def lone_masks(scene: dict, engine: str) -> tuple[dict, list[str]]:
    """A library from nothing but masks that are no grains."""
    for kind in scene["masks"]:
        try:
            masked_library([DEGENERATE[kind]], 3, np.random.default_rng(5))
        except InputError as refusal:
            last = refusal
        else:
            return {}, [f"a grain was made of a {kind}"]
    raise last


def ill_network(scene: dict, engine: str) -> tuple[dict, list[str]]:
    """Permeability where nothing flows, and where widths differ by a thousand."""
    return NETWORKS[scene["case"]](scene)


def plugged(scene: dict) -> tuple[dict, list[str]]:
    """Blobs of pore that a solid plane parts along every axis."""
    from scipy import ndimage

    n = scene["pixels"]
    noise = ndimage.gaussian_filter(np.random.default_rng(1).standard_normal((n,) * 3), 2)
    pore = noise > np.quantile(noise, 0.6)
    for axis in range(3):
        np.moveaxis(pore, axis, 0)[n // 2] = False
    faults = []
    for method in flow.METHODS:
        table = flow.permeability(pore, 1.0, method)
        if not (table["k_md"] == 0).all() or table["formation_factor"].notna().any():
            faults.append(f"{method}: flow through solid ({table['k_md'].tolist()})")
    return {}, faults


def contrast(scene: dict) -> tuple[dict, list[str]]:
    """Square ducts in a row, every other one a thousand times narrower: g ~ width^4, so some 1e12 apart."""
    n, spacing = scene["pores"], 10.0
    wide, narrow = 4.0, 0.0035
    net = network.empty()
    middle = np.arange(n - 1)
    net["pore.coords"] = np.outer(np.arange(n), [spacing, 0, 0])
    net["throat.conns"] = np.stack([middle, middle + 1], axis=1)
    width = {"pore": np.full(n, wide), "throat": np.where(middle % 2, narrow, wide)}
    for name in list(net):
        part = name.split(".")[0]
        if name.endswith("_diameter"):
            net[name] = width[part].copy()
        elif name in ("pore.volume", "pore.surface_area"):
            net[name] = np.zeros(n)
        elif name == "throat.coords":
            net[name] = net["pore.coords"][:-1] + np.array([spacing / 2, 0, 0])
        elif name.endswith(".shape_factor"):
            net[name] = np.full(len(width[part]), 1 / 16)
        elif name == "throat.half_lengths":
            net[name] = np.full((n - 1, 2), spacing / 2)
        elif part == "throat" and name != "throat.conns":
            net[name] = np.full(n - 1, spacing)
    for name in ("boundary", *network.FACES):
        net[f"pore.{name}"] = np.zeros(n, bool)
    net["throat.disc_bounding"] = np.zeros(n - 1, bool)
    net["pore.xmin"][0] = net["pore.xmax"][-1] = True
    whole = np.array(flow.conductances(net, "x", "pyramids"))
    # the series law, over the same conduits one by one
    links = []
    for k in range(2):
        two = network.subnetwork(net, np.isin(np.arange(n), [k, k + 1]))
        two["pore.xmin"], two["pore.xmax"] = np.array([True, False]), np.array([False, True])
        links.append(flow.conductances(two, "x", "pyramids"))
    count = np.array([-(-(n - 1) // 2), (n - 1) // 2])
    series = 1 / (count[:, None] / np.array(links)).sum(axis=0)
    apart = links[0][0] / links[1][0]
    faults = [] if apart > 1e12 else [f"conductances only {apart:.2g} apart"]
    if not np.allclose(whole, series, rtol=1e-6, atol=0):
        faults.append(f"conductances {whole.tolist()}, the series law says {series.tolist()}")
    return {}, faults


# --- shapes ---------------------------------------------------------------------------------------------


def library_of(meshes: list[tuple[np.ndarray, np.ndarray]]) -> grains.Library:
    """Closed meshes as a library: equal-volume radius 1, centre of mass at the origin."""
    vertices, faces = [], []
    for v, f in meshes:
        mesh = trimesh.Trimesh(v, f, process=False)
        assert mesh.is_watertight
        assert mesh.volume > 0
        vertices.append((v - mesh.center_mass) / np.cbrt(mesh.volume / (4 * np.pi / 3)))
        faces.append(np.asarray(f, np.int32))
    return grains.Library(
        vertices, faces, pd.DataFrame({"shape": np.arange(len(meshes)), "phase": 1, "r2d_um": 50.0})
    )


def spheres(rng: np.random.Generator) -> grains.Library:
    """No mesh: shape -1."""
    return grains.Library([], [], pd.DataFrame(columns=["shape", "phase", "r2d_um"]))


def pebbles(rng: np.random.Generator) -> grains.Library:
    """Ellipsoids cut by three random planes."""
    return angular_grains(8, rng, planes=3, subdivisions=2)


def spheroids(*axes: float) -> Callable[[np.random.Generator], grains.Library]:
    """Ellipsoids of these axes."""
    ball = trimesh.creation.icosphere(2)
    return lambda rng: library_of([(np.array(ball.vertices) * axes, ball.faces)])


def cubes(rng: np.random.Generator) -> grains.Library:
    """Cubes."""
    box = trimesh.creation.box()
    return library_of([(np.array(box.vertices), box.faces)])


def stars(rng: np.random.Generator) -> grains.Library:
    """Balls with six long rounded arms."""
    ball = trimesh.creation.icosphere(3)
    v = np.array(ball.vertices)
    return library_of([(v * (0.5 + 1.0 * (v**8).sum(axis=1, keepdims=True)), ball.faces)])


def ells(rng: np.random.Generator) -> grains.Library:
    """L-shaped prisms: arms three long, one wide, one thick."""
    outline = np.array([[0, 0], [3, 0], [3, 1], [1, 1], [1, 3], [0, 3]], float)
    v = np.vstack([np.column_stack([outline, np.full(6, z)]) for z in (0.0, 1.0)])
    top = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]])
    side = [[i, j, j + 6] for i, j in zip(range(6), [1, 2, 3, 4, 5, 0], strict=True)]
    side += [[i, j + 6, i + 6] for i, j in zip(range(6), [1, 2, 3, 4, 5, 0], strict=True)]
    return library_of([(v, np.vstack([top[:, ::-1], top + 6, side]))])


def disc(n: int) -> np.ndarray:
    """A round mask ``n`` pixels wide."""
    middle = np.arange(n) - (n - 1) / 2
    return middle[:, None] ** 2 + middle**2 <= (n / 2) ** 2


def with_hole() -> np.ndarray:
    """A round mask with a hole."""
    mask = disc(15)
    mask[5:10, 5:10] = False
    return mask


DEGENERATE = {
    "line": np.ones((1, 40), bool),
    "pixel": np.ones((1, 1), bool),
    "three": np.ones((1, 3), bool),
    "hole": with_hole(),
}


def masked_library(masks: list[np.ndarray], shapes: int, rng: np.random.Generator) -> grains.Library:
    """The library of a section that shows these masks side by side, by way of all its chapters."""
    high = max(m.shape[0] for m in masks) + 4
    labels = np.zeros((high, sum(m.shape[1] + 2 for m in masks) + 2), np.int32)
    left = 2
    for number, mask in enumerate(masks, start=1):
        h, w = mask.shape
        labels[2 : 2 + h, left : left + w][mask] = number
        left += w + 2
    found = analyse((labels > 0).astype(np.uint8), 1.0, instances=labels, min_radius_px=0.0)
    return grains.build_library(found.grain_labels, found.grains, shapes, rng)


def four_pixels(rng: np.random.Generator) -> grains.Library:
    """Grains of masks as small as masks may be."""
    return masked_library([np.ones((4, 4), bool), np.ones((3, 6), bool), disc(5)], 4, rng)


def with_degenerate(rng: np.random.Generator) -> grains.Library:
    """Sound masks, one with a hole, a line and a pixel."""
    library = masked_library([disc(15), disc(11), *DEGENERATE.values()], 4, rng)
    # left out with a reason: the line, the pixel and the three pixels, not the hole
    assert library.skipped["grain"].tolist() == [3, 4, 5]
    assert library.skipped["reason"].str.len().gt(0).all()
    return library


SHAPES: dict[str, Callable[[np.random.Generator], grains.Library]] = {
    "spheres": spheres,
    "pebbles": pebbles,
    "needles": spheroids(5, 1, 1),
    "plates": spheroids(5, 5, 1),
    "cubes": cubes,
    "stars": stars,
    "ells": ells,
    "masks_of_four_pixels": four_pixels,
    "masks_with_a_line_a_pixel_and_a_hole": with_degenerate,
}

RUNS: dict[str, Callable[[dict, str], tuple[dict, list[str]]]] = {
    "pour": pour,
    "rest": at_rest,
    "target": target,
    "section": one_valued_section,
    "shapes": lone_masks,
    "network": ill_network,
}

NETWORKS = {"plugged": plugged, "contrast": contrast}
