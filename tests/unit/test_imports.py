"""A job loads what it uses: of thousands of small ones, the start is most of the cost."""

import ast
import importlib
import inspect
import json
import os
import re
import subprocess
import sys

import grimp
import pytest

TABLES = ("plan", "provenance", "s2_slices", "scene", "summary", "sweep_table", "twin_provenance")
"""Scripts that only read and write tables and JSON."""
DRAWING = ("accuracy_figure", "paper_figures", "validation_page")
ON_DEMAND = {"coacd", "matplotlib", "openpnm", "plotly", "porespy", "pybullet", "pyvista", "sapien"}
"""What a setting or a rule calls for; loaded by the call."""
NUMERICAL = {"fcl", "networkx", "numba", "skimage", "trimesh"}
SHARED = {f"grainfall.{name}" for name in ("errors", "io", "random", "units")}
"""Of every job's science."""
TO_ITS_LOG = {"metrics": {"grainfall.report.judgement"}}
"""What a script says to its log by, and no file."""
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


def rules_with_scripts(root):
    """Script and chapters of every rule that names its science."""
    for path in sorted((root / "workflow/rules").glob("*.smk")):
        for rule in re.split(r"^ *(?:use )?rule ", path.read_text(), flags=re.MULTILINE)[1:]:
            chapters = re.search(r"science=science\((.*?)\)", rule, re.DOTALL)
            script = re.search(r'"\.\./\.\./scripts/(\w+)\.py"', rule)
            if chapters and script:
                yield path.stem, script[1], tuple(re.findall(r'"([\w.]+)"', chapters[1]))


def called_by(path):
    """Modules of ours that hold what a script uses by name: `io.read_json` is of `grainfall.io`."""
    tree = ast.parse(path.read_text())
    names = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module.partition(".")[0] == "grainfall":
            whence = importlib.import_module(node.module)
            for alias in node.names:
                found = getattr(whence, alias.name, None)
                if found is None:
                    found = importlib.import_module(f"{node.module}.{alias.name}")
                names[alias.asname or alias.name] = found
    found = [thing for thing in names.values() if not inspect.ismodule(thing)]
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            owner = names.get(node.value.id)
            if inspect.ismodule(owner):
                found.append(getattr(owner, node.attr))
    modules = {getattr(inspect.unwrap(thing), "__module__", None) for thing in found}
    return {module for module in modules if str(module).startswith("grainfall.")}


def test_an_edit_of_what_a_script_calls_reruns_its_jobs(root):
    """Each rule's science holds every module of ours that its script calls."""
    graph = grimp.build_graph("grainfall", cache_dir=None)
    found = list(rules_with_scripts(root))
    assert len(found) > 30
    missed = {}
    for where, script, chapters in found:
        known = set(SHARED)
        for chapter in (f"grainfall.{name}" for name in chapters):
            known |= {chapter, *graph.find_descendants(chapter)}
            known |= graph.find_upstream_modules(chapter, as_package=True)
        if left := called_by(root / f"scripts/{script}.py") - known - TO_ITS_LOG.get(script, set()):
            missed[where, script] = sorted(left)
    assert missed == {}
