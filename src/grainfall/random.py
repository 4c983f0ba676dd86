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
    """Different random plane slices of a volume, spread evenly over its three axes.

    Parameters
    ----------
    rng : numpy.random.Generator
    shape : (nz, ny, nx)
    n : int
        Slices wanted; an axis with fewer planes than its share gives all it has.

    Returns
    -------
    list of (axis, index)
        The slice lies normal to ``axis``; in random order.
    """
    share = np.minimum(n // 3 + (rng.permutation(3) < n % 3), shape)
    drawn = [(a, int(i)) for a in range(3) for i in rng.choice(shape[a], share[a], replace=False)]
    return [drawn[i] for i in rng.permutation(len(drawn))]
