"""What the validation table says of the paper's claims, in words that follow from its figures."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import pandas as pd
import scipy  # its stats take half a second to load, and do so when they are first used

from grainfall.report.metrics import METRICS
from grainfall.report.numbers import number
from grainfall.report.validation import BEREA_PUBLISHED_MD

SHOWN, NOT_SHOWN, OPEN, NOT_RUN = "holds", "does not hold", "open", "not run"


class Claim(NamedTuple):
    """A claim, what the paper has for it, what we found, and whether it holds."""

    case: str
    claim: str
    paper: str
    ours: str
    status: str
    """holds, does not hold, open (nothing finished yet, one section only, or the interval decides neither
    way), or not run (the case has not been begun)."""


def row_of(table: pd.DataFrame, case: str, variant: str, quantity: str) -> Mapping | None:
    """One row of the validation table as a mapping, or None."""
    keys = (table["case"] == case) & (table["variant"] == variant) & (table["quantity"] == quantity)
    return table[keys].iloc[0].to_dict() if keys.any() else None


def interval_words(row: Mapping, digits: int = 3, unit: str = "") -> str:
    """Mean with its interval and unit, and of how many twins and sections."""
    words = number(row["mean"], digits)
    if not math.isnan(row["lower"]):
        words += f" ({number(row['lower'], digits)} to {number(row['upper'], digits)})"
    n, sections = int(row["n"]), int(row["sections"])
    words += f" {unit}" if unit else ""
    return words + f", n = {n} from " + (f"{sections} sections" if sections > 1 else "one section")


def _within(row: Mapping | None, aim: float, tolerance: float) -> str:
    """Whether the mean over sections is within the tolerance; open where the interval reaches the other side
    of it, and where there is a single section, which is silent on others."""
    if row is None or math.isnan(row["lower"]) or row["sections"] < 2:
        return OPEN
    inside = abs(row["mean"] - aim) <= tolerance
    edges = np.array([row["lower"], row["upper"]])
    reaches_in = (edges[0] <= aim + tolerance) and (edges[1] >= aim - tolerance)
    all_in = (np.abs(edges - aim) <= tolerance).all()
    if inside:
        return SHOWN if all_in else OPEN
    return OPEN if reaches_in else NOT_SHOWN


def _further(row: Mapping | None) -> tuple[float, float]:
    """Where one more section would lie (95 %), by the t-interval of the mean of those there are."""
    if row is None or math.isnan(row["lower"]) or row["sections"] < 2:
        return math.nan, math.nan
    half = (row["upper"] - row["mean"]) * math.sqrt(row["sections"] + 1)
    return row["mean"] - half, row["mean"] + half


def _each_within(row: Mapping | None, aim: float, tolerance: float) -> str:
    """Whether any one section is within the tolerance; where most are not it does not hold."""
    low, high = _further(row)
    if math.isnan(low):
        return OPEN
    if max(abs(low - aim), abs(high - aim)) <= tolerance:
        return SHOWN
    spread = (row["upper"] - row["mean"]) * math.sqrt(row["sections"])
    spread /= scipy.stats.t.ppf(0.975, row["sections"] - 1)
    if spread == 0:
        return NOT_SHOWN
    edges = (np.array([-tolerance, tolerance]) + aim - row["mean"]) / spread
    return NOT_SHOWN if np.diff(scipy.stats.norm.cdf(edges)).item() < 0.5 else OPEN


def _surely_above(*rows: Mapping | None) -> str:
    """Whether all these differences are surely above 0, or one surely below."""
    if any(row is None or math.isnan(row["lower"]) for row in rows):
        return OPEN
    if any(row["upper"] < 0 for row in rows):
        return NOT_SHOWN
    return SHOWN if all(row["lower"] > 0 for row in rows) else OPEN


def _surely_below(row: Mapping | None, limit: float) -> str:
    """Whether a figure is surely below a limit, or surely above it."""
    if row is None or math.isnan(row["lower"]):
        return OPEN
    return SHOWN if row["upper"] < limit else NOT_SHOWN if row["lower"] > limit else OPEN


def claims(table: pd.DataFrame) -> list[Claim]:
    """Every claim of the paper's three cases that the table can judge; those of cases not begun at the end.

    Parameters
    ----------
    table : DataFrame
        As :func:`grainfall.report.validation.validation_table` gives it.
    """
    found = [*_stereology(table), *_spheres(table), *_berea(table), *_tomogram(table)]
    found += [claim for case in dict.fromkeys(c.case for c in found) for claim in _sections(table, case)]
    begun = set(table["case"])
    tested = [c._replace(ours=_counted_once(c.ours)) for c in found if c.case in begun]
    return tested + [c._replace(ours="not run", status=NOT_RUN) for c in found if c.case not in begun]


def _counted_once(words: str) -> str:
    """The words without the counts of twins and sections that the next figure repeats."""
    count = r", n = \d+ from (?:one section|\d+ sections)"
    return re.sub(rf"({count})(?=(?:(?!, n = ).)*\1)", "", words)


def _said(row: Mapping | None, digits: int = 3, unit: str = "") -> str:
    return "not finished" if row is None else interval_words(row, digits, unit)


def _stereology(table: pd.DataFrame) -> list[Claim]:
    full = row_of(table, "stereology", "full", "k_ratio")
    skipped = row_of(table, "stereology", "no_inversion", "k_ratio")
    paired = row_of(table, "stereology", "no_inversion", "k_of_full")
    sizes = [row_of(table, "stereology", v, "w1_f3d") for v in ("full", "no_inversion")]
    nearer = row_of(table, "stereology", "no_inversion", "w1_f3d_nearer")
    found = [
        Claim(
            "stereology",
            "With the inversion, K is that of the truth (within 10 % in the mean of sections)",
            "K over the truth's 1.18",
            f"K over the truth's {_said(full)}",
            _within(full, 1.0, 0.1),
        ),
        Claim(
            "stereology",
            "The inversion brings the sizes nearer to the true ones in 3D",
            "shown as histograms",
            f"distance to the true radii over their mean: {_said(sizes[0])}; without: {_said(sizes[1])}; "
            f"nearer by {_said(nearer)}",
            _surely_above(nearer),
        ),
        _nearer_by_s2(table, "stereology", "no_inversion", "The inversion brings S₂ nearer to the truth's"),
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
        of_full = sweep[sweep["quantity"].str.startswith("k_of_full@") & (sweep["lower"] > 1)]
        above = [quantity.partition("@cv")[2] for quantity in of_full["quantity"]]
        of_each = " to ".join(f"{n:g}" for n in sorted({k["n"].min(), k["n"].max()}))
        said = ", ".join(f"CV {c:g}: {number(v)}" for c, v in ratio.items())
        found.append(
            Claim(
                "cv_sweep",
                "Skipping the inversion lowers K by some 50 % at any spread of sizes (our reading of it)",
                "−48 %, one sample, called systematic",
                f"spheres, K over the truth's without the inversion: {said}"
                + (f"; surely above K with the inversion at CV {', '.join(above)}" if len(above) else "")
                + f"; n = {of_each} of each",
                # one spread of sizes that surely loses less than a third speaks against it
                NOT_SHOWN if (k["lower"] > 2 / 3).any() else SHOWN if (k["upper"] < 2 / 3).all() else OPEN,
            )
        )
    return found


def _nearer_by_s2(table: pd.DataFrame, case: str, without: str, claim: str, paper: str = "shown as curves"):
    """The S2 of twins against that of twins without a step, both by their largest distance to the truth's."""
    gap, other = (row_of(table, case, variant, "s2_gap") for variant in ("full", without))
    nearer = row_of(table, case, without, "s2_gap_nearer")
    words = f"largest distance to the truth's: {_said(gap, 2)}; without: {_said(other, 2)}"
    words += f"; nearer by {_said(nearer, 2)}" + _chance(row_of(table, case, "truth", "s2_gap"))
    return Claim(case, claim, paper, words, _surely_above(nearer))


