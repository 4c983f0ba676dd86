"""Permeability and formation factor against published Stokes values and exact solutions.

    python tests/benchmarks/permeability.py [--samples arrays andra packs berea] [--methods elliptic direct]
        [--cubes 0 13 26] [--out results/benchmarks/permeability.csv]

Columns: sample, cube, axis, method, k, k_ref (mD), ff, ff_ref, wall_s. Rows already in the table are not
computed again: delete the file, or the rows, to measure anew.

- ``berea``: 27 cubes of 128^3 voxels, Stokes values by others.
- ``arrays``: simple cubic spheres (Zick & Homsy 1982) and square cylinders (Sangani & Acrivos 1982) in a
  periodic cell of 1 mm, as voxels and as a distance field, ``_n`` voxels along the cell.
- ``andra``: the sphere pack of Andra et al. (2013), 621 spheres of 0.35 mm, as a closed box of voxels (every
  method) and as the periodic distance field it is; k_ref is the middle of the published range.
- ``packs``: six packed twins of different shape, sorting and porosity, and those that ``--twins`` names;
  k_ref and ff_ref are those of direct.
- ``volume_...``: cubes of ``--volume``, a segmented rock of your own, against direct, too:
  ``make bench-permeability VOLUME=rock.tif VOXEL=2.5`` (um; ``PORE=1`` where that is the pore).
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import tifffile
import trimesh
from engines import angular_grains
from scipy.spatial import cKDTree

from grainfall import flow, io, network, volume
from grainfall.flow import direct, elliptic
from grainfall.grains import Library
from grainfall.packing import Parameters, container, deposit
from grainfall.section import read_reference
from grainfall.units import um2_to_millidarcy

DATA = Path(__file__).resolve().parents[2].parent / "shared/data"
BEREA_VOXEL_UM = 5.345
BEREA_EDGE = 128
CELL_UM = 1000.0
ANDRA_BOX = (55.185506, 55.404375, 55.540488)
"""Period along x, y, z in tenths of a millimetre, radius 3.5."""
ANDRA_K_M2 = (2.438e-10, 2.903e-10)
"""Range over the solvers of Saxena et al. (2017)."""
COLUMNS = ["sample", "cube", "axis", "method", "k", "k_ref", "ff", "ff_ref", "wall_s"]
KEY = COLUMNS[:4]
NETWORKS = {
    "network_local": ("persistence", "local"),
    "network_shape_factor": ("persistence", "shape_factor"),
    "snow2": ("snow2", "pyramids"),
}
"""Methods by a network: its extraction and its conductances."""


class Table:
    """The rows measured so far, on disk after every one."""

    def __init__(self, path: Path):
        self.path = path
        self.rows = (
            pd.read_csv(path, dtype={"cube": "Int64"}) if path.exists() else pd.DataFrame(columns=COLUMNS)
        )

    def has(self, *key: object) -> bool:
        rows = self.rows
        return bool(
            (
                (rows["sample"] == key[0])
                & (rows["axis"] == key[2])
                & (rows["method"] == key[3])
                & ((rows["cube"] == key[1]) if key[1] is not None else rows["cube"].isna())
            ).any()
        )

    def add(self, row: tuple) -> None:
        new = pd.DataFrame([row], columns=COLUMNS).astype({"cube": "Int64"})
        self.rows = pd.concat([self.rows, new], ignore_index=True) if len(self.rows) else new
        io.write_table(self.path, self.rows)
        print(*row, flush=True)


def through(
    pore: np.ndarray, voxel_um: float, axis: str, method: str, conditions: dict[str, str]
) -> tuple[float, float, float]:
    """K in mD, formation factor and seconds along one axis by a method that solves on the voxels."""
    begin = time.perf_counter()
    k = {"elliptic": elliptic, "direct": direct}[method].solve(pore, axis, **conditions).k
    wall_s = time.perf_counter() - begin
    voxels = pore if pore.dtype == bool else pore > 0
    factor = elliptic.formation_factor(voxels, axis, **conditions)
    return um2_to_millidarcy(k * voxel_um**2), factor, wall_s


def measured(pore: np.ndarray, voxel_um: float, method: str) -> pd.DataFrame:
    """Table of :func:`grainfall.flow.permeability`, the extraction's time included."""
    if method not in NETWORKS:
        return flow.permeability(pore, voxel_um, method)
    extraction, conductance = NETWORKS[method]
    begin = time.perf_counter()
    found = network.extract(pore, voxel_um, extraction) if conductance != "local" else None
    extraction_s = time.perf_counter() - begin
    table = flow.permeability(pore, voxel_um, "network", conductance=conductance, network=found)
    table["wall_s"] += extraction_s / 3
    return table


