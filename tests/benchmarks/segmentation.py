"""Grain splitting against hand outlines, beside other tools, and its robustness on synthetic grains.

    python tests/benchmarks/segmentation.py --image mask.png --truth instances.npz --out segmentation.csv

The image says only grain or not (non-zero is grain); the truth holds one number per outlined grain. A
found grain is right (tp) if it shares more than half of its union with an outline (IoU > 0.5: at most one).
Rows called "best of" are tuned on the truth itself: what the tool could reach if one knew the answer.
With --robustness FILE, the threshold is swept on this image and on synthetic grains of known truth.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
from scipy import ndimage
from skimage.feature import peak_local_max
from skimage.io import imread
from skimage.segmentation import watershed

from grainfall.io import write_table
from grainfall.morphology import split_grains

SWEEP = (0.0, 0.025, 0.05, 0.075, 0.1, 0.125, 0.15, 0.2, 0.25, 0.3)


def score(truth: np.ndarray, found: np.ndarray, iou: float = 0.5) -> dict[str, float]:
    """Counts of matched grains and what follows from them.

    Parameters
    ----------
    truth, found : (y, x) ndarray of int
        Labels, 0 none.
    iou : float
        Intersection over union that a match exceeds; from 0.5 on a grain has at most one match.
    """
    n = int(found.max()) + 1
    pairs, shared = np.unique(truth.astype(np.int64).ravel() * n + found.ravel(), return_counts=True)
    i, j = np.divmod(pairs, n)
    size_truth = np.bincount(truth.ravel())
    size_found = np.bincount(found.ravel())
    both = (i > 0) & (j > 0)
    union = size_truth[i] + size_found[j] - shared
    tp = int(np.count_nonzero(both & (shared > iou * union)))
    fp = int(np.count_nonzero(size_found[1:])) - tp
    fn = int(np.count_nonzero(size_truth[1:])) - tp
    return {
        "tp": tp,
        "fp": fp,
        "fn": fn,
        "precision": tp / max(tp + fp, 1),
        "recall": tp / max(tp + fn, 1),
        "f1": 2 * tp / max(2 * tp + fp + fn, 1),
    }


def grainfall(solid: np.ndarray, **options: float) -> np.ndarray:
    """This package."""
    return split_grains(solid.astype(np.uint8), **options)


def plain_watershed(solid: np.ndarray, min_distance: int = 1) -> np.ndarray:
    """Watershed of the distance map from its local maxima, as in scikit-image's own example."""
    distance = ndimage.distance_transform_edt(solid)
    peaks = peak_local_max(distance, min_distance=min_distance, labels=ndimage.label(solid)[0])
    markers = np.zeros(solid.shape, np.int32)
    markers[tuple(peaks.T)] = np.arange(1, len(peaks) + 1)
    return watershed(-distance, markers, mask=solid)


def snow(solid: np.ndarray, r_max: int = 4, sigma: float = 0.4) -> np.ndarray:
    """PoreSpy's SNOW: watershed of the smoothed distance map, peaks trimmed on saddles and when near."""
    from porespy.filters import snow_partitioning

    return np.asarray(snow_partitioning(solid, r_max=r_max, sigma=sigma).regions)


def run(method: Callable, solid: np.ndarray, truth: np.ndarray, **options: float) -> dict[str, float]:
    """Score of one method, timed."""
    start = time.perf_counter()
    found = method(solid, **options)
    wall = time.perf_counter() - start
    return {**score(truth, found), "wall_s": wall}


def compare(solid: np.ndarray, truth: np.ndarray) -> pd.DataFrame:
    """One row per method: every tool as it comes, and the other two tuned on the truth."""
    contests = [
        ("grainfall persistence", grainfall, "persistence", ()),
        ("porespy snow_partitioning", snow, "r_max", (4, 8, 12, 16, 20, 24, 28, 32)),
        ("skimage watershed", plain_watershed, "min_distance", (1, 5, 10, 15, 20, 25, 30, 40)),
    ]
    rows = []
    for name, method, key, sweep in contests:
        run(method, solid[:64, :64], truth[:64, :64])  # imports and compilation are not timed
        rows.append({"method": name, **run(method, solid, truth), "parameters": "defaults"})
        tried = [
            {**run(method, solid, truth, **{key: value}), "parameters": f"{key}={value}"} for value in sweep
        ]
        if tried:
            rows.append({"method": f"{name}, best of {len(tried)}", **max(tried, key=lambda row: row["f1"])})
    return pd.DataFrame(rows)


