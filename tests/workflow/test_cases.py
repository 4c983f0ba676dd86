"""The validation cases, tiny: every rule of theirs runs, and the page comes out with what there is."""

import hashlib
import http.server
import shutil
import threading
import zipfile

import numpy as np
import pandas as pd
import pytest
import tifffile

from conftest import TINY, planned, snakemake, write_config
from grainfall.io import read_json, read_volume, write_json
from grainfall.report.figures import NOTE
from grainfall.report.paper_figures import FIGURES, Cases
from grainfall.report.validation import COLUMNS, validation_table

pytestmark = pytest.mark.xdist_group("cases")


SWEEP = {"cv": [0.3], "truths": 1, "voxels_per_radius": 4, "edge": 32, "grains": 60}


@pytest.fixture(scope="module")
def studied(finished, tmp_path_factory):
    """The finished tiny twins as two cases, the sweep beside them, and the page of it all."""
    folder = tmp_path_factory.mktemp("cases")
    shutil.copytree(finished, folder, dirs_exist_ok=True)
    scan = {"rim_um": 20, "crush_um": 3}
    for case, over in (("stereology", {}), ("xct", {"tomogram": scan}), ("cv_sweep", {"cv_sweep": SWEEP})):
        write_config(folder, {**TINY, "case": case, **over}, f"{case}.yaml")
    for config in ("xct.yaml", "cv_sweep.yaml"):
        done = snakemake(folder, "--", "case", config=config)
        assert done.returncode == 0, done.stdout[-6000:]
    # the tiny rock stands for both cases
    done = snakemake(folder, "--", "validation", config="xct.yaml")
    assert done.returncode == 0, done.stdout[-6000:]
    return folder


def test_the_table_has_what_there_is(studied):
    table = pd.read_csv(studied / "results/validation.csv")
    assert tuple(table.columns) == COLUMNS
    rows = table.set_index(["case", "variant", "quantity"])
    k = rows.loc[("xct", "full", "k_md")]
    assert k["paper"] == 1183
    assert k["n"] == 2
    assert k["lower"] < k["mean"] < k["upper"]
    twins = [pd.read_csv(studied / f"results/tiny/full/{n}/metrics.csv").set_index("metric") for n in (0, 1)]
    assert k["mean"] == pytest.approx(sum(t.loc["k_md", "value"] for t in twins) / 2)
    assert rows.loc[("xct", "tomogram", "phantom"), "mean"] > 0
    assert {"full", "no_inversion"} <= set(table[table["case"] == "cv_sweep"]["variant"])


def test_a_truth_is_the_mean_of_its_cubes_and_a_tomogram_is_held_against_its_own(studied):
    table = pd.read_csv(studied / "results/validation.csv")
    table = table.set_index(["case", "variant", "quantity"]).sort_index()
    rock = studied / "results/tiny"
    flows = [pd.read_csv(folder / "reference_flow.csv") for folder in (rock, rock / "cube_1")]
    one, other = (flow.k_md[flow.method == flow.method[0]].mean() for flow in flows)
    assert one != other
    both = (one + other) / 2
    assert table.loc[("xct", "truth", "k_md"), "mean"] == pytest.approx(both)
    full = table.loc[("xct", "full")]
    assert full.loc["k_ratio", "mean"] == pytest.approx(full.loc["k_md", "mean"] / both)
    seen = table.loc[("xct", "section", "surface_section"), "mean"]
    assert full.loc["k_at_equal_surface", "mean"] == pytest.approx(full.loc["k_ratio", "mean"] * seen**2)
    assert table.loc[("xct", "tomogram", "k_md"), "truth"] == pytest.approx(one)


def test_a_section_is_held_against_slices_of_its_truth(studied):
    table = pd.read_csv(studied / "results/validation.csv").set_index(["case", "variant", "quantity"])
    test = read_json(studied / "results/tiny/reference_envelope.json")
    assert test["n_volumes"] == 2
    assert table.loc[("xct", "section", "s2_envelope_p"), "mean"] == test["p"]
    assert table.loc[("xct", "full", "s2_envelope_p"), "truth"] == test["p"]


def test_the_page_names_paper_and_ours(studied):
    page = (studied / "results/validation.html").read_text()
    assert "1\u202f183" in page
    assert "Not begun: Case 1" in page
    assert "not run" in page
    assert "<script" not in page
    assert 'src="http' not in page


DRAWN = {"motivation", "sample3", "sample3_analysis", "cv_sweep", "permeability"}
"""Figures of what was studied; of the other cases a sentence stands in their place."""