def _spheres(table: pd.DataFrame) -> list[Claim]:
    found = []
    for case, paper in (("virtual_spheres", True), ("virtual_spheres_deep", False)):
        miss = row_of(table, case, "full", "porosity_miss")
        first = row_of(table, case, "full", "porosity_first")
        k, bare = (row_of(table, case, v, "k_ratio") for v in ("full", "grains_only"))
        tail, tail_bare = (row_of(table, case, v, "pore_r95_um") for v in ("full", "grains_only"))
        kept = row_of(table, case, "full", "pore_r95_ratio")
        circles = row_of(table, case, "full", "circle_r95_um")
        every, alike = (row_of(table, case, v, "w1_pores") for v in ("full", "truth"))
        name = "Virtual spheres" if paper else "Virtual spheres (deficit above 0.10)"
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
                f"{name} bring K to the truth's (within 8 % in the mean of sections)",
                "K over the truth's 0.87; grains alone 0.32" if paper else "-",
                f"K over the truth's {_said(k)}; grains alone {_said(bare)}",
                _within(k, 1.0, 0.08),
            ),
            Claim(
                case,
                f"{name} keep the tail of large pores (within 10 % in the mean of sections)",
                "shown as a histogram" if paper else "-",
                f"radius below which 95 % of the pore volume lies over the truth's: {_said(kept)}; "
                f"{_said(tail, unit='µm')}, truth {_aim(tail)} µm; grains alone "
                f"{_said(tail_bare, unit='µm')}; circles on slices {_said(circles, unit='µm')}, the "
                f"section's {_aim(circles)} µm; all pore radii by volume, distance to the truth's over their "
                f"mean {_said(every)}" + _chance(alike),
                _within(kept, 1.0, 0.1),
            ),
            _nearer_by_s2(
                table, case, "grains_only", f"{name} bring S₂ nearer to the truth's than grains alone do",
                "shown as curves" if paper else "-",
            ),
        ]  # fmt: skip
        change, moved, lost = (
            row_of(table, case, "full", name)
            for name in ("resettled_porosity", "resettled_moved", "lost_support")
        )
        if change is not None:
            found.append(
                Claim(
                    case,
                    "The matrix is stable without the spheres: settled anew it keeps its porosity (to 0.01 "
                    "in the mean of sections)",
                    "a physically stable matrix" if paper else "-",
                    f"changes by {_said(change, 2)}; share of grains that move by more than 0.1 radii "
                    f"{_said(moved, 2)}; that lost their support {_said(lost, 2)}",
                    _within(change, 0.0, 0.01),
                )
            )
        for what, quantity, shaped in (("K", "k_ratio", k), ("the tail", "pore_r95_ratio", kept)):
            round_, nearer = (row_of(table, case, "round", f"{quantity}{end}") for end in ("", "_nearer"))
            if nearer is not None:
                found.append(
                    Claim(
                        case,
                        f"{name} in the shapes of the section's voids bring {what} nearer to the truth's "
                        "than round ones (ours only)",
                        "-",
                        f"over the truth's {_said(shaped)}; round {_said(round_)}; nearer by {_said(nearer)}",
                        _surely_above(nearer),
                    )
                )
    return found + _rims(table, "virtual_spheres")


