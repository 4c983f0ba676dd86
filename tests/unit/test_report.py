"""The report on a small results tree made here: what it says, and that it holds when files are missing."""

import html.parser
import itertools
import re
import runpy
import shutil
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from grainfall import grains, io, network
from grainfall.packing import rest, stages
from grainfall.report import (
    METRICS,
    SUMMARY_COLUMNS,
    bodies_within,
    build_report,
    envelope_values,
    figure_files,
    figures,
    flow_values,
    intervals,
    judge,
    judgement,
    metrics_table,
    network_values,
    packing_values,
    paired_differences,
    phase_values,
    read_costs,
    resettling_values,
    sampling_values,
    save_figure,
    section_comparison,
    summary_row,
    surface_values,
    sweep_table,
    verdict,
    view3d,
)
from grainfall.report.html import Results, _permeability, data_uri, drawn_grains, shown_uri
from grainfall.report.judgement import headline
from grainfall.report.numbers import number
from grainfall.surface import SolidSurface, sampling_errors
from grainfall.volume import as_minerals, correction

PIXEL = 2.0
PHASES = ["pore", "quartz", "feldspar <b>"]


def balls(shape, count, rng, radius=(5, 9)):
    """Grains as labelled balls (or discs) at random places, later ones on top, and their phases."""
    grid = np.indices(shape)
    labels = np.zeros(shape, np.int32)
    for n in range(1, count + 1):
        centre = [rng.uniform(0, s) for s in shape]
        r = rng.uniform(*radius)
        labels[sum((g - c) ** 2 for g, c in zip(grid, centre, strict=True)) < r * r] = n
    phase = np.where(labels > 0, 1 + labels % 2, 0).astype(np.uint8)
    return labels, phase


def grain_table(rng, n, mean):
    r = rng.lognormal(np.log(mean), 0.25, n)
    return pd.DataFrame(
        {
            "grain": np.arange(1, n + 1),
            "phase": 1 + np.arange(1, n + 1) % 2,
            "y_um": rng.uniform(0, 150, n),
            "x_um": rng.uniform(0, 180, n),
            "area_um2": np.pi * r**2,
            "r_um": r,
            "border": rng.uniform(size=n) < 0.2,
            "aspect_ratio": rng.uniform(1, 2, n),
            "circularity": rng.uniform(0.7, 1, n),
            "solidity": rng.uniform(0.8, 1, n),
        }
    ).assign(weight=lambda t: np.where(t["border"], 0.0, 1.0))


def histogram(kind, phase, mean, rng):
    edges = np.linspace(0, 3 * mean, 13)
    mid = (edges[1:] + edges[:-1]) / 2
    f = np.exp(-(((mid - mean) / (0.4 * mean)) ** 2))
    f /= (f * np.diff(edges)).sum()
    g = f * rng.uniform(0.8, 1.2, len(f))
    g /= (g * np.diff(edges)).sum()
    return pd.DataFrame(
        {"phase": phase, "kind": kind, "r_lo_um": edges[:-1], "r_hi_um": edges[1:], "f2d": g, "f3d": f,
         "lower": 0.7 * f, "upper": 1.3 * f}
    )  # fmt: skip


def make_sample(root: Path, name="demo", variants=("full", "bullet"), realizations=2, reference=True):
    """A results tree of one sample as the workflow leaves it, small."""
    rng = np.random.default_rng(5)
    sample = root / name
    labels, phase = balls((75, 90), 30, rng)
    io.write_volume(sample / "section.zarr.zip", {"phase": phase}, PIXEL, {"phases": PHASES})
    io.write_volume(sample / "labels.zarr.zip", {"grains": labels, "pores": labels, "phase": phase}, PIXEL)
    io.write_table(sample / "grains2d.csv", grain_table(rng, 30, 12))
    pores = grain_table(rng, 25, 5).rename(columns={"grain": "pore"})
    io.write_table(sample / "pores2d.csv", pores)
    io.write_json(
        sample / "section.json",
        {
            "porosity": float((phase == 0).mean()),
            "n_grains": 30,
            "phases": PHASES,
            "notes": {"thresholds": [17, 91]},
        },
    )
    ball, faces = grains.sphere()
    masks = np.unique(labels)[1:]
    shapes = pd.DataFrame(
        {"shape": range(4), "phase": [1, 1, 2, 2], "r2d_um": [8.0, 12.0, 9.0, 14.0],
         **{f"mask_{plane}": masks[k : k + 4] for k, plane in enumerate(("xy", "xz", "yz"))}}
    )  # fmt: skip
    grains.Library([ball] * 4, [faces] * 4, shapes).save(sample / "grains3d")
    sizes = [histogram("grain", 1, 12, rng), histogram("grain", 2, 14, rng), histogram("pore", 0, 6, rng)]
    io.write_table(sample / "sizes.csv", pd.concat(sizes))
    (sample / "benchmarks").mkdir()
    costs = "s\th:m:s\tmax_rss\tcpu_time\n{}\t0:00:02\t{}\t1.5\n"
    (sample / "benchmarks" / "morphology.tsv").write_text(costs.format(2.5, 120))
    flow = pd.DataFrame(
        {"method": "network", "axis": list("xyz"), "k_md": [1200.0, 1100.0, 0.0],
         "formation_factor": [5.0, 6.0, np.nan], "wall_s": 1.0}
    )  # fmt: skip
    lags = np.arange(0, 60, 2.0)
    if reference:
        io.write_volume(sample / "reference.zarr.zip", {"phase": balls((20, 20, 20), 9, rng)[1]}, PIXEL)
        network.save(
            small_network(rng),
            sample / "reference_network_pores.csv",
            sample / "reference_network_throats.csv",
        )
        io.write_table(sample / "truth_sizes.csv", pd.DataFrame({"phase": 1, "r_um": rng.normal(12, 2, 80)}))
        io.write_table(sample / "reference_flow.csv", flow.assign(k_md=[1190.0, 1000.0, 900.0]))
        io.write_table(
            sample / "reference_s2.csv",
            pd.DataFrame({"axis": "x", "lag_um": lags, "s2": 0.36 + 0.24 * np.exp(-lags / 9)}),
        )
    rows = []
    for variant in variants:
        curve = 0.36 + 0.24 * np.exp(-lags / 10)
        io.write_table(
            sample / variant / "s2_envelope.csv",
            pd.DataFrame({"lag_um": lags, "observed": curve, "lower": curve - 0.04, "upper": curve + 0.04,
                          "mean": curve, "section": curve + 0.01}),
        )  # fmt: skip
        test = {"p": 0.23, "n_slices": 199, "n_windows": 9, "windows_rejected": 1 / 9}
        io.write_json(sample / variant / "s2_envelope.json", test)
        scene = {"edge_um": 80.0, "mean_diameter_um": 25.0, "voxel_size_um": PIXEL}
        io.write_json(sample / variant / "scene.json", scene)
        for realization in range(realizations):
            twin = sample / variant / str(realization)
            body, volume = balls((40, 44, 48), 40, rng, (5, 8))
            attributes = {"phases": PHASES, "seed": 1}
            io.write_volume(twin / "twin.zarr.zip", {"phase": volume, "body": body}, PIXEL, attributes)
            io.write_volume(twin / "first" / "volume.zarr.zip", {"phase": volume}, PIXEL)
            spheres = np.where((volume > 0) & (body % 5 == 0), 255, volume).astype(np.uint8)
            io.write_volume(twin / "second" / "volume.zarr.zip", {"phase": spheres}, PIXEL)
            io.write_json(twin / "first" / "packing.json", {"steps": 900, "unit_um": 12.5})
            io.write_json(twin / "second" / "packing.json", {"steps": 1200, "p_sp": 0.12, "passes": []})
            io.write_json(twin / "cement.json", {"room": 1.0, "compaction": {"factor": 1.0}})
            io.write_json(
                twin / "plan.json",
                {"virtual_spheres": {"on": True, "forced": False, "reason": "porosity 0.36 < 0.40",
                                     "cost_s": 12.0, "saved_s": None},
                 "cement": {"on": False, "forced": True, "reason": "gap 0.06 > 0.01",
                            "cost_s": None, "saved_s": 3.5}},
            )  # fmt: skip
            spheres_table = histogram("pore", 0, 6, rng)
            io.write_table(
                twin / "virtual_spheres.csv",
                spheres_table[["r_lo_um", "r_hi_um"]].assign(
                    target=spheres_table["f3d"], first=spheres_table["f2d"],
                    difference=lambda t: t["target"] - t["first"],
                    used=lambda t: t["difference"].clip(lower=0)),
            )  # fmt: skip
            io.write_table(
                twin / "bodies.csv",
                pd.DataFrame({"id": range(40), "kind": "grain", "phase": [1, 2] * 20,
                              "scale": rng.normal(13, 2, 40), "x": rng.uniform(-20, 110, 40),
                              "y": rng.uniform(0, 80, 40), "z": rng.uniform(0, 80, 40)}),
            )  # fmt: skip
            pairs = pd.DataFrame({"grain_a": range(39), "grain_b": range(1, 40)})
            middle = {"x": rng.uniform(0, 80, 39), "y": 40.0, "z": rng.uniform(0, 80, 39)}
            force = rng.exponential(1e-6, 39) * (np.arange(39) % 5 > 0)
            io.write_table(twin / "contacts.csv", pairs.assign(**middle, force_n=force))
            seen, twin_pores = (
                grain_table(rng, 60, 12.5),
                grain_table(rng, 60, 5).rename(columns={"grain": "pore"}),
            )
            io.write_table(twin / "grains2d.csv", seen)
            io.write_table(twin / "pores2d.csv", twin_pores)
            slices = [
                pd.DataFrame(
                    {"slice": i, "axis": "xyz"[i % 3], "lag_um": lags, "s2": curve + rng.normal(0, 0.02)}
                )
                for i in range(20)
            ]
            io.write_table(twin / "s2_slices.csv", pd.concat(slices))
            ours = flow.assign(k_md=flow["k_md"] * rng.uniform(0.9, 1.1))
            io.write_table(twin / "flow.csv", ours)
            network.save(small_network(rng), twin / "network_pores.csv", twin / "network_throats.csv")
            benchmarks = twin / "benchmarks"
            benchmarks.mkdir()
            for part in ("1-of-2", "2-of-2"):
                (benchmarks / f"s2_slices_{part}.tsv").write_text(costs.format(1.25, 200))
            reference_flow = io.read_table(sample / "reference_flow.csv") if reference else None
            metrics = metrics_table(
                {
                    "porosity": 0.371 + 0.001 * realization,
                    "porosity_target": 0.309,
                    "porosity_first": 0.36,
                    "n_grains": 40,
                    "s2_inside_envelope": 1.0,
                    "s2_envelope_p": 0.23,
                    "max_overlap": 0.001,
                    "coordination": None,
                    **section_comparison(
                        io.read_table(sample / "grains2d.csv"), pores, seen, twin_pores,
                        np.random.default_rng(1), repeats=20,
                    ),
                    **phase_values(volume, phase),
                    **flow_values(ours, reference_flow),
                    **({"w1_network_pores_um": 0.5} if reference else {}),
                }
            )  # fmt: skip
            io.write_table(twin / "metrics.csv", metrics)
            engine = "bullet" if variant == "bullet" else "physx"
            rows.append(
                summary_row(name, variant, realization, engine, volume.shape, PIXEL, metrics, "network")
            )
    io.write_table(root / "summary.csv", pd.concat(rows))
    return root


