"""Every random number comes from (config seed, sample, realization, chapter) and nothing else."""

from __future__ import annotations

import hashlib

import numpy as np


def generator(seed: int, sample: str, realization: int, chapter: str) -> np.random.Generator:
    """A generator that depends on its four arguments only.

    Variants share their numbers on purpose: comparisons between them are paired.

    Parameters
    ----------
    seed : int
        The config's seed.
    sample : str
        Sample name.
    realization : int
        Realization index; use -1 for work done once per sample.
    chapter : str
        Name of the chapter (and step) that draws, for example ``"packing/first"``.

    Returns
    -------
    numpy.random.Generator
        PCG64 seeded by a BLAKE2 digest of the arguments.
    """
    key = "\x1f".join([str(int(seed)), sample, str(int(realization)), chapter])
    digest = hashlib.blake2b(key.encode(), digest_size=32).digest()
    return np.random.default_rng(np.frombuffer(digest, dtype=np.uint32))


def slices(rng: np.random.Generator, shape: tuple[int, int, int], n: int) -> list[tuple[int, int]]:
    """``n`` different plane slices of a volume, drawn over its three axes.

    Parameters
    ----------
    rng : numpy.random.Generator
    shape : (nz, ny, nx)
    n : int
        Number wanted; all there are where the volume has fewer.

    Returns
    -------
    list of (axis, index)
        Axis 0, 1, 2 for slices normal to z, y, x.
    """
    every = [(axis, index) for axis in range(3) for index in range(shape[axis])]
    return [every[k] for k in rng.permutation(len(every))[:n]]
