"""Figures as a reader sees them."""

from __future__ import annotations

import math

import pandas as pd

RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
"""Digits of an exponent."""


def number(value: float | None, digits: int = 3) -> str:
    """A figure for a reader: ``digits`` significant digits; empty if missing."""
    value = as_float(value)
    if value is None:
        return ""
    sign, size = ("\u2212" if value < 0 else ""), abs(value)
    if size == 0:
        return "0"
    if not 1e-4 <= size < 1e7:
        mantissa, exponent = f"{size:.{digits - 1}e}".split("e")
        return f"{sign}{mantissa}·10{str(int(exponent)).translate(RAISED)}"
    if size.is_integer():
        return sign + f"{int(size):,}".replace(",", "\u202f")
    text = f"{size:,.{max(0, digits - 1 - math.floor(math.log10(size)))}f}"
    if "." in text and float(text.replace(",", "")) == size:
        text = text.rstrip("0")  # 0.05 is 0.05, not 0.0500
    return sign + text.replace(",", "\u202f")


def as_float(value: object) -> float | None:
    """A figure of a table; None where it is missing."""
    if value is None or value is pd.NA:
        return None
    value = float(value)
    return None if math.isnan(value) else value