def small_network(rng, pores=30):
    """Pores on a line, each linked to the next; the first and last lie beyond the faces."""
    ends = np.arange(pores) % (pores - 1) == 0
    return {
        "pore.coords": rng.uniform(0, 80, (pores, 3)),
        "pore.boundary": ends,
        "pore.inscribed_diameter": rng.uniform(2, 9, pores),
        "pore.extended_diameter": rng.uniform(2, 9, pores),
        "pore.volume": rng.uniform(8, 700, pores),
        "throat.conns": np.stack([np.arange(pores - 1), np.arange(1, pores)], axis=1),
        "throat.inscribed_diameter": rng.uniform(1, 4, pores - 1),
    }


class Page(html.parser.HTMLParser):
    """Checks nesting while it gathers attributes, headings and text."""

    VOID = frozenset({"meta", "br", "img", "link", "input", "hr"})

    def __init__(self, text):
        super().__init__()
        self.stack, self.attributes, self.headings, self.words, self.faults = [], [], [], [], []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.attributes += [(tag, k, v or "") for k, v in attrs]
        if tag not in self.VOID:
            self.stack.append(tag)
        if re.fullmatch("h[1-6]", tag):
            self.headings.append(int(tag[1]))

    def handle_endtag(self, tag):
        if not self.stack or self.stack.pop() != tag:
            self.faults.append(tag)

    def handle_data(self, data):
        if self.stack and self.stack[-1] not in ("script", "style"):
            self.words.append(data)

    @property
    def text(self):
        return " ".join(" ".join(self.words).split())


@pytest.fixture(scope="module")
def tree(tmp_path_factory):
    return make_sample(tmp_path_factory.mktemp("results"))


@pytest.fixture(scope="module")
def page(tree):
    out = tree / "report.html"
    build_report(tree, ["demo"], out, "Twins of a demo")
    return out.read_text(encoding="utf-8")


@pytest.mark.parametrize("name", ["sizes", "virtual"])
def test_a_figure_that_lies_there_is_taken_as_it_is(tree, tmp_path, name):
    root = shutil.copytree(tree, tmp_path / "results")
    file = figure_files(root, "demo", "full", 0)[name]
    saved = root / "demo/full/0/figures" / f"{name}.svg"
    saved.parent.mkdir(exist_ok=True)
    file.save(saved)
    pages = []
    for drawn in (False, True):
        build_report(root, ["demo"], root / "report.html", variants=["full"], drawn=drawn)
        pages.append(html.unescape((root / "report.html").read_text(encoding="utf-8")))
    image = data_uri(saved)
    assert image in pages[0]
    assert image in pages[1]
    assert len(pages[1]) < len(pages[0])  # others are not there


def test_a_sentence_in_place_of_a_figure_is_no_image(tmp_path):
    assert shown_uri(tmp_path / "none.svg") is None
    save_figure(figures.note_figure("nothing"), tmp_path / "note.svg")
    assert shown_uri(tmp_path / "note.svg") is None


def test_the_report_judges_by_the_limits_that_the_method_keeps():
    assert judgement.POROSITY_TOLERANCE == correction.TOLERANCE
    assert METRICS["packing_overlap"].high == stages.MOST_OVERLAP
    assert METRICS["drift"].high == rest.AT_REST


# ---- the page


def test_page_is_well_formed_and_accessible(page):
    parsed = Page(page)
    assert not parsed.faults
    assert not parsed.stack
    assert parsed.headings[0] == 1
    assert parsed.headings.count(1) == 1
    assert all(b - a <= 1 for a, b in zip(parsed.headings, parsed.headings[1:], strict=False))
    assert ("html", "lang", "en") in parsed.attributes
    images = [v for t, k, v in parsed.attributes if (t, k) == ("img", "alt")]
    assert len(images) == sum(t == "img" and k == "src" for t, k, _ in parsed.attributes) > 5
    assert all(len(v) > 20 for v in images)
    assert page.count("<th ") == sum(t == "th" and k == "scope" for t, k, _ in parsed.attributes)
    identities = [v for _, k, v in parsed.attributes if k == "id"]
    assert len(identities) == len(set(identities))
    anchors = [v[1:] for t, k, v in parsed.attributes if (t, k) == ("a", "href")]
    assert set(anchors) <= set(identities)