def berea(table: Table, methods: list[str], cubes: list[int]) -> None:
    pore = tifffile.imread(DATA / "berea/berea_400_pore1.tif") == 1
    published = pd.read_csv(DATA / "berea/subvolume_K_FF.csv")
    for cube in cubes:
        row = published.iloc[cube]
        i, j, k = (int(row[name]) for name in ("i0_axis0", "j0_axis1", "k0_axis2"))
        part = pore[i : i + BEREA_EDGE, j : j + BEREA_EDGE, k : k + BEREA_EDGE]
        for method in methods:
            if all(table.has("berea", cube, axis, method) for axis in flow.AXES):
                continue
            for found in measured(part, BEREA_VOXEL_UM, method).itertuples():
                axis = found.axis.upper()
                k_ref = um2_to_millidarcy(row[f"K_{axis}_h2"] * BEREA_VOXEL_UM**2)
                ff, ff_ref = found.formation_factor, row[f"FF_{axis}"]
                table.add(("berea", cube, found.axis, method, found.k_md, k_ref, ff, ff_ref, found.wall_s))


def arrays() -> Iterator[tuple[str, np.ndarray, int, float]]:
    """Periodic cells: name, distance field, voxels along the cell, exact K over the cell's edge squared."""
    spheres = pd.read_csv(DATA / "reference/zick_homsy_1982_SC.csv", comment="#").set_index("c")["K_drag"]
    for c in (0.125, 0.343, 0.5236):
        radius = (3 * c / (4 * np.pi)) ** (1 / 3)
        for n in (16, 32, 64):
            at = (np.arange(n) + 0.5) / n - 0.5
            away = np.sqrt(at[:, None, None] ** 2 + at[:, None] ** 2 + at**2)
            yield f"simple_cubic_{c}", (away - radius) * n, n, 2 * radius**2 / (9 * c * spheres[c])
    cylinders = pd.read_csv(DATA / "reference/sangani_acrivos_1982_square_cylinders.csv", comment="#")
    for c, force in cylinders.itertuples(index=False):
        narrow = (512, 1024) if c >= 0.7 else ()  # gaps of a fiftieth of the cell
        for n in (64, 128, 256, *narrow):
            at = (np.arange(n) + 0.5) / n - 0.5
            away = np.sqrt(at[:, None] ** 2 + at**2)[None]
            yield f"square_cylinders_{c}", (away - np.sqrt(c / np.pi)) * n, n, 1 / force


def andra(n: int) -> tuple[np.ndarray, float]:
    """Distance field in voxels of the pack with n voxels along x and as near as can be along y and z, and the
    edge of a voxel in um; the voxels' edges along the axes differ by less than 1 % of one another."""
    box = np.array(ANDRA_BOX)
    counts = np.round(box / box[0] * n).astype(int)
    centres = np.loadtxt(DATA / "spherepack/andra2013_621.txt")[:, :3] % box
    tree = cKDTree(centres, boxsize=box)
    at = [(np.arange(m) + 0.5) / m * length for m, length in zip(counts, box, strict=True)]
    grid = np.stack(np.meshgrid(at[2], at[1], at[0], indexing="ij"), axis=-1)[..., ::-1]
    voxel = (box / counts).prod() ** (1 / 3)
    distance = (tree.query(grid)[0] - 3.5) / voxel
    return distance, voxel * 100