def test_figures_are_there_in_three_formats(studied):
    for name in FIGURES:
        figure = studied / f"results/validation/{name}"
        assert (NOTE in figure.with_suffix(".svg").read_text()) == (name not in DRAWN), name
        assert figure.with_suffix(".pdf").read_bytes().startswith(b"%PDF")
        assert figure.with_suffix(".png").read_bytes().startswith(b"\x89PNG")


def test_every_figure_is_drawn_where_its_case_is_there(studied, tmp_path):
    """The tiny rock stands for every case, its twins for those of other variants."""
    folder = shutil.copytree(studied / "results", tmp_path / "results")
    rock, volume = folder / "tiny", folder / "data/berea"
    for variant in ("no_inversion", "grains_only"):
        shutil.copytree(rock / "full", rock / variant)
    shutil.copytree(rock, volume, ignore=lambda *_: {"full", "no_inversion", "grains_only"})
    about = read_json(rock / "section.json")
    write_json(rock / "section.json", {**about, "notes": {**about["notes"], "slice": "y10"}})
    cases = Cases(folder, {case: ["tiny"] for case in ("stereology", "virtual_spheres", "berea", "xct")})
    drawn = {name: figure.draw(cases) for name, figure in FIGURES.items()}
    assert [name for name, figure in drawn.items() if figure is None] == []
    # each with data in it: an axes of its own that shows something
    assert [name for name, figure in drawn.items() if not any(a.has_data() for a in figure.axes)] == []


def test_page_again_does_nothing_and_asks_for_no_twin(studied):
    assert planned(studied, "--", "validation", config="xct.yaml") == {}


@pytest.mark.parametrize(("gone", "again"), [("full/1/flow.csv", "flow"), ("labels.zarr.zip", "morphology")])
def test_what_is_deleted_of_a_case_is_made_again(studied, tmp_path, gone, again):
    folder = shutil.copytree(studied, tmp_path / "damaged")
    (folder / "results/tiny" / gone).unlink()
    assert planned(folder, "--", "case", config="xct.yaml").get(again) == 1


def figures_of(folder, case="xct"):
    """The case's rows of the folder's results, and what was left out."""
    study = {case: {"samples": ["tiny"], "variants": ["full"]}}
    table, left_out = validation_table(folder / "results", study)
    return table.set_index(["variant", "quantity"]), left_out


def test_what_is_not_finished_or_cannot_be_read_costs_no_page(studied, tmp_path):
    folder = shutil.copytree(studied, tmp_path / "copy")
    rock = folder / "results/tiny"
    whole, left_out = figures_of(folder)
    assert ("tomogram", "k_md") in whole.index
    assert not left_out
    (rock / "tomogram/reference_s2.csv").unlink()
    rows, left_out = figures_of(folder)
    assert "tomogram" not in rows.index.get_level_values(0)
    assert not left_out
    flow = pd.read_csv(rock / "cube_1/reference_flow.csv")
    for table in (rock / "reference_flow.csv", rock / "cube_1/reference_flow.csv"):
        flow.assign(k_md=0.0).to_csv(table, index=False)  # no truth percolates
    rows, left_out = figures_of(folder)
    assert ("full", "k_ratio") not in rows.index
    assert rows.loc[("full", "k_md"), "mean"] == whole.loc[("full", "k_md"), "mean"]
    scene = rock / "full/scene.json"
    scene.write_text(scene.read_text().replace("resolution_um", "once_called"))
    rows, left_out = figures_of(folder)
    assert rows.empty
    assert left_out == ["xct, tiny: no 'resolution_um' in its files, as of another version"]
    done = snakemake(folder, "--", "validation", config="xct.yaml")
    assert done.returncode == 0, done.stdout[-3000:]
    assert "left out: xct, tiny" in done.stdout
    assert "Left out" in (folder / "results/validation.html").read_text()


def test_permeability_is_held_against_the_same_method(studied, tmp_path):
    folder = shutil.copytree(studied, tmp_path / "copy")
    whole, _ = figures_of(folder)
    for table in (folder / "results/tiny/full").glob("*/flow.csv"):
        flow = pd.read_csv(table)
        assert len(set(flow["method"])) > 1
        flow[::-1].to_csv(table, index=False)
    rows, _ = figures_of(folder)
    ref = [pd.read_csv(folder / f"results/tiny/{cube}reference_flow.csv") for cube in ("", "cube_1/")]
    ref = pd.concat(ref)
    truth = ref.loc[ref["method"] == flow["method"].iloc[-1], "k_md"].mean()
    assert rows.loc[("full", "k_ratio"), "mean"] == pytest.approx(rows.loc[("full", "k_md"), "mean"] / truth)
    assert rows.loc[("full", "k_md"), "mean"] != whole.loc[("full", "k_md"), "mean"]