def test_page_asks_nothing_of_the_network(page):
    for _, key, value in Page(page).attributes:
        if key in ("src", "href", "srcset", "action", "data", "poster"):
            assert value.startswith(("data:", "#"))
    style = page[page.index("<style>") : page.index("</style>")]
    assert "url(" not in style
    assert "@import" not in style
    assert "default-src 'none'" in page
    assert page.count("plotly.js v") == 1


def test_page_stays_small(page):
    assert len(page.encode()) < 15e6


def test_page_says_every_metric_and_what_missed(page, tree):
    text = Page(page).text
    for name in io.read_table(tree / "demo/full/0/metrics.csv")["metric"]:
        if not name.endswith("_target") and not name.startswith("k_ref_"):
            assert name in text
    assert "porosity 0.371 misses 0.309 by 0.062: the plan says what kept" in text
    assert "nothing flows through the twin" in text
    assert "(missed by 2 of 2; figures of realization 0)" in text
    assert "full changes nothing" in text
    assert "(range)" in text
    assert "porosity 0.36 < 0.40" in text
    assert "s2_slices" in text
    assert "12.5 µm, so that a grain is of order 1" in text
    assert "Thresholds 17, 91" in text


def test_page_has_the_same_bytes_twice(page, tree):
    again = tree / "again.html"
    build_report(tree, ["demo"], again, "Twins of a demo")
    assert again.read_text(encoding="utf-8") == page


@pytest.mark.parametrize(
    "hostile",
    ["<script>alert(1)</script>", "\"><img src=x onerror='alert(1)'>", "</script><b>", "{{ 7 * 7 }}", "a&b"],
)
def test_nothing_reaches_the_page_unescaped(tmp_path, hostile):
    root = tmp_path
    folder = hostile.replace("/", "\u2215")
    io.write_table(root / folder / "full" / "0" / "metrics.csv", metrics_table({"porosity": 0.3}))
    io.write_json(
        root / folder / "full" / "0" / "plan.json", {hostile: {"on": True, "reason": hostile, "cost_s": 1}}
    )
    io.write_json(root / folder / "section.json", {"phases": ["pore", hostile], "notes": {hostile: hostile}})
    build_report(root, [folder], root / "report.html", hostile)
    page = (root / "report.html").read_text(encoding="utf-8")
    parsed = Page(page)
    assert not parsed.faults
    assert not parsed.stack
    assert not any(k.startswith("on") for _, k, _ in parsed.attributes)
    assert sum(t == "img" for t, *_ in parsed.attributes) == 0
    assert hostile in " ".join(parsed.words)
    if "<" in hostile:
        assert hostile not in page


def test_the_3d_view_of_a_file_is_that_of_its_volume(tmp_path, monkeypatch):
    """Whatever planes are read at a time, also where blocks reach beyond the volume."""
    phase = np.random.default_rng(1).integers(0, 3, (83, 50, 91), np.uint8)
    path = tmp_path / "twin.zarr.zip"
    with io.create_volume(path, phase.shape, {"phase": "uint8"}, 1.0, {}) as volume:
        volume["phase"][:] = phase
    whole = view3d.view_data(phase, 2.0, edge=30)
    monkeypatch.setattr(view3d, "CHUNK", 9)
    with io.open_volume(path, "phase") as (stored, _):
        assert view3d.view_data(stored, 2.0, edge=30) == whole
    assert set(whole["groups"]) == {"mineral 1", "mineral 2"}


def test_phase_names_are_data_in_the_3d_view(tmp_path):
    root = make_sample(tmp_path, variants=("full",), realizations=1)
    evil = ["pore", "</script><script>alert(1)</script>", "b"]
    about = io.read_json(root / "demo/section.json")
    io.write_json(root / "demo/section.json", about | {"phases": evil})
    build_report(root, ["demo"], root / "report.html")
    assert "<script>alert(1)" not in (root / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "gone",
    [
        {
            "reference*": "none: the section alone judges the twin",
            "*/*/virtual_spheres.*": "The sizes of virtual spheres have not been computed yet.",
            "*/*/plan.json": "No plan has been written",
            "**/benchmarks/*.tsv": "No benchmark files were found",
        },
        {
            "*/*/s2_slices.csv": "S₂ has not been computed yet",
            "*/*/flow.csv": "No permeability has been computed yet",
            "*/*/contacts.csv": "The contacts have not been found yet",
            "sizes.csv": "No sizes have been unfolded yet",
            "grains3d/*": "The grain library is not there yet",
            "*/*/network_*": "The pore network has not been extracted",
        },
        {
            "*/*/metrics.csv": "No metric with a target has been computed yet",
            "labels.zarr.zip": "The section",
            "*/s2_envelope.*": "Two-point correlation",
            "*/*/first/*": "The two packings and the twin",
            "truth_sizes.csv": "Sizes in 2D and in 3D",
        },
    ],
)
def test_page_degrades(tmp_path, gone):
    root = make_sample(tmp_path, variants=("full",), realizations=1)
    for pattern in gone:
        files = [f for f in (root / "demo").glob(pattern) if f.is_file()]
        assert files
        for file in files:
            file.unlink()
    build_report(root, ["demo"], root / "report.html", variants=["full"], realizations=[0])
    parsed = Page((root / "report.html").read_text(encoding="utf-8"))
    for said in gone.values():
        assert said in parsed.text
    anchors = {v for t, k, v in parsed.attributes if (t, k) == ("a", "href")}
    for key, files in (("virtual", "*/*/virtual_spheres.*"), ("forces", "*/*/contacts.csv")):
        assert (f"#sample-0-{key}" in anchors) == (files not in gone)
    assert "One twin only" in parsed.text
    assert not parsed.faults


def test_a_slice_has_its_reference_and_what_measures_otherwise_is_not_held_against_it(tmp_path):
    """Of a slice's volume only the measurements are there; a variant's other network has no counterpart."""
    root = make_sample(tmp_path, realizations=1)
    (root / "demo/reference.zarr.zip").unlink()
    other = root / "demo/bullet/0/metrics.csv"
    metrics = io.read_table(other)
    io.write_table(other, metrics[metrics["metric"] != "w1_network_pores_um"])
    build_report(root, ["demo"], root / "report.html")
    assert "none: the section alone" not in Page((root / "report.html").read_text(encoding="utf-8")).text
    rows = _permeability(root, "demo", [("full", 0), ("bullet", 0)])
    assert [row["who"] for row in rows] == ["reference", "full 0", "bullet 0"]
    assert [bool(row["cells"][0]["change"]) for row in rows] == [False, True, False]


def test_one_mineral_and_nothing_that_flows(tmp_path):
    root = make_sample(tmp_path, variants=("full",), realizations=1, reference=False)
    twin = root / "demo" / "full" / "0"
    sizes = io.read_table(root / "demo/sizes.csv")
    io.write_table(root / "demo/sizes.csv", sizes[sizes["phase"] < 2])
    io.write_json(root / "demo/section.json", {"phases": ["pore", "solid"]})
    solid = np.ones((20, 20, 20), np.uint8)
    io.write_volume(twin / "twin.zarr.zip", {"phase": solid}, PIXEL, {"phases": ["pore", "solid"]})
    network.save(network.empty(), twin / "network_pores.csv", twin / "network_throats.csv")
    flow = io.read_table(twin / "flow.csv").assign(k_md=0.0, formation_factor=np.nan)
    io.write_table(twin / "flow.csv", flow)
    io.write_table(twin / "metrics.csv", metrics_table({"porosity": 0.0} | flow_values(flow)))
    build_report(root, ["demo"], root / "report.html")
    text = Page((root / "report.html").read_text(encoding="utf-8")).text
    assert "Permeability along x, y, z is 0, 0, 0 mD (0: nothing percolates)" in text
    assert "nothing flows through: K = 0" in text
    assert "has no pores" in text


