"""How one curve lies among others: the share inside their cloud, and a global envelope test."""

from __future__ import annotations

import numpy as np


def fraction_inside(observed: np.ndarray, cloud: np.ndarray) -> float:
    """Fraction of lags at which a curve lies between the lowest and the highest of a cloud.

    Parameters
    ----------
    observed : (m,) float
    cloud : (n, m) float

    Returns
    -------
    float
    """
    cloud = np.asarray(cloud)
    return float(np.mean((observed >= cloud.min(axis=0)) & (observed <= cloud.max(axis=0))))


def global_envelope(observed: np.ndarray, curves: np.ndarray, alpha: float = 0.05) -> dict:
    """Global envelope test by extreme rank length (Myllymaki et al. 2017, J. R. Stat. Soc. B 79, 381).

    Each curve gets its ranks at all lags, from below or above, whichever is more extreme; curves are
    ordered by their sorted ranks, lexicographically: the most extreme rank first, ties by how long it
    lasts. The p-value is the share of curves (the observed among them) at least as extreme as the observed.
    Its level is exact where observed and curves are exchangeable: equal windows, pixels and law, and each
    curve of a volume of its own. Slices of one volume depend on each other, so of few volumes they reject
    more in one case and less in another.

    Parameters
    ----------
    observed : (m,) float
    curves : (n, m) float
        Curves under the hypothesis; n of at least 1 / alpha - 1 to be able to reject, 199 or more advised.
    alpha : float
        Level of the envelope.

    Returns
    -------
    dict
        p; lower, upper (m,), the envelope, which the observed leaves exactly when p <= alpha (in the
        absence of ties); mean (m,) of the curves; alpha; n.
    """
    from scipy.stats import rankdata  # half a second that a job without an envelope need not spend

    observed, curves = np.asarray(observed, float), np.asarray(curves, float)
    every = np.vstack([observed, curves])
    total = len(every)
    ascending = rankdata(every, axis=0)
    ranks = np.sort(np.minimum(ascending, total + 1 - ascending), axis=1)
    # Rows in lexicographic order; equal rows share a number.
    _, order, sizes = np.unique(ranks, axis=0, return_inverse=True, return_counts=True)
    order = order.ravel()
    more_extreme = (np.cumsum(sizes) - sizes)[order]
    at_least = np.cumsum(sizes)[order]
    critical = more_extreme[more_extreme <= alpha * total].max()
    kept = every[more_extreme >= critical]
    return {
        "p": float(at_least[0] / total),
        "lower": kept.min(axis=0),
        "upper": kept.max(axis=0),
        "mean": curves.mean(axis=0),
        "alpha": float(alpha),
        "n": len(curves),
    }
