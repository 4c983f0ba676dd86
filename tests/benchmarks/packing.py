"""Packings that physics knows: does each engine reproduce them?

    python tests/benchmarks/packing.py [--only spheres heap] [--engines physx] [--seeds 5] [--out ...]

Every single packing is kept in ``packing_runs.csv`` beside the table as soon as it is done and is not run
again: an interrupted benchmark goes on where it was, and ``--only`` fills in one case at a time. The table
has a row a case: case, engine, friction, coarse_share, seeds, solid_fraction, lower, upper (mean over the
seeds and its 95 % interval by Student's t), z, z_lower, z_upper (coordination of the backbone, rattlers
removed), rattlers, contact_tolerance, angle_deg, angle_lower, angle_upper, drift, net_force, energy_rise
(worst seed), cpu_s (mean of a run), reference, verdict (yes, no, or what is missing), note.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import trimesh
from engines import angular_grains
from scipy.stats import t as student

from grainfall import io
from grainfall.contacts import coordination, find_contacts
from grainfall.grains import Library
from grainfall.packing import Parameters, container, deposit
from grainfall.packing.engine import Solid, start
from grainfall.packing.rest import settle
from grainfall.volume import voxelise

RADIUS = 50.0
"""Mean grain radius (of the coarse grains where there are two sizes), um."""

TOLERANCE = 1e-4
"""Largest gap of a contact, mean diameters. Of 2,324 spheres at rest without friction in PhysX, all contacts
that bore a force were within 1e-5, of 744 with friction in Bullet 99 in 100 within 1e-6; with 1e-3 the
neighbours that merely came near add 0.1 to z."""

VOXELS = 40
"""Voxels across a diameter. Centres of voxels are unbiased samples of the solid: a sphere's volume is then
known to 1e-3, and the solid fraction of a hundred to 1e-4."""

SLOW_WINDOWS = {"physx": 120, "bullet": 30}
"""Without friction, spheres frozen while pouring were not stable, and in a liquid all goes slowly: such beds
take many windows to come to rest. Bullet's beds drift on for as long as one waits."""

LIQUID = 3.0
"""Rate, 1/s, at which spheres lose speed as they sink: they arrive as fast as from a fall over half a radius.
The known packings were brought together slowly. Falling from four radii, spheres of any friction above 0.3
shake each other down to 0.61 (case ``poured``)."""


@dataclass(frozen=True)
class Case:
    """One row of the table: a packing's settings and how many seeds it is repeated with."""

    case: str
    engine: str = "physx"
    friction: float = 0.5
    coarse_share: float = 1.0
    seeds: int = 5

    @property
    def parameters(self) -> Parameters:
        """The defaults with this friction; spheres of the known packings sink through a liquid."""
        changes: dict[str, float] = {"friction_static": self.friction, "friction_dynamic": self.friction}
        if self.case == "spheres":
            changes["linear_damping"] = LIQUID
        if self.case == "spheres":
            changes["rest_windows"] = SLOW_WINDOWS[self.engine]
        return Parameters.named(engine=self.engine, **changes)


FRICTIONS = (0.0, 0.1, 0.3, 0.5, 1.0)
SHARES = (0.5, 0.6, 0.7, 0.8, 0.9)
HEAPS = (0.2, 0.4, 0.7, 1.0)

CASES = (
    *(Case("spheres", friction=mu) for mu in FRICTIONS),
    *(Case("spheres", "bullet", mu, seeds=3) for mu in FRICTIONS),
    *(Case("poured", friction=mu) for mu in (0.3, 1.0)),
    *(Case("heap", friction=mu, seeds=20) for mu in HEAPS),
    *(Case("heap", "bullet", mu, seeds=1) for mu in HEAPS),
    Case("rest"),
    Case("rest", "bullet", seeds=1),
    Case("ellipsoids", friction=0.0),
    Case("ellipsoids", "bullet", friction=0.0, seeds=1),
    *(Case("two_sizes", friction=0.0, coarse_share=x) for x in SHARES),
    *(Case("two_sizes", "bullet", 0.0, x, seeds=1) for x in SHARES),
)


# --- packings --------------------------------------------------------------------------------------------


