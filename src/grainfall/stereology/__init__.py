"""Wicksell's corpuscle problem: the radii of sections become the radii of the particles that were cut.

A plane meets a sphere of radius R with probability proportional to R, at a distance from the centre that is
uniform on (0, R). Number densities of particles (f3D) and of sections (f2D) therefore obey

    f2D(r) = r / E[R] * integral over R > r of f3D(R) / sqrt(R^2 - r^2) dR .

Particles of another shape, alike at all sizes, are cut in proportion to R, too, and profiles of that shape
take the place of a sphere's. Everything here is a number density per micrometre of equivalent radius.
"""

from grainfall.stereology.distribution import (
    COLUMNS,
    SizeDistribution,
    draw_radii,
    from_table,
    to_table,
)
from grainfall.stereology.inversion import METHODS, unfold, unfold_table
from grainfall.stereology.kernel import (
    SPHERE,
    Particle,
    Profiles,
    midpoint_kernel,
    own_shapes,
    particle_of,
    section_kernel,
)

__all__ = [
    "COLUMNS",
    "METHODS",
    "SPHERE",
    "Particle",
    "Profiles",
    "SizeDistribution",
    "draw_radii",
    "from_table",
    "midpoint_kernel",
    "own_shapes",
    "particle_of",
    "section_kernel",
    "to_table",
    "unfold",
    "unfold_table",
]
