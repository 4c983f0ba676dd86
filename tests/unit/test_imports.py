"""A job loads what it uses: of thousands of small ones, the start is most of the cost."""

import ast
import json
import os
import subprocess
import sys

import pytest

TABLES = ("plan", "provenance", "s2_slices", "scene", "summary", "sweep_table", "twin_provenance")
"""Scripts that only read and write tables and JSON."""
DRAWING = ("accuracy_figure", "paper_figures", "validation_page")
ON_DEMAND = {"coacd", "matplotlib", "openpnm", "plotly", "porespy", "pybullet", "pyvista", "sapien"}
"""What a setting or a rule calls for; loaded by the call."""
NUMERICAL = {"fcl", "networkx", "numba", "skimage", "trimesh"}
STATISTICS = {"scipy.stats"}
"""Half a second, for figures that test something."""


def loaded(root, scripts):
    """Modules that are loaded once the scripts' imports are done, all in one process."""
    lines = []
    for name in scripts:
        body = ast.parse((root / f"scripts/{name}.py").read_text()).body
        lines += [ast.unparse(node) for node in body if isinstance(node, ast.Import | ast.ImportFrom)]
    lines += ["import json, sys", "print(json.dumps(list(sys.modules)))"]
    path = os.pathsep.join(str(root / part) for part in ("src", "scripts"))
    done = subprocess.run(
        [sys.executable, "-c", "\n".join(lines)],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=True,
    )
    return set(json.loads(done.stdout))


@pytest.mark.parametrize(
    ("of", "without"),
    [
        ("tables", ON_DEMAND | NUMERICAL | STATISTICS),
        ("drawing", (ON_DEMAND | STATISTICS) - {"matplotlib"}),
        ("rest", ON_DEMAND),
    ],
)
def test_a_script_loads_what_its_job_uses(root, of, without):
    every = {path.stem for path in (root / "scripts").glob("[!_]*.py")}
    assert {*TABLES, *DRAWING} < every
    scripts = {"tables": TABLES, "drawing": DRAWING, "rest": sorted(every - {*DRAWING})}[of]
    assert loaded(root, scripts) & without == set()
