"""Non-convex shapes cut into convex pieces."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

import grainfall
from grainfall.grains import cut
from grainfall.grains.decomposition import MOST_PIECES, decompose, union_volume


def bumpy() -> tuple[np.ndarray, np.ndarray]:
    ball = trimesh.creation.icosphere(3)
    v = np.array(ball.vertices)
    lobes = 1 + 0.35 * np.cos(3 * np.arctan2(v[:, 1], v[:, 0])) * (1 - v[:, 2] ** 2)
    return v * lobes[:, None], np.array(ball.faces)


def test_pieces_of_an_l_are_its_two_boxes(ell):
    pieces, excess = cut(*ell)
    assert len(pieces) == 2
    for piece in pieces:  # each is a box: as large as its bounding box
        assert union_volume((piece,)) == pytest.approx(np.ptp(piece, axis=0).prod(), rel=1e-3)
    assert sorted(np.ptp(p, axis=0).prod() for p in pieces) == pytest.approx([1, 2], abs=1e-3)
    assert excess == pytest.approx(0, abs=0.01)


def test_pieces_take_the_place_of_most_of_the_excess():
    vertices, faces = bumpy()
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    pieces, excess = cut(vertices, faces)
    assert 2 <= len(pieces) <= MOST_PIECES
    assert 0 < excess < (mesh.convex_hull.volume / mesh.volume - 1) / 2


@pytest.mark.parametrize("grain", [trimesh.creation.box([1, 2, 3]), trimesh.creation.icosphere(2)])
def test_a_convex_shape_has_no_pieces(grain):
    pieces, excess = cut(np.array(grain.vertices), np.array(grain.faces))
    assert pieces == ()
    assert np.isnan(excess)


def test_an_open_mesh_is_not_cut(ell):
    vertices, faces = ell
    assert decompose(vertices, faces[1:]) == ()


def test_same_bytes_in_another_process_with_other_threads():
    program = f"""
import hashlib, sys
sys.path.insert(0, {str(Path(__file__).parent)!r})
from test_cut import bumpy
from grainfall.grains import cut
print(hashlib.md5(b"".join(p.tobytes() for p in cut(*bumpy())[0])).hexdigest())
"""
    found = set()
    for threads in ("1", "2"):
        environment = {
            **os.environ,
            "PYTHONPATH": str(Path(grainfall.__file__).parents[1]),
            "OMP_NUM_THREADS": threads,
        }
        done = subprocess.run(
            [sys.executable, "-c", program], env=environment, capture_output=True, text=True
        )
        assert len(done.stdout.split()) == 1, done.stderr
        found.add(done.stdout)
    assert len(found) == 1


def test_what_two_pieces_share_counts_once():
    box = np.array(trimesh.creation.box([2, 2, 2]).vertices)
    up = np.array([0.0, 0.0, 1.0])
    assert union_volume((box, box + 0.5 * up)) == pytest.approx(2 * 2 * 2.5, rel=1e-3)
    assert union_volume((box, box + 5 * up)) == pytest.approx(16, rel=1e-3)
    assert union_volume((box, 0.5 * box)) == pytest.approx(8, rel=1e-3)
