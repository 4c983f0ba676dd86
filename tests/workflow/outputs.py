"""What two runs of one config have to agree in."""

import json
from pathlib import Path

import pandas as pd
import zarr

TIMED = ("summary.csv", "summary_row.csv", "flow.csv", "reference_flow.csv")
ASIDE = ("report.html", "metrics.csv", "provenance.json")
"""They tell of times, or of files that do."""


def timeless(content):
    """JSON without its seconds."""
    if isinstance(content, dict):
        seconds = {"wall_s", "cost_s", "saved_s"}
        return {key: timeless(value) for key, value in content.items() if key not in seconds}
    return [timeless(value) for value in content] if isinstance(content, list) else content


def unchunked(path):
    """Bytes of a file; of a volume those of its arrays, whatever chunks they lie in."""
    if not path.name.endswith(".zarr.zip"):
        return path.read_bytes()
    group = zarr.open_group(zarr.storage.ZipStore(path, mode="r"), mode="r")
    return dict(group.attrs), {name: array[...].tobytes() for name, array in group.arrays()}


def outputs(folder, read=Path.read_bytes):
    """Content of every file that must depend on the config alone, timing columns aside."""
    found = {}
    for path in sorted((folder / "results").rglob("*")):
        name = path.relative_to(folder).as_posix()
        aside = {"benchmarks", "logs", "figures"} & set(path.parts)
        if path.is_dir() or aside or path.name in ASIDE:
            continue
        found[name] = read(path)
        if path.suffix == ".json":
            found[name] = timeless(json.loads(found[name]))
        if path.name in TIMED:
            found[name] = pd.read_csv(path).drop(columns=["wall_s", "peak_rss_mb"], errors="ignore").to_csv()
    return found
