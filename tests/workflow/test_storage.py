"""Results on storage elsewhere, by Snakemake's own providers: the same bytes, none in the working folder."""

import shutil
import subprocess
import sys

import boto3
import numpy as np
import pytest
from moto.server import ThreadedMotoServer

from conftest import ROOT, TINY, snakemake, write_config

pytestmark = pytest.mark.xdist_group("storage")

TARGET = "results/tiny/full/scene.json"
BEHIND = ("results/tiny/section.zarr.zip", "results/tiny/labels.zarr.zip", "results/tiny/sizes.csv")


@pytest.fixture(params=["fs", "s3"])
def store(request, tmp_path, monkeypatch):
    """Arguments for Snakemake, and what reads a file of the store."""
    if request.param == "fs":
        if not shutil.which("rsync"):
            pytest.skip("rsync is not installed, which the provider fs copies with")
        prefix = tmp_path / "store"
        yield ("fs", "--default-storage-prefix", prefix), lambda name: (prefix / name).read_bytes()
        return
    for name in ("ACCESS_KEY_ID", "SECRET_ACCESS_KEY"):
        monkeypatch.setenv(f"AWS_{name}", "nobody")
    server = ThreadedMotoServer("127.0.0.1", 0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    endpoint = f"http://{host}:{port}"
    client = boto3.client("s3", endpoint_url=endpoint, region_name="us-east-1")
    client.create_bucket(Bucket="twins")
    yield (
        ("s3", "--default-storage-prefix", "s3://twins", "--storage-s3-endpoint-url", endpoint),
        lambda name: client.get_object(Bucket="twins", Key=name)["Body"].read(),
    )
    server.stop()


def test_the_users_image_is_read_where_it_lies(tmp_path, store):
    y, x = np.mgrid[:120, :120] % 20 - 10
    provider, _ = store
    sample = {"image": "rock.npy", "kind": "binary", "pixel_size_um": 2.0}
    folder = write_config(tmp_path / "work", {**TINY, "samples": {"rock": sample}})
    np.save(folder / "rock.npy", np.hypot(y, x) < 8)
    target = "results/rock/section.json"
    done = snakemake(folder, "--default-storage-provider", *provider, "--", target)
    assert done.returncode == 0, done.stdout[-4000:]


def test_storage_elsewhere_takes_the_results(finished, tmp_path, store):
    provider, read = store
    folder, where = write_config(tmp_path / "work", TINY), ("--default-storage-provider", *provider)
    done = snakemake(folder, *where, "--", TARGET)
    assert done.returncode == 0, done.stdout[-4000:]
    assert not (folder / "results").exists()
    for name in (TARGET, *BEHIND):
        assert read(name) == (finished / name).read_bytes(), name
    again = snakemake(folder, *where, "--dry-run", "--", TARGET)
    assert "Nothing to be done" in again.stdout


def test_what_is_made_of_a_whole_folder_is_left_out(tmp_path, store):
    """A page about nothing, and success, would be worse than none."""
    provider, _ = store
    folder = write_config(tmp_path / "work", TINY)
    done = snakemake(folder, "--default-storage-provider", *provider, "--dry-run")
    assert done.returncode == 0, done.stdout[-4000:]
    assert "rule summary:" in done.stdout
    assert "report_page" not in done.stdout
    assert "provenance:" not in done.stdout.replace("twin_provenance:", "")


def test_a_page_of_results_elsewhere_is_refused():
    """Asked for by name, too."""
    asked = """
import sys; sys.path.insert(0, sys.argv[1])
from types import SimpleNamespace
from _stage import results_folder
print(results_folder(SimpleNamespace(rule="report_page", output=[sys.argv[2]])))
"""

    def said(path):
        command = [sys.executable, "-c", asked, ROOT / "scripts", path]
        done = subprocess.run(command, capture_output=True, text=True)
        return (done.stdout + done.stderr).strip().splitlines()[-1]

    assert said("results/report.html") == "results"
    refused = said(".snakemake/storage/s3/twins/results/report.html")
    assert "report_page: results are on storage elsewhere; copy them to results/ here" in refused
