"""What two runs of one config have to agree in."""

import json

import pandas as pd

TIMED = ("summary.csv", "summary_row.csv", "flow.csv", "reference_flow.csv")
ASIDE = ("report.html", "metrics.csv", "provenance.json")
"""They tell of times, or of files that do."""


def timeless(content):
    """JSON without its seconds."""
    if isinstance(content, dict):
        seconds = {"wall_s", "cost_s", "saved_s"}
        return {key: timeless(value) for key, value in content.items() if key not in seconds}
    return [timeless(value) for value in content] if isinstance(content, list) else content


def outputs(folder):
    """Content of every file that must depend on the config alone, timing columns aside."""
    found = {}
    for path in sorted((folder / "results").rglob("*")):
        name = path.relative_to(folder).as_posix()
        aside = {"benchmarks", "logs", "figures"} & set(path.parts)
        if path.is_dir() or aside or path.name in ASIDE:
            continue
        content = path.read_bytes()
        if path.suffix == ".json":
            content = timeless(json.loads(content))
        if path.name in TIMED:
            content = pd.read_csv(path).drop(columns=["wall_s", "peak_rss_mb"], errors="ignore").to_csv()
        found[name] = content
    return found
