"""Config and sample sheet: validated against their schemas before any job runs."""

from __future__ import annotations

import copy
import csv
import difflib
import math
import re
from collections.abc import Callable, Iterable, Iterator
from datetime import date
from pathlib import Path

import yaml

from grainfall.errors import InputError
from grainfall.presets import MEASURED, SMALLEST, measured, with_accuracy
from grainfall.rules import check_rules

VARIANT_KEYS = ("scene", "packing", "effects", "feedback", "network", "flow")
RESERVED = (
    "accuracy", "benchmarks", "cv_sweep", "data", "docs", "figures", "grains3d", "logs", "tomogram",
    "validation",
)  # fmt: skip
"""Folders of results that no sample and no variant may be named after."""

NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
"""A number as people write it; Python alone would also take 1_000 for 1000."""

NO_OCTAL = re.compile(r"[+-]?(0$|0[.eE]|[^0+-])")
"""Begins as such a number does, not with a zero before other digits."""

MAX_NODES = 20_000
"""Most values in a config; aliases of aliases make billions of a few lines."""

MAX_TEXT = 10_000_000
"""Longest config or sample sheet read, bytes."""


NAME_RULE = "at most 64 letters, digits, - and _"


def is_name(name: str) -> bool:
    """Whether a sample or a variant may be named so.

    A name becomes a folder: nothing that could leave it, hide in it or be taken for an option.
    """
    return bool(re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_-]{0,63}", name)) and name.lower() not in RESERVED


def _check_names(names: Iterable[str], where: str, what: str) -> None:
    folded: dict[str, str] = {}
    for name in names:
        if not is_name(name):
            right = f"{NAME_RULE}, none of: {', '.join(RESERVED)}"
            raise InputError(where, f"{what} '{name}' is no name", right)
        # one folder on a file system that does not tell cases apart
        if (other := folded.setdefault(name.lower(), name)) != name:
            raise InputError(where, f"'{other}' and '{name}' differ in case only", "distinct names")


def load_yaml(path: str | Path, ours: bool = False) -> dict:
    """Read a YAML mapping.

    Parameters
    ----------
    path : path
    ours : bool
        A file that comes with grainfall: read by libyaml where PyYAML has it, at a tenth of the time. A
        user's is not: libyaml is less strict, and has other words for what is wrong.

    Raises
    ------
    InputError
        When the file is missing, is not YAML or is not a mapping.
    """
    text = _read_text(path, "a YAML file")
    try:
        content = yaml.load(text, _OurLoader if ours else _Loader)
    except InputError as fault:
        raise InputError(f"{path}: {fault.where}", fault.wrong, fault.right) from None
    except (yaml.YAMLError, ValueError, RecursionError) as fault:
        raise InputError(path, f"is not YAML ({fault})"[:300], "see config/README.md") from None
    if not isinstance(content, dict):
        raise InputError(path, "is not a mapping", "key: value lines, see config/README.md")
    if "__use_yte__" in content:
        raise InputError(path, "is a template, which would be run as code", "leave out __use_yte__")
    _check_plain(content, str(path))
    return content


class _Loader(yaml.SafeLoader):
    """YAML that does not let a later key silently take the place of an earlier one."""


class _OurLoader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):
    """The same, faster."""


def _unique_mapping(loader: _Loader | _OurLoader, node: yaml.MappingNode) -> dict:
    seen = set()
    for key, _ in node.value:
        # what is merged (<<) gives way to the mapping's own keys
        if isinstance(key, yaml.ScalarNode) and not key.tag.endswith(":merge"):
            read = loader.construct_object(key, deep=True)
            if {read, str(read)} & seen:  # 7 and '7' are one name
                line = key.start_mark.line + 1
                raise InputError(f"line {line}", f"key '{key.value}' stands there twice", "unique keys")
            seen |= {read, str(read)}
    return yaml.SafeLoader.construct_mapping(loader, node, deep=True)


def _number_as_written(kind: str) -> Callable:
    """Constructor of numbers. YAML has some that few know: 010 is 8 to it, 1_000 is 1000, 1:30 is 90."""

    def number(loader: _Loader | _OurLoader, node: yaml.ScalarNode) -> int | float:
        read = getattr(yaml.SafeLoader, f"construct_yaml_{kind}")(loader, node)
        if math.isfinite(read) and not (NUMBER.fullmatch(node.value) and NO_OCTAL.match(node.value)):
            line, right = node.start_mark.line + 1, "write it as a plain number, or a name in quotes"
            raise InputError(f"line {line}", f"{node.value} is {read} to YAML", right)
        return read

    return number