def pour(case: Case, seed: int, supply: pd.DataFrame, library, roi: float, margin: float) -> dict:
    """Grains poured into a box; what the core, ``margin`` diameters from all walls, holds."""
    box = container(roi * 2 * RADIUS, 2 * RADIUS, margin)
    started = time.process_time()
    bodies = deposit(supply, library, box, case.parameters, np.random.default_rng(seed))
    cpu = time.process_time() - started
    n = round(roi * VOXELS)
    _, body = voxelise(bodies, library, (n,) * 3, box.roi_um[0] / n)
    solid = np.bincount(body.ravel(), minlength=len(bodies) + 1)[1:]
    touching = find_contacts(bodies, library, None, 1.0, TOLERANCE, case.parameters)
    found = coordination(touching, bodies, box.roi_um).iloc[0]
    report = bodies.attrs["report"]
    return {
        "solid_fraction": solid.sum() / n**3,
        "coarse_measured": solid[bodies["scale"] > 0.9 * RADIUS].sum() / solid.sum(),
        "z": found["coordination"],
        "rattlers": found["rattlers"],
        "drift": report["rest"]["drift_mean"],
        "net_force": report["rest"]["net_force"],
        "energy_rise": report["rest"]["energy_rise"],
        "max_overlap": report["max_overlap"],
        "n_bodies": len(bodies),
        "cpu_s": cpu,
    }


def grains(n: int, shape: int | np.ndarray = -1, scale: float | np.ndarray = RADIUS) -> pd.DataFrame:
    """A supply of grains."""
    return pd.DataFrame({"kind": "grain", "phase": 1, "shape": np.full(n, shape), "scale": scale})


def spheres(case: Case, seed: int) -> dict:
    """Equal spheres; the core three diameters from walls, floor and surface."""
    roi = 4.5 if case.engine == "physx" else 3.0
    return pour(case, seed, grains(200), None, roi, 3.0)


def ellipsoids(case: Case, seed: int, roi: float | None = None, margin: float = 3.0, fine: int = 3) -> dict:
    """Ellipsoids 1.25 : 1 : 0.8, the core three diameters from walls, floor and surface."""
    roi = roi or (4.0 if case.engine == "physx" else 2.5)
    ball = trimesh.creation.icosphere(fine)
    vertices = np.array(ball.vertices) * [1.25, 1.0, 0.8]
    vertices *= (4 * np.pi / 3 / trimesh.Trimesh(vertices, ball.faces).volume) ** (1 / 3)
    table = pd.DataFrame({"shape": [0], "phase": 1, "r2d_um": RADIUS})
    library = Library([vertices], [np.array(ball.faces, np.int32)], table)
    return pour(case, seed, grains(200, 0), library, roi, margin)


def two_sizes(case: Case, seed: int, ratio: int = 4, margin: float | None = None) -> dict:
    """Two sizes of spheres, 1 : 4; the core 1.5 coarse (Bullet 1), 6 fine (4) diameters from walls."""
    roi, margin = 2.0, margin or (1.5 if case.engine == "physx" else 1.0)
    rng = np.random.default_rng(seed)
    fines = (1 - case.coarse_share) * ratio**3  # numbers are as volume over volume of one
    coarse = rng.random(20000) < case.coarse_share / (case.coarse_share + fines)
    return pour(case, seed, grains(20000, -1, np.where(coarse, RADIUS, RADIUS / ratio)), None, roi, margin)


def rest(case: Case, seed: int, roi: float = 4.0) -> dict:
    """Angular grains poured with the defaults, then all set free in a new engine for 300 steps."""
    rng = np.random.default_rng(seed)
    library = angular_grains(40, rng)
    scale = RADIUS * np.exp(rng.normal(0, 0.25, 400))
    supply = grains(400, rng.integers(0, 40, 400), scale)
    box = container(roi * 2 * RADIUS, 2 * RADIUS, 1.0)
    started = time.process_time()
    bodies = deposit(supply, library, box, case.parameters, rng)
    _, found = settle(bodies, library, box, case.parameters, windows=1)
    poured = bodies.attrs["report"]["rest"]
    return {
        "drift": found["drift_mean"],
        # normal forces alone, which is all that PhysX tells, do not balance a grain with friction
        "net_force": max(found["net_force"], found["net_force_contacts"] or 0.0),
        "energy_rise": max(found["energy_rise"], poured["energy_rise"]),
        "max_overlap": found["max_overlap"],
        "n_bodies": len(bodies),
        "cpu_s": time.process_time() - started,
    }


# --- heaps -----------------------------------------------------------------------------------------------