def test_more_judges_make_no_twin_anew(studied):
    more = {**TINY, "case": "stereology", "reference_cubes": 3, "samples": TINY["samples"]}
    write_config(studied, more, "more.yaml")
    measured = dict.fromkeys(("reference_network", "reference_flow", "reference_s2"), 2)
    measured |= {"reference_envelope": 1, "further_cubes": 1}
    jobs = planned(studied, "--", "case", config="more.yaml")
    assert jobs | measured == jobs
    assert set(jobs) <= {*measured, "case"}
    sweep = {**SWEEP, "truths": 2, "cv": [0.3, 0.5]}
    write_config(studied, {**TINY, "case": "cv_sweep", "cv_sweep": sweep}, "more.yaml")
    jobs = planned(studied, "--", "case", config="more.yaml")
    assert jobs == {"size_bias_truth": 3, "size_bias_packs": 3 * 2, "case": 1}
    write_config(studied, {**TINY, "case": "cv_sweep", "cv_sweep": SWEEP, "realizations": 3}, "more.yaml")
    assert planned(studied, "--", "case", config="more.yaml") == {"size_bias_packs": 1, "case": 1}


def test_samples_of_a_case_may_stand_in_a_sheet(studied, tmp_path):
    """The names of the sheet's rows, not the letters of its path."""
    folder = shutil.copytree(studied, tmp_path / "copy")
    (folder / "s.tsv").write_text("sample\tkind\tpixel_size_um\ntiny\tsynthetic\t2\n")
    write_config(folder, {**TINY, "case": "xct", "samples": "s.tsv"}, "sheet.yaml")
    (folder / "results/validation.csv").unlink()
    done = snakemake(folder, "--", "results/validation.csv", config="sheet.yaml")
    assert done.returncode == 0, done.stdout[-3000:]
    assert "xct" in set(pd.read_csv(folder / "results/validation.csv")["case"])


@pytest.fixture
def published(tmp_path):
    """A zip with a volume, behind a server of our own: its address and checksum."""
    rng = np.random.default_rng(1)
    volume = np.where(rng.random((24, 30, 36)) < 0.3, 0, 255).astype(np.uint8)
    served = tmp_path / "served"
    served.mkdir()
    tifffile.imwrite(served / "rock.tif", volume)
    with zipfile.ZipFile(served / "rock.zip", "w") as archive:
        archive.write(served / "rock.tif", "rock.tif")
    digest = hashlib.sha256((served / "rock.zip").read_bytes()).hexdigest()

    class Quiet(http.server.SimpleHTTPRequestHandler):
        def __init__(self, *arguments):
            super().__init__(*arguments, directory=str(served))

        def log_message(self, *_):
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Quiet)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}/rock.zip", digest, served / "rock.zip", volume
    server.shutdown()


@pytest.mark.parametrize("how", ["address", "path", "damaged"])
def test_a_published_volume_is_fetched_checked_and_cut(tmp_path, published, how):
    address, digest, path, volume = published
    rock = {
        "source": str(path) if how == "path" else address,
        "voxel_size_um": 5.0,
        "files": {"0" * 64 if how == "damaged" else digest: 0},
    }
    cut = {"cut": {"kind": "slice", "data": "rock", "slice": "y7"}}
    config = {**TINY, "case": "berea", "samples": cut, "data": {"rock": rock}}
    folder = write_config(tmp_path / "run", config)
    done = snakemake(folder, "--", "results/cut/section.zarr.zip")
    if how == "damaged":
        assert done.returncode != 0
        assert f"has SHA-256 {digest}" in done.stdout
        assert "Traceback" not in done.stdout
        assert not (folder / "results/data/rock/reference.zarr.zip").exists()
        return
    assert done.returncode == 0, done.stdout[-4000:]
    phase, attributes = read_volume(folder / "results/cut/section.zarr.zip")
    assert attributes["voxel_size_um"] == 5.0
    assert (phase == (volume[:, 7] > 0)).all()
    if how == "path":
        # the case holds such a section against slices of its volume, too
        test = "results/cut/reference_envelope.json"
        done = snakemake(folder, "--", test)
        assert done.returncode == 0, done.stdout[-4000:]
        assert read_json(folder / test)["n_volumes"] == 1
    # from now on it matters neither where it came from nor whether that can be reached
    elsewhere = shutil.copy(path, tmp_path / "elsewhere.zip")
    for source in ("http://127.0.0.1:9/rock.zip", str(elsewhere)):
        rock["source"] = source
        write_config(folder, config)
        assert planned(folder, "--", "results/cut/section.zarr.zip") == {}