# ---- figures


def test_every_figure_can_be_a_file(tree, tmp_path):
    files = figure_files(tree, "demo", "full", 0)
    for name, figure in files.items():
        figure.save(tmp_path / f"{name}.svg")
        text = (tmp_path / f"{name}.svg").read_text(encoding="utf-8")
        assert figure.available
        assert len(text) > 5000
        assert "<dc:date>" not in text
    for n in range(2):
        files["sizes"].save(tmp_path / f"{n}.png")
    assert (tmp_path / "0.png").read_bytes() == (tmp_path / "1.png").read_bytes()


def test_a_figure_without_its_files_is_a_sentence(tmp_path):
    figure = figure_files(tmp_path, "nothing", "full", 0)["virtual"]
    assert figure.draw() is None
    figure.save(tmp_path / "virtual.svg")
    assert (tmp_path / "virtual.svg").exists()


def test_save_figure_refuses_other_formats(tree, tmp_path):
    with pytest.raises(ValueError, match=r"\.svg, \.pdf or \.png"):
        save_figure(figure_files(tree, "demo", "full", 0)["sizes"].draw(), tmp_path / "figure.gif")


def test_histograms_of_samples_keep_their_area(tree):
    figure = figure_files(tree, "demo", "full", 0)["sizes"].draw()
    for axes in figure.axes:
        assert axes.get_ylabel() or not axes.get_subplotspec().is_first_col()
        for patch in axes.patches:
            values, edges, baseline = patch.get_data()
            if baseline is None or np.ndim(baseline) == 0:
                assert (values * np.diff(edges)).sum() <= 1 + 1e-9 or patch.get_fill()


# ---- tables


def test_a_sweep_has_its_parameters_beside_what_came_of_them():
    metrics = metrics_table({"porosity": 0.25})
    rows = [
        summary_row("s", name, n, "physx", (4, 5, 6), 2.5, metrics, "network")
        for name in ("rough", "smooth")
        for n in (0, 1)
    ]
    summary = pd.concat(rows, ignore_index=True)
    parameters = {"smooth": {"scene.porosity": None, "f": 0.1}, "rough": {"scene.porosity": 0.4, "f": 0.8}}
    table = sweep_table(summary, parameters)
    assert tuple(table.columns) == (*SUMMARY_COLUMNS[:3], "scene.porosity", "f", *SUMMARY_COLUMNS[3:])
    assert table["f"].tolist() == [0.8, 0.8, 0.1, 0.1]
    assert table["scene.porosity"].tolist()[:2] == [0.4, 0.4]
    assert table["scene.porosity"].isna().tolist() == [False, False, True, True]
    pd.testing.assert_frame_equal(table[list(SUMMARY_COLUMNS)], summary)


def test_summary_row_has_the_columns_of_the_contract():
    metrics = metrics_table({"porosity": 0.3, "n_grains": 12, "k_x_md": 0.0})
    row = summary_row("s", "full", 1, "physx", (4, 5, 6), 2.5, metrics, "network")
    assert tuple(row.columns) == SUMMARY_COLUMNS
    line = row.to_csv(index=False, lineterminator="\n").splitlines()[1].split(",")
    by_name = dict(zip(SUMMARY_COLUMNS, line, strict=True))
    assert (by_name["shape_z"], by_name["shape_y"], by_name["shape_x"]) == ("4", "5", "6")
    assert by_name["n_grains"] == "12"
    assert by_name["k_x_md"] == "0.0"  # blocked is a finding …
    assert by_name["k_y_md"] == ""  # … not computed is not
    assert by_name["porosity_first"] == ""


def test_unknown_metrics_are_refused():
    with pytest.raises(KeyError, match="nonsense"):
        metrics_table({"nonsense": 1.0})
    for name in ("phase_fraction_3", "w1_grains_2_um", "w1_grains_um_target", *METRICS):
        assert len(metrics_table({name: None})) == 1


@given(shift=st.floats(-5, 5), scale=st.floats(0.5, 2))
def test_distance_of_shifted_radii_is_the_shift(shift, scale):
    rng = np.random.default_rng(0)
    one = grain_table(rng, 40, 12)
    one["r_um"] *= scale
    found = section_comparison(one, None, one.assign(r_um=one["r_um"] + shift), None)
    assert found["w1_grains_um"] == pytest.approx(abs(shift), abs=1e-9)
    assert found["w1_pores_um"] is None
    assert found["w1_solidity"] == pytest.approx(0, abs=1e-12)


def test_distances_ignore_border_grains_and_use_weights():
    one = pd.DataFrame({"phase": 1, "r_um": [1.0, 3.0, 99.0], "weight": [3.0, 1.0, 0.0]})
    two = pd.DataFrame({"phase": 1, "r_um": [1.0], "weight": [1.0]})
    assert section_comparison(one, None, two, None)["w1_grains_um"] == pytest.approx(0.25 * 2)


def test_chance_bound_holds_for_chance_and_catches_a_shift():
    rng = np.random.default_rng(3)
    one = grain_table(rng, 200, 12)
    twins = [grain_table(rng, 200, 12) for _ in range(12)]
    inside = 0
    for twin in twins:
        found = section_comparison(one, None, twin, None, np.random.default_rng(1), repeats=60)
        inside += found["w1_grains_um"] <= found["w1_grains_um_target"][2]
    assert inside >= 8  # two draws from one law, against a bound drawn from one of them
    shifted = section_comparison(one, None, one.assign(r_um=one["r_um"] + 2), None, np.random.default_rng(1))
    assert shifted["w1_grains_um"] > shifted["w1_grains_um_target"][2]


def test_phase_shares_of_the_section_itself_are_met():
    phase = np.random.default_rng(0).integers(0, 3, (60, 60)).astype(np.uint8)
    found = phase_values(phase[None], phase)
    assert all(j.status == "met" for j in judge(metrics_table(found)))
    assert sum(found[f"phase_fraction_{i}"] for i in (1, 2)) == pytest.approx(1)
    swapped = phase_values(np.where(phase == 2, 1, phase)[None], phase)
    assert all(j.status == "missed" for j in judge(metrics_table(swapped)))
    one = (phase > 0).astype(np.uint8)
    assert phase_values(one[None], one) == {}


def test_rims_count_for_the_mineral_they_grew_on():
    """Two equal grains, the second within a rim as large again: two thirds of what a section shows."""
    phase = np.repeat(np.array([1, 2, 3, 0], np.uint8), 100).reshape(4, 10, 10)
    body = np.repeat([1, 2, 2, 0], 100).reshape(4, 10, 10)
    grains = pd.DataFrame({"id": [0, 1], "phase": [1, 2]})
    section = np.array([[1, 2], [2, 1]], np.uint8)
    found = phase_values(phase, section, 1, slab=3, body=body, shown=partial(as_minerals, bodies=grains))
    assert (found["phase_fraction_1"], found["phase_fraction_2"]) == pytest.approx((1 / 3, 2 / 3))


def test_shares_of_a_twin_are_as_uncertain_as_the_twin_is():
    """Slabs of one mineral each: a twin of four such grains says little of the shares."""
    section = np.tile(np.array([[1, 2], [2, 1]], np.uint8), (20, 20))
    twin = np.repeat(np.array([1, 2, 1, 1], np.uint8), 100).reshape(4, 10, 10)
    found = phase_values(twin, section)
    assert found["phase_fraction_1"] == 0.75
    share, low, high = found["phase_fraction_1_target"]
    # residuals of the slabs about 3/4, of 100 voxels each: 4/3 (3 * 25^2 + 75^2), over 400
    assert (share, high - share) == pytest.approx((0.5, 2 * np.sqrt(4 / 3 * (3 * 25**2 + 75**2)) / 400))
    assert low < 0.75 < high