for _loader in (_Loader, _OurLoader):
    _loader.add_constructor(yaml.resolver.BaseResolver.DEFAULT_MAPPING_TAG, _unique_mapping)
    for _kind in ("int", "float"):
        _loader.add_constructor(f"tag:yaml.org,2002:{_kind}", _number_as_written(_kind))


def _read_text(path: str | Path, what: str) -> str:
    """A text file of the user's, if it is one: not a device, not endless, UTF-8."""
    path, right = Path(path), f"give {what}"
    try:
        if not path.is_file():
            raise InputError(path, "is no file" if path.exists() else "No such file or directory", right)
        if path.stat().st_size > MAX_TEXT:
            raise InputError(path, f"is larger than {MAX_TEXT // 1_000_000} MB", right)
        return path.read_text(encoding="utf-8-sig")
    except InputError:
        raise
    except OSError as fault:
        raise InputError(path, fault.strerror or "cannot be read", right) from None
    except UnicodeDecodeError as fault:
        raise InputError(path, f"is not UTF-8 text ({fault.reason})", right) from None
    except ValueError:
        raise InputError(repr(str(path)), "is no path", right) from None


def _check_plain(content: object, where: str) -> None:
    """Refuse what would never end: aliases of aliases (each use counts), mappings that hold themselves."""
    left = [(content, 0)]
    for _ in range(MAX_NODES):
        if not left:
            return
        value, depth = left.pop()
        if depth > 50 or len(left) > MAX_NODES:
            break
        if isinstance(value, dict):
            left.extend((item, depth + 1) for item in value.values())
        elif isinstance(value, list | tuple):
            left.extend((item, depth + 1) for item in value)
    raise InputError(where, f"more than {MAX_NODES} values, or nested too deeply", "a plain config")


def _text_keys(content: object, where: str) -> object:
    """``content`` with every key as text: to YAML a bare 300 is a number, 2024-05-01 a date.

    What it makes of a bare no or null does not tell what was written, so that these need quotes.
    """
    if isinstance(content, list):
        return [_text_keys(item, where) for item in content]
    if not isinstance(content, dict):
        return content
    named: dict[str, object] = {}
    for key, value in content.items():
        if isinstance(key, bool) or not isinstance(key, str | int | date):
            raise InputError(where, f"YAML reads a name there as {key!r}"[:200], "put the name in quotes")
        if str(key) in named:
            raise InputError(where, f"'{key}' stands there twice", "unique names")
        named[str(key)] = _text_keys(value, f"{where}: {key}")
    return named


def merge(base: dict, over: dict | None) -> dict:
    """A deep copy of ``base`` with the values of ``over`` put over it, mapping by mapping."""
    merged = copy.deepcopy(base)
    for key, value in (over or {}).items():
        if isinstance(value, dict) and isinstance(merged.get(key), dict):
            merged[key] = merge(merged[key], value)
        else:
            merged[key] = copy.deepcopy(value)
    return merged


def canonical(content: object) -> object:
    """One way to write what means the same: keys in alphabetical order, whole numbers without a point.

    Jobs rerun when the text of their parameters changes; 1.0 for 1 or keys in another order must not do that.
    """
    if isinstance(content, dict):
        return {key: canonical(content[key]) for key in sorted(content, key=str)}
    if isinstance(content, list):
        return [canonical(item) for item in content]
    if isinstance(content, float) and content.is_integer() and abs(content) < 2**53:
        return int(content)
    return content


def check(content: object, schema: dict, where: str) -> None:
    """Hold ``content`` against a JSON schema.

    Raises
    ------
    InputError
        One line for the first fault: the key, what is wrong, what would be right.
    """
    from jsonschema import Draft202012Validator  # most jobs read a config that was checked before

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
    if fault.validator == "pattern":
        raise InputError(place, f"{fault.instance!r} is not written as it has to be"[:200], note)
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


WORDS = {"null": ("null", None), "true": ("boolean", True), "false": ("boolean", False)}