def _rims(table: pd.DataFrame, case: str) -> list[Claim]:
    """What rims about the contacts do, where twins without them were made."""
    (surface, points, less), (k, k_points, k_less) = (
        (
            row_of(table, case, "full", quantity),
            row_of(table, case, "touching", quantity),
            row_of(table, case, "touching", f"{quantity}_nearer"),
        )
        for quantity in ("surface_ratio", "k_ratio")
    )
    if less is None or k_less is None:
        return []
    return [
        Claim(
            case,
            "Rims that close the contacts bring surface and K nearer to the truth (ours only)",
            "-",
            f"over the truth's: surface {_said(surface)}, K {_said(k)}; grains left touching in points: "
            f"surface {_said(points)}, K {_said(k_points)}; nearer by {_said(less)} and {_said(k_less)}",
            _surely_above(less, k_less),
        )
    ]


def _sections(table: pd.DataFrame, case: str) -> list[Claim]:
    """Whether sections look like slices of their twins, as much as they do like slices of their own truth."""
    p, told, more = (
        row_of(table, case, "full", f"s2_{name}")
        for name in ("envelope_p", "windows_rejected", "windows_excess")
    )
    if more is None:
        return []
    level = METRICS["s2_envelope_p"].low  # as many are told of what is alike
    # of a single section both comparisons are with NaN
    status = SHOWN if more["upper"] <= level else NOT_SHOWN if more["lower"] > level else OPEN
    return [
        Claim(
            case,
            "By S₂, windows of a section differ from slices of its twins no more often than from slices of "
            f"the truth itself (at most {100 * level:g} % of windows more)",
            "shown as clouds",
            f"rejected {_said(told, 2)}; from slices of the truth {number(told['truth'], 2)}; more often by "
            f"{_said(more, 2)}; p of the middle windows {_said(p, 2)}",
            status,
        )
    ]