def heap(case: Case, seed: int, n: int = 480, width: float = 60.0) -> dict:
    """Spheres poured from just above a heap on a plate of fixed spheres, and the angle of its flank."""
    p, rng = case.parameters, np.random.default_rng(seed)
    engine = start(p, width, width)
    started = time.process_time()
    mass = p.density * 4 / 3 * np.pi
    ball, upright, centre = Solid((), 1.0, mass, np.full(3, 0.4 * mass)), np.array([1.0, 0, 0, 0]), width / 2
    for x in np.arange(1.0, width, 2.0):
        for y in np.arange(1.0, width, 2.0):
            # uneven, since spheres on a lattice go on as a crystal whose slope knows no friction
            engine.add(ball, np.array([x, y, 0.0]) + rng.random(3), upright, fixed=True)
    poured, xyz = 0, np.empty((0, 3))
    while poured < n:
        near = np.linalg.norm(xyz[:, :2] - centre, axis=1) < NOZZLE
        low = xyz[near, 2].max(initial=2.0) + 2.0
        for k in range(BATCH):  # a ring of grains that do not touch, just above the heap
            angle = 2 * np.pi * (k + 0.2 * rng.random()) / BATCH
            place = centre + NOZZLE * np.array([np.cos(angle), np.sin(angle)])
            engine.add(ball, np.array([*place, low + 0.3 * rng.random()]), upright)
        poured += BATCH
        engine.step(100)  # they fall five radii meanwhile
        xyz = engine.state().position
    for _ in range(20):
        engine.step(100)
        moved = np.linalg.norm(engine.state().position - xyz, axis=1)
        xyz = engine.state().position
        if moved.mean() < p.sleep_speed * 100 * p.dt:
            break
    engine.close()
    return {"angle_deg": angle_of_repose(xyz - [centre, centre, 2.0]), "n_bodies": len(xyz)} | {
        "cpu_s": time.process_time() - started
    }


NOZZLE = 3.0
"""Radius, grain radii, of the place that a heap is poured from."""

BATCH = 8
"""Grains that leave the nozzle at a time."""


def angle_of_repose(xyz: np.ndarray, cell: float = 3.0) -> float:
    """Slope, degrees, of the surface of a heap of unit spheres between a fifth and four fifths of its foot.

    The surface is the highest grain in each column of a square grid. Half a cone's volume lies within half
    the radius of its foot, which therefore is twice the grains' median distance from the axis, strays or not.

    Parameters
    ----------
    xyz : (n, 3) float
        Centres; the heap's axis is z, its base z = 0.
    cell : float
        Width of the columns.
    """
    foot = 2 * np.median(np.hypot(xyz[:, 0], xyz[:, 1]))
    n = 2 * int(np.ceil(foot / cell))
    index = np.floor(xyz[:, :2] / cell).astype(int) + n // 2
    inside = ((index >= 0) & (index < n)).all(axis=1)
    tops = np.zeros((n, n))
    np.maximum.at(tops, tuple(index[inside].T), xyz[inside, 2] + 1.0)
    middle = (np.arange(n) + 0.5 - n / 2) * cell
    r = np.hypot(*np.meshgrid(middle, middle))
    flank = (r > 0.2 * foot) & (r < 0.8 * foot)
    return float(np.degrees(np.arctan(-np.polyfit(r[flank], tops[flank], 1)[0])))


MEASURES = {
    "spheres": spheres,
    "poured": spheres,
    "ellipsoids": ellipsoids,
    "two_sizes": two_sizes,
    "heap": heap,
    "rest": rest,
}


# --- the table -------------------------------------------------------------------------------------------

KEY = ["case", "engine", "friction", "coarse_share"]


def interval(values: pd.Series) -> tuple[float, float, float]:
    """Mean and its 95 % interval by Student's t; no interval from one value."""
    values = values.dropna()
    if len(values) < 2:
        return (values.mean(), np.nan, np.nan)
    half = student.ppf(0.975, len(values) - 1) * values.sem()
    return values.mean(), values.mean() - half, values.mean() + half


def summarise(runs: pd.DataFrame) -> pd.DataFrame:
    """A row a case from a row a packing."""
    rows = []
    for key, group in runs.groupby(KEY, sort=False):
        row = dict(zip(KEY, key, strict=True)) | {"seeds": len(group)}
        for column, names in (
            ("solid_fraction", ("solid_fraction", "lower", "upper")),
            ("z", ("z", "z_lower", "z_upper")),
            ("angle_deg", ("angle_deg", "angle_lower", "angle_upper")),
        ):
            row |= dict(zip(names, interval(group[column]), strict=True))
        row["rattlers"], row["coarse_measured"] = group["rattlers"].mean(), group["coarse_measured"].mean()
        row["contact_tolerance"] = TOLERANCE if group["z"].notna().any() else np.nan
        row |= {name: group[name].max() for name in ("drift", "net_force", "energy_rise", "max_overlap")}
        row |= {"n_bodies": round(group["n_bodies"].mean()), "cpu_s": group["cpu_s"].mean()}
        rows.append(row)
    table = pd.DataFrame(rows)
    judged = [judge(row, table) for _, row in table.iterrows()]
    table[["reference", "verdict", "note"]] = judged
    return table


