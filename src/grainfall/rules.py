"""Rules that give a grain its mineral by one of its features: what makes one valid."""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping, Sequence

from grainfall.errors import InputError

FEATURES = ("mean_grey", "r_um", "area_um2", "aspect_ratio", "circularity", "solidity")
_KEYS = ("phase", "feature", "above", "below")


def check_rules(rules: Sequence[Mapping], phases: Sequence[str] | None = None, where: str = "rules") -> None:
    """Raise an InputError for a rule that cannot be meant; needs no grains.

    Parameters
    ----------
    rules : sequence of mapping
        See :func:`grainfall.morphology.classify_grains`.
    phases : sequence of str, optional
        Names of the phases, index 0 the pore; without them a rule's phase is not looked up.
    where : str
        What the rules are called in messages.

    Raises
    ------
    InputError
    """
    for number, rule in enumerate(rules, start=1):
        at = f"{where}[{number}]"
        if not isinstance(rule, Mapping):
            raise InputError(at, f"{rule!r} is no rule", f"give {', '.join(_KEYS)}")
        for key in rule:
            _known(at, "key", key, _KEYS)
        if phases is not None:
            _known(at, "phase", rule.get("phase"), tuple(phases[1:]))
        _known(at, "feature", rule.get("feature"), FEATURES)
        bounds = {key: rule[key] for key in ("above", "below") if rule.get(key) is not None}
        for key, value in bounds.items():
            if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
                raise InputError(f"{at}: {key}", f"{value!r} is no number", "give a finite number")
        if not bounds:
            raise InputError(at, "neither above nor below", "give one of them, or both")
        if len(bounds) == 2 and not bounds["above"] < bounds["below"]:
            raise InputError(
                at, f"nothing is above {bounds['above']} and below {bounds['below']}", "above must be less"
            )


def _known(where: str, what: str, name: object, names: Sequence[str]) -> None:
    if name not in names:
        near = difflib.get_close_matches(str(name), names, n=1)
        wrong = f"no {what}" if name is None else f"{what} {name!r} is unknown"
        raise InputError(where, wrong, f"{near[0]!r}?" if near else f"one of {', '.join(names)}")
