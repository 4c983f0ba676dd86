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


def loaded(root, scripts):
    """Top-level modules that are loaded once the scripts' imports are done, all in one process."""
    lines = []
    for name in scripts:
        body = ast.parse((root / f"scripts/{name}.py").read_text()).body
        lines += [ast.unparse(node) for node in body if isinstance(node, ast.Import | ast.ImportFrom)]
    lines += ["import json, sys", "print(json.dumps([name.partition('.')[0] for name in sys.modules]))"]
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
    [("tables", ON_DEMAND | NUMERICAL | {"matplotlib"}), ("rest", ON_DEMAND | {"matplotlib"})],
)
def test_a_script_loads_what_its_job_uses(root, of, without):
    every = {path.stem for path in (root / "scripts").glob("[!_]*.py")}
    assert {*TABLES, *DRAWING} < every
    assert loaded(root, TABLES if of == "tables" else sorted(every - {*DRAWING})) & without == set()
