"""Networks in the files and objects of other programs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from grainfall.errors import InputError
from grainfall.io import atomic_path, read_table, write_table, write_text
from grainfall.network.elements import LENGTH_POWER, Network, conduit_lengths


def to_openpnm(network: Network) -> object:
    """The network as an ``openpnm.network.Network``, in metres.

    ``pore.diameter``, ``throat.diameter`` and ``throat.spacing`` are set as OpenPNM's example of an extracted
    network sets them: equivalent sphere, inscribed sphere, length through the throat.
    """
    import openpnm

    arrays = {k: v * 1e-6 ** LENGTH_POWER.get(k, 0) if k in LENGTH_POWER else v for k, v in network.items()}
    pn = openpnm.network.Network(coords=arrays.pop("pore.coords"), conns=arrays.pop("throat.conns"))
    # OpenPNM would otherwise replace the lengths measured through the throats by straight ones.
    pn.models.clear()
    pn.update(arrays)
    pn["pore.diameter"] = pn["pore.equivalent_diameter"]
    pn["throat.diameter"] = pn["throat.inscribed_diameter"]
    pn["throat.spacing"] = pn["throat.total_length"]
    return pn


def save_openpnm(network: Network, path: str | Path) -> None:
    """Write a network as the one CSV that ``openpnm.io.network_from_csv`` reads, in metres.

    Throats from a pore to itself carry nothing, and OpenPNM's models refuse them: they are left out.
    """
    import openpnm

    linking = network["throat.conns"][:, 0] != network["throat.conns"][:, 1]
    network = {name: v[linking] if name.startswith("throat.") else v for name, v in network.items()}

    with atomic_path(path) as part:
        tables = openpnm.io.network_to_pandas(to_openpnm(network), join=False)
        # side by side: network_to_csv drops the pores that outnumber the throats
        pd.concat([tables["throat"], tables["pore"]], axis=1).to_csv(part, index=False)


def save(network: Network, pores_csv: str | Path, throats_csv: str | Path) -> None:
    """Write a network as two tables (``network_pores.csv``, ``network_throats.csv``).

    Columns carry OpenPNM's names; a vector's components are ``pore.coords[0]``, ``[1]``, ``[2]``, as OpenPNM
    writes them. Units: um, um2, um3. Equal networks give equal bytes.
    """
    for kind, path in (("pore", pores_csv), ("throat", throats_csv)):
        columns: dict[str, np.ndarray] = {}
        names = [k for k in network if k.startswith(f"{kind}.")]
        for name in sorted(names, key=lambda k: (k not in ("pore.coords", "throat.conns"), k)):
            values = network[name]
            if values.ndim == 1:
                columns[name] = values
            else:
                columns |= {f"{name}[{i}]": values[:, i] for i in range(values.shape[1])}
        write_table(path, pd.DataFrame(columns))


def load(pores_csv: str | Path, throats_csv: str | Path) -> Network:
    """Read a network that :func:`save` wrote.

    Raises
    ------
    InputError
        When a table lacks coordinates or connections.
    """
    network: Network = {}
    for path, kind, needed in ((pores_csv, "pore", "pore.coords"), (throats_csv, "throat", "throat.conns")):
        table = read_table(path)
        vectors: dict[str, list[str]] = {}
        for column in table.columns:
            vectors.setdefault(column.split("[")[0], []).append(column)
        if needed not in vectors:
            raise InputError(
                path, f"no column {needed}[0]", f"a table of {kind}s written by grainfall is needed"
            )
        for name, columns in vectors.items():
            values = table[columns].to_numpy() if len(columns) > 1 else table[columns[0]].to_numpy()
            is_label = name not in LENGTH_POWER and name != "throat.conns"
            dtype = np.int64 if name == "throat.conns" else bool if is_label else float
            network[name] = values.astype(dtype)
    return network


def save_vtp(network: Network, path: str | Path) -> None:
    """Write a network as VTK polydata (.vtp): points are pores, lines are throats, um.

    Properties are point and cell data under their OpenPNM names.
    """
    import pyvista

    conns = network["throat.conns"]
    mesh = pyvista.PolyData()
    mesh.points = network["pore.coords"]
    mesh.lines = np.concatenate([np.full((len(conns), 1), 2), conns], axis=1).ravel()
    for name, values in network.items():
        if name in ("pore.coords", "throat.conns") or len(values) == 0:
            continue
        data = mesh.point_data if name.startswith("pore.") else mesh.cell_data
        data[name] = values.astype(np.uint8) if values.dtype == bool else values
    with atomic_path(path) as part:
        # PyVista tells the format by the suffix.
        named = part.with_suffix(".vtp")
        try:
            mesh.save(str(named))
            named.replace(part)
        finally:
            named.unlink(missing_ok=True)


def save_statoil(network: Network, prefix: str | Path, size_um: tuple[float, float, float]) -> None:
    """Write a network as the four Statoil files that pnflow reads (``prefix_link1.dat`` ...), in metres.

    Flow is along x: throats to boundary pores on xmin become links to the inlet (-1), on xmax to the outlet
    (0); boundary pores of the other faces are left out, as are throats from a pore to itself, which carry no
    flow. Lengths of pores and throats are those of :func:`conduit_lengths`. The whole volume is in the pores.

    Parameters
    ----------
    network : dict
    prefix : path
        Of the files.
    size_um : 3-tuple of float
        Edges of the volume along x, y, z in micrometres.
    """
    metre = 1e-6
    inner = ~network["pore.boundary"]
    number = np.cumsum(inner)
    number[network["pore.xmin"]], number[network["pore.xmax"]] = -1, 0
    conns = network["throat.conns"]
    known = inner | network["pore.xmin"] | network["pore.xmax"]
    keep = known[conns].all(axis=1) & (conns[:, 0] != conns[:, 1])
    conns = conns[keep]
    ends = number[conns]
    radius = network["pore.inscribed_diameter"] / 2 * metre
    throat_radius = network["throat.inscribed_diameter"][keep] / 2 * metre
    lengths = conduit_lengths(network)[keep] * metre
    links = np.arange(1, len(conns) + 1)
    shape = network["throat.shape_factor"][keep]
    first = zip(links, *ends.T, throat_radius, shape, lengths.sum(axis=1), strict=True)
    second = zip(links, *ends.T, *lengths[:, [0, 2, 1]].T, strict=True)
    write_text(f"{prefix}_link1.dat", f"{len(links)}\n" + "".join(_line(*row) for row in first))
    write_text(f"{prefix}_link2.dat", "".join(_line(*row, 0, 0) for row in second))

    pores = np.flatnonzero(inner)
    neighbours: list[list[int]] = [[] for _ in range(len(inner))]
    throats: list[list[int]] = [[] for _ in range(len(inner))]
    for link, (a, b), (i, j) in zip(links, conns, ends, strict=True):
        neighbours[a].append(j)
        neighbours[b].append(i)
        throats[a].append(link)
        throats[b].append(link)
    lines = [_line(len(pores), *(float(s) * metre for s in size_um))]
    for p in pores:
        near = neighbours[p]
        faces = (int(-1 in near), int(0 in near))
        place = network["pore.coords"][p] * metre
        lines.append(_line(number[p], *place, len(near), *near, *faces, *throats[p]))
    write_text(f"{prefix}_node1.dat", "".join(lines))
    volume, g = network["pore.volume"] * metre**3, network["pore.shape_factor"]
    write_text(f"{prefix}_node2.dat", "".join(_line(number[p], volume[p], radius[p], g[p], 0) for p in pores))


def _line(*values: float) -> str:
    return " ".join(f"{v:.6e}" if isinstance(v, float) else str(v) for v in values) + "\n"