def _typed(content: dict, schema: dict) -> dict:
    """``content`` with text read where the schema has no text: Snakemake's --config gives what lies within a
    mapping as text, and to YAML 1e3 is a word. What cannot be read is left for the schema to refuse."""
    typed = dict(content)
    for key, value in content.items():
        sub = schema.get("properties", {}).get(key, {})
        kinds = sub.get("type", ())
        kinds = {kinds} if isinstance(kinds, str) else {*kinds}
        if isinstance(value, dict):
            typed[key] = _typed(value, sub)
        elif isinstance(value, str) and kinds and "string" not in kinds:
            kind, plain = WORDS.get(value, ("", None))
            if kind in kinds:
                typed[key] = plain
            elif kinds & {"number", "integer"} and NUMBER.fullmatch(value):
                typed[key] = _number(value, key, "number" if "number" in kinds else "integer")
    return typed


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
        Every key present, in canonical form (:func:`canonical`).

    Raises
    ------
    InputError
        On the first fault, variants' overrides included; where no preset holds the ``accuracy`` asked for.
    """
    _check_plain(config, where)
    config = _switched(_typed(_text_keys(config, where), schema))
    if isinstance(config.get("variants"), dict):
        over = {
            k: _switched(_typed(v, schema)) if isinstance(v, dict) else v
            for k, v in config["variants"].items()
        }
        config = {**config, "variants": over}
    check(config, schema, where)
    if config.get("sweep"):
        config = {**config, "variants": _with_sweep(config, schema)}
    if config.get("accuracy"):
        config = with_accuracy(config, measured(), where)
    preset = config.get("preset", schema["properties"]["preset"]["default"])
    whole = fill(merge(presets.get(preset) or {}, config), schema)
    check(whole, schema, where)
    _check_names(whole["data"], f"{where}: data", "entry")
    _check_names(whole["variants"], f"{where}: variants", "variant")
    of_variants = {**schema, "required": [], "properties": {k: schema["properties"][k] for k in VARIANT_KEYS}}
    for name, over in whole["variants"].items():
        for key in over or {}:
            if key in schema["properties"] and key not in VARIANT_KEYS:
                raise InputError(
                    f"{where}: variants.{name}",
                    f"'{key}' cannot differ between variants of one sample",
                    f"override one of: {', '.join(VARIANT_KEYS)}",
                )
        check(over or {}, of_variants, f"{where}: variants.{name}")
    _check_sweep(whole, f"{where}: accuracy_sweep")
    check_rules(whole["section"]["rules"], where=f"{where}: section.rules")
    whole["variants"] = {name: _meant(over, whole["scene"]) for name, over in whole["variants"].items()}
    # samples and variants are shown in the user's order
    named = {key: whole[key] for key in ("samples", "variants") if isinstance(whole[key], dict)}
    ordered = {key: {name: canonical(values) for name, values in of.items()} for key, of in named.items()}
    return canonical(whole) | ordered


def _check_sweep(whole: dict, where: str) -> None:
    """Refuse what a sweep of settings could not find, before it has run for hours."""
    sweep = whole["accuracy_sweep"]
    if sweep["packing"] and sweep["against"] is None:
        raise InputError(f"{where}.against", "is missing", "the variant that the others are held against")
    poured = [name for names in sweep["packing"].values() for name in names]
    chance = [name for pair in sweep["chance"].items() for name in pair]
    for name in [*poured, *filter(None, [sweep["against"]]), *chance, *sweep["presets"]]:
        if name not in whole["variants"]:
            known = ", ".join(whole["variants"])
            raise InputError(where, f"no variant is called '{name}'", f"one of: {known}")


IN_UM = {"edge_grains": "edge_um", "voxels_per_grain": "voxel_size_um"}
"""Lengths of the scene in grains, each with its like in um, which counts where both are given."""


def _meant(over: dict | None, scene: dict) -> dict | None:
    """An override as it is meant: a length in grains resets the config's in um, which would hide it."""
    own = (over or {}).get("scene", {})
    hiding = [um for grains, um in IN_UM.items() if grains in own and um not in own and scene[um] is not None]
    return merge(over, {"scene": dict.fromkeys(hiding)}) if hiding else over


def variant(whole: dict, name: str) -> dict:
    """The config as one variant sees it, without those of the others."""
    own = {key: value for key, value in whole.items() if key != "variants"}
    return merge(own, whole["variants"][name])


