"""What the validation table says of the paper's claims, in words that follow from its figures."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import pandas as pd

from grainfall.report.tables import number
from grainfall.report.validation import BEREA_PUBLISHED_MD

SHOWN, NOT_SHOWN, OPEN = "holds", "does not hold", "open"


class Claim(NamedTuple):
    """A claim, what the paper has for it, what we found, and whether it holds."""

    case: str
    claim: str
    paper: str
    ours: str
    status: str
    """holds, does not hold, or open (nothing finished yet, or the interval decides neither way)."""


def row_of(table: pd.DataFrame, case: str, variant: str, quantity: str) -> Mapping | None:
    """One row of the validation table as a mapping, or None."""
    keys = (table["case"] == case) & (table["variant"] == variant) & (table["quantity"] == quantity)
    return table[keys].iloc[0].to_dict() if keys.any() else None


def interval_words(row: Mapping, digits: int = 3) -> str:
    """Mean with its interval, and of how many twins and truths."""
    words = number(row["mean"], digits)
    if not math.isnan(row["lower"]):
        words += f" ({number(row['lower'], digits)} to {number(row['upper'], digits)})"
    n, truths = int(row["n"]), int(row["truths"])
    return words + f", n = {n}" + (f" over {truths} truths" if truths > 1 else " of one truth")


def _within(row: Mapping | None, aim: float, tolerance: float) -> str:
    """Whether the mean is within the tolerance; open where the interval reaches the other side of it."""
    if row is None:
        return OPEN
    inside = abs(row["mean"] - aim) <= tolerance
    if math.isnan(row["lower"]):
        return OPEN
    edges = np.array([row["lower"], row["upper"]])
    reaches_in = (edges[0] <= aim + tolerance) and (edges[1] >= aim - tolerance)
    all_in = (np.abs(edges - aim) <= tolerance).all()
    if inside:
        return SHOWN if all_in else OPEN
    return OPEN if reaches_in else NOT_SHOWN


def claims(table: pd.DataFrame) -> list[Claim]:
    """Every claim of the paper's three cases that the table can judge.

    Parameters
    ----------
    table : DataFrame
        As :func:`grainfall.report.validation.validation_table` gives it.
    """
    found = [*_stereology(table), *_spheres(table), *_berea(table), *_tomogram(table)]
    begun = set(table["case"])
    return [c if c.case in begun else c._replace(ours="not finished", status=OPEN) for c in found]


def _said(row: Mapping | None, digits: int = 3) -> str:
    return "not finished" if row is None else interval_words(row, digits)


def _stereology(table: pd.DataFrame) -> list[Claim]:
    full = row_of(table, "stereology", "full", "k_ratio")
    skipped = row_of(table, "stereology", "no_inversion", "k_ratio")
    paired = row_of(table, "stereology", "no_inversion", "k_of_full")
    sizes = [row_of(table, "stereology", v, "w1_f3d") for v in ("full", "no_inversion")]
    found = [
        Claim(
            "stereology",
            "With the inversion, K is that of the truth (within 10 %)",
            "K over the truth's 1.18",
            f"K over the truth's {_said(full)}",
            _within(full, 1.0, 0.1),
        ),
        Claim(
            "stereology",
            "The inversion recovers the 3D sizes",
            "shown as histograms",
            f"distance to the true radii over their mean: {_said(sizes[0])}; without: {_said(sizes[1])}",
            OPEN if None in sizes else SHOWN if sizes[0]["mean"] < 0.5 * sizes[1]["mean"] else NOT_SHOWN,
        ),
        Claim(
            "stereology",
            "Skipping the inversion halves K at the same porosity",
            "K over the truth's 0.52; over that with the inversion 0.44",
            f"K over the truth's {_said(skipped)}; over that with the inversion {_said(paired)}",
            _within(paired, 559 / 1272, 0.15),
        ),
    ]
    sweep = table[(table["case"] == "cv_sweep") & (table["variant"] == "no_inversion")]
    k = sweep[sweep["quantity"].str.startswith("k_ratio@")]
    if len(k):
        cv = k["quantity"].str.partition("@cv")[2].astype(float)
        ratio = pd.Series(k["mean"].to_numpy(), index=cv.to_numpy()).sort_index()
        above = ratio.index[ratio > 1]
        of_each = " to ".join(f"{n:g}" for n in sorted({k["n"].min(), k["n"].max()}))
        said = ", ".join(f"CV {c:g}: {number(v)}" for c, v in ratio.items())
        found.append(
            Claim(
                "cv_sweep",
                "Skipping the inversion lowers K by some 50 %, whatever the sizes",
                "-48 %, one sample, called systematic",
                f"spheres, K over the truth's without the inversion: {said}"
                + (f"; above 1 from CV {above[0]:g}" if len(above) else "")
                + f"; n = {of_each} of each",
                # one spread of sizes that surely loses less than a third speaks against it
                NOT_SHOWN if (k["lower"] > 2 / 3).any() else SHOWN if (k["upper"] < 2 / 3).all() else OPEN,
            )
        )
    return found


def _spheres(table: pd.DataFrame) -> list[Claim]:
    found = []
    for case, paper in (("virtual_spheres", True), ("virtual_spheres_deep", False)):
        miss = row_of(table, case, "full", "porosity_miss")
        first = row_of(table, case, "full", "porosity_first")
        k, bare = (row_of(table, case, v, "k_ratio") for v in ("full", "grains_only"))
        tail, tail_bare = (row_of(table, case, v, "pore_r95_um") for v in ("full", "grains_only"))
        circles = row_of(table, case, "full", "circle_r95_um")
        name = "Virtual spheres" if paper else "Virtual spheres, deficit above 0.10"
        if miss is None and not paper:
            continue
        found += [
            Claim(
                case,
                f"{name} bring the porosity to the target (within 0.0002)",
                "0.4306 for 0.4304; grains alone 0.2339" if paper else "-",
                f"largest distance {_said(miss, 2)}; first packing {_said(first)}",
                OPEN if miss is None else SHOWN if miss["mean"] <= 0.0002 + 1e-9 else NOT_SHOWN,
            ),
            Claim(
                case,
                f"{name} bring K to the truth's (within 8 %)",
                "K over the truth's 0.87; grains alone 0.32" if paper else "-",
                f"K over the truth's {_said(k)}; grains alone {_said(bare)}",
                _within(k, 1.0, 0.08),
            ),
            Claim(
                case,
                f"{name} keep the tail of large pores",
                "shown as a histogram" if paper else "-",
                f"radius below which 95 % of the pore volume lies: {_said(tail)}, truth "
                f"{number(tail['truth']) if tail else '-'}; grains alone {_said(tail_bare)} µm; circles on "
                f"slices {_said(circles)}, the section's {number(circles['truth']) if circles else '-'} µm",
                _within(_relative(tail), 1.0, 0.1),
            ),
        ]
        shaped, k_shaped = (row_of(table, case, "voids", q) for q in ("pore_r95_um", "k_ratio"))
        if shaped is not None and k_shaped is not None:
            found += [
                Claim(
                    case,
                    f"{name} in the shapes of the section's voids bring {what} (ours only)",
                    "-",
                    f"{_said(with_shapes)}; as spheres {_said(round_)}",
                    _within(_relative(with_shapes), 1.0, tolerance),
                )
                for what, with_shapes, round_, tolerance in (
                    ("K to the truth's (within 8 %)", k_shaped, k, 0.08),
                    ("the tail to the truth's (within 10 %, µm)", shaped, tail, 0.1),
                )
            ]
    pairs = [
        [row_of(table, "virtual_spheres", variant, quantity) for variant in ("full", "touching")]
        for quantity in ("surface_ratio", "k_ratio")
    ]
    if all(row is not None for pair in pairs for row in pair):
        (surface, points), (k, k_points) = pairs
        nearer = all(abs(full["mean"] - 1) < abs(left["mean"] - 1) for full, left in pairs)
        found.append(
            Claim(
                "virtual_spheres",
                "Rims that close the contacts bring surface and K nearer to the truth (ours only)",
                "-",
                f"over the truth's: surface {_said(surface)}, K {_said(k)}; grains left touching in points: "
                f"surface {_said(points)}, K {_said(k_points)}",
                SHOWN if nearer else NOT_SHOWN,
            )
        )
    return found


def _relative(row: Mapping | None) -> Mapping | None:
    if row is None or not row["truth"]:
        return None
    return {**row, **{k: row[k] / row["truth"] for k in ("mean", "lower", "upper")}}


def _berea(table: pd.DataFrame) -> list[Claim]:
    k = row_of(table, "berea", "full", "k_md")
    if k is None:
        return [
            Claim("berea", "From one slice of Berea, K of the volume", "-", "not finished", OPEN),
        ]
    inside = [
        None if math.isnan(k["lower"]) else k["lower"] <= aim <= k["upper"]
        for aim in (k["truth"], BEREA_PUBLISHED_MD)
    ]
    equal = row_of(table, "berea", "full", "k_at_equal_surface")
    slices = [row_of(table, "berea", "section", q) for q in ("k_any_slice", "k_any_slice_surface")]
    return [
        Claim(
            "berea",
            "From one slice of Berea at the volume's porosity: K of the volume inside the interval",
            "- (the paper's sandstone: 0.92 of its tomogram)",
            f"{interval_words(k)} mD; the volume by the same method {number(k['truth'])}, "
            f"published mean of its cubes {number(BEREA_PUBLISHED_MD)}; with what the slices' surfaces "
            f"are off taken out {_said(equal)} of the volume's",
            OPEN if inside[0] is None else SHOWN if inside[0] and inside[1] else NOT_SHOWN,
        ),
        Claim(
            "berea",
            "A single slice says what porosity and surface are",
            "porosity held at the truth",
            "not attempted"
            if None in slices
            else "95 % of all slices would put K between "
            + ", ".join(
                f"{number(row['lower'])} and {number(row['upper'])} of the truth's by their {what} alone"
                for row, what in zip(slices, ("porosity", "surface"), strict=True)
            ),
            OPEN if None in slices else NOT_SHOWN,
        ),
    ]


def _tomogram(table: pd.DataFrame) -> list[Claim]:
    found = []
    for quantity, claim, paper in (
        ("s2_gap", "By S₂ the twin is nearer to the rock than the tomogram is", "shown as clouds"),
        ("w1_pores", "By pore sizes the twin is nearer to the rock than the tomogram is",
         "shown as histograms"),
        ("k_ratio", "By K the twin is nearer to the rock than the tomogram is",
         "twin 1183, tomogram 1284 mD; the rock is not known"),
    ):  # fmt: skip
        twin, scan = (row_of(table, "xct", v, quantity) for v in ("full", "tomogram"))
        status = OPEN
        if twin is not None and scan is not None:
            aim = 1.0 if quantity == "k_ratio" else 0.0
            near, far = (abs(r["mean"] - aim) for r in (twin, scan))
            status = SHOWN if near < far else NOT_SHOWN
            bounds = [[abs(r["lower"] - aim), abs(r["upper"] - aim)] for r in (twin, scan)]
            if math.isnan(bounds[0][0]) or math.isnan(bounds[1][0]):
                status = OPEN
            elif max(min(bounds[0]), min(bounds[1])) < min(max(bounds[0]), max(bounds[1])):
                status = OPEN  # the two intervals of the distance overlap
        found.append(Claim("xct", claim, paper, f"twin {_said(twin)}; tomogram {_said(scan)}", status))
    return found
