"""Files: equal content gives equal bytes, a failed write leaves what was there."""

import os
import tempfile
import time
import zipfile
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import zarr

from grainfall import io
from grainfall.errors import InputError


def test_names_stay_what_they_are(tmp_path):
    names = ["001", "1", "NA", "nan", "true", "1e3", "None"]
    table = pd.DataFrame({"sample": names, "variant": names[::-1], "k_md": [1.5, np.nan, 3, 4, 5, 1 / 3, 7]})
    io.write_table(tmp_path / "t.csv", table)
    pd.testing.assert_frame_equal(io.read_table(tmp_path / "t.csv"), table, check_exact=True)


@pytest.fixture
def volume():
    return np.arange(60, dtype=np.uint8).reshape(3, 4, 5)


def test_volume_round_trip(tmp_path, volume):
    path = tmp_path / "v.zarr.zip"
    io.write_volume(path, {"phase": volume, "body": volume.astype(np.int32)}, 2.5, {"seed": 7})
    for name, dtype in ((None, np.uint8), ("body", np.int32)):
        array, attributes = io.read_volume(path, name)
        np.testing.assert_array_equal(array, volume)
        assert array.dtype == dtype
    assert attributes["voxel_size_um"] == 2.5
    assert attributes["seed"] == 7
    scale = attributes["ome"]["multiscales"][0]["datasets"][0]["coordinateTransformations"][0]["scale"]
    assert scale == [2.5, 2.5, 2.5]


def test_volume_opens_with_plain_zarr(tmp_path, volume):
    path = tmp_path / "v.zarr.zip"
    io.write_volume(path, {"phase": volume}, 1.0)
    group = zarr.open_group(zarr.storage.ZipStore(path, mode="r"), mode="r")
    np.testing.assert_array_equal(group["phase"][...], volume)


def test_equal_content_gives_equal_bytes_at_any_time(tmp_path, volume):
    io.write_volume(tmp_path / "a.zarr.zip", {"phase": volume}, 1.0)
    time.sleep(2.1)  # zip dates have a resolution of two seconds
    io.write_volume(tmp_path / "b.zarr.zip", {"phase": volume}, 1.0)
    assert (tmp_path / "a.zarr.zip").read_bytes() == (tmp_path / "b.zarr.zip").read_bytes()


def test_slabs_give_the_bytes_of_the_whole_and_are_read_as_it(tmp_path, monkeypatch):
    monkeypatch.setattr(io, "CHUNK", 4)
    body = np.random.default_rng(1).integers(0, 9, (10, 6, 5)).astype(np.int32)
    arrays = {"phase": (body > 0).astype(np.uint8), "body": body}
    io.write_volume(tmp_path / "whole.zarr.zip", arrays, 1.5, {"seed": 7})
    kinds = {"phase": "uint8", "body": "int32"}
    with io.create_volume(tmp_path / "slabs.zarr.zip", body.shape, kinds, 1.5, {"seed": 7}) as target:
        for z in range(0, 10, 4):
            for name, array in arrays.items():
                target[name][z : z + 4] = array[z : z + 4]
    assert (tmp_path / "slabs.zarr.zip").read_bytes() == (tmp_path / "whole.zarr.zip").read_bytes()
    with io.open_volume(tmp_path / "whole.zarr.zip", "body") as (opened, attributes):
        assert (opened.shape, opened.dtype, len(opened)) == (body.shape, body.dtype, 10)
        np.testing.assert_array_equal(opened[3:7], body[3:7])
        np.testing.assert_array_equal(opened[:, 2], body[:, 2])
        assert attributes["voxel_size_um"] == 1.5
    with pytest.raises(RuntimeError), io.create_volume(tmp_path / "half.zarr.zip", (2, 2), {"a": "u1"}, 1.0):
        raise RuntimeError
    assert not (tmp_path / "half.zarr.zip").exists()


@pytest.mark.parametrize("parts", [1, 2, 3, 5])
def test_slabs_in_files_of_their_own_join_to_the_bytes_of_the_whole(tmp_path, monkeypatch, parts):
    """Three layers of chunks: of five slabs, two are empty; the last layer is all pore, and not stored."""
    monkeypatch.setattr(io, "CHUNK", 4)
    body = np.random.default_rng(1).integers(0, 9, (11, 6, 5)).astype(np.int32)
    body[8:] = 0
    arrays = {"phase": (body > 0).astype(np.uint8), "body": body}
    io.write_volume(tmp_path / "whole.zarr.zip", arrays, 1.5, {"seed": 7})
    kinds = {name: array.dtype for name, array in arrays.items()}
    files, cuts = [], [0]
    for part in range(1, parts + 1):
        start, stop = io.slab(len(body), part, parts)
        assert start == cuts[-1]
        cuts.append(stop)
        files.append(tmp_path / f"{part}.zarr.zip")
        with io.create_volume(files[-1], body.shape, kinds, 1.5, {"seed": 7}) as target:
            for name, array in arrays.items():
                target[name][start:stop] = array[start:stop]
    assert cuts[-1] == len(body)
    io.join_volumes(tmp_path / "joined.zarr.zip", files)
    assert (tmp_path / "joined.zarr.zip").read_bytes() == (tmp_path / "whole.zarr.zip").read_bytes()


