"""Config and sample sheet: validated against their schemas before any job runs."""

from __future__ import annotations

import copy
import difflib
import math
import re
from pathlib import Path

import pandas as pd
import yaml
from jsonschema import Draft202012Validator

from grainfall.errors import InputError

VARIANT_KEYS = ("scene", "packing", "effects", "feedback", "network", "flow")
RESERVED = ("benchmarks", "accuracy", "data", "validation", "cv_sweep")
"""Names under results/ that no sample may take."""


NAME_RULE = "letters, digits, - and _"


def _is_name(text: str) -> bool:
    return re.fullmatch(r"[A-Za-z0-9_-]{1,64}", text) is not None


def load_yaml(path: str | Path) -> dict:
    """Read a YAML mapping.

    Raises
    ------
    InputError
        When the file is missing, is not YAML or is not a mapping.
    """
    try:
        content = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except OSError as fault:
        raise InputError(path, fault.strerror or "cannot be read", "give a readable YAML file") from None
    except (yaml.YAMLError, UnicodeDecodeError) as fault:
        raise InputError(path, f"is not YAML ({fault})", "see config/README.md") from None
    if not isinstance(content, dict):
        raise InputError(path, "is not a mapping", "key: value lines, see config/README.md")
    return content


def merge(base: dict, over: dict | None) -> dict:
    """A deep copy of ``base`` with the values of ``over`` put over it, mapping by mapping."""
    merged = copy.deepcopy(base)
    for key, value in (over or {}).items():
        if isinstance(value, dict) and isinstance(merged.get(key), dict):
            merged[key] = merge(merged[key], value)
        else:
            merged[key] = copy.deepcopy(value)
    return merged


def check(content: object, schema: dict, where: str) -> None:
    """Hold ``content`` against a JSON schema.

    Raises
    ------
    InputError
        One line for the first fault: the key, what is wrong, what would be right.
    """
    _check_finite(content, where)
    faults = sorted(Draft202012Validator(schema).iter_errors(content), key=lambda e: [str(p) for p in e.path])
    if not faults:
        return
    fault = faults[0]
    key = ".".join(str(p) for p in fault.absolute_path)
    place = f"{where}: {key}" if key else where
    note = fault.schema.get("description", "")
    if fault.validator == "additionalProperties":
        known = sorted(fault.schema.get("properties", {}))
        unknown = sorted(set(fault.instance) - set(known), key=str)[0]
        near = difflib.get_close_matches(str(unknown), known, n=1)
        hint = f"did you mean '{near[0]}'?" if near else f"known keys: {', '.join(known)}"
        raise InputError(place, f"unknown key '{unknown}'", hint)
    if fault.validator == "required":
        raise InputError(place, fault.message, note)
    if fault.validator == "enum":
        allowed = ", ".join(str(v) for v in fault.validator_value)
        raise InputError(place, f"{fault.instance!r} is not known", f"one of: {allowed}")
    raise InputError(place, fault.message[:200], note)


def _check_finite(content: object, where: str) -> None:
    """JSON schemas let NaN pass every bound, since it compares false with each."""
    if isinstance(content, float) and not math.isfinite(content):
        raise InputError(where, f"{content} is not a finite number", "a plain number")
    items = (
        content.items()
        if isinstance(content, dict)
        else enumerate(content)
        if isinstance(content, list)
        else ()
    )
    for key, value in items:
        _check_finite(value, f"{where}: {key}")


def fill(content: dict, schema: dict) -> dict:
    """``content`` with every default of the schema where a key is absent, at every depth."""
    filled = copy.deepcopy(content)
    for key, sub in schema.get("properties", {}).items():
        if sub.get("type") == "object" and "properties" in sub:
            if not isinstance(filled.get(key, {}), dict):
                continue
            filled[key] = fill(filled.get(key, {}), sub)
        elif key not in filled and "default" in sub:
            filled[key] = copy.deepcopy(sub["default"])
    return filled


def _switched(content: dict) -> dict:
    """Switches as words: YAML reads a bare on or off as true or false."""
    if not isinstance(content.get("effects"), dict):
        return content
    words = {True: "on", False: "off"}
    effects = {k: words[v] if isinstance(v, bool) else v for k, v in content["effects"].items()}
    return {**content, "effects": effects}


def resolve(config: dict, schema: dict, presets: dict, where: str = "config") -> dict:
    """The config a run uses: defaults, under the preset, under the user's own values.

    Parameters
    ----------
    config : dict
        The user's config.
    schema : dict
        JSON schema of the config.
    presets : dict
        Named sets of values.
    where : str
        Name of the config in messages.

    Returns
    -------
    dict
        Every key present.

    Raises
    ------
    InputError
        On the first fault, variants' overrides included.
    """
    config = _switched(config)
    if isinstance(config.get("variants"), dict):
        over = {k: _switched(v) if isinstance(v, dict) else v for k, v in config["variants"].items()}
        config = {**config, "variants": over}
    check(config, schema, where)
    preset = config.get("preset", schema["properties"]["preset"]["default"])
    whole = fill(merge(presets.get(preset) or {}, config), schema)
    check(whole, schema, where)
    for name, over in whole["variants"].items():
        if not _is_name(str(name)):
            raise InputError(f"{where}: variants", f"'{name}' is no name", NAME_RULE)
        for key in over or {}:
            if key in schema["properties"] and key not in VARIANT_KEYS:
                raise InputError(
                    f"{where}: variants.{name}",
                    f"'{key}' cannot differ between variants of one sample",
                    f"override one of: {', '.join(VARIANT_KEYS)}",
                )
        check({"samples": "-", **(over or {})}, schema, f"{where}: variants.{name}")
    return whole