def words(values):
    return {j.metric: (j.status, j.words) for j in judge(metrics_table(values))}


def test_a_twin_is_held_to_the_surface_of_its_section():
    found = surface_values(SolidSurface(0.12, 0.003), SolidSurface(0.10, 0.004))
    assert found["solid_surface_per_um_target"] == pytest.approx((0.10, 0.09, 0.11))
    (verdict,) = judge(metrics_table(found))
    assert verdict.status == "missed"
    assert verdict.words.startswith("20% more surface than the section's solid has")
    near = surface_values(SolidSurface(0.105, 0.003), SolidSurface(0.10, 0.004))
    assert [v.status for v in judge(metrics_table(near))] == ["met"]
    none = SolidSurface(np.inf, np.inf)
    assert surface_values(none, none) == surface_values(SolidSurface(0.1, 0.1), none)


def test_what_the_section_leaves_open_is_said():
    rng = np.random.default_rng(0)
    phase = (rng.random((200, 200)) > 0.3).astype(np.uint8)
    errors = sampling_errors(phase)
    own, given = (sampling_values(phase, source) for source in ("areal of the section", "given"))
    assert (own["k_sampling_error"], own["porosity_sampling_error"]) == (errors.k, errors.porosity)
    assert given == own | {"k_sampling_error": errors.k_at_porosity, "porosity_sampling_error": None}
    said = [headline([metrics_table(values)])[-1] for values in (own, given)]
    assert all(
        f"K open by a factor of {f:.3g} either way" in s
        for f, s in zip((np.exp(2 * errors.k), np.exp(2 * errors.k_at_porosity)), said, strict=True)
    )
    layers = np.repeat(phase[:, :20], 10, axis=1)
    assert "lies aligned" in headline([metrics_table(sampling_values(layers, "given"))])[-1]
    assert [f"porosity by {2 * errors.porosity:.2g}" in s for s in said] == [True, False]
    blank = sampling_values(np.ones((9, 9), np.uint8), "given")
    assert headline([metrics_table(blank)]) == []


@pytest.mark.parametrize(
    ("windows", "said"),
    [
        (1, "(envelope test, p = 0.03)"),
        (
            9,
            "p = 0.03; of all its windows 11% are rejected, where some 5% would be by chance)",
        ),
    ],
)
def test_one_windows_p_is_said_beside_all_windows(windows, said):
    test = {"inside": 1.0, "p": 0.03, "n_windows": windows, "windows_rejected": 1 / 9}
    assert headline([metrics_table(envelope_values(test))])[-1].endswith(f"{said}.")


@pytest.mark.parametrize(("across", "said"), [(7.9, True), (8.0, False)])
def test_few_voxels_a_grain_are_said(across, said):
    lines = headline([metrics_table({"voxels_per_grain": across})])
    assert any("7.9 voxels across" in line for line in lines) == said
    lines = headline([metrics_table({"voxels_per_grain": 4 * across, "network_coarsen": 4})])
    assert any(line.startswith("Network and flow see 7.9 voxels") for line in lines) == said


def test_a_permeability_as_the_references_is_not_said_to_be_above_or_below():
    k = {"k_x_md": 800.0, "k_y_md": 900.0, "k_z_md": 1003.0}
    (line,) = headline([metrics_table(k | {f"k_ref_{a}_md": 900.0 for a in "xyz"})])
    assert "within 1% of the reference by the same method on average" in line


def test_judgements_in_plain_words():
    assert words({"porosity": 0.371, "porosity_target": 0.309})["porosity"] == (
        "missed",
        "porosity 0.371 misses 0.309 by 0.062: the plan says what kept position scaling from closing it",
    )
    assert words({"porosity": 0.3094, "porosity_target": 0.309})["porosity"][0] == "met"
    status, text = words({"porosity": 0.312, "porosity_target": 0.309})["porosity"]
    assert (status, "0.312 misses 0.309 by 0.003" in text) == ("missed", True)
    blocked = words({"k_x_md": 0.0, "k_ref_x_md": 900.0})["k_x_md"]
    assert blocked == ("missed", "permeability along x 0 mD misses 900 mD: nothing flows through the twin")
    assert words({"k_x_md": 0.0})["k_x_md"] == ("reported", "nothing flows through: K = 0")
    assert words({"k_x_md": 0.0, "k_ref_x_md": 0.0})["k_x_md"][0] == "met"
    assert words({"k_x_md": 950.0, "k_ref_x_md": 900.0})["k_x_md"][0] == "met"
    assert "17% below" in words({"k_x_md": 750.0, "k_ref_x_md": 900.0})["k_x_md"][1]
    assert words({"coordination": None})["coordination"][0] == "not computed"
    assert words({"coordination": 4.4})["coordination"][0] == "reported"
    assert words({"s2_envelope_p": 0.04})["s2_envelope_p"][0] == "missed"
    assert words({"max_overlap": 0.0908})["max_overlap"] == (
        "missed",
        "largest overlap of the true shapes: 0.0908 of the smaller radius, above 0.02",
    )
    assert words({"asleep": 0.98})["asleep"][1] == "share of bodies at rest: 0.98, below 1"


def test_verdict_counts_only_what_has_a_target():
    judged = judge(
        metrics_table({"porosity": 0.3, "porosity_target": 0.3, "coordination": 5, "rattlers": None})
    )
    assert verdict(judged) == "1 of 1 targets are met."
    assert verdict([]) == "No metric with a target has been computed yet."


def test_network_values():
    names = ("pore_radius_um", "pore_volume_um3", "throat_radius_um", "coordination")
    sizes = {k: np.array([1.0, 2.0]) for k in names}
    moved = {k: v if k == "pore_volume_um3" else v + 1 for k, v in sizes.items()}
    found = network_values(sizes, moved)
    assert found["w1_network_pores_um"] == pytest.approx(1)
    assert len(metrics_table(found)) == 5
    nothing = {k: np.array([]) for k in sizes}
    assert network_values(nothing, sizes)["w1_network_pores_um"] is None


def test_intervals_are_student_t():
    rows = pd.DataFrame(
        {"sample": "s", "variant": ["a"] * 4 + ["b"] * 4, "engine": "physx", "realization": [0, 1, 2, 3] * 2,
         "porosity": [0.30, 0.32, 0.31, 0.33, 0.35, 0.37, 0.36, 0.38], "k_x_md": np.nan}
    )  # fmt: skip
    table = intervals(rows, ["porosity", "k_x_md", "absent"])
    assert list(table["metric"]) == ["porosity", "porosity"]
    # 3.182 is the two-sided 95 % point of t with 3 degrees of freedom
    half = 3.182446 * np.std([0.30, 0.32, 0.31, 0.33], ddof=1) / 2
    assert table["upper"][0] - table["mean"][0] == pytest.approx(half, rel=1e-6)
    paired = paired_differences(rows, ["porosity"])
    assert paired["mean"][0] == pytest.approx(0.05)
    assert bool(paired["differs"][0])
    one = paired_differences(rows[rows["realization"] == 0], ["porosity"])
    assert one["differs"][0] is None
    assert np.isnan(one["lower"][0])
    two = paired_differences(
        rows[rows["realization"] < 2].assign(porosity=[0.3, 0.32, 0.35, 0.38]), ["porosity"]
    )
    assert two["differs"][0] is None
    assert two.loc[0, ["lower", "upper"]].tolist() == pytest.approx([0.05, 0.06])