def synthetic(
    kind: str, rng: np.random.Generator, size: int = 900, overlap: float = 0.06
) -> tuple[np.ndarray, np.ndarray]:
    """Grains placed at random without overlap, then grown until neighbours merge.

    Radii are lognormal (σ 0.35, median 32 pixels). Each grain is a convex shape with the gauge function g(p),
    1 on its rim: disc; ellipse (axes 1 : 1 to 1 : 2); polygon (5 to 8 tangents of an ellipse). Grains are
    grown by `overlap` and a pixel belongs to the grain of the smallest gauge.

    Returns
    -------
    solid : (size, size) ndarray of bool
    truth : (size, size) ndarray of int
    """
    y, x = np.indices((size, size)) + 0.5
    gauge = np.full((size, size), np.inf)
    truth = np.zeros((size, size), np.int32)
    for radius in np.sort(32 * np.exp(0.35 * rng.normal(size=1200)))[::-1]:
        aspect = 1.0 if kind == "discs" else rng.uniform(1, 2)
        turn = rng.uniform(0, np.pi)
        corners = rng.integers(5, 9)
        tangents = (np.arange(corners) + rng.uniform(-0.25, 0.25, corners)) * 2 * np.pi / corners
        for _ in range(12):
            cy, cx = rng.uniform(0, size, 2)
            reach = int(radius * aspect * 1.8) + 2
            box = np.s_[max(int(cy) - reach, 0) : int(cy) + reach, max(int(cx) - reach, 0) : int(cx) + reach]
            u = ((x[box] - cx) * np.cos(turn) + (y[box] - cy) * np.sin(turn)) / (radius * np.sqrt(aspect))
            v = (-(x[box] - cx) * np.sin(turn) + (y[box] - cy) * np.cos(turn)) / (radius / np.sqrt(aspect))
            if kind == "polygons":
                own = np.max([u * np.cos(a) + v * np.sin(a) for a in tangents], axis=0)
            else:
                own = np.hypot(u, v)
            if np.any((own < 1) & (gauge[box] < 1)):
                continue
            nearer = own < gauge[box]
            truth[box][nearer & (own < 1 + overlap)] = truth.max() + 1
            gauge[box] = np.minimum(gauge[box], own)
            break
    return truth > 0, truth


def robustness(solid: np.ndarray, truth: np.ndarray) -> pd.DataFrame:
    """The threshold swept on the image and on synthetic grains of known truth."""
    cases = [("image", solid, truth)]
    # Magnification: the same image, coarser.
    cases += [(f"image 1:{k}", solid[::k, ::k], truth[::k, ::k]) for k in (2, 4)]
    for kind in ("discs", "ellipses", "polygons"):
        for overlap in (0.03, 0.06, 0.1):
            made = synthetic(kind, np.random.default_rng(1), overlap=overlap)
            cases.append((f"{kind}, grown by {overlap:.0%}", *made))
    return pd.DataFrame(
        {"case": name, "persistence": h, **run(grainfall, s, t, persistence=h)}
        for name, s, t in cases
        for h in SWEEP
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    data = Path(__file__).parents[3] / "shared" / "data" / "thin_section"
    parser.add_argument(
        "--image", type=Path, default=data / "miocene_20_2_mask.png", help="mask; non-zero is grain"
    )
    parser.add_argument(
        "--truth",
        type=Path,
        default=data / "miocene_20_2_instances.npz",
        help="*.npz with the array 'labels'",
    )
    parser.add_argument("--out", type=Path, required=True, help="table to write, *.csv")
    parser.add_argument("--robustness", type=Path, help="second table: the threshold swept, *.csv")
    options = parser.parse_args()
    for path in (options.image, options.truth):
        if not path.is_file():
            parser.error(f"{path}: no such file; give --image and --truth")
    solid = imread(options.image) > 0
    truth = np.load(options.truth)["labels"]
    table = compare(solid, truth)
    write_table(options.out, table)
    print(table.to_string(index=False, float_format="%.3f"))
    if options.robustness:
        swept = robustness(solid, truth)
        write_table(options.robustness, swept)
        print(swept.pivot_table("f1", "case", "persistence", sort=False).to_string(float_format="%.3f"))


if __name__ == "__main__":
    main()