def twins(paths: list[Path], edge: int) -> Iterator[tuple[str, np.ndarray, float]]:
    """The middle of packed twins: name, pore space, edge of a voxel in um."""
    for path in paths:
        phase, attributes = io.read_volume(path, "phase")
        middle = tuple(slice(max(0, (n - edge) // 2), (n + edge) // 2) for n in phase.shape)
        name = "twin_" + "_".join(path.absolute().parent.parts[-3:])
        yield name, np.ascontiguousarray(phase[middle] == 0), attributes["voxel_size_um"]


def cubes(path: Path, pore: int, voxel_um: float, edge: int) -> Iterator[tuple[str, np.ndarray, float]]:
    """A volume in cubes: name, pore space, edge of a voxel in um."""
    rock, _ = read_reference(path, voxel_um, pore_value=pore)
    edge = min(edge, *rock.shape)
    for n, start in enumerate(np.ndindex(*(length // edge for length in rock.shape))):
        part = tuple(slice(edge * i, edge * (i + 1)) for i in start)
        yield f"volume_{path.stem}_{n}", rock[part] == 0, voxel_um


PACKS = {
    "spheres": ("sphere", 0.0, None),
    "spheres_unsorted": ("sphere", 0.5, None),
    "angular": ("angular", 0.25, None),
    "needles": ("needle", 0.25, None),
    "angular_cemented": ("angular", 0.25, 0.25),
    "spheres_cemented": ("sphere", 0.25, 0.12),
}
"""Packed twins of this benchmark: shape of the grains, spread of their radii (cv), porosity if cemented."""

PACK_EDGE, PACK_VOXELS = 6, 16
"""Edge in mean grains, voxels across one."""


def packs() -> Iterator[tuple[str, np.ndarray, float]]:
    """Grains poured and, for some, cemented: name, pore space, edge of a voxel in um."""
    rng = np.random.default_rng(0)
    ball = trimesh.creation.icosphere(3)
    needle = np.array(ball.vertices) * np.array([2.0, 1.0, 1.0]) / 2 ** (1 / 3)
    table = pd.DataFrame({"shape": [0], "phase": 1, "r2d_um": 50.0})
    libraries = {
        "sphere": None,
        "angular": angular_grains(40, rng),
        "needle": Library([needle], [np.array(ball.faces, np.int32)], table),
    }
    for number, (name, (shape, cv, porosity)) in enumerate(PACKS.items()):
        rng = np.random.default_rng(number)
        library, box = libraries[shape], container(PACK_EDGE * 100.0, 100.0, 1.0)
        kinds = -1 if library is None else rng.integers(0, len(library.vertices), 2000)
        spread = np.log(1 + cv**2) ** 0.5
        supply = pd.DataFrame(
            {"kind": "grain", "phase": 1, "shape": kinds, "scale": 50 * np.exp(rng.normal(0, spread, 2000))}
        )
        bodies = deposit(supply, library, box, Parameters(), rng)
        voxels, voxel_um = (PACK_EDGE * PACK_VOXELS,) * 3, 100.0 / PACK_VOXELS
        if porosity is None:
            phase, _ = volume.voxelise(bodies, library, voxels, voxel_um)
        else:
            phase, _, _ = volume.cement(bodies, library, voxels, voxel_um, porosity, 2)
        yield f"pack_{name}", phase == 0, voxel_um


def against_direct(table: Table, methods: list[str], sample: str, pore: np.ndarray, voxel_um: float) -> None:
    """Rows of a volume whose k_ref and ff_ref are those of direct."""
    for method in ["direct", *(m for m in methods if m != "direct")]:
        if all(table.has(sample, None, axis, method) for axis in flow.AXES):
            continue
        known = table.rows[(table.rows["sample"] == sample) & (table.rows["method"] == "direct")]
        found = measured(pore, voxel_um, method)
        if method == "direct":
            known = found.rename(columns={"k_md": "k", "formation_factor": "ff"})
        refs = known.set_index("axis")
        for row in found.itertuples():
            k_ref, ff_ref = refs.loc[row.axis, ["k", "ff"]]
            ours = row.k_md, k_ref, row.formation_factor, ff_ref, row.wall_s
            table.add((sample, None, row.axis, method, *ours))


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    options.add_argument("--samples", nargs="*", default=["arrays", "andra", "packs", "berea"])
    options.add_argument("--methods", nargs="+", default=[*NETWORKS, "elliptic", "direct"])
    options.add_argument("--cubes", nargs="+", type=int, default=list(range(27)))
    options.add_argument("--andra", nargs="+", type=int, default=[96, 128, 192], help="voxels along the pack")
    options.add_argument("--twins", nargs="+", type=Path, default=[], help="volumes, twin.zarr.zip")
    options.add_argument("--twin_edge", type=int, default=100, help="voxels along the middle of a twin")
    options.add_argument("--volume", type=Path, help="a segmented rock of your own")
    options.add_argument("--pore", type=int, default=0, help="its value that is pore")
    options.add_argument("--voxel", type=float, default=1.0, help="edge of its voxels, um")
    options.add_argument("--edge", type=int, default=128, help="of the cubes that it is cut into, voxels")
    options.add_argument("--out", type=Path, default=Path("results/benchmarks/permeability.csv"))
    given = options.parse_args()
    table = Table(given.out)
    voxel_methods = [m for m in given.methods if m in ("elliptic", "direct")]
    repeated = {"ends": "periodic", "sides": "periodic"}
    if "arrays" in given.samples:
        for name, distance, n, exact in arrays():
            k_ref = um2_to_millidarcy(exact * CELL_UM**2)
            for suffix, pore in (("", distance), ("_voxels", distance > 0)):
                for method in voxel_methods:
                    sample = f"{name}_n{n}{suffix}"
                    if not table.has(sample, None, "x", method):
                        k, factor, wall_s = through(pore, CELL_UM / n, "x", method, repeated)
                        table.add((sample, None, "x", method, k, k_ref, factor, np.nan, wall_s))
    if "andra" in given.samples:
        k_ref = um2_to_millidarcy(sum(ANDRA_K_M2) / 2 * 1e12)
        for n in given.andra:
            distance, voxel_um = andra(n)
            for method in given.methods:
                if not all(table.has(f"andra_n{n}_voxels", None, axis, method) for axis in flow.AXES):
                    for found in measured(distance > 0, voxel_um, method).itertuples():
                        ff = found.formation_factor
                        sample = f"andra_n{n}_voxels"
                        table.add(
                            (sample, None, found.axis, method, found.k_md, k_ref, ff, np.nan, found.wall_s)
                        )
            for method in voxel_methods:
                for axis in flow.AXES:
                    if not table.has(f"andra_n{n}", None, axis, method):
                        k, factor, wall_s = through(distance, voxel_um, axis, method, repeated)
                        table.add((f"andra_n{n}", None, axis, method, k, k_ref, factor, np.nan, wall_s))
    if "berea" in given.samples:
        berea(table, given.methods, given.cubes)
    own = cubes(given.volume, given.pore, given.voxel, given.edge) if given.volume else ()
    for volumes in (packs() if "packs" in given.samples else (), twins(given.twins, given.twin_edge), own):
        for sample, pore, voxel_um in volumes:
            against_direct(table, given.methods, sample, pore, voxel_um)
    report(table.rows)


KNOWN = (
    "berea pnextract + pnflow k: 81 values, median ratio 1.073, mean absolute error 0.26, std of log 0.294"
)
"""Of Imperial College's programs with their defaults, measured before this project and not installed here."""


def report(rows: pd.DataFrame) -> None:
    """What the table says, a line for each sample and method."""
    group = rows["sample"].where(
        rows["sample"] == "berea",
        rows["sample"].str.replace(r"_n\d+|(?<=^twin)_.*|(?<=^pack)_.*|(?<=^volume)_.*", "", regex=True),
    )
    for (sample, method), part in rows.groupby([group, "method"], sort=False):
        for name in ("k", "ff"):
            ratio = (part[name] / part[f"{name}_ref"]).dropna()
            if len(ratio):
                print(
                    f"{sample} {method} {name}: {len(ratio)} values, median ratio {ratio.median():.4f}, mean "
                    f"absolute error {(ratio - 1).abs().mean():.4f}, std of log {np.log(ratio).std():.4f}"
                )
    if (group == "berea").any():
        print(KNOWN)


if __name__ == "__main__":
    main()