def test_parts_of_different_volumes_do_not_join(tmp_path, volume):
    io.write_volume(tmp_path / "a.zarr.zip", {"phase": volume}, 1.0, {"seed": 7})
    io.write_volume(tmp_path / "b.zarr.zip", {"phase": volume}, 1.0, {"seed": 8})
    with pytest.raises(InputError, match=r"b\.zarr\.zip: has another zarr\.json than .*parts of one volume"):
        io.join_volumes(tmp_path / "c.zarr.zip", [tmp_path / "a.zarr.zip", tmp_path / "b.zarr.zip"])
    (tmp_path / "b.zarr.zip").write_bytes(b"no zip")
    with pytest.raises(InputError, match=r"b\.zarr\.zip: not a readable volume"):
        io.join_volumes(tmp_path / "c.zarr.zip", [tmp_path / "a.zarr.zip", tmp_path / "b.zarr.zip"])
    assert not (tmp_path / "c.zarr.zip").exists()


def test_failed_write_keeps_the_old_file_and_no_litter(tmp_path):
    path = tmp_path / "t.csv"
    io.write_text(path, "old")
    with pytest.raises(RuntimeError), io.atomic_path(path) as part:
        part.write_text("half")
        raise RuntimeError
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["t.csv"]


@pytest.mark.parametrize("keep", [0, 10, 200])
def test_truncated_volume_is_refused(tmp_path, volume, keep):
    path = tmp_path / "v.zarr.zip"
    io.write_volume(path, {"phase": volume}, 1.0)
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(InputError, match=r"v\.zarr\.zip: not a readable volume"):
        io.read_volume(path)


def test_a_file_that_cannot_be_opened_is_not_to_be_deleted(tmp_path, volume):
    with pytest.raises(InputError, match="cannot be read") as fault:
        io.read_json(tmp_path)  # a folder
    assert "delete" not in str(fault.value)
    io.write_volume(tmp_path / "v.zarr.zip", {"phase": volume}, 1.0)
    with io.open_volume(tmp_path / "v.zarr.zip", "phase") as (array, _), pytest.raises(IndexError):
        array[10_000]  # the caller is wrong, not the file


def test_many_volumes_are_open_one_at_a_time(tmp_path, volume):
    paths = [tmp_path / f"{k}.zarr.zip" for k in range(40)]
    for k, path in enumerate(paths):
        io.write_volume(path, {"phase": volume + k}, 1.0)
    descriptors = Path("/proc/self/fd")
    if not descriptors.is_dir():
        pytest.skip("no list of open files on this system")
    before = len(list(descriptors.iterdir()))
    volumes = io.Volumes(paths, "phase")
    assert len(volumes) == 40
    for k, one in enumerate(volumes):
        np.testing.assert_array_equal(one[0], volume[0] + k)
        assert len(list(descriptors.iterdir())) <= before + 2


def test_foreign_zip_is_one_line(tmp_path):
    path = tmp_path / "v.zarr.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("readme.txt", "no volume")
    with pytest.raises(InputError):
        io.read_volume(path)
    with pytest.raises(InputError, match="no such file"):
        io.read_volume(tmp_path / "none.zarr.zip")


def test_missing_figures_are_empty_cells(tmp_path):
    io.write_table(tmp_path / "t.csv", pd.DataFrame({"a": [1.5, np.nan], "b": ["x", None]}))
    assert (tmp_path / "t.csv").read_text() == "a,b\n1.5,x\n,\n"


def test_table_floats_survive(tmp_path):
    values = np.random.default_rng(1).random(100) * 10.0 ** np.arange(-50, 50)
    io.write_table(tmp_path / "t.csv", pd.DataFrame({"a": values}))
    np.testing.assert_array_equal(io.read_table(tmp_path / "t.csv").a, values)


def test_json_knows_no_nan(tmp_path):
    content = {"a": np.float32("nan"), "b": [1.5, float("inf")], "c": np.arange(2), "d": {"e": None}}
    io.write_json(tmp_path / "j.json", content)
    assert io.read_json(tmp_path / "j.json") == {"a": None, "b": [1.5, None], "c": [0, 1], "d": {"e": None}}


@pytest.mark.parametrize("compressed", [True, False])
def test_arrays_are_read_at_once_or_when_asked_for(tmp_path, compressed):
    path, arrays = tmp_path / "a.npz", {"one": np.arange(5), "two": np.ones((2, 3), np.uint8)}
    io.write_arrays(path, arrays, compressed=compressed)
    for back in (io.read_arrays(path), io.StoredArrays(path)):
        assert sorted(back) == ["one", "two"]
        assert "three" not in back
        for name, array in arrays.items():
            assert back[name].dtype == array.dtype
            np.testing.assert_array_equal(back[name], array)
    path.write_bytes(path.read_bytes()[:-30])
    with pytest.raises(InputError, match=r"a\.npz"):
        io.StoredArrays(path)["one"]


def test_axes_of_a_volume_are_named_in_their_order(tmp_path):
    io.write_volume(tmp_path / "v.zarr.zip", {"phase": np.zeros((3, 4, 5), np.uint8)}, 1.0)
    axes = io.read_volume(tmp_path / "v.zarr.zip")[1]["ome"]["multiscales"][0]["axes"]
    assert [axis["name"] for axis in axes] == ["z", "y", "x"]


def test_only_what_is_old_and_nobodys_is_swept(tmp_path, monkeypatch):
    """A folder is made a moment before it is locked: a young one may be somebody's."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    held = io.Scratch()
    young, old = (tmp_path / f"{io.Scratch.PREFIX}{name}" for name in ("young", "old"))
    for folder in (young, old):
        folder.mkdir()
    for folder in (held.path, old):
        os.utime(folder, (time.time() - 100,) * 2)
    io.Scratch().close()
    assert (held.path.exists(), young.exists(), old.exists()) == (True, True, False)
    held.close()
    assert not held.path.exists()