def parameters(whole: dict) -> dict[str, dict]:
    """What differs between variants: every dotted key that any of them overrides, as each has it.

    Returns
    -------
    dict
        Variant name to dotted key to value; None where the config gives none.
    """
    keys = sorted({key for over in whole["variants"].values() for key, _ in _leaves(over or {})})
    found = {}
    for name in whole["variants"]:
        values = dict(_leaves(variant(whole, name)))
        found[name] = {key: values.get(key) for key in keys}
    return found


def unmeasured(whole: dict, alone: dict) -> list[str]:
    """Dotted keys in which a config leaves what was measured of its preset.

    Parameters
    ----------
    whole, alone : dict
        A config with every key, and that of its preset alone.
    """
    found, held = (
        {key: value for key, value in _leaves(content) if key.startswith(MEASURED)}
        for content in (whole, alone)
    )
    other = [key for key in found.keys() | held.keys() if found.get(key) != held.get(key)]
    own = whole["scene"]
    other += [f"scene.{key}" for key, least in SMALLEST.items() if own[key] and own[key] < least]
    return sorted(other)


def _leaves(content: dict, prefix: str = "") -> Iterator[tuple[str, object]]:
    """Every value that is no mapping, with its dotted key."""
    for key, value in content.items():
        if isinstance(value, dict):
            yield from _leaves(value, f"{prefix}{key}.")
        else:
            yield prefix + key, value


def read_sweep(path: str, schema: dict) -> dict[str, dict]:
    """A table of parameters as variants.

    Parameters
    ----------
    path : str
        TSV sheet with a column ``variant`` and one for each dotted key of the config that differs; in a list,
        ``;`` stands between its values.
    schema : dict
        JSON schema of the config.

    Returns
    -------
    dict
        Variant name to its overrides, as the config's ``variants`` has them; empty cells are left out.

    Raises
    ------
    InputError
        On the first fault of the sheet.
    """
    known = dict(_dotted(schema))
    overrides = {}
    for name, row in _read_sheet(path, "variant", known).items():
        overrides[name] = {}
        for key, value in row.items():
            if key not in known:
                near = difflib.get_close_matches(key, known, n=1)
                hint = f"did you mean '{near[0]}'?" if near else "dotted keys of config/README.md"
                raise InputError(path, f"unknown column '{key}'", hint)
            if key.partition(".")[0] not in VARIANT_KEYS:
                raise InputError(
                    path,
                    f"column '{key}' cannot differ between variants of one sample",
                    f"a key of one of: {', '.join(VARIANT_KEYS)}",
                )
            *parents, last = key.split(".")
            inner = overrides[name]
            for parent in parents:
                inner = inner.setdefault(parent, {})
            inner[last] = value.split(";") if known[key].get("type") == "array" else value
    return overrides


def _dotted(schema: dict, prefix: str = "") -> Iterator[tuple[str, dict]]:
    """Every dotted key that holds a value, with its schema."""
    for key, sub in schema["properties"].items():
        if "properties" in sub:
            yield from _dotted(sub, f"{prefix}{key}.")
        else:
            yield prefix + key, sub


def _with_sweep(config: dict, schema: dict) -> dict[str, dict | None]:
    """The config's own variants, if it names any, and those of its table."""
    own, rows = config.get("variants") or {}, read_sweep(config["sweep"], schema)
    if twice := sorted(own.keys() & rows.keys()):
        raise InputError(config["sweep"], f"variant '{twice[0]}' is in the config, too", "unique names")
    default = schema["properties"]["variants"]["default"]
    # a run without the sweep may have made it: what it is must not change under its name
    if other := [name for name, over in rows.items() if name in default and over != default[name]]:
        raise InputError(
            config["sweep"], f"variant '{other[0]}' is what a config without variants runs", "another name"
        )
    return {**own, **rows}


def synthesis(whole: dict, row: dict, schema: dict, where: str) -> dict:
    """The ``synthetic`` keys as one sample sees them: its own over the config's.

    Raises
    ------
    InputError
        When the sample's own do not fit the schema of the config.
    """
    check({"samples": "-", "synthetic": row.get("synthetic") or {}}, schema, where)
    return merge(whole["synthetic"], row.get("synthetic"))


