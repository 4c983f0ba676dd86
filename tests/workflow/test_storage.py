"""Results on storage elsewhere, by Snakemake's own providers: the same bytes, none in the working folder."""

import shutil

import pytest

from conftest import TINY, snakemake, write_config

pytestmark = pytest.mark.xdist_group("workflow")

TARGET = "results/tiny/full/scene.json"
BEHIND = ("results/tiny/section.zarr.zip", "results/tiny/labels.zarr.zip", "results/tiny/sizes.csv")


def test_a_file_system_elsewhere_takes_the_results(finished, tmp_path):
    if not shutil.which("rsync"):
        pytest.skip("rsync is not installed, which the provider fs copies with")
    folder, store = write_config(tmp_path / "work", TINY), tmp_path / "store"
    where = ("--default-storage-provider", "fs", "--default-storage-prefix", store)
    done = snakemake(folder, *where, "--", TARGET)
    assert done.returncode == 0, done.stdout[-4000:]
    assert not (folder / "results").exists()
    for name in (TARGET, *BEHIND):
        assert (store / name).read_bytes() == (finished / name).read_bytes(), name
    again = snakemake(folder, *where, "--dry-run", "--", TARGET)
    assert "Nothing to be done" in again.stdout