SMALLER = {
    "spheres": ", core 3 diameters wide instead of 4.5",
    "ellipsoids": ", core 2.5 diameters wide instead of 4",
    "two_sizes": ", core 1 coarse diameter (4 fine) from walls instead of 1.5",
}
"""How Bullet's beds are reduced."""


def judge(row: pd.Series, table: pd.DataFrame) -> tuple[str, str, str]:
    """What is known of a case, whether the row meets it, and what to keep in mind."""
    alike = table[(table["case"] == row["case"]) & (table["engine"] == row["engine"])]
    note = "" if row["seeds"] >= 5 else f"reduced: {row['seeds']} seed(s)"
    if row["engine"] == "bullet":
        note += SMALLER.get(row["case"], "")
    misses = []
    if row["case"] == "spheres" and row["friction"] == 0:
        reference = "solid fraction 0.634-0.643, z 5.9-6.2 (Agnolin and Roux 2007: 0.639, 6)"
        misses += _outside("solid fraction", row, ("solid_fraction", "lower", "upper"), 0.634, 0.643)
        misses += _outside("z", row, ("z", "z_lower", "z_upper"), 5.9, 6.2)
    elif row["case"] == "spheres":
        reference = (
            "falls from 0.64, never below 0.550 (random loose: Jerkins et al. 2008); z from 6 to 4-4.6"
        )
        lesser = alike[alike["friction"] < row["friction"]].sort_values("friction")
        if row["solid_fraction"] < 0.55:
            misses.append("below random loose packing")
        if len(lesser):
            less = lesser.iloc[-1]
            misses += _not_below(
                "solid fraction", row["solid_fraction"], row["lower"], less["solid_fraction"], less["upper"]
            )
            misses += _not_below("z", row["z"], row["z_lower"], less["z"], less["z_upper"])
        if row["friction"] >= 1:
            misses += _outside("z", row, ("z", "z_lower", "z_upper"), 4.0, 4.6)
    elif row["case"] == "poured":
        reference = "between random loose, 0.550, and random close, 0.643"
        misses += _outside("solid fraction", row, ("solid_fraction", "lower", "upper"), 0.55, 0.643)
        note = "; ".join(filter(None, (note, "fell freely, as the defaults have it")))
    elif row["case"] == "ellipsoids":
        reference = "solid fraction >= 0.70 (jammed optimum 0.735: Donev et al. 2004)"
        misses += _outside("solid fraction", row, ("solid_fraction", "lower", "upper"), 0.70, 0.735)
    elif row["case"] == "two_sizes":
        reference = "largest solid fraction between 65 and 80 % coarse, >= 0.70"
        best = alike.loc[alike["solid_fraction"].idxmax()]
        if not 0.65 <= best["coarse_measured"] <= 0.80:
            misses.append(f"largest at {100 * best['coarse_measured']:.0f} % coarse")
        if best["solid_fraction"] < 0.70:
            misses.append(f"largest is {best['solid_fraction']:.3f}")
        if row["engine"] == "physx":
            note = "; ".join(filter(None, (note, "core 1.5 coarse (6 fine) diameters from walls")))
    elif row["case"] == "heap":
        reference = "rises with friction"
        lesser = alike[alike["friction"] < row["friction"]].sort_values("friction")
        if len(lesser):
            less = lesser.iloc[-1]
            misses += _not_below(
                "flatness", -row["angle_deg"], -row["angle_upper"], -less["angle_deg"], -less["angle_lower"]
            )
    else:
        reference = "drift < 1e-3 R in 300 steps, net force < 1e-2 weight, energy rises < 1e-3"
        for name, limit in (("drift", 1e-3), ("net_force", 1e-2), ("energy_rise", 1e-3)):
            if not row[name] < limit:
                misses.append(f"{name} {row[name]:.2g}")
    return reference, "; ".join(misses) or "yes", note


def _outside(name: str, row: pd.Series, columns: tuple, low: float, high: float) -> list[str]:
    """Where a mean misses a range; by how much, and whether its interval reaches it."""
    value, lower, upper = (row[c] for c in columns)
    if low <= value <= high:
        return []
    by = value - high if value > high else value - low
    reaches = lower <= high and upper >= low
    return [f"{name} off by {by:+.3f}" + (", its interval reaches" if reaches else "")]