def test_permeabilities_are_compared_by_their_ratio():
    """A pair of 10 and 20 mD says as much as one of 1000 and 2000."""
    rows = pd.DataFrame(
        {"sample": "s", "variant": ["a"] * 3 + ["b"] * 3, "realization": [0, 1, 2] * 2,
         "k_x_md": [10.0, 1000.0, 100.0, 20.0, 2000.0, 200.0]}
    )  # fmt: skip
    (row,) = paired_differences(rows, ["k_x_md"]).itertuples()
    assert row.ratio
    assert row.differs
    assert [row.mean, row.lower, row.upper] == pytest.approx([2, 2, 2])
    (blocked,) = paired_differences(rows.assign(k_x_md=[0, 1, 2, 0, 1, 2.0]), ["k_x_md"]).itertuples()
    assert not blocked.ratio
    assert not blocked.differs


def test_two_realizations_have_a_range_and_no_bound_is_impossible():
    """Two permeabilities of 3315 and 4993 mD have a t-interval from -6504 to 14812."""
    rows = pd.DataFrame(
        {"sample": "s", "variant": ["two"] * 2 + ["three"] * 3, "engine": "physx",
         "k_x_md": [3315.0, 4993.0, 100.0, 300.0, 900.0], "rattlers": [0.1, 0.2, 0.0, 0.9, 0.9]}
    )  # fmt: skip
    table = intervals(rows, ["k_x_md", "rattlers"]).set_index(["variant", "metric"])
    assert table.loc[("two", "k_x_md"), ["lower", "upper"]].tolist() == [3315, 4993]
    lower, upper = table.loc[("three", "k_x_md"), ["lower", "upper"]]
    # 4.303 is the two-sided 95 % point of t with 2 degrees of freedom
    assert [lower, upper] == pytest.approx(300 * np.exp(np.array([-1, 1]) * 4.302653 * np.log(3) / 3**0.5))
    assert table.loc[("three", "rattlers"), ["lower", "upper"]].tolist() == [0, 1]
    panel = figures.comparison_figure(rows, table.reset_index()).axes[0]
    # ticks and a dot of each ensemble, and one interval
    assert len(panel.lines) == 5


def test_costs_add_up_over_jobs_and_parts(tree):
    costs = read_costs(sorted((tree / "demo").rglob("*.tsv"))).set_index("rule")
    assert costs.loc["s2_slices", "jobs"] == 8
    assert costs.loc["s2_slices", "wall_s"] == pytest.approx(8 * 1.25)
    assert costs.loc["morphology", "peak_rss_mb"] == 120
    assert read_costs([]).empty


def test_fewer_independent_bodies_widen_the_bound():
    one, two = (grain_table(np.random.default_rng(n), 300, 12) for n in (1, 2))
    bounds = [
        section_comparison(one, None, two, None, np.random.default_rng(0), 60, n)["w1_grains_um_target"][2]
        for n in (None, {1: 20})
    ]
    assert bounds[1] > bounds[0]


def test_so_few_grains_that_all_draws_are_alike_bound_nothing():
    one, twin = (grain_table(np.random.default_rng(n), size, 12) for n, size in ((1, 1), (2, 300)))
    found = section_comparison(one, None, twin, None, np.random.default_rng(0), 60)
    assert found["w1_grains_um"] > 0
    assert "w1_grains_um_target" not in found


def test_a_rare_mineral_is_held_to_what_chance_gives_its_own_grains():
    """285 grains of one mineral and 15 of the other, of one law: the others' number is not theirs."""
    common, rare = (grain_table(np.random.default_rng(n), 300, 12) for n in (1, 2))
    both = pd.concat([common.assign(phase=1), rare.assign(phase=2)])
    rng = np.random.default_rng(0)
    found = section_comparison(both, None, both, None, rng, 60, {1: 285, 2: 15})
    bounds = {i: found[f"w1_grains_{i}_um_target"][2] for i in (1, 2)}
    assert bounds[2] > 2 * bounds[1]
    # of as many as 15, alone
    alone = section_comparison(rare, None, rare, None, np.random.default_rng(0), 60, {1: 15})
    assert bounds[2] == pytest.approx(alone["w1_grains_um_target"][2], rel=0.3)


def test_grains_of_the_margin_are_not_the_regions():
    scene = {"shape_zyx": [10, 10, 10], "voxel_size_um": 2.0}
    bodies = pd.DataFrame({"phase": [1, 2, 2, 1], "x": [1.0, 19.9, 20.0, -0.1], "y": 1.0, "z": 1.0})
    assert bodies_within(bodies, scene) == {1: 1, 2: 1}


def test_many_minerals_stay_readable():
    rng = np.random.default_rng(0)
    names = ["pore", *(f"$mineral_{i}$" for i in range(1, 41))]
    sizes = pd.concat([histogram("grain", i, 12, rng) for i in range(1, 41)] + [histogram("pore", 0, 6, rng)])
    figure = figures.sizes_figure(sizes, names)
    assert len(figure.axes) == 2 * figures.MOST_PANELS
    assert figure.axes[figures.MOST_PANELS - 1].get_title(loc="left") == "pore circles"
    many = (
        rng.integers(0, 41, (9, 9)).astype(np.uint8),
        0.5,
        rng.integers(0, 41, (6, 6, 6)).astype(np.uint8),
        1.0,
    )
    block = figures.twin_figure(*many, names)
    assert block.legends[0].get_texts()[-2].get_text() == "and 31 more"


def test_the_sizes_show_a_band_only_where_there_is_one():
    sizes = histogram("grain", 1, 12, np.random.default_rng(0))

    def legend(table):
        return [text.get_text() for text in figures.sizes_figure(table, PHASES).legends[0].get_texts()]

    assert "bootstrap band" in legend(sizes)
    assert "bootstrap band" not in legend(sizes.assign(lower=np.nan, upper=np.nan))
    assert "bootstrap band" not in legend(sizes.assign(lower=sizes.f3d, upper=sizes.f3d))
    # it is that of the bins which it was found in, whatever the others are drawn on
    panel = figures.sizes_figure(sizes, PHASES).axes[1]
    bands = [p.get_data() for p in panel.patches if np.ndim(p.get_data().baseline)]
    assert [band.edges.tolist() for band in bands] == [[*sizes.r_lo_um, sizes.r_hi_um.iloc[-1]]]


# ---- the page in a browser

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
SOFTWARE_GL = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
TURNED = "JSON.stringify(document.querySelector('.view').layout.scene.camera.eye)"


@pytest.fixture(scope="module")
def opened(page, tree):
    """The page in headless Chromium without a network, and all that it complained of or asked for."""
    if CHROMIUM is None:
        pytest.skip("no Chromium on this machine")
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=SOFTWARE_GL)
        tab = browser.new_context(offline=True, viewport={"width": 1280, "height": 900}).new_page()
        complaints, requests = [], []
        tab.on("console", lambda said: complaints.append(said.text) if said.type == "error" else None)
        tab.on("pageerror", lambda fault: complaints.append(str(fault)))
        tab.on("request", lambda request: requests.append(request.url))
        tab.goto((tree / "report.html").as_uri())
        tab.wait_for_selector(".view canvas")
        tab.evaluate("document.querySelectorAll('details').forEach(part => { part.open = true; })")
        yield tab, complaints, requests
        browser.close()


def test_browser_opens_the_page_offline_without_complaint(opened, tree):
    tab, complaints, requests = opened
    assert tab.title() == "Twins of a demo"
    assert complaints == []
    address = (tree / "report.html").as_uri()
    assert [url for url in requests if url != address and not url.startswith(("data:", "blob:"))] == []
    assert tab.evaluate("[...document.images].every(image => image.complete && image.naturalWidth > 0)")


