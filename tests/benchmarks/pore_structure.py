"""Where a case's twins differ from their truths -> results/benchmarks/pore_structure.csv

Beyond what results/validation.csv says of a finished case: pores by bands of radius, how evenly porosity
lies, the voids that grains alone do not leave and what lies around them, how grains and the bodies that held
voids open have come to lie, and how second packings met the porosity.

    python tests/benchmarks/pore_structure.py CASE [--variant full] [--results results] [--out FILE]

CASE is a case of synthetic truths, by its name in config/cases or by its config, of which samples with twins
and reference cubes are taken.
Columns: quantity, truth, twins, difference, lower, upper, ratio, ratio_lower, ratio_upper, twins_n, cubes_n,
sections. Twins and cubes of one section are averaged first; intervals (95 %) are over sections.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
import skimage
from scipy.ndimage import distance_transform_edt as distance
from scipy.spatial.transform import Rotation

from grainfall import config, grains, io, morphology
from grainfall.errors import InputError
from grainfall.report.ensembles import t_interval
from grainfall.report.validation import CUBES, network_sizes, slice_porosities

HOUSE = Path(__file__).resolve().parents[2]
BANDS_UM = (0, 10, 15, 20, 30, 40, np.inf)
"""Radii of pores that are counted together."""
LARGE_UM = 25
AROUND_UM = (0, 8, 15, 25, 40, 70, np.inf)
"""Distances from a void."""
PARTS = (16, 8, 4)
"""A region is cut into cubes of so many a side to see how evenly porosity lies."""
KINDS = {"grain": "grains", "virtual": "virtual spheres"}


def between(low: float, high: float) -> str:
    """A band in words."""
    return f"{low:g} to {high:g} µm" if np.isfinite(high) else f"beyond {low:g} µm"


def pores(stem: Path, size_um3: float) -> dict[str, float]:
    """Shares of the pore volume by radius, and how many large pores there are."""
    sizes = network_sizes(stem)
    radius, volume = sizes["pore_radius_um"], sizes["pore_volume_um3"]
    shares = np.histogram(radius, BANDS_UM, weights=volume / volume.sum())[0]
    found = {
        f"share of the pore volume, pores {between(low, high)}": share
        for (low, high), share in zip(pairwise(BANDS_UM), shares, strict=True)
    }
    large = radius > LARGE_UM
    found[f"share of the pore volume, pores beyond {LARGE_UM} µm"] = volume[large].sum() / volume.sum()
    found[f"pores beyond {LARGE_UM} µm in a mm³"] = large.sum() / size_um3 * 1e9
    return found


def evenness(pore: np.ndarray, voxel_um: float) -> dict[str, float]:
    """Scatter of the porosity between planes, and between cubes of some edges."""
    planes = slice_porosities(~pore).reshape(3, -1)
    found = {"scatter of the porosity of planes": planes.std(axis=1).mean()}
    for parts in PARTS:
        n = len(pore) // parts
        cubes = skimage.measure.block_reduce(pore[(slice(parts * n),) * 3], n, np.mean)
        found[f"scatter of the porosity of cubes of {n * voxel_um:g} µm"] = cubes.std()
    return found


def voids(pore: np.ndarray, voxel_um: float, radius_um: float) -> dict[str, float]:
    """What opening by a ball leaves of the pores, and what lies around it; the volume's faces are mirrors."""
    rim = int(np.ceil(radius_um / voxel_um)) + 2
    inside = (slice(rim, -rim),) * 3
    wide = np.pad(pore, rim, mode="reflect")
    opened = morphology.voids(wide, radius_um / voxel_um)
    away = (distance(~opened) * voxel_um if opened.any() else np.full(wide.shape, np.nan))[inside]
    opened = opened[inside]
    volume = np.bincount(skimage.measure.label(opened, connectivity=1).ravel())[1:] * voxel_um**3
    found = {
        "voids, share of the volume": opened.mean(),
        "voids that are not linked": float(len(volume)),
        "void, mean by volume, mm³": (volume**2).sum() / max(volume.sum(), 1) * 1e-9,
        "porosity between voids": pore[~opened].mean(),
    }
    # faces of voxels overstate a surface by 3/2 whichever way it lies
    by_faces = 2 / 3 / voxel_um
    every, faces = 0, np.zeros(len(AROUND_UM) - 1)
    for axis in range(3):
        here, there = np.s_[: len(pore) - 1], np.s_[1:]
        at = (np.s_[:],) * axis
        differ = pore[(*at, here)] != pore[(*at, there)]
        every += differ.sum()
        faces += np.histogram(np.maximum(away[(*at, here)], away[(*at, there)])[differ], AROUND_UM)[0]
    found["surface in the volume by faces of voxels, 1/µm"] = every * by_faces / pore.size
    outside = ~opened
    among = np.histogram(away[outside], AROUND_UM)[0]
    open_share = np.histogram(away[outside & pore], AROUND_UM)[0] / np.maximum(among, 1)
    for (low, high), of_pores, count, near in zip(pairwise(AROUND_UM), open_share, among, faces, strict=True):
        if count:
            found[f"porosity {between(low, high)} from a void"] = of_pores
            found[f"surface {between(low, high)} from a void, 1/µm"] = near * by_faces / count
    return found


