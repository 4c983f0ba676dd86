"""Contacts between packed grains: exact gaps of their convex hulls, contact areas of the voxel volume.

Virtual spheres are left out everywhere: they are no part of the rock.
"""

from grainfall.contacts.distance import Hulls, closest_points, collided, exact_distance
from grainfall.contacts.find import (
    RATTLER_CONTACTS,
    TOLERANCE,
    coordination,
    find_contacts,
    lost_support,
    max_overlap,
)

__all__ = [
    "RATTLER_CONTACTS",
    "TOLERANCE",
    "Hulls",
    "closest_points",
    "collided",
    "coordination",
    "exact_distance",
    "find_contacts",
    "lost_support",
    "max_overlap",
]
