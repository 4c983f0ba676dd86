"""Malformed, hostile and endless inputs: one line, nothing run, nothing lost."""

import gzip
import io
import os
import resource
import subprocess
import sys
import zlib

import fuzz
import numpy as np
import pytest
import tifffile
import zarr
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

from grainfall import config
from grainfall.errors import InputError
from grainfall.section import read_section


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A user's folder with a good image in it, as working directory."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "config").mkdir()
    (tmp_path / "config/samples.tsv").write_bytes((fuzz.ROOT / "config/samples.tsv").read_bytes())
    (tmp_path / "a.png").write_bytes(fuzz.images()["a.png"])
    return tmp_path


def test_two_thousand_malformed_inputs(folder):
    good = fuzz.images()
    truth = np.array(Image.open(io.BytesIO(good["a.png"]))) > 100
    refused = 0
    for kind, name, data in fuzz.cases(2000):
        found = fuzz.try_case(kind, name, data, folder)
        refused += found == "refused" if isinstance(found, str) else 0
        # where a checksum covers the pixels, what is accepted is what was written
        if kind == "image" and name.endswith(fuzz.CHECKED) and not isinstance(found, str):
            np.testing.assert_array_equal(found.phase, truth)
        (folder / "a.png").write_bytes(good["a.png"])
    assert refused > 1000
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss < 2 * 2**20  # KiB


TEXT = st.text(max_size=30) | st.sampled_from(fuzz.NASTY)


@settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(name=TEXT, row=st.dictionaries(st.sampled_from(sorted(fuzz.SAMPLE_SCHEMA["properties"])) | TEXT, TEXT))
def test_names_and_paths_stay_where_they_belong(folder, name, row):
    base = {"kind": "binary", "image": "a.png", "pixel_size_um": 1.0}
    try:
        samples = config.read_samples({name: {**base, **row}}, fuzz.SAMPLE_SCHEMA)
    except InputError as fault:
        assert str(fault).isprintable()
    else:
        assert set(samples) == {name}
        assert name.isascii()
        assert (folder / "results" / name).resolve().parent == (folder / "results").resolve()


@pytest.mark.parametrize(
    "name", ["../a", "a/b", ".", "-rf", "", "a b", "$(touch x)", "<script>", "logs", "GRAINS3D"]
)
def test_no_sample_and_no_variant_is_named_so(name):
    with pytest.raises(InputError, match="is no name"):
        config.read_samples({name: {"kind": "synthetic", "pixel_size_um": 1}}, fuzz.SAMPLE_SCHEMA)
    with pytest.raises(InputError, match="is no name"):
        config.resolve({"samples": "s", "variants": {name: {}}}, fuzz.CONFIG_SCHEMA, fuzz.PRESETS)
    data = {name: {"source": "a.tif", "voxel_size_um": 1, "files": {64 * "a": 0}}}
    with pytest.raises(InputError, match="is no name"):
        config.resolve({"samples": "s", "data": data}, fuzz.CONFIG_SCHEMA, fuzz.PRESETS)


def test_no_phase_is_named_so():
    rules = {"rules": [{"phase": "</script><script>", "feature": "r_um"}]}
    with pytest.raises(InputError, match=r"section\.rules"):
        config.resolve({"samples": "s", "section": rules}, fuzz.CONFIG_SCHEMA, fuzz.PRESETS)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a: 1\na: 2\n", "key 'a' stands there twice"),
        ("samples: {x: {}, x: {}}\n", "twice"),
        ("variants:\n  7: {}\n  007: {}\n", "line 3: 007 is 7 to YAML"),
        ("variants: {7: {}, '7': {}}\n", "twice"),
        ("!!python/object/apply:os.system [touch x]\n", "not YAML"),
        ("a: " + "[" * 2000 + "]" * 2000, "YAML|nested"),
        ("a0: &a0 [x]\n" + "".join(f"a{n}: &a{n} [*a{n - 1}, *a{n - 1}]\n" for n in range(1, 60)), "values"),
        ("a: &a [*a]\n", "YAML|nested"),
        ("\x00", "not YAML"),
        ("__use_yte__: true\na: ?__import__('os').system('touch x')\n", "run as code"),
    ],
)
def test_config_that_would_mislead_or_never_end(folder, text, words):
    (folder / "c.yaml").write_text(text)
    with pytest.raises(InputError, match=words):
        config.load_yaml(folder / "c.yaml")
    assert not (folder / "x").exists()