def test_browser_finds_no_barrier(opened):
    """The rules of axe-core, those of WCAG 2 A and AA among them, on the whole page."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe is not installed")
    found = axe.Axe().run(opened[0]).response
    assert len(found["passes"]) > 20
    assert [(fault["id"], [node["html"] for node in fault["nodes"]]) for fault in found["violations"]] == []


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (1.819e-10, "1.82·10⁻¹⁰"),
        (-2.5e7, "\u22122.50·10⁷"),
        (0.05, "0.05"),
        (12345, "12\u202f345"),
        (None, ""),
    ],
)
def test_figures_read_as_a_person_writes_them(value, text):
    assert number(value) == text
    assert figure(text) == (None if value is None else pytest.approx(value, rel=5e-3))


def column(table, number):
    """Texts of one column, top to bottom."""
    return table.locator(f"tbody tr > :nth-child({number + 1})").all_inner_texts()


def figure(text):
    """A figure of the page as a number; ``None`` where there is none."""
    plain = (
        text.replace("\u202f", "")
        .replace("\u2212", "-")
        .replace("·10", "e")
        .translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789"))
    )
    found = re.match(r"\s*[-+]?\d+(\.\d+)?(e[-+]?\d+)?", plain)
    return float(found.group()) if found else None


def test_browser_sorts_every_table_by_every_column(opened):
    tab, complaints, _ = opened
    tables = tab.locator("table").all()
    assert len(tables) >= 6
    for table in tables:
        heads = table.locator("thead th")
        before = table.locator("tbody").inner_text()
        for index in range(heads.count()):
            head = heads.nth(index)
            numeric = "n" in (head.get_attribute("class") or "").split()
            orders = []
            for way in ("ascending", "descending"):
                head.get_by_role("button").click()
                assert head.get_attribute("aria-sort") == way
                texts = column(table, index)
                if numeric:
                    values = [figure(text) for text in texts]
                    known = [value for value in values if value is not None]
                    assert values == known + [None] * (len(values) - len(known))
                    assert known == sorted(known, reverse=way == "descending")
                else:
                    orders.append([word for word, _ in itertools.groupby(texts)])
                    assert len(orders[-1]) == len(set(texts))
            assert numeric or orders[0] == orders[1][::-1]
            head.get_by_role("button").click()
            assert head.get_attribute("aria-sort") is None
            assert table.locator("tbody").inner_text() == before
    assert complaints == []


def test_browser_turns_the_view_by_mouse_and_by_keyboard(opened):
    tab, complaints, _ = opened
    view = tab.locator(".view").first
    view.scroll_into_view_if_needed()
    box = view.bounding_box()
    eyes, pictures = [tab.evaluate(TURNED)], [view.screenshot()]

    def look():
        tab.wait_for_timeout(300)
        eyes.append(tab.evaluate(TURNED))
        pictures.append(view.screenshot())

    middle = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    tab.mouse.move(*middle)
    tab.mouse.down()
    tab.mouse.move(middle[0] + 120, middle[1], steps=5)
    tab.mouse.up()
    look()
    for name in ("Turn left", "Look from below"):
        tab.get_by_role("button", name=name).first.focus()
        tab.keyboard.press("Enter")
        look()
    assert len(set(eyes)) == len(eyes)
    assert len(set(pictures)) == len(pictures)
    # a button takes its part away and brings it back
    button = tab.locator("button[data-group='mineral 1']").first
    for pressed in ("false", "true"):
        button.click()
        assert button.get_attribute("aria-pressed") == pressed
        look()
    assert len({pictures[-3], pictures[-2]}) == 2
    assert complaints == []


def test_growth_of_a_run_from_the_benchmark_files_of_its_jobs(root, tmp_path):
    """A start-up and a share per voxel is told from a power; scattered jobs and figures count as one rule."""
    bench = runpy.run_path(str(root / "tests" / "benchmarks" / "paper_scale.py"))

    def took(rule, n):
        return {"network": 2 + 1e-6 * n**3, "s2_slices": 1e-6 * n**3.5 / 2, "figure": 3.0}[rule]

    for n in (125, 250):
        twin = tmp_path / f"{n}/results/rock/full/0"
        (twin / "benchmarks").mkdir(parents=True)
        (tmp_path / f"{n}/results/report.html").write_text("")
        io.write_json(twin.parent / "scene.json", {"shape_zyx": [n, n, n]})
        for job in ("network", "s2_slices_1-of-2", "s2_slices_2-of-2", "figure_block"):
            cpu = took(re.sub("_[0-9]-of-2|_block", "", job), n)
            (twin / f"benchmarks/{job}.tsv").write_text(
                f"s\tmax_rss\tcpu_time\n{2 * cpu}\t{100 * cpu}\t{cpu}\n"
            )
    table = bench["gather"](tmp_path)
    assert list(table) == ["rule", "n", "wall_s", "cpu_s", "peak_rss_mb"]
    rows = table.set_index(["rule", "n"])
    assert rows.loc[("s2_slices", 250), "cpu_s"] == pytest.approx(1e-6 * 250**3.5)
    assert rows.loc[("total", 125), "wall_s"] == pytest.approx(2 * (5 + 1e-6 * 125**3 + 1e-6 * 125**3.5))
    grown = bench["growth"](table).set_index("rule")
    assert grown.loc["s2_slices", "cpu_exponent"] == pytest.approx(3.5)
    assert 3600 * grown.loc["s2_slices", "cpu_h_4000"] == pytest.approx(1e-6 * 4000**3.5)
    assert 3600 * grown.loc["network", "cpu_h_2000"] == pytest.approx(2 + 1e-6 * 2000**3)
    assert 3600 * grown.loc["figure", "cpu_h_4000"] == pytest.approx(3)
    assert grown.loc["total", "memory_gb_2000"] == grown["memory_gb_2000"].iloc[:-1].max()


def test_cement_has_one_colour_whatever_its_number():
    seen = set()
    for phases in (["pore", "quartz", "cement"], ["pore", "quartz", "feldspar", "cement"]):
        cement = phases.index("cement")
        volume = np.zeros((9, 9, 9), np.uint8)
        volume[2:7, 2:7, 2:7] = cement
        view = view3d.view_data(volume, 1.0, phases)
        seen |= {
            figures.to_rgb(view["traces"][0]["color"]),
            figures.to_rgb(figures.mineral_handles(phases)[cement - 1].get_facecolor()),
            tuple(figures.phase_colours(volume, phases)[4, 4, 4]),
        }
    assert seen == {figures.to_rgb(figures.CEMENT)}
    assert figures.CEMENT not in figures.MINERALS


def test_no_bin_of_a_network_is_narrower_than_its_voxels():
    sizes = {k: np.linspace(1, 12, 50) for k in ("pore_radius_um", "pore_volume_um3", "throat_radius_um")}
    figure = figures.network_figure({**sizes, "coordination": np.arange(50)}, None, 2.0)
    assert np.diff(figure.axes[1].patches[0].get_data().edges) == pytest.approx(2)


def test_the_share_of_forces_beyond_the_axis_is_said():
    """One contact of twenty carries ten times the mean, and more than half of all force."""
    force = np.r_[np.full(19, 9 / 19), 10.0]
    bodies = pd.DataFrame({"id": range(21), "x": 5.0, "z": 5.0})
    contacts = pd.DataFrame({"grain_a": range(20), "grain_b": range(1, 21), "force_n": force})
    right = figures.forces_figure(contacts.assign(x=5.0, y=5.0, z=5.0), bodies, 10.0, 2.0).axes[1]
    assert right.texts[0].get_text() == "5 % beyond"
    values, edges, _ = right.patches[0].get_data()
    assert values @ np.diff(edges) == pytest.approx(0.95)


def test_rebinned_histograms_keep_their_area_and_end_where_little_is_left():
    edges = np.geomspace(1, 100, 40)
    density = np.exp(-edges[:-1] / 5)
    density /= density @ np.diff(edges)
    last = figures.reach(edges, density)
    wide, coarse = figures.rebinned(edges, density, last)
    assert (len(coarse), wide[-1]) == (24, last)
    assert 0.999 <= coarse @ np.diff(wide) < 1
    assert last < 100


def test_the_used_volume_is_that_of_the_difference_above_zero():
    """Three bins of equal number: the widest radii are short by as much as the narrowest are in excess."""
    table = pd.DataFrame({"r_lo_um": [0.0, 1, 2], "r_hi_um": [1.0, 2, 3], "target": [0.2, 0.3, 0.5]})
    table = table.assign(first=[0.5, 0.3, 0.2], difference=[-0.3, 0, 0.3], used=[0, 0, 1.0])
    outlines = [p for p in figures.virtual_figure(table, 0.1).axes[1].patches if not p.get_fill()]
    (difference, edges, _), (used, _, _) = (outline.get_data() for outline in outlines)
    assert used == pytest.approx(difference.clip(0))
    # of all volume of the target: radii cubed over bins
    share = 0.3 * (3**4 - 2**4) / (0.2 + 0.3 * (2**4 - 1) + 0.5 * (3**4 - 2**4))
    assert used @ np.diff(edges) == pytest.approx(share)
    nothing = figures.virtual_figure(table.assign(target=0.0, difference=0.0, used=0.0))
    assert nothing.axes[1].texts[0].get_text() == "none called for"


@pytest.mark.parametrize(("p_sp", "shown"), [(0.12, True), (0.0, False)])
def test_sizes_left_over_count_as_used_only_where_spheres_were_poured(p_sp, shown):
    edges = np.arange(11.0)
    table = pd.DataFrame({"r_lo_um": edges[:-1], "r_hi_um": edges[1:], "target": 0.1, "first": 0.05})
    drawn = figures.virtual_figure(table.assign(difference=0.05, used=0.1), p_sp)
    names = [text.get_text() for text in drawn.legends[0].get_texts()]
    assert any(name.startswith("used") for name in names) == shown
    assert any(text.get_text() == "none called for" for text in drawn.axes[1].texts) != shown


def test_grains_are_held_against_the_section_as_large_as_they_were_drawn(tmp_path):
    root = make_sample(tmp_path, variants=("full",), realizations=1)
    twin = root / "demo/full/0"
    before = drawn_grains(Results(root, "demo", "full", 0))
    assert 0 < len(before) < 40  # some lie in the margin
    io.write_json(twin / "cement.json", {"room": 0.9, "compaction": {"factor": 1.2}})
    after = drawn_grains(Results(root, "demo", "full", 0))
    assert after["scale"].to_numpy() == pytest.approx(before["scale"].to_numpy() / 1.08)


def test_several_samples_stand_side_by_side(tree, tmp_path):
    root = shutil.copytree(tree, tmp_path / "two")
    shutil.copytree(root / "demo", root / "other")
    summary = pd.read_csv(root / "summary.csv")
    pd.concat([summary, summary.assign(sample="other", porosity=0.25)]).to_csv(
        root / "summary.csv", index=False
    )
    build_report(root, ["demo", "other"], root / "report.html")
    page = (root / "report.html").read_text()
    table = page[page.index('aria-label="All samples"') :].partition("</table>")[0]
    rows = [re.sub(r"<[^>]+>", " ", row).split() for row in table.split("<tr>")[2:]]
    assert {row[0] for row in rows} == {"demo", "other"}
    assert all("0.25" in row for row in rows if row[0] == "other")
    assert 'href="#sample-1"' in table
    build_report(root, ["demo"], root / "report.html")
    assert "All samples" not in (root / "report.html").read_text()


def test_what_the_packing_jobs_say_of_a_twin():
    """Four of 24 voxels are pore, eight cement; seven of ten bodies were grains."""
    phase = np.ones((2, 3, 4), np.uint8)
    phase[0, 0], phase[0, 1], phase[1, :2] = 0, 2, 3
    scene = {
        "phases": ["pore", "quartz", "feldspar"],
        "shape_zyx": [2, 3, 4],
        "voxel_size_um": 2.0,
        "porosity_target": 0.2,
        "mean_diameter_um": 5.0,
    }
    # by x, y, z: a region of 8 x 6 x 4 um
    bodies = pd.DataFrame(
        {
            "phase": [1, 2, 2],
            "x": [7.0, 1, 1],
            "y": [1.0, 7, 1],
            "z": [1.0, 1, 3],
            "asleep": [True, True, False],
        }
    )
    told = {"contacts": 1, "euler": 1, "contact_area_um2": 1.0, "shared_share": 0.1}
    found = packing_values(
        scene, {"porosity_first": 0.4},
        {"poured": 10, "poured_grains": 7, "p_sp": 0.3, "max_overlap": 0.01,
         "rest": {"drift_mean": 0.0, "net_force": 0.0, "energy_rise": 0.0}},
        {"before": {**told, "porosity": 0.3}, "after": {**told, "porosity": 0.29}, "scale_factor": 1.0},
        bodies, phase,
    )  # fmt: skip
    assert (found["porosity"], found["cement_share"]) == (4 / 24, 8 / 24)
    assert (found["porosity_target"], found["porosity_first"], found["porosity_second"]) == (0.2, 0.4, 0.3)
    assert (found["n_virtual"], found["n_grains"], found["voxels_per_grain"]) == (3, 2, 2.5)
    assert found["asleep"] == pytest.approx(2 / 3)


def test_k_is_the_mean_of_the_axes_by_the_same_method():
    def table(*k, methods=("network", "direct")):
        k = np.array(k)
        each = [
            pd.DataFrame({"method": m, "axis": list("xyz"), "k_md": n * k}) for n, m in enumerate(methods, 1)
        ]
        return pd.concat(each)

    found = flow_values(table(100.0, 200.0, 600.0), table(1.0, 2.0, 3.0)[::-1], "direct")
    assert found["k_md"] == (600, 200, 1200)
    assert [found[f"k_ref_{a}_md"] for a in "xyz"] == [2, 4, 6]
    # nothing to hold against what was not measured by that method
    assert flow_values(table(1.0, 1.0, 1.0), table(1.0, 1.0, 1.0, methods=["direct"]))["k_ref_x_md"] is None


def test_a_bed_that_settled_anew_is_told_as_it_came_to_lie():
    change = {"porosity_before": 0.4, "porosity_after": 0.38, "s2_change": 0.01, "moved_share": 0.2}
    assert resettling_values(change) == {
        "porosity_resettled": 0.38,
        "s2_resettled": 0.01,
        "moved_resettled": 0.2,
    }
    assert set(resettling_values(None).values()) == {None}


def test_targets_have_two_sides():
    assert words({"porosity": 0.3, "porosity_target": 0.309})["porosity"][0] == "missed"
    assert words({"k_x_md": 1000.0, "k_ref_x_md": 900.0})["k_x_md"][0] == "missed"


@pytest.mark.parametrize(("p", "said"), [(0.05, "cannot"), (0.049, "can")])
def test_a_section_is_told_apart_below_the_level(p, said):
    (line,) = headline([metrics_table({"s2_envelope_p": p})])
    assert f"the section {said} be told" in line


def test_a_twin_that_conducts_half_as_much_is_said_to():
    k = {f"k_{a}_md": 450.0 for a in "xyz"} | {f"k_ref_{a}_md": 900.0 for a in "xyz"}
    assert any("50% below the reference" in line for line in headline([metrics_table(k)]))


def test_slices_of_a_twin_weigh_as_the_section_does():
    one = pd.DataFrame({"phase": 1, "r_um": [1.0], "weight": [1.0]})
    two = pd.DataFrame({"phase": 1, "r_um": [1.0, 3.0, 99.0], "weight": [3.0, 1.0, 0.0]})
    assert section_comparison(one, None, two, None)["w1_grains_um"] == pytest.approx(0.25 * 2)
