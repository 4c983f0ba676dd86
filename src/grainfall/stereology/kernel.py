"""How random planes cut particles: spheres by formula, others as profiles of their shape say."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np


class Particle(Protocol):
    """What a kernel asks of the shape that all particles share, whatever their size.

    Let S(u) be the chance that a profile of a particle of radius 1 has a radius beyond u. Radii are of equal
    measure: sqrt(area / pi) of a profile, (3 volume / (4 pi))**(1/3) of a particle. Of pores they are those
    of circles in the profiles, and of the void that shows such.
    """

    def primitive(self, radius: np.ndarray, x: np.ndarray) -> np.ndarray:
        r"""G(R, x) = \int_0^R \rho S(x / \rho) d\rho; 0 where R cuts no profile beyond x."""

    def exceeded(self, share: float) -> float:
        """Radius that this share of the profiles of a particle of radius 1 exceeds."""


class _Sphere:
    """S(u) = sqrt(1 - u^2): a plane that meets a sphere lies at a uniform distance from its centre."""

    def primitive(self, radius: np.ndarray, x: np.ndarray) -> np.ndarray:
        radius = np.maximum(radius, x)
        ratio = np.divide(radius, x, out=np.ones_like(radius), where=x > 0)
        return 0.5 * (radius * np.sqrt((radius - x) * (radius + x)) - x**2 * np.arccosh(ratio))

    def exceeded(self, share: float) -> float:
        return float(np.sqrt(1.0 - share**2))


SPHERE: Particle = _Sphere()


@dataclass(frozen=True)
class Profiles:
    """Profiles in which random planes cut a particle of radius 1, in place of a sphere's.

    Attributes
    ----------
    radii : (n,) ndarray
        Of the profiles, measured as :class:`Particle` says; increasing, > 0.
    weights : (n,) ndarray
        Chance of each; they sum to 1.
    """

    radii: np.ndarray
    weights: np.ndarray

    def primitive(self, radius: np.ndarray, x: np.ndarray) -> np.ndarray:
        r"""G of :class:`Particle`: S is a step function, so that each profile u adds (R^2 - (x / u)^2) / 2.

        Parameters
        ----------
        radius, x : array
            >= 0; they broadcast.
        """
        ratio = np.divide(x, radius, out=np.full(np.broadcast(x, radius).shape, np.inf), where=radius > 0)
        first = np.searchsorted(self.radii, ratio, side="right")
        beyond, inverse = (
            np.append(np.cumsum(terms[::-1])[::-1], 0.0)
            for terms in (self.weights, self.weights / self.radii**2)
        )
        return 0.5 * (radius**2 * beyond[first] - x**2 * inverse[first])

    def exceeded(self, share: float) -> float:
        """Radius that this share of the profiles exceeds."""
        return float(self.radii[np.searchsorted(np.cumsum(self.weights), 1.0 - share)])

    @property
    def mean(self) -> float:
        """E[r] of a particle of radius 1; pi / 4 of a sphere."""
        return float(self.weights @ self.radii)


def particle_of(radii: np.ndarray) -> Particle:
    """The particle of radius 1 whose random planes show profiles of these radii, all as likely.

    Parameters
    ----------
    radii : (n,) ndarray
        Increasing, > 0.

    Returns
    -------
    Particle
        A sphere where there are none.
    """
    return Profiles(radii, np.full(len(radii), 1 / len(radii))) if len(radii) else SPHERE


def own_shapes(method: str, particles: str, outlined: bool) -> dict:
    """Whether sizes are unfolded by the grains' own shapes, or as if they were spheres.

    Parameters
    ----------
    method : str
        Rule of the inversion, as in :func:`unfold`: but for ``adaptive`` all take grains for spheres.
    particles : {"auto", "grains", "spheres"}
        What the config says.
    outlined : bool
        Whether the section came with its grains outlined. Where a distance map has to part them, what it
        leaves joined makes profiles larger and more ragged, and own shapes would add to that.

    Returns
    -------
    dict
        on, forced, reason.
    """
    forced = particles != "auto"
    on = method == "adaptive" and (particles == "grains" if forced else outlined)
    why = "the section came with its grains outlined" if outlined else "a distance map parts the grains"
    if method != "adaptive":
        why = f"the rule {method} knows no other shape"
    elif forced:
        why = f"the config says so, where {why}"
    how = "unfolded by what planes cut from the grains' own shapes" if on else "unfolded as those of spheres"
    if method == "none":
        how, why = "not unfolded", "the rule none takes profiles for grains"
    return {"on": on, "forced": forced, "reason": f"sizes were {how}: {why}"}


def section_kernel(section_edges: np.ndarray, edges: np.ndarray, particle: Particle = SPHERE) -> np.ndarray:
    r"""Probability that a particle drawn and cut gives a section in bin i, exact for flat bins.

    With a number density that is constant on the particle bin [a, b], the chance that a section of such a
    particle exceeds x is ``(G(b, x) - G(a, x)) / (G(b, 0) - G(a, 0))`` where

    .. math:: G(R, x) = \int_0^R \rho\, S(x / \rho)\, d\rho

    and S(u) is the chance that a section of a particle of radius 1 exceeds u. Of spheres that is the survival
    function of Wicksell's equation, integrated over the bin,

    .. math:: G(R, x) = \int_x^R \sqrt{\rho^2 - x^2}\, d\rho
                      = \tfrac12 \left( R\sqrt{R^2 - x^2} - x^2 \operatorname{arccosh}(R / x) \right)

    and G = 0 for R < x.

    Parameters
    ----------
    section_edges : (m + 1,) ndarray
        Increasing edges of the section bins, >= 0.
    edges : (n + 1,) ndarray
        Increasing edges of the particle bins, >= 0.
    particle : Particle
        Shape of all particles.

    Returns
    -------
    (m, n) ndarray
        Column j sums to 1 where the section bins cover all sections of such a particle ([0, edges[j + 1]] of
        a sphere). A particle is cut in proportion to its radius: multiply column j by the bin's mean radius
        to start from number densities.
    """
    edges = np.asarray(edges, dtype=float)
    x = np.asarray(section_edges, dtype=float)[:, None]
    survival = np.diff(particle.primitive(edges[None, :], x), axis=1)
    return -np.diff(survival, axis=0) / (0.5 * np.diff(edges**2))


def midpoint_kernel(edges: np.ndarray) -> np.ndarray:
    """The paper's matrix **A**: section densities at bin midpoints from particle densities (up to a factor).

    a_ij = r_mi [ln((R + s) / (R - s))] between max(r_(j-1), r_mi) and max(r_j, r_mi), s = sqrt(R^2 - r_mi^2).
    The paper's lower limit r_(j-1) is below r_mi on the diagonal, where the root is imaginary (NaN);
    particles smaller than the section cannot have made it, so the integral starts at r_mi.
    Half the logarithm is arccosh(R / r_mi), which does not cancel.

    Parameters
    ----------
    edges : (n + 1,) ndarray

    Returns
    -------
    (n, n) ndarray
    """
    middle = 0.5 * (edges[1:] + edges[:-1])[:, None]
    limits = np.maximum(edges[None, :], middle)
    return 2.0 * middle * np.diff(np.arccosh(limits / middle), axis=1)