def _chance(alike: Mapping | None) -> str:
    """How far cubes of one rock are from each other, where there are several."""
    return f"; one cube of the truth to its others {interval_words(alike)}" if alike else ""


def _aim(row: Mapping | None) -> str:
    return number(row["truth"]) if row else "-"


def _berea(table: pd.DataFrame) -> list[Claim]:
    k, ratio, equal = (row_of(table, "berea", "full", q) for q in ("k_md", "k_ratio", "k_at_equal_surface"))
    slices = [row_of(table, "berea", "section", q) for q in ("k_any_slice", "k_any_slice_surface")]
    low, high = _further(ratio)
    more = (
        ""
        if math.isnan(low)
        else f"; one more slice of this volume would have {number(low)} to {number(high)}"
    )
    return [
        Claim(
            "berea",
            "From one slice of Berea at the volume's porosity, K is that of the volume (within 10 %)",
            "- (the paper's sandstone: 0.92 of its tomogram)",
            f"K over the volume's {_said(ratio)}; {_said(k, unit='mD')}; the volume by the same method "
            f"{_aim(k)}, published mean of its cubes {number(BEREA_PUBLISHED_MD)} mD; K over the volume's "
            f"with what the slices' surfaces are off taken out {_said(equal)}{more}",
            _each_within(ratio, 1.0, 0.1),
        ),
        Claim(
            "berea",
            "A single slice tells porosity and surface well enough for K within 10 %",
            "-",
            "not attempted"
            if None in slices
            else "95 % of all slices would put K between "
            + ", ".join(
                f"{number(row['lower'])} and {number(row['upper'])} of the truth's by their {what} alone"
                for row, what in zip(slices, ("porosity", "surface"), strict=True)
            ),
            OPEN
            if None in slices
            else SHOWN
            if all(abs(row[end] - 1) <= 0.1 for row in slices for end in ("lower", "upper"))
            else NOT_SHOWN,
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
        nearer = row_of(table, "xct", "tomogram", f"{quantity}_nearer")
        words = f"twin {_said(twin)}; tomogram {_said(scan)}; nearer by {_said(nearer)}"
        words += _chance(row_of(table, "xct", "truth", quantity))
        found.append(Claim("xct", claim, paper, words, _surely_above(nearer)))
    scan, twin, wide = (
        row_of(table, "xct", variant, quantity)
        for variant, quantity in (
            ("tomogram", "pore_median_ratio"), ("full", "pore_median_ratio"), ("tomogram", "pore_r50_ratio")
        )
    )  # fmt: skip
    found.append(
        Claim(
            "xct",
            "The tomogram's pores are shifted to small radii (their median by number below the rock's)",
            "shown as histograms",
            f"over the rock's {_said(scan)}; the twin's {_said(twin)}; the tomogram's by volume "
            f"{_said(wide)}",
            _surely_below(scan, 1.0),
        )
    )
    told, more = (row_of(table, "xct", "tomogram", f"s2_windows_{name}") for name in ("rejected", "excess"))
    level = METRICS["s2_envelope_p"].low
    status = OPEN
    if more is not None:
        # of a single section both comparisons are with NaN
        status = SHOWN if more["lower"] > level else NOT_SHOWN if more["upper"] <= level else OPEN
    claim = (
        "By S₂, windows of a section differ from slices of its tomogram more often than from the rock's own"
    )
    words = f"rejected {_said(told, 2)}; more often by {_said(more, 2)}"
    found.append(Claim("xct", claim, "the section's S₂ leaves the tomogram's cloud", words, status))
    return found + _rims(table, "xct")
