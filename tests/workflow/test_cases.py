"""The validation cases, tiny: every rule of theirs runs, and the page comes out with what there is."""

import copy
import hashlib
import http.server
import json
import threading
import zipfile

import numpy as np
import pandas as pd
import pytest
import tifffile

from conftest import TINY, snakemake, write_config
from grainfall.io import read_volume
from grainfall.report.validation import COLUMNS

pytestmark = pytest.mark.xdist_group("workflow")

QUICK = {
    "flow": {"methods": ["estimate"]},
    "contacts": {"resettled": 0},
    "correlation": {"slices": 4, "envelope_slices": 19, "chunks": 1},
    "feedback": {"passes": 1},
    "grains": {"shapes_per_phase": 8},
    "scene": {"edge_um": 70.0, "margin_grains": 1},
}


def tiny(case, **over):
    config = {**copy.deepcopy(TINY), **copy.deepcopy(QUICK), "case": case, "realizations": 1}
    for key, value in over.items():
        config[key] = {**config.get(key, {}), **value} if isinstance(value, dict) else value
    return config


@pytest.fixture(scope="module")
def studied(tmp_path_factory):
    """Two tiny cases and the sweep, run one after the other in one folder, then the page."""
    folder = tmp_path_factory.mktemp("cases")
    rock = {"packed_porosity": 0.38, "dissolved": 0, "shape": [48, 160, 160]}
    stereology = tiny(
        "stereology",
        samples={"grown": {"kind": "synthetic", "pixel_size_um": 1.0, "porosity": 0.38}},
        variants={"full": {}, "no_inversion": {"scene": {"sizes_from": "f2d"}}},
        synthetic={**rock, "voxel_size_um": 2.0},
    )
    glass = [{"name": "quartz", "fraction": 1.0, "radius_um": 12.0, "cv": 0.15}]
    xct = tiny(
        "xct",
        samples={"scanned": {"kind": "synthetic", "pixel_size_um": 2.0}},
        synthetic={**rock, "minerals": glass},
        tomogram={"rim_um": 20, "crush_um": 3},
    )
    sweep = {
        "case": "cv_sweep",
        "samples": {"none": {"kind": "synthetic", "pixel_size_um": 1}},
        "cv_sweep": {"cv": [0.3], "truths": 1, "voxels_per_radius": 4, "edge": 32, "section": [80, 80]},
    }
    for name, config in (("stereology", stereology), ("xct", xct), ("sweep", sweep)):
        write_config(folder, config, f"{name}.yaml")
        done = snakemake(folder, "--", "case", config=f"{name}.yaml")
        assert done.returncode == 0, done.stdout[-6000:]
    done = snakemake(folder, "--", "validation", config="stereology.yaml")
    assert done.returncode == 0, done.stdout[-6000:]
    return folder


def test_the_table_has_what_there_is(studied):
    table = pd.read_csv(studied / "results/validation.csv")
    assert tuple(table.columns) == COLUMNS
    row = table.set_index(["case", "variant", "quantity"]).sort_index()
    assert row.loc[("stereology", "full", "k_md"), "paper"] == 1272
    assert row.loc[("stereology", "no_inversion", "k_of_full"), "n"] == 1
    assert {"full", "no_inversion"} <= set(table[table["case"] == "cv_sweep"]["variant"])
    # a single twin has no interval
    twins = table[(table["variant"] == "full") & (table["case"] == "stereology")]
    assert twins["lower"].isna().all()


def test_the_page_names_paper_and_ours(studied):
    page = (studied / "results/validation.html").read_text()
    assert "1\u202f272" in page
    assert "does not hold" in page
    assert "http" not in page.replace("http-equiv", "").replace("http://www.w3.org", "")


def test_figures_are_drawn_in_three_formats(studied):
    for name in (
        "sample1_full",
        "sample1_s2",
        "motivation",
        "sample3_analysis",
        "masks",
        "grain",
        "cv_sweep",
    ):
        sizes = [
            (studied / f"results/validation/{name}.{kind}").stat().st_size for kind in ("svg", "pdf", "png")
        ]
        assert min(sizes) > 5000, name


def test_page_again_does_nothing_and_asks_for_no_twin(studied):
    done = snakemake(studied, "--dry-run", "--", "validation", config="stereology.yaml")
    assert "Nothing to be done" in done.stdout


def test_tomogram_is_measured_as_the_rock_is(studied):
    folder = studied / "results/scanned/tomogram"
    about = json.loads((folder / "tomogram.json").read_text())
    assert 0 < about["phantom"] < 0.5
    assert {"reference_flow.csv", "reference_s2.csv", "s2_envelope.json"} <= {
        p.name for p in folder.iterdir()
    }


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
    config = tiny(
        "berea",
        samples={"cut": {"kind": "slice", "data": "rock", "slice": "y7"}},
        data={
            "rock": {
                "source": str(path) if how == "path" else address,
                "voxel_size_um": 5.0,
                "files": {"0" * 64 if how == "damaged" else digest: 0},
            }
        },
    )
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
