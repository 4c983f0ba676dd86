"""Units at every file and public boundary: micrometres, seconds, millidarcy; arrays are (z, y, x)."""

LENGTHS_UM = {"um": 1.0, "µm": 1.0, "μm": 1.0, "nm": 1e-3, "mm": 1e3}
"""Units of length, as people write them, in micrometres."""

MILLIDARCY_M2 = 9.869233e-16
"""One millidarcy in square metres."""


def um2_to_millidarcy(k_um2: float) -> float:
    """Permeability from square micrometres to millidarcy."""
    return k_um2 * 1e-12 / MILLIDARCY_M2