def check_data(samples: dict[str, dict], data: dict, *, files: bool = True) -> None:
    """Every sample of kind slice names an entry of ``data``; its source is an address or a file.

    Raises
    ------
    InputError
        For the first sample that does not.
    """
    for name, row in samples.items():
        if row["kind"] != "slice":
            continue
        if row["data"] not in data:
            known = ", ".join(map(str, data)) or "none is there: add it"
            raise InputError(f"config: sample {name}", f"data '{row['data']}' is unknown", f"one of: {known}")
        source = data[row["data"]]["source"]
        if files and not is_address(source):
            _check_path(source, "source", f"config: data {row['data']}")


def is_address(source: str) -> bool:
    """Whether a source is to be fetched, and not a path on this machine."""
    return source.startswith(("http://", "https://"))


def samples_of(whole: dict, schema: dict, sample_schema: dict, *, files: bool = True) -> dict[str, dict]:
    """The samples of a resolved config, held against the rest of it.

    Parameters
    ----------
    whole : dict
        As :func:`resolve` returns it.
    schema, sample_schema : dict
        JSON schemas of the config and of one sample.
    files : bool
        Whether the files that they name have to be there.

    Returns
    -------
    dict
        As :func:`read_samples` returns it.

    Raises
    ------
    InputError
        On the first fault.
    """
    samples = read_samples(whole["samples"], sample_schema, files=files)
    check_data(samples, whole["data"], files=files)
    for name, row in samples.items():
        rock = synthesis(whole, row, schema, f"config: sample {name}")
        minerals = [mineral["name"] for mineral in rock["minerals"]]
        named = minerals if row["kind"] == "synthetic" else parse_phases(row.get("phases"))
        if named:
            phases = ["pore", *(phase for phase in named if phase != "pore")]
            check_rules(whole["section"]["rules"], phases, f"config: sample {name}: section.rules")
    return samples


def read_samples(samples: str | dict, schema: dict, *, files: bool = True) -> dict[str, dict]:
    """The sample sheet as a mapping of name to values.

    Parameters
    ----------
    samples : str or dict
        Path of a TSV sheet with a column ``sample``, or the same as a mapping.
    schema : dict
        JSON schema of one sample.
    files : bool
        Whether the files that they name have to be there.

    Returns
    -------
    dict
        Sample name to its filled values in canonical form; empty cells are left out.

    Raises
    ------
    InputError
        On the first fault of the sheet.
    """
    if isinstance(samples, dict):
        where, rows = "config: samples", {}
        for key, row in _text_keys(samples, where).items():
            if not isinstance(row, dict | None):
                raise InputError(f"{where}: {key}", f"{row!r} is no sample"[:200], "give it as key: value")
            rows[key] = _typed(row or {}, schema)
    else:
        where, rows = samples, _read_sheet(samples, "sample", schema["properties"])
    _check_names(rows, where, "sample")
    for name, row in rows.items():
        check(row, schema, f"{where}: sample {name}")
        _check_sample(row, f"{where}: sample {name}", files)
        rows[name] = canonical(fill(row, schema))
    return rows


def _read_sheet(path: str, first: str, known: dict[str, dict]) -> dict[str, dict]:
    """Rows of a TSV sheet by the name in column ``first``, numbers read where the schemas ask for them."""
    text = _read_text(path, "a TSV sheet")
    # Only a line that begins with # is a comment: a path may have one in it.
    lines = [(n, line) for n, line in enumerate(text.splitlines(), start=1) if line.strip(" \t")]
    lines = [(n, line) for n, line in lines if not line.startswith("#")]
    try:
        cells = [row for (row,) in (list(csv.reader([line], delimiter="\t")) for _, line in lines)]
    except (csv.Error, ValueError) as fault:
        raise InputError(
            path, f"is not a TSV table ({fault})", f"one header line, one row a {first}, tabs"
        ) from None
    header = [cell.strip() for cell in cells[0]] if cells else []
    for n in range(len(header) - 1, -1, -1):
        if not header[n]:  # as spreadsheets leave them behind
            if any(row[n].strip() for row in cells[1:] if len(row) > n):
                raise InputError(path, f"column {n + 1} has no name", "a name above its cells")
            header.pop(n)
            cells = [row[:n] + row[n + 1 :] for row in cells]
    if first not in header or len(cells) < 2:
        tabs = len(header) == 1 and re.search(r"[\s,;]", header[0])
        right = "columns separated by tabs" if tabs else "see config/README.md"
        raise InputError(path, f"has no column '{first}' or no row", right)
    if len(set(header)) < len(header):
        raise InputError(path, "a column stands there twice", "unique columns")
    rows: dict[str, dict] = {}
    for (number, _), values in zip(lines[1:], cells[1:], strict=True):
        if len(values) > len(header) and any(value.strip() for value in values[len(header) :]):
            raise InputError(
                f"{path}: line {number}",
                f"{len(values)} cells under {len(header)} columns",
                "a cell a column",
            )
        record = {key: value.strip() for key, value in zip(header, values, strict=False)}
        name = record.pop(first, "")
        if name in rows:
            raise InputError(path, f"{first} '{name}' stands there twice", "unique names")
        row = {key: value for key, value in record.items() if value != ""}
        for key, value in row.items():
            kinds = known.get(key, {}).get("type", ())
            for kind in {"number", "integer"} & {*([kinds] if isinstance(kinds, str) else kinds)}:
                row[key] = _number(value, f"{path}: {first} {name}: {key}", kind)
        rows[name] = row
    return rows


