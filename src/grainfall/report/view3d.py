"""The 3D view that can be turned: surfaces of the minerals and the pore network, as plain plotly data.

Numbers travel as base64 of 16-bit integers in voxels of a coarse grid, so that a page stays small.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence

import numpy as np
import skimage  # its parts load when they are first used

from grainfall.io import CHUNK, Volume
from grainfall.report.figures import PORE_CIRCLE, mineral_colour
from grainfall.report.metrics import plane_counts

TRIANGLES = 160_000
"""Most triangles of one view; the grid is coarsened until they fit."""
STEPS = 64
"""Positions are kept to 1/64 of a coarse voxel."""
NETWORK_COLOUR = "#6E6E6E"


def view_data(
    phase: np.ndarray | Volume,
    voxel_size_um: float,
    phases: Sequence[str] = (),
    network: Mapping[str, np.ndarray] | None = None,
    edge: int = 72,
) -> dict:
    """Traces and layout of the view.

    Parameters
    ----------
    phase : ndarray of uint8, (z, y, x), or Volume
        0 pore, 1…M minerals; an open volume file is read a few planes at a time.
    voxel_size_um : float
    phases : sequence of str
        Names; index 0 is the pore.
    network : mapping, optional
        Pore network as :func:`grainfall.network.load` gives it (µm).
    edge : int
        Longest edge of the coarse grid at the start.

    Returns
    -------
    dict
        ``traces`` (plotly), ``groups`` (trace group → name on its button), ``layout``; JSON throughout.
    """
    minerals = [int(i) for i in np.flatnonzero(plane_counts(phase).sum(axis=0)) if i]
    while True:
        factor = max(1, -(-max(phase.shape) // edge))
        meshes = [(i, *_surface(share)) for i, share in _shares(phase, minerals, factor).items()]
        if sum(len(f) for _, _, f in meshes) <= TRIANGLES or edge <= 12:
            break
        edge = int(0.85 * edge)
    scale = factor * voxel_size_um
    traces, groups = [], {}
    for i, vertices, faces in meshes:
        name = phases[i] if i < len(phases) else f"mineral {i}"
        groups[f"mineral {i}"] = name
        traces.append(_mesh(vertices, faces, scale, mineral_colour(i, phases), name, f"mineral {i}"))
    balls = _network(network)
    if balls:
        groups["network"] = "pore network"
        traces += balls
    nz, ny, nx = (n * voxel_size_um for n in phase.shape)
    longest = max(nz, ny, nx)
    axis = {"showbackground": False, "gridcolor": "#DDDDDD", "zeroline": False, "linecolor": "#444444"}
    layout = {
        "margin": {"l": 0, "r": 0, "t": 0, "b": 0},
        "showlegend": False,
        "paper_bgcolor": "#FFFFFF",
        "uirevision": "keep",
        "scene": {
            "xaxis": {**axis, "title": {"text": "x (µm)"}, "range": [0, nx]},
            "yaxis": {**axis, "title": {"text": "y (µm)"}, "range": [0, ny]},
            "zaxis": {**axis, "title": {"text": "z, up (µm)"}, "range": [0, nz]},
            "aspectmode": "manual",
            "aspectratio": {"x": nx / longest, "y": ny / longest, "z": nz / longest},
            "camera": {"eye": {"x": 1.6, "y": -1.6, "z": 1.05}},
        },
    }
    return {"traces": traces, "groups": groups, "layout": layout}


def _shares(phase: np.ndarray | Volume, minerals: Sequence[int], factor: int) -> dict[int, np.ndarray]:
    """Share of each mineral in blocks of so many voxels an edge; what is beyond the volume counts as pore."""
    blocks = [-(-n // factor) for n in phase.shape]
    beyond = [(0, b * factor - n) for b, n in zip(blocks, phase.shape, strict=True)]
    shares = {i: np.empty(blocks, np.float32) for i in minerals}
    layers = max(1, CHUNK // factor)  # as many planes as a file unpacks at once
    for first in range(0, blocks[0], layers):
        planes = phase[first * factor : (first + layers) * factor]
        for layer in range(-(-len(planes) // factor)):
            block = planes[layer * factor : (layer + 1) * factor]
            block = np.pad(block, [(0, factor - len(block)), *beyond[1:]])
            block = block.reshape(factor, blocks[1], factor, blocks[2], factor)
            for i, share in shares.items():
                share[first + layer] = (block == i).mean((0, 2, 4))
    return shares


def _surface(share: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Closed surface of a mineral: vertices (n, 3) x, y, z in coarse voxels; faces."""
    blocks = share.shape
    share = np.pad(share, 1)  # empty rim: the cut faces of the box close
    if not (share > 0.5).any():
        return np.zeros((0, 3)), np.zeros((0, 3), int)
    vertices, faces, _, _ = skimage.measure.marching_cubes(share, 0.5)
    inside = np.clip(vertices - 0.5, 0, blocks)  # rim voxel centre → corner of the volume
    return inside[:, ::-1], faces[:, ::-1]


def _packed(values: np.ndarray, kind: str) -> dict:
    array = np.ascontiguousarray(values).astype(np.dtype(kind).newbyteorder("<"))
    return {"dtype": array.dtype.str[1:], "bdata": base64.b64encode(array.tobytes()).decode()}


def _mesh(vertices, faces, scale: float, colour: str, name: str, group: str) -> dict:
    index = "u2" if len(vertices) < 2**16 else "u4"
    coordinates = np.rint(vertices * STEPS)
    return {
        "type": "mesh3d",
        # the page multiplies by `step` once: positions arrive as integers
        "step": scale / STEPS,
        **{a: _packed(coordinates[:, n], "u2") for n, a in enumerate("xyz")},
        **{a: _packed(faces[:, n], index) for n, a in enumerate("ijk")},
        "color": colour,
        "name": name,
        "group": group,
        "hoverinfo": "name",
        "flatshading": False,
        "lighting": {"ambient": 0.55, "diffuse": 0.75, "specular": 0.12, "roughness": 0.8},
        "lightposition": {"x": 2000, "y": -4000, "z": 6000},
    }


def _network(network: Mapping[str, np.ndarray] | None) -> list[dict]:
    """Pores as balls and throats as sticks."""
    if network is None or len(network["pore.coords"]) == 0:
        return []
    xyz, ends = network["pore.coords"], network["throat.conns"]
    inside = ~network["pore.boundary"]
    radius = network["pore.inscribed_diameter"][inside] / 2
    # three points a stick: its ends and a gap
    sticks = np.full((len(ends), 3, 3), np.nan)
    sticks[:, :2] = xyz[ends]
    sticks = sticks.reshape(-1, 3)
    size = np.clip(9 * radius / np.quantile(radius, 0.9), 3, 14) if len(radius) else radius
    return [
        {
            "type": "scatter3d",
            "mode": "lines",
            **{a: _packed(sticks[:, n], "f4") for n, a in enumerate("xyz")},
            "line": {"color": NETWORK_COLOUR, "width": 1.5},
            "name": "throats",
            "group": "network",
            "hoverinfo": "skip",
        },
        {
            "type": "scatter3d",
            "mode": "markers",
            **{a: _packed(xyz[inside, n], "f4") for n, a in enumerate("xyz")},
            "marker": {
                "color": PORE_CIRCLE,
                "opacity": 1,
                "line": {"color": "#7A2E58", "width": 1},
                "size": [round(float(s), 1) for s in size],
            },
            "text": [f"radius {r:.3g} µm" for r in radius],
            "name": "pores",
            "group": "network",
            "hoverinfo": "text",
        },
    ]