def _not_below(name: str, value: float, lower: float, other: float, upper: float) -> list[str]:
    """Where a mean that should be below another one is not, and whether the intervals allow that."""
    if value < other:
        return []
    return [f"{name} not below that at less friction" + (", by chance perhaps" if lower <= upper else "")]


def figure(table: pd.DataFrame):
    """Solid fraction and coordination against friction, fines, and angle of repose, with what is known."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.2, 5.4), layout="constrained")
    density, contacts, fines, slope = figure.subplots(2, 2).ravel()
    marks = {"physx": ("o", "-", "#0072B2"), "bullet": ("s", "--", "#D55E00")}
    panels = (
        (density, "spheres", "friction", ("solid_fraction", "lower", "upper"), "solid fraction"),
        (contacts, "spheres", "friction", ("z", "z_lower", "z_upper"), "coordination of the backbone"),
        (fines, "two_sizes", "coarse_measured", ("solid_fraction", "lower", "upper"), "solid fraction"),
        (slope, "heap", "friction", ("angle_deg", "angle_lower", "angle_upper"), "angle of repose (degrees)"),
    )
    for axes, case, x, (mean, lower, upper), label in panels:
        for engine, rows in table[table["case"] == case].groupby("engine"):
            rows, (marker, line, colour) = rows.sort_values(x), marks[engine]
            reach = np.nan_to_num([rows[mean] - rows[lower], rows[upper] - rows[mean]])
            axes.errorbar(
                rows[x], rows[mean], reach, marker=marker, ls=line, color=colour, capsize=3, label=engine
            )
        axes.set_xlabel("coarse share of the solid" if x == "coarse_measured" else x)
        axes.set_ylabel(label)
    density.axhspan(0.634, 0.643, color="#009E73", alpha=0.3, label="random close, frictionless")
    density.axhline(0.550, color="#009E73", ls=":", label="random loose")
    contacts.axhspan(5.9, 6.2, xmax=0.1, color="#009E73", alpha=0.3)
    contacts.axhspan(4.0, 4.6, xmin=0.9, color="#009E73", alpha=0.3)
    fines.axvspan(0.65, 0.80, color="#009E73", alpha=0.3)
    fines.axhline(0.70, color="#009E73", ls=":")
    for axes in (density, slope):
        axes.legend(frameon=False, fontsize=7)
    return figure


def write(out: Path, runs: pd.DataFrame) -> pd.DataFrame:
    """The table and its picture."""
    from grainfall.report.figures import save_figure

    table = summarise(runs)
    io.write_table(out, table)
    save_figure(figure(table), out.with_suffix(".svg"))
    return table


def main() -> None:
    options = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    options.add_argument("--only", nargs="+", choices=list(MEASURES), default=list(MEASURES))
    options.add_argument("--engines", nargs="+", default=["physx", "bullet"])
    options.add_argument("--seeds", type=int, default=20, help="most seeds of a case")
    options.add_argument("--out", type=Path, default=Path("results/benchmarks/packing_physics.csv"))
    given = options.parse_args()
    given.out.parent.mkdir(parents=True, exist_ok=True)
    store = given.out.with_name("packing_runs.csv")
    chosen = [c for c in CASES if c.case in given.only and c.engine in given.engines]
    for seed in range(given.seeds):  # seed by seed: what is stopped early still has every case
        for case in chosen:
            runs = io.read_table(store) if store.exists() else pd.DataFrame(columns=[*KEY, "seed"])
            key = {name: getattr(case, name) for name in KEY} | {"seed": seed}
            done = np.logical_and.reduce([runs[name] == value for name, value in key.items()]).any()
            if seed >= case.seeds or done:
                continue
            row = dict.fromkeys(COLUMNS, np.nan) | key | MEASURES[case.case](case, seed)
            print({k: v for k, v in row.items() if v == v}, flush=True)
            runs = pd.concat([r for r in (runs, pd.DataFrame([row])) if len(r)], ignore_index=True)
            io.write_table(store, runs)
    table = write(given.out, io.read_table(store))
    print(table.to_string())


COLUMNS = (
    *("solid_fraction", "coarse_measured", "z", "rattlers", "angle_deg", "drift", "net_force"),
    *("energy_rise", "max_overlap", "n_bodies", "cpu_s"),
)


if __name__ == "__main__":
    main()