def lie(folder: Path, library: grains.Library, edge_um: np.ndarray) -> dict[str, float]:
    """Extents along x, y and z over their mean, of grains and of the bodies that held voids open."""
    bodies = io.read_table(folder / "second/bodies.csv")
    at = bodies[list("xyz")].to_numpy()
    bodies = bodies[((at > 0) & (at < edge_um)).all(axis=1) & (bodies["shape"] >= 0)]
    found = {}
    for kind, own in bodies.groupby("kind"):
        turned = Rotation.from_quat(own[["qx", "qy", "qz", "qw"]].to_numpy()).as_matrix()
        moments = np.array([_second_moments(library, shape) for shape in own["shape"]])
        along = np.einsum("nij,njk,nik->ni", turned, moments, turned)
        extent = (np.sqrt(along) * own["scale"].to_numpy()[:, None]).mean(axis=0)
        for axis, value in zip("xyz", extent / extent.mean(), strict=True):
            found[f"extent of {KINDS[kind]} along {axis} over the mean"] = value
    return found


def _second_moments(library: grains.Library, shape: int) -> np.ndarray:
    """Of a body of unit density about its centre, by its volume."""
    volume, _, inertia = grains.mass_properties(library.vertices[shape], library.faces[shape])
    return (np.trace(inertia) / 2 * np.eye(3) - inertia) / volume


def second_packing(folder: Path) -> dict[str, float]:
    """How the porosity was met."""
    passes = io.read_json(folder / "second/packing.json")["passes"]
    if not passes:  # the first packing had it already
        return {}
    last = passes[-1]
    return {
        "passes of the second packing": len(passes),
        "share of second packings met in one pass": float(len(passes) == 1),
        "share of second packings with friction lubricated": float(last["lubrication"] < 1),
        "share of second packings whose region was moved": float(np.any(last["moved_um"])),
    }


def volume(path: Path, name: str | None, stem: Path, radius_um: float) -> dict[str, float]:
    """All of a volume and its pore network."""
    phase, about = io.read_volume(path, name)
    pore, voxel_um = phase == 0, about["voxel_size_um"]
    return {
        **pores(stem, pore.size * voxel_um**3),
        **evenness(pore, voxel_um),
        **voids(pore, voxel_um, radius_um),
    }


def section(sample: Path, variant: str) -> tuple[list[dict], list[dict]]:
    """Of a sample's reference cubes and of its twins."""
    radius = morphology.solid_radius(io.read_table(sample / "grains2d.csv"))
    cubes = [
        volume(folder / "reference.zarr.zip", None, folder / "reference_network", radius)
        for folder in [sample, *sorted(sample.glob(CUBES))]
        if (folder / "reference_network_pores.csv").exists()
    ]
    library = grains.Library.load(sample / "grains3d")
    scene = io.read_json(sample / variant / "scene.json")
    edge = np.array(scene["shape_zyx"][::-1]) * scene["voxel_size_um"]
    twins = []
    for pores_of in sorted((sample / variant).glob("*/network_pores.csv")):
        twin = pores_of.parent
        found = volume(twin / "twin.zarr.zip", "phase", twin / "network", radius)
        twins.append({**found, **lie(twin, library, edge), **second_packing(twin)})
    return cubes, twins


def compare(sections: Iterable[tuple[list[dict], list[dict]]]) -> pd.DataFrame:
    """A row a quantity: means over sections, and the twins' less and over the truth's with intervals."""
    sections = list(sections)
    truth, twins = (
        pd.DataFrame([pd.DataFrame(volumes).mean() for volumes in kind])
        for kind in zip(*sections, strict=True)
    )
    truth = truth.reindex(columns=twins.columns)

    def interval(values: pd.DataFrame) -> np.ndarray:
        known = (values[name].dropna().to_numpy() for name in values)
        return np.array([t_interval(of)[1:] if len(of) else (np.nan,) * 3 for of in known])

    difference, ratio = interval(twins - truth), interval(twins / truth.where(truth != 0))
    own = interval(twins)
    alone = truth.isna().all().to_numpy()  # with no truth beside them the interval is the twins'
    difference[alone, 1:] = own[alone, 1:]
    shares = alone & twins.columns.str.startswith("share")
    difference[shares, 1:] = difference[shares, 1:].clip(0, 1)
    return pd.DataFrame(
        {
            "quantity": twins.columns, "truth": truth.mean().to_numpy(), "twins": own[:, 0],
            "difference": difference[:, 0], "lower": difference[:, 1], "upper": difference[:, 2],
            "ratio": ratio[:, 0], "ratio_lower": ratio[:, 1], "ratio_upper": ratio[:, 2],
            "twins_n": sum(len(found) for _, found in sections),
            "cubes_n": sum(len(found) for found, _ in sections), "sections": len(sections),
        }
    )  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description="Where a case's twins differ from their truths")
    parser.add_argument("case")
    parser.add_argument("--variant", default="full")
    parser.add_argument("--results", type=Path, default=Path("results"))
    parser.add_argument("--out", type=Path, default=Path("results/benchmarks/pore_structure.csv"))
    arguments = parser.parse_args()
    own = HOUSE / f"config/cases/{arguments.case}.yaml"
    try:
        study = config.load_yaml(own if own.exists() else arguments.case)
    except InputError as fault:
        parser.error(str(fault))
    found = []
    for name in study["samples"]:
        sample = arguments.results / name
        if any((sample / arguments.variant).glob("*/network_pores.csv")):
            found.append(section(sample, arguments.variant))
            print(f"{name}: {len(found[-1][0])} cubes, {len(found[-1][1])} twins", flush=True)
    if not found:
        parser.error(f"no finished twins of {arguments.case} in {arguments.results}: run the case first")
    table = compare(found)
    io.write_table(arguments.out, table)
    print(table.to_string(index=False, float_format=lambda value: f"{value:.4g}"))


if __name__ == "__main__":
    main()
