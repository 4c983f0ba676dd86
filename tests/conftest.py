"""Fixtures shared by all tests."""

import os
from pathlib import Path

# Workers are as many as cores: threads of BLAS would wait for each other and be counted as work.
for pool in ("OMP", "NUMBA", "OPENBLAS", "MKL"):
    os.environ.setdefault(f"{pool}_NUM_THREADS", "1")

import numpy as np
import pytest
import trimesh

from grainfall.config import load_yaml

ROOT = Path(__file__).resolve().parents[1]


def pytest_collection_modifyitems(items):
    """Which tests come first, and which one worker runs together.

    Runs of the whole workflow take minutes each: they start first, so that no core waits for the last. What
    the unit tests of a module share is made once where one worker runs them.
    """
    items.sort(key=lambda item: "workflow" not in item.path.parts)
    for item in items:
        if "unit" in item.path.parts:
            item.add_marker(pytest.mark.xdist_group(item.path.stem))


@pytest.fixture(scope="session")
def root() -> Path:
    """The repository's root."""
    return ROOT


@pytest.fixture(scope="session")
def schema(root) -> dict:
    """The JSON schema of the config."""
    return load_yaml(root / "workflow/schemas/config.schema.yaml")


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Reference measurements beside the checkout, which a user's clone does not have."""
    folder = ROOT.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("reference data (../shared/data) is not here")
    return folder


@pytest.fixture(scope="session")
def ell() -> tuple[np.ndarray, np.ndarray]:
    """Three unit cubes as a mesh: one on the floor, one on it, one beside that one, over nothing."""
    outline = np.array([[0, 0], [1, 0], [1, 1], [2, 1], [2, 2], [0, 2]], float)
    corners = np.vstack([np.column_stack([outline[:, 0], np.full(6, y), outline[:, 1]]) for y in (0, 1)])
    cap = [[0, 1, 2], [0, 2, 5], [2, 3, 4], [2, 4, 5]]
    sides = [t for i in range(6) for j in [(i + 1) % 6] for t in ([i, i + 6, j], [j, i + 6, j + 6])]
    faces = cap + [[c + 6, b + 6, a + 6] for a, b, c in cap] + sides
    mesh = trimesh.Trimesh(corners, faces, process=False)
    assert mesh.is_watertight
    if mesh.volume < 0:
        mesh.invert()
    assert mesh.volume == pytest.approx(3)
    return np.array(mesh.vertices), np.array(mesh.faces)
