"""Time, memory and topology of network extraction, method by method, each run in a process of its own.

    python tests/benchmarks/network.py [--edges 128 256 400] [--random 250 500] [--snow2 256]
        [--out results/benchmarks/network_speed.csv]

Images: the Berea sandstone beside the checkout (skipped without it), cut from its corner, and a random medium
of porosity 0.35 (Gaussian noise blurred by 4 voxels, cut at the quantile). Extraction, by two threads, is
timed after a first one of a small cube, so without imports and compilation; peak_rss_mb is that of the whole
process. euler_error is components less loops of the network minus those of the pore space, 0 where its
topology is kept (boundary pores and loops that bound a disc aside). Columns: method, image, n (edge in
voxels), wall_s, cpu_s, peak_rss_mb, pores, throats, euler_error. Methods that are not installed, or not run
at that size, have empty rows. Runs that the table already has are kept: remove it to measure anew.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd

from grainfall import io, network

BEREA = Path(__file__).resolve().parents[2].parent / "shared/data/berea/berea_400_pore1.tif"
COLUMNS = ["method", "image", "n", "wall_s", "cpu_s", "peak_rss_mb", "pores", "throats", "euler_error"]
PEERS = ("pnextract", "peclet-pnm")
POROSITY, BLUR, VOXEL_UM = 0.35, 4.0, 5.345


def random_medium(n: int) -> np.ndarray:
    """Gaussian noise of fixed correlation length, cut at its quantile: (n, n, n) bool."""
    from scipy.ndimage import gaussian_filter1d

    noise = np.random.default_rng(1).standard_normal((n, n, n), np.float32)
    for axis in range(3):
        gaussian_filter1d(noise, BLUR, axis, output=noise, mode="wrap")
    step = max(1, n // 250)
    return noise > np.quantile(noise[::step, ::step, ::step], 1 - POROSITY)


def save_image(image: str, n: int, path: str) -> None:
    """Write an image for the runs to load."""
    if image == "random":
        pore = random_medium(n)
    else:
        import tifffile

        pore = tifffile.imread(BEREA)[:n, :n, :n] == 1
    np.save(path, pore)


def run(method: str, path: str) -> dict:
    """One extraction and its figures."""
    pore = np.load(path)
    network.extract(pore[:40, :40, :40], VOXEL_UM, method, threads=2)
    wall, cpu = time.perf_counter(), time.process_time()
    found = network.extract(pore, VOXEL_UM, method, threads=2)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    inner = network.subnetwork(found, ~found["pore.boundary"])
    components, loops = network.betti_numbers(found)
    true_components, true_loops, _ = network.pore_betti_numbers(pore)
    return {
        "wall_s": round(wall, 2),
        "cpu_s": round(cpu, 2),
        "peak_rss_mb": round(memory),
        "pores": len(inner["pore.coords"]),
        "throats": len(inner["throat.conns"]),
        "euler_error": (components - loops) - (true_components - true_loops),
    }


def child(*call: str) -> str:
    """Output of one of the functions above in a process of its own."""
    done = subprocess.run([sys.executable, __file__, "--call", *call], stdout=subprocess.PIPE, check=True)
    return done.stdout.decode()


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    options.add_argument("--edges", type=int, nargs="*", default=[128, 256, 400], help="of Berea")
    options.add_argument("--random", type=int, nargs="*", default=[250, 500], help="edges of the medium")
    options.add_argument("--snow2", type=int, default=256, help="largest edge that snow2 is run at")
    options.add_argument("--out", type=Path, default=Path("results/benchmarks/network_speed.csv"))
    options.add_argument("--call", nargs="*", help=argparse.SUPPRESS)
    given = options.parse_args()
    if given.call:
        name, *rest = given.call
        if name == "run":
            print(json.dumps(run(*rest)))
        else:
            save_image(rest[0], int(rest[1]), rest[2])
        return
    rows = io.read_table(given.out).to_dict("records") if given.out.exists() else []
    jobs = [("random", n) for n in given.random]
    if BEREA.exists():
        jobs = [("berea", n) for n in given.edges] + jobs
    else:
        print("reference data (../shared/data) is not here: no Berea")
    with tempfile.TemporaryDirectory() as folder:
        path = f"{folder}/image.npy"
        for image, n in jobs:
            wanted = ["persistence", "snow2", *PEERS]
            known = {(r["method"], r["image"], r["n"]) for r in rows}
            wanted = [m for m in wanted if (m, image, n) not in known]
            if "persistence" in wanted or ("snow2" in wanted and n <= given.snow2):
                child("save", image, str(n), path)
            for method in wanted:
                row = {"method": method, "image": image, "n": n}
                if method == "persistence" or (method == "snow2" and n <= given.snow2):
                    row |= json.loads(child("run", method, path).splitlines()[-1])
                rows.append(row)
                print(row, flush=True)
                table = pd.DataFrame(rows, columns=COLUMNS)
                whole = dict.fromkeys(("peak_rss_mb", "pores", "throats", "euler_error"), "Int64")
                io.write_table(given.out, table.astype(whole))


if __name__ == "__main__":
    main()