def test_devices_and_pipes_are_not_waited_for(folder):
    os.mkfifo(folder / "pipe")
    for path in ("/dev/zero", "pipe"):
        with pytest.raises(InputError, match="is no file"):
            config.read_samples(path, fuzz.SAMPLE_SCHEMA)
        with pytest.raises(InputError, match="neither a file nor a folder"):
            config.read_samples(
                {"a": {"kind": "binary", "image": path, "pixel_size_um": 1}}, fuzz.SAMPLE_SCHEMA
            )


def test_braces_would_be_wildcards(folder):
    (folder / "{x}.png").write_bytes((folder / "a.png").read_bytes())
    with pytest.raises(InputError, match="brace"):
        config.read_samples(
            {"a": {"kind": "binary", "image": "{x}.png", "pixel_size_um": 1}}, fuzz.SAMPLE_SCHEMA
        )
    data = {"rock": {"source": "{x}.png", "voxel_size_um": 1, "files": {64 * "a": 0}}}
    with pytest.raises(InputError, match="without braces"):
        config.resolve({"samples": "s", "data": data}, fuzz.CONFIG_SCHEMA, fuzz.PRESETS)


def test_sheet_cells_are_taken_as_they_stand(folder):
    """A # in a path is no comment, one cell too many is no shift, 1_000 is no number."""
    Image.fromarray(np.eye(4, dtype=np.uint8)).save(folder / "scan#2.png")
    header = "# mine\nsample\timage\tkind\tpixel_size_um\tporosity\n"
    (folder / "s.tsv").write_text(header + "a\tscan#2.png\tbinary\t2\t0.3\n")
    row = config.read_samples("s.tsv", fuzz.SAMPLE_SCHEMA)["a"]
    assert (row["image"], row["porosity"]) == ("scan#2.png", 0.3)
    for line, words in (
        ("a\ta.png\tbinary\t2\t0.3\t7\n", "6 cells under 5"),
        ("a\ta.png\tbinary\t1_000\t\n", "1_000"),
    ):
        (folder / "s.tsv").write_text(header + line)
        with pytest.raises(InputError, match=words):
            config.read_samples("s.tsv", fuzz.SAMPLE_SCHEMA)


BOMB = 1_300_000_000


def zeros(window):
    """What unpacks to :data:`BOMB` zeros."""
    packer, block = zlib.compressobj(1, zlib.DEFLATED, window), bytes(25_000_000)
    return b"".join([packer.compress(block) for _ in range(BOMB // len(block))]) + packer.flush()


@pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="the memory of a decoder is bounded on Linux"
)
@pytest.mark.parametrize("kind", ["zarr", "tiff"])
def test_bomb_is_refused_before_it_has_unpacked(folder, kind):
    """A chunk or strip of a few MB that unpacks to more than any machine has."""
    if kind == "zarr":
        path = folder / "b.zarr"
        array = zarr.open_group(path, mode="w").create_array(
            "phase", shape=(64, 64), dtype="u1", chunks=(64, 64), compressors=[zarr.codecs.GzipCodec()]
        )
        array[...] = 1
        chunk = path / "phase/c/0/0"
        assert gzip.decompress(chunk.read_bytes()) == b"\1" * 4096
        chunk.write_bytes(zeros(31))
    else:
        path = folder / "b.tif"
        tifffile.imwrite(path, np.tri(64, dtype=np.uint8), compression="deflate", rowsperstrip=64)
        with tifffile.TiffFile(path) as tif:
            tags = [tif.pages.first.tags[name].valueoffset for name in ("StripOffsets", "StripByteCounts")]
        data, strip = bytearray(path.read_bytes()), zeros(15)
        for place, value in zip(tags, (len(data), len(strip)), strict=True):
            data[place : place + 4] = value.to_bytes(4, "little")
        path.write_bytes(data + strip)
    code = (
        "import resource, sys\n"
        "from grainfall.section import read_section\n"
        "try:\n    read_section(sys.argv[1], 'binary', 1.0)\n"
        "except Exception as fault:\n    print(fault)\n"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)\n"
    )
    said = subprocess.run(
        [sys.executable, "-c", code, path],
        env={**os.environ, "PYTHONPATH": str(fuzz.ROOT / "src")},
        capture_output=True,
        text=True,
    )
    line, peak = said.stdout.splitlines()
    assert "unpacks to far more than the 64 x 64 it declares" in line
    assert said.stderr == ""
    assert int(peak) < 2 * 2**20  # KiB


def test_decoders_get_their_memory_back(folder):
    before = resource.getrlimit(resource.RLIMIT_AS)
    read_section("a.png", "binary", 1.0)
    tifffile.imwrite("a.tif", np.tri(8, dtype=np.uint8))
    read_section("a.tif", "binary", 1.0)
    assert resource.getrlimit(resource.RLIMIT_AS) == before