def variant(whole: dict, name: str) -> dict:
    """The config as one variant sees it."""
    return merge(whole, whole["variants"][name])


def synthesis(whole: dict, row: dict, schema: dict, where: str) -> dict:
    """The ``synthetic`` keys as one sample sees them: its own over the config's.

    Raises
    ------
    InputError
        When the sample's own do not fit the schema of the config.
    """
    check({"samples": "-", "synthetic": row.get("synthetic") or {}}, schema, where)
    return merge(whole["synthetic"], row.get("synthetic"))


def check_data(samples: dict[str, dict], data: dict) -> None:
    """Every sample of kind slice names an entry of ``data``; no other one does.

    Raises
    ------
    InputError
        For the first sample that does not.
    """
    for name, row in samples.items():
        if row["kind"] == "slice" and row["data"] not in data:
            known = ", ".join(data) or "none is there: add it"
            raise InputError(f"config: sample {name}", f"data '{row['data']}' is unknown", f"one of: {known}")


def read_samples(samples: str | dict, schema: dict) -> dict[str, dict]:
    """The sample sheet as a mapping of name to values.

    Parameters
    ----------
    samples : str or dict
        Path of a TSV sheet with a column ``sample``, or the same as a mapping.
    schema : dict
        JSON schema of one sample.

    Returns
    -------
    dict
        Sample name to its filled values; empty cells are left out.

    Raises
    ------
    InputError
        On the first fault of the sheet.
    """
    if isinstance(samples, dict):
        where, rows = "config: samples", {str(k): dict(v or {}) for k, v in samples.items()}
    else:
        where, rows = samples, _read_sheet(samples, schema)
    for name, row in rows.items():
        if not _is_name(name) or name in RESERVED:
            raise InputError(
                where, f"sample '{name}' is no name", f"{NAME_RULE}, none of: {', '.join(RESERVED)}"
            )
        check(row, schema, f"{where}: sample {name}")
        _check_sample(row, f"{where}: sample {name}")
        rows[name] = fill(row, schema)
    return rows


def _read_sheet(path: str, schema: dict) -> dict[str, dict]:
    try:
        sheet = pd.read_csv(path, sep="\t", dtype=str, keep_default_na=False, comment="#")
    except OSError as fault:
        raise InputError(path, fault.strerror or "cannot be read", "give a TSV sample sheet") from None
    except (ValueError, UnicodeDecodeError) as fault:
        raise InputError(
            path, f"is not a TSV table ({fault})", "one header line, one row a sample, tabs"
        ) from None
    if "sample" not in sheet.columns or sheet.empty:
        raise InputError(path, "has no column 'sample' or no row", "see config/README.md")
    rows: dict[str, dict] = {}
    for record in sheet.to_dict("records"):
        name = record.pop("sample")
        if name in rows:
            raise InputError(path, f"sample '{name}' stands there twice", "unique names")
        row = {str(k): v for k, v in record.items() if v != ""}
        for key, value in row.items():
            kind = schema["properties"].get(key, {}).get("type")
            if kind in ("number", "integer"):
                row[key] = _number(value, f"{path}: sample {name}: {key}", kind)
        rows[name] = row
    return rows


def _number(text: str, where: str, kind: str) -> float | int:
    try:
        value = float(text)
    except ValueError:
        raise InputError(where, f"'{text}' is not a number", "a plain number") from None
    if not math.isfinite(value):
        raise InputError(where, f"'{text}' is not finite", "a plain number")
    return int(value) if kind == "integer" and value.is_integer() else value


def _check_sample(row: dict, where: str) -> None:
    if "pixel_size_um" not in row and row["kind"] != "slice":
        raise InputError(where, "pixel_size_um is missing", "the edge of a pixel in micrometres")
    parse_phases(row.get("phases"))
    if row["kind"] == "synthetic":
        return
    if row["kind"] == "slice":
        for key, right in (("data", "an entry of the config's data"), ("slice", "axis and plane: z200")):
            if key not in row:
                raise InputError(where, f"{key} is missing", right)
        return
    if not row.get("image"):
        raise InputError(where, "image is missing", "the path of the section")
    if not Path(row["image"]).exists():
        raise InputError(where, f"image {row['image']} does not exist", "a path from the working directory")
    if row.get("grey") and not Path(row["grey"]).exists():
        raise InputError(where, f"grey {row['grey']} does not exist", "a path, or leave it empty")
    if row.get("reference"):
        if not Path(row["reference"]).exists():
            raise InputError(
                where, f"reference {row['reference']} does not exist", "a path, or leave it empty"
            )
        if "reference_voxel_size_um" not in row:
            raise InputError(
                where, "reference_voxel_size_um is missing", "the edge of a voxel in micrometres"
            )


def parse_phases(text: str | None) -> dict[str, int] | list[str] | None:
    """``"pore=0;quartz=1"`` as name to image value, ``"pore;quartz"`` as a list of names.

    Raises
    ------
    InputError
        When some names have a value and others have not, or a name stands there twice.
    """
    if not text:
        return None
    pairs = [part.partition("=") for part in text.split(";")]
    names = [name for name, _, _ in pairs]
    if len(set(names)) < len(names):
        raise InputError(f"phases '{text}'", "a name stands there twice", "unique names")
    if len({sign for _, sign, _ in pairs}) > 1:
        raise InputError(f"phases '{text}'", "some names have a value and some have not", "all or none")
    return {name: int(value) for name, _, value in pairs} if pairs[0][1] else names