def _number(text: str, where: str, kind: str) -> float | int:
    if not NUMBER.fullmatch(text):
        wrong = "is not finite" if re.fullmatch(r"[+-]?(nan|inf(inity)?)", text, re.I) else "is not a number"
        raise InputError(where, f"'{text}' {wrong}"[:200], "a plain number")
    if kind == "integer" and re.fullmatch(r"[+-]?\d{1,18}", text):
        return int(text)
    value = float(text)
    if not math.isfinite(value):
        raise InputError(where, f"'{text}' is not finite", "a plain number")
    return int(value) if kind == "integer" and value.is_integer() else value


def _check_sample(row: dict, where: str, files: bool) -> None:
    if "pixel_size_um" not in row and row["kind"] != "slice":
        raise InputError(where, "pixel_size_um is missing", "the edge of a pixel in micrometres")
    parse_phases(row.get("phases"))
    if row["kind"] == "synthetic":
        return
    if row["kind"] == "slice":
        for key, right in (("data", "an entry of the config's data"), ("slice", "axis and plane: z200")):
            if key not in row:
                raise InputError(where, f"{key} is missing", right)
        for key in sorted(row.keys() - {"kind", "data", "slice", "porosity"}):
            raise InputError(where, f"{key} is given, which a slice takes from its volume", "leave it out")
        return
    if not row.get("image"):
        raise InputError(where, "image is missing", "the path of the section")
    for key in ("image", "grey", "reference"):
        if files and row.get(key):
            _check_path(row[key], key, where)
    if row.get("reference") and "reference_voxel_size_um" not in row:
        raise InputError(where, "reference_voxel_size_um is missing", "the edge of a voxel in micrometres")


def _check_path(path: str, key: str, where: str) -> None:
    """A file or a folder that is there; a pipe or a device would be waited for without end."""
    right = f"a path from {Path.cwd()}"
    try:
        found = Path(path)
        if not found.exists():
            raise InputError(where, f"{key} {path} does not exist", right)
        if not (found.is_file() or found.is_dir()):
            raise InputError(where, f"{key} {path} is neither a file nor a folder", right)
        if "{" in path or "}" in path:
            raise InputError(where, f"{key} {path} has a brace, which marks a wildcard", "rename the file")
    except InputError:
        raise
    except (OSError, ValueError):
        raise InputError(where, f"{key} {path!r} is no path"[:300], right) from None


def parse_phases(text: str | None) -> dict[str, int] | list[str] | None:
    """``"pore=0;quartz=1"`` as name to image value, ``"pore;quartz"`` as a list of names.

    Raises
    ------
    InputError
        When some names have a value and others have not, a value is no whole number, or a name stands there
        twice.
    """
    if not text:
        return None
    pairs = [[word.strip() for word in part.partition("=")] for part in text.split(";")]
    names = [name for name, _, _ in pairs]
    if len(set(names)) < len(names):
        raise InputError(f"phases '{text}'", "a name stands there twice", "unique names")
    if len({sign for _, sign, _ in pairs}) > 1:
        raise InputError(f"phases '{text}'", "some names have a value and some have not", "all or none")
    for name, sign, value in pairs:
        if sign and not re.fullmatch(r"-?[0-9]+", value, re.ASCII):
            wrong = f"the value of {name}, '{value}', is no whole number"
            raise InputError(f"phases '{text}'", wrong, "phases apart by ;, as pore=0;quartz=1")
    return {name: int(value) for name, _, value in pairs} if pairs[0][1] else names
