"""The section: what is read, what is refused, and that a damaged file never goes unnoticed."""

from __future__ import annotations

import gc
import io
import json
import pickle
import struct
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest
import tifffile
import zarr
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

from grainfall.errors import InputError
from grainfall.section import (
    Section,
    guess_kind,
    load_section,
    read_reference,
    read_section,
    stated_pixel_um,
    write_section,
)

VALUES = np.array([[0, 128, 255, 255], [0, 0, 128, 255], [128, 0, 0, 0]], np.uint8)
PHASES = {"pore": 0, "quartz": 128, "feldspar": 255}
EXPECTED = np.array([[0, 1, 2, 2], [0, 0, 1, 2], [1, 0, 0, 0]])


def save(path: Path, image: np.ndarray, name: str = "phase") -> Path:
    """Write an image in the format of the path's suffix."""
    if path.name.endswith(".zarr.zip"):
        store = zarr.storage.ZipStore(path, mode="w")
        zarr.create_group(store).create_array(name, data=image, chunks=(2, 2))
        store.close()
    elif path.suffix == ".zarr":
        zarr.create_group(path).create_array(name, data=image)
    elif path.suffix == ".npz":
        np.savez_compressed(path, **{name: image})
    elif path.suffix == ".npy":
        np.save(path, image)
    elif path.suffix == ".tif":
        tifffile.imwrite(path, image)
    elif path.suffix == ".tiff":
        Image.fromarray(image).save(path, compression="tiff_lzw")
    else:
        Image.fromarray(image).save(path)
    return path


FORMATS = ["a.png", "a.tif", "a.tiff", "a.npy", "a.npz", "a.zarr", "a.zarr.zip"]


def refuse(match: str, *args, **kwargs) -> None:
    """One line that says what is wrong, and nothing of the decoder behind it."""
    with pytest.raises(InputError, match=match) as caught:
        read_section(*args, **kwargs)
    assert caught.value.__cause__ is None
    assert caught.value.__suppress_context__ or caught.value.__context__ is None
    assert caught.value.right


# --- what is read -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_gives_the_same_phases(tmp_path, name):
    section = read_section(save(tmp_path / name, VALUES), "phases", 2.5, PHASES)
    assert section.phases == ("pore", "quartz", "feldspar")
    assert section.pixel_size_um == 2.5
    assert section.phase.dtype == np.uint8
    np.testing.assert_array_equal(section.phase, EXPECTED)
    assert section.fractions == {"pore": 6 / 12, "quartz": 3 / 12, "feldspar": 3 / 12}
    assert section.porosity == 0.5
    assert section.phase.flags.writeable


@pytest.mark.parametrize("dtype", ["<u2", ">u2", "<i4", ">f4", "<f8"])
@pytest.mark.parametrize("name", ["a.tif", "a.npz", "a.npy"])
def test_number_type_and_byte_order_do_not_matter(tmp_path, name, dtype):
    section = read_section(save(tmp_path / name, VALUES.astype(dtype)), "phases", 1, PHASES)
    np.testing.assert_array_equal(section.phase, EXPECTED)


@pytest.mark.parametrize("name", FORMATS)
def test_boolean_images(tmp_path, name):
    section = read_section(save(tmp_path / name, VALUES > 0), "binary", 1)
    np.testing.assert_array_equal(section.phase, EXPECTED > 0)


def test_minerals_are_numbered_as_declared_and_values_may_share_a_phase(tmp_path):
    path = save(tmp_path / "a.png", VALUES)
    section = read_section(path, "phases", 1, {"feldspar": 255, "quartz": 128, "pore": 0})
    assert section.phases == ("pore", "feldspar", "quartz")
    np.testing.assert_array_equal(section.phase == 1, VALUES == 255)
    section = read_section(path, "binary", 1, {"pore": 0, "grain": [128, 255]})
    np.testing.assert_array_equal(section.phase, VALUES > 0)


def test_a_list_of_phases_means_value_is_position(tmp_path):
    path = save(tmp_path / "a.png", EXPECTED.astype(np.uint8))
    np.testing.assert_array_equal(read_section(path, "phases", 1, ["pore", "a", "b"]).phase, EXPECTED)
    section = read_section(path, "phases", 1, ["a", "pore", "b"])
    assert section.phases == ("pore", "a", "b")
    np.testing.assert_array_equal(section.phase == 0, EXPECTED == 1)
    np.testing.assert_array_equal(section.phase == 1, EXPECTED == 0)


def test_phases_by_default_are_pore_and_minerals_in_ascending_order(tmp_path):
    section = read_section(save(tmp_path / "a.png", VALUES), "phases", 1)
    assert section.phases == ("pore", "mineral_1", "mineral_2")
    np.testing.assert_array_equal(section.phase, EXPECTED)


def test_lower_value_of_a_binary_image_is_pore_unless_said_otherwise(tmp_path):
    path = save(tmp_path / "a.png", np.where(VALUES > 0, 200, 7).astype(np.uint8))
    np.testing.assert_array_equal(read_section(path, "binary", 1).phase, VALUES > 0)
    np.testing.assert_array_equal(read_section(path, "binary", 1, pore_value=200).phase, VALUES == 0)
    refuse("does not occur", path, "binary", 1, pore_value=8)


def test_instances_keep_their_outlines_and_are_numbered_without_gaps(tmp_path):
    labels = np.array([[0, 5, 5, 0], [9, 9, 0, 70000]])
    section = read_section(save(tmp_path / "a.npz", labels, "labels"), "instances", 1)
    assert section.instances.dtype == np.int32
    np.testing.assert_array_equal(section.instances, [[0, 1, 1, 0], [2, 2, 0, 3]])
    np.testing.assert_array_equal(section.phase, labels > 0)
    assert section.phases == ("pore", "grain")
    assert section.notes == {"instances_renumbered": True}
    section = read_section(save(tmp_path / "b.npz", labels), "instances", 1, ["pore", "quartz"], pore_value=9)
    np.testing.assert_array_equal(section.instances, [[1, 2, 2, 1], [0, 0, 1, 3]])
    assert section.phases == ("pore", "quartz")


def test_the_kind_is_judged_from_the_pixels(tmp_path):
    """Balls on a grid: numbered, as two minerals, as solid, as a noisy photograph."""
    y, x = np.mgrid[:96, :96]
    numbered = (1 + 8 * (y // 12) + x // 12) * (np.hypot(y % 12 - 6, x % 12 - 6) < 5)
    minerals = np.where(numbered > 0, 1 + numbered % 2, 0)
    noise = np.random.default_rng(0).normal(0, 8, numbered.shape)
    images = {
        "instances": numbered.astype(np.uint16),
        "phases": (100 * minerals).astype(np.uint8),
        "binary": np.where(minerals > 0, 7, 3).astype(np.uint8),
        "grey": np.clip(40 + 70 * minerals + noise, 0, 255).astype(np.uint8),
    }
    for kind, image in images.items():
        found, reason = guess_kind(save(tmp_path / f"{kind}.png", image))
        assert found == kind
        assert reason
        assert read_section(tmp_path / f"{kind}.png", found, 1.0).porosity > 0.2
    assert guess_kind(save(tmp_path / "grey.npy", 0.5 + noise))[0] == "grey"
    with pytest.raises(InputError, match="one value only"):
        guess_kind(save(tmp_path / "flat.png", np.full((9, 9), 5, np.uint8)))


def test_several_arrays_need_a_name(tmp_path):
    path = tmp_path / "a.npz"
    np.savez(path, one=VALUES, two=VALUES // 2)
    refuse(
        "2 arrays \\(one, two\\); .*phase or phases; of a sample's image its name: array", path, "phases", 1
    )
    refuse("no array 'three'; it has: one, two", path, "phases", 1, array="three")
    section = read_section(path, "phases", 1, {"pore": 0, "a": 64, "b": 127}, array="two")
    np.testing.assert_array_equal(section.phase, EXPECTED)


@pytest.mark.parametrize("scale", [1, 1 / 255])
def test_one_hot_pixel_does_not_decide_what_is_pore(tmp_path, scale):
    rng = np.random.default_rng(0)
    pore = rng.random((60, 60)) < 0.3
    grey = scale * np.rint(np.where(pore, 90, 180) + rng.normal(0, 8, pore.shape))
    grey = grey.astype(np.uint16 if scale == 1 else np.float32)
    grey[7, 7] = 65535 if scale == 1 else 60
    tifffile.imwrite(tmp_path / "a.tif", grey)
    found = read_section(tmp_path / "a.tif", "grey", 1.0).phase == 0
    pore[7, 7] = False
    assert (found == pore).all()


def test_multi_otsu_finds_separated_modes_exactly(tmp_path, request):
    rng = np.random.default_rng(5)
    classes = rng.integers(0, 3, (40, 50))
    grey = np.array([30, 120, 210])[classes] + rng.integers(-20, 21, classes.shape)
    path = save(tmp_path / "a.png", grey.astype(np.uint8))
    section = read_section(path, "grey", 1, ["pore", "quartz", "feldspar"])
    np.testing.assert_array_equal(section.phase, classes)
    np.testing.assert_array_equal(section.grey, grey)
    low, high = section.notes["multi_otsu_thresholds"]
    assert 50 <= low < 100
    assert 140 <= high < 190
    assert read_section(path, "grey", 1, classes=3).phases == ("pore", "mineral_1", "mineral_2")
    # The brightest is pore: the mapping gives the class, 0 the darkest.
    section = read_section(path, "grey", 1, {"pore": 2, "quartz": [0, 1]})
    np.testing.assert_array_equal(section.phase, classes < 2)
    # Sixteen bits and floats only change the scale.
    for scaled in (grey.astype(np.uint16) * 200, grey / 255):
        path = save(tmp_path / "b.tif", scaled)
        again = read_section(path, "grey", 1, ["pore", "quartz", "feldspar"])
        np.testing.assert_array_equal(again.phase, classes)
        assert again.grey.dtype == np.uint16
    assert again.notes["grey_rescaled_from"] == [scaled.min(), scaled.max()]
    # What goes by grey goes by the file's own scale.
    np.testing.assert_allclose(again.grey_as_given, scaled, atol=1e-5)
    np.testing.assert_allclose(again.notes["multi_otsu_thresholds"], np.array([low, high]) / 255, atol=0.1)


def test_two_levels_are_split_between_them(tmp_path):
    section = read_section(
        save(tmp_path / "a.png", np.where(VALUES > 0, 101, 100).astype(np.uint8)), "grey", 1
    )
    np.testing.assert_array_equal(section.phase, VALUES > 0)
    assert section.notes["multi_otsu_thresholds"] == [100]


def test_a_grey_image_may_accompany_the_outlines(tmp_path):
    labels = save(tmp_path / "a.npz", EXPECTED, "labels")
    section = read_section(labels, "instances", 1, grey=save(tmp_path / "g.png", VALUES))
    np.testing.assert_array_equal(section.grey, VALUES)
    refuse("equal sizes", labels, "instances", 1, grey=save(tmp_path / "h.png", VALUES[:2]))


@pytest.mark.parametrize("compression", [None, "raw", "tiff_lzw"])
def test_values_are_those_stored_also_where_white_is_zero(tmp_path, compression):
    if compression is None:
        tifffile.imwrite(tmp_path / "a.tif", VALUES, photometric="miniswhite")
    else:
        Image.fromarray(255 - VALUES).save(tmp_path / "a.tif", compression=compression, tiffinfo={262: 0})
        with tifffile.TiffFile(tmp_path / "a.tif") as tif:
            assert tif.pages.first.photometric == tifffile.PHOTOMETRIC.MINISWHITE
    np.testing.assert_array_equal(read_section(tmp_path / "a.tif", "phases", 1, PHASES).phase, EXPECTED)


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("compression", ["raw", "tiff_lzw"])
def test_values_are_where_they_are_stored_also_where_viewers_turn_them(tmp_path, compression, orientation):
    image = Image.fromarray(VALUES)
    image.save(tmp_path / "a.tif", compression=compression, tiffinfo={274: orientation})
    np.testing.assert_array_equal(read_section(tmp_path / "a.tif", "phases", 1, PHASES).phase, EXPECTED)


def test_palette_indices_are_labels_but_not_grey(tmp_path):
    image = Image.fromarray(EXPECTED.astype(np.uint8), mode="P")
    image.putpalette([0, 0, 0, 255, 0, 0, 0, 0, 255])
    image.save(tmp_path / "a.png")
    np.testing.assert_array_equal(read_section(tmp_path / "a.png", "phases", 1).phase, EXPECTED)
    refuse("palette", tmp_path / "a.png", "grey", 1)


@pytest.mark.parametrize("name", ["a.png", "a.tif"])
def test_labels_whose_lowest_is_not_darkest_need_names(tmp_path, name):
    """A program that orders its palette by itself puts the black pore anywhere."""
    stored = np.array([2, 0, 1], np.uint8)[EXPECTED]
    if name == "a.png":
        image = Image.fromarray(stored, mode="P")
        image.putpalette([255, 255, 0, 255, 0, 0, 0, 0, 0])
        image.save(tmp_path / name)
    else:
        tifffile.imwrite(tmp_path / name, stored, photometric="miniswhite")
    refuse("its lowest value, 0, would be the pore, and is not the darkest", tmp_path / name, "phases", 1)
    section = read_section(tmp_path / name, "phases", 1, {"pore": 2, "a": 0, "b": 1})
    np.testing.assert_array_equal(section.phase, EXPECTED)


def test_binary_image_that_looks_inverted_needs_a_word(tmp_path):
    """By stored value the pore would be what everybody sees as grain."""
    seen = EXPECTED > 0
    stored = (~seen).astype(np.uint8)
    image = Image.fromarray(stored, mode="P")
    image.putpalette([255, 255, 255, 0, 0, 0])
    image.save(tmp_path / "a.png")
    tifffile.imwrite(tmp_path / "a.tif", stored * np.uint8(255), photometric="miniswhite")
    for name, pore, why in (("a.png", 1, "palette"), ("a.tif", 255, "0 as white")):
        refuse(why, tmp_path / name, "binary", 1)
        section = read_section(tmp_path / name, "binary", 1, pore_value=pore)
        np.testing.assert_array_equal(section.phase > 0, seen)
    refuse("0 as white", tmp_path / "a.tif", "grey", 1)


def test_bilevel_scans_that_show_zero_as_white_need_a_word(tmp_path):
    """Fax and scanner software stores them so; only Python's booleans are marked so whatever they mean."""
    Image.fromarray(EXPECTED == 0).save(tmp_path / "a.tif", tiffinfo={262: 0})
    with tifffile.TiffFile(tmp_path / "a.tif") as tif:
        assert (tif.pages.first.photometric, tif.pages.first.bitspersample) == (0, 1)
    refuse("0 as white", tmp_path / "a.tif", "binary", 1)


def test_a_tiff_of_lossy_compression_is_refused(tmp_path):
    discs = np.uint8(np.add.outer(np.arange(64) % 16, np.arange(64) % 16) > 12) * 200
    Image.fromarray(discs).save(tmp_path / "a.tif", compression="jpeg")
    refuse("JPEG compression, which may alter values", tmp_path / "a.tif", "instances", 1)


def test_a_tiff_of_nibbles_says_what_is_needed(tmp_path):
    tifffile.imwrite(tmp_path / "a.tif", EXPECTED.astype(np.uint8))
    data = bytearray((tmp_path / "a.tif").read_bytes())
    with tifffile.TiffFile(tmp_path / "a.tif") as tif:
        at = tif.pages.first.tags["BitsPerSample"].valueoffset
    data[at] = 4
    (tmp_path / "b.tif").write_bytes(data)
    refuse("4 bits a sample", tmp_path / "b.tif", "phases", 1)


def test_half_precision_labels_are_read_in_silence(tmp_path, recwarn):
    section = read_section(save(tmp_path / "a.npy", EXPECTED.astype(np.float16)), "phases", 1)
    np.testing.assert_array_equal(section.phase, EXPECTED)
    assert not recwarn.list


def test_zarr_folder_that_lost_a_chunk_is_refused(tmp_path):
    """Absent chunks read as 0, the pore: half a section would pass for a porous one."""
    group = zarr.open_group(tmp_path / "a.zarr", mode="w")
    array = group.create_array(
        "phase", shape=VALUES.shape, dtype="u1", chunks=(2, 2), config={"write_empty_chunks": True}
    )
    array[...] = (VALUES > 0) + 1
    chunk = sorted((tmp_path / "a.zarr/phase/c").rglob("*"))[-1]
    read_section(tmp_path / "a.zarr", "binary", 1)
    chunk.unlink()
    refuse("chunks are absent", tmp_path / "a.zarr", "binary", 1)


def test_the_zip_of_a_section_gives_it_back_and_depends_on_nothing_else(tmp_path):
    section = Section(
        EXPECTED.astype(np.uint8), 2.5, tuple(PHASES), EXPECTED.astype(np.int32), VALUES, {"thresholds": [3]}
    )
    for name in ("a.zarr.zip", "b.zarr.zip"):
        write_section(tmp_path / name, section)
    assert (tmp_path / "a.zarr.zip").read_bytes() == (tmp_path / "b.zarr.zip").read_bytes()
    again = load_section(tmp_path / "a.zarr.zip")
    for name in ("phase", "instances", "grey"):
        np.testing.assert_array_equal(getattr(again, name), getattr(section, name))
        assert getattr(again, name).dtype == getattr(section, name).dtype
    assert (again.pixel_size_um, again.phases, again.notes) == (2.5, tuple(PHASES), {"thresholds": [3]})
    # The file is an input like any other.
    np.testing.assert_array_equal(
        read_section(tmp_path / "a.zarr.zip", "instances", 2.5).instances, section.instances
    )


# --- what is refused ----------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [None, 0, -1.0, float("nan"), float("inf"), "1 um", True, [1]])
def test_pixel_size(tmp_path, size):
    refuse("^pixel_size_um: .*micrometres", save(tmp_path / "a.png", VALUES), "phases", size, PHASES)


@pytest.mark.parametrize("channels", [3, 4])
@pytest.mark.parametrize("name", ["a.png", "a.tif", "a.npy", "a.zarr"])
@pytest.mark.parametrize("kind", ["grey", "binary", "instances"])
def test_colour(tmp_path, name, channels, kind):
    image = np.random.default_rng(1).integers(0, 255, (6, 7, channels), np.uint8)
    refuse("one grey or label channel", save(tmp_path / name, image), kind, 1)


@pytest.mark.parametrize("depth", [1, 2, 4])
def test_grey_of_few_bits_is_read_as_stored(tmp_path, depth):
    """Pillow writes no such files; label maps of three minerals come so."""
    stored = np.arange(2**depth, dtype=np.uint8).repeat(8).reshape(-1, 8)
    bits = np.unpackbits(stored[..., None], axis=-1)[..., -depth:].reshape(len(stored), -1)
    lines = b"".join(b"\0" + np.packbits(line).tobytes() for line in bits)

    def chunk(name, content):
        return (
            struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content))
        )

    head = struct.pack(">IIBBBBB", 8, len(stored), depth, 0, 0, 0, 0)
    parts = chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(lines)) + chunk(b"IEND", b"")
    (tmp_path / "few.png").write_bytes(b"\x89PNG\r\n\x1a\n" + parts)
    phases = ["pore", *(f"m{i}" for i in range(1, 2**depth))]
    np.testing.assert_array_equal(read_section(tmp_path / "few.png", "phases", 1, phases).phase, stored)


def test_phase_mistakes(tmp_path):
    path = save(tmp_path / "a.png", VALUES)
    refuse(
        "values without a phase: 255 \\(3 pixels\\); declared are pore: 0, quartz: 128",
        path,
        "phases",
        1,
        {"pore": 0, "quartz": 128},
    )
    refuse("no pixel of clay", path, "phases", 1, {**PHASES, "clay": 7})
    refuse("lack pore", path, "phases", 1, {"quartz": 128, "feldspar": 255})
    refuse("lack pore or a mineral", path, "phases", 1, {"pore": 0})
    refuse("0 is also pore", path, "phases", 1, {"pore": 0, "quartz": 0})
    refuse("twice", path, "phases", 1, ["pore", "a", "a"])
    refuse("0.5 is no value", path, "phases", 1, {"pore": 0.5, "quartz": 1})
    refuse("'x' is no value", path, "phases", 1, {"pore": "x", "quartz": 1})
    refuse("no phase has an image value", path, "phases", 1, {"pore": None, "quartz": None})
    refuse("no name", path, "phases", 1, {0: "pore", 1: "quartz"})
    refuse("no list", path, "phases", 1, "pore")
    refuse("'fases' is unknown", path, "fases", 1)
    refuse("no mineral values", path, "instances", 1, PHASES)
    refuse("3 distinct values in a binary image", path, "binary", 1)
    refuse("not for phases", path, "phases", 1, pore_value=0)
    refuse("not for phases", path, "phases", 1, classes=2)
    refuse("2 to 5", path, "grey", 1, classes=6)
    refuse("3 classes named, 2 asked|2 classes", path, "grey", 1, PHASES, classes=2)
    refuse("40 distinct values", save(tmp_path / "b.npy", np.arange(40).reshape(5, 8)), "phases", 1)


def test_declared_phases_may_wait_for_the_rules(tmp_path):
    path = save(tmp_path / "a.npz", EXPECTED, "labels")
    refuse("no pixel of feldspar", path, "instances", 1, list(PHASES))
    section = read_section(path, "instances", 1, list(PHASES), classified_later=True)
    assert section.phases == tuple(PHASES)
    assert set(np.unique(section.phase)) == {0, 1}


@pytest.mark.parametrize("kind", ["instances", "phases", "binary"])
def test_no_pore_and_no_grain(tmp_path, kind):
    refuse("no grain", save(tmp_path / "a.png", np.zeros((4, 4), np.uint8)), kind, 1)
    refuse("no pore", save(tmp_path / "b.png", np.ones((4, 4), np.uint8)), kind, 1)


def test_bad_pixels(tmp_path):
    image = VALUES.astype(float)
    image[1, 2] = np.nan
    for kind in ("phases", "instances", "binary", "grey"):
        refuse(
            "1 pixels are NaN or infinite, the first at \\(1, 2\\)", save(tmp_path / "a.npy", image), kind, 1
        )
    refuse("fractional", save(tmp_path / "b.npy", VALUES + 0.5), "phases", 1)
    refuse("negative", save(tmp_path / "c.npy", EXPECTED - 1), "instances", 1)
    refuse("one grey level|1 grey levels", save(tmp_path / "d.npy", np.full((3, 3), 7.5)), "grey", 1)
    refuse("1 grey levels", save(tmp_path / "d.png", np.full((3, 3), 7, np.uint8)), "grey", 1)


def test_bad_arrays(tmp_path):
    refuse("empty image", save(tmp_path / "a.npy", np.zeros((0, 5), np.uint8)), "phases", 1)
    refuse("5 x 6 x 7", save(tmp_path / "b.npy", np.zeros((5, 6, 7), np.uint8)), "phases", 1)
    refuse("2D image", save(tmp_path / "c.tif", np.zeros((5, 6, 7), np.uint8)), "phases", 1)
    refuse("2D image", save(tmp_path / "d.npy", np.zeros(5, np.uint8)), "phases", 1)
    refuse("plain integers", save(tmp_path / "e.npy", np.zeros((5, 5), complex)), "phases", 1)
    np.save(tmp_path / "f.npy", np.array([[{}]], object), allow_pickle=True)
    refuse("plain integers", tmp_path / "f.npy", "phases", 1)
    tifffile.imwrite(tmp_path / "g.tif", VALUES)
    tifffile.imwrite(tmp_path / "g.tif", VALUES[:2], append=True)
    refuse("2 different images", tmp_path / "g.tif", "phases", 1)
    zarr.create_group(tmp_path / "h.zarr")
    refuse("0 arrays", tmp_path / "h.zarr", "phases", 1)


def test_bad_files(tmp_path):
    refuse("no such file", tmp_path / "none.png", "grey", 1)
    refuse("directory without Zarr", tmp_path, "grey", 1)
    for name, content, match in [
        ("empty.png", b"", "an empty file"),
        ("text.tif", b"not an image at all", "not an image"),
        ("photo.png", b"\xff\xd8\xff\xe0" + bytes(50), "JPEG"),
        ("notes.npz", None, "neither NumPy nor Zarr"),
    ]:
        if content is None:
            with zipfile.ZipFile(tmp_path / name, "w") as archive:
                archive.writestr("readme.txt", "hello")
        else:
            (tmp_path / name).write_bytes(content)
        refuse(match, tmp_path / name, "grey", 1)


class Touch:
    """Unpickling it creates a file."""

    def __init__(self, path: Path):
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


@pytest.mark.parametrize("key", ["filters", "compressor"])
def test_nothing_is_ever_unpickled(tmp_path, key):
    """A Zarr v2 codec can unpickle whatever the chunks hold."""
    array = zarr.create_array(
        tmp_path / "a.zarr", shape=(4, 4), dtype="u1", zarr_format=2, compressors=None, fill_value=0
    )
    array[...] = 1
    header = tmp_path / "a.zarr" / ".zarray"
    content = json.loads(header.read_text())
    content[key] = [{"id": "pickle"}] if key == "filters" else {"id": "pickle"}
    header.write_text(json.dumps(content))
    (tmp_path / "a.zarr" / "0.0").write_bytes(pickle.dumps(Touch(tmp_path / "touched")))
    refuse("pickle", tmp_path / "a.zarr", "phases", 1)
    assert not (tmp_path / "touched").exists()


def png_chunk(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


HUGE = 100_000


def bomb(path: Path) -> Path:
    """A tiny file that declares 1e5 x 1e5 pixels."""
    if path.suffix == ".png":
        header = struct.pack(">IIBBBBB", HUGE, HUGE, 8, 0, 0, 0, 0)
        parts = [
            png_chunk(b"IHDR", header),
            png_chunk(b"IDAT", zlib.compress(b"\0")),
            png_chunk(b"IEND", b""),
        ]
        path.write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(parts))
    elif path.suffix == ".tif":
        tifffile.imwrite(path, VALUES)
        with tifffile.TiffFile(path, mode="r+") as tif:
            for tag in ("ImageWidth", "ImageLength", "RowsPerStrip"):
                tif.pages.first.tags[tag].overwrite(HUGE)
            del tif.pages.first.tags  # the description still says 3 x 4; the reader must not believe either
    elif path.suffix == ".zarr":
        zarr.create_array(path, shape=(HUGE, HUGE), dtype="u1", chunks=(HUGE, HUGE))
    elif path.name.endswith(".zarr.zip"):
        store = zarr.storage.ZipStore(path, mode="w")
        zarr.create_array(store, shape=(HUGE, HUGE), dtype="u1", chunks=(1000, 1000))
        store.close()
    else:
        header = io.BytesIO()
        np.lib.format.write_array_header_1_0(
            header, {"descr": "|u1", "fortran_order": False, "shape": (HUGE, HUGE)}
        )
        if path.suffix == ".npy":
            path.write_bytes(header.getvalue())
        else:
            with zipfile.ZipFile(path, "w") as archive:
                archive.writestr("labels.npy", header.getvalue())
    return path


@pytest.mark.parametrize("name", ["a.png", "a.tif", "a.npy", "a.npz", "a.zarr", "a.zarr.zip"])
def test_a_huge_image_in_a_tiny_file_is_refused_before_decoding(tmp_path, name):
    path = bomb(tmp_path / name)
    refuse("100000 x 100000 pixels are declared|declare more|damaged", path, "binary", 1)


def write_tiff(path: Path, width: int, height: int, byte_count: int) -> None:
    """A minimal TIFF of one strip with eight bytes of pixels, whatever its tags say."""
    tags = [(256, width), (257, height), (258, 8), (259, 1), (262, 1), (273, 8), (277, 1), (278, height)]
    tags = [*tags, (279, byte_count)]
    entries = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in tags)
    header = b"II*\0" + struct.pack("<I", 16) + bytes(8)
    path.write_bytes(header + struct.pack("<H", len(tags)) + entries + bytes(4))


def test_a_plain_tiff_bomb_says_its_size(tmp_path):
    write_tiff(tmp_path / "a.tif", HUGE, HUGE, 8)
    refuse(
        "100000 x 100000 pixels are declared, more than the limit of 2e\\+08", tmp_path / "a.tif", "grey", 1
    )


def test_a_tiff_that_lacks_its_pixels(tmp_path):
    write_tiff(tmp_path / "a.tif", 3, 4, 0)
    refuse("pixels are missing", tmp_path / "a.tif", "grey", 1)


def test_a_zip_bomb_is_refused_by_its_directory(tmp_path):
    path = tmp_path / "a.zarr.zip"
    save(path, VALUES)
    with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("phase/c/9/9", bytes(20_000))
    refuse("declare more bytes", path, "phases", 1, PHASES, max_pixels=1000)


def test_the_limit_is_the_users(tmp_path):
    path = save(tmp_path / "a.png", VALUES)
    refuse("3 x 4 pixels are declared, more than the limit of 11", path, "phases", 1, PHASES, max_pixels=11)
    assert read_section(path, "phases", 1, PHASES, max_pixels=12).phase.shape == (3, 4)


# --- damaged files ------------------------------------------------------------------------------------

LABELS = np.kron(np.array([[0, 1, 2], [3, 0, 4], [5, 6, 0]]), np.ones((5, 4), int)).astype(np.uint8)
FILES = ["a.png", "a.tif", "a.tiff", "a.npy", "a.npz", "a.zarr.zip"]
quick = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture(scope="module")
def originals(tmp_path_factory) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("originals")
    return {name: save(folder / name, LABELS, "labels").read_bytes() for name in FILES}


def read_or_refuse(path: Path, kind: str) -> Section | None:
    """A section, or None where it is refused; any other exception fails the test."""
    try:
        return read_section(path, kind, 1, max_pixels=10_000)
    except InputError:
        return None


@pytest.mark.parametrize("name", FILES)
def test_a_truncated_file_is_refused_or_whole(tmp_path, originals, name, capfd):
    """Never a section that silently lacks some of its pixels, nor anything on the screen."""
    content, path = originals[name], tmp_path / name
    for length in range(0, len(content), 1 if len(content) < 1000 else 37):
        path.write_bytes(content[:length])
        section = read_or_refuse(path, "instances")
        if section is not None:
            np.testing.assert_array_equal(section.instances, LABELS)
    gc.collect()  # a forgotten task complains when it is collected
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("name", ["a.png", "a.npz"])
def test_a_checksum_catches_every_changed_byte(tmp_path, originals, name):
    content, path = originals[name], tmp_path / name
    for position in range(len(content)):
        path.write_bytes(content[:position] + bytes([content[position] ^ 0x41]) + content[position + 1 :])
        section = read_or_refuse(path, "instances")
        if section is not None:
            np.testing.assert_array_equal(section.instances, LABELS)


def test_a_truncated_stack_is_never_a_shorter_one(tmp_path):
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, VOLUME, metadata=None)
    content = path.read_bytes()
    for length in range(len(content)):
        path.write_bytes(content[:length])
        try:
            volume, _ = read_reference(path, 1.0)
        except InputError:
            continue
        assert volume.shape == VOLUME.shape


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("kind", ["instances", "grey"])
@quick
@given(flips=st.lists(st.tuples(st.integers(0, 2**20), st.integers(1, 255)), min_size=1, max_size=4))
def test_flipped_bytes_give_one_line_or_a_section(tmp_path, originals, name, kind, flips):
    content = bytearray(originals[name])
    for position, mask in flips:
        content[position % len(content)] ^= mask
    path = tmp_path / name
    path.write_bytes(content)
    section = read_or_refuse(path, kind)
    if section is not None:
        assert section.phase.dtype == np.uint8
        assert section.phase.ndim == 2
        assert 0 < section.porosity < 1
        assert section.phase.max() < len(section.phases)


@quick
@given(
    content=st.binary(max_size=200),
    head=st.sampled_from([b"", b"\x89PNG\r\n\x1a\n", b"II*\0", b"PK\x03\x04", b"\x93NUMPY"]),
)
def test_any_bytes_at_all(tmp_path, content, head):
    (tmp_path / "a").write_bytes(head + content)
    with pytest.raises(InputError):
        read_section(tmp_path / "a", "instances", 1)


def test_a_zarr_folder_with_a_cut_chunk(tmp_path):
    save(tmp_path / "a.zarr", LABELS, "labels")
    chunk = tmp_path / "a.zarr" / "labels" / "c" / "0" / "0"
    chunk.write_bytes(chunk.read_bytes()[:10])
    refuse("damaged or truncated", tmp_path / "a.zarr", "instances", 1)


# --- the 3D reference ---------------------------------------------------------------------------------

VOLUME = (np.arange(5 * 4 * 6).reshape(5, 4, 6) % 3).astype(np.uint8)


@pytest.mark.parametrize("name", ["a.tif", "a.npy", "a.npz", "a.zarr", "a.raw"])
def test_reference_volumes(tmp_path, name):
    path, raw = tmp_path / name, {}
    if name == "a.raw":
        VOLUME.astype(">u2").tofile(path)
        raw = {"shape": [5, 4, 6], "dtype": ">u2"}
    elif name == "a.zarr":
        zarr.create_array(path, data=VOLUME)
    else:
        save(path, VOLUME)
    volume, size = read_reference(path, 3, pore_value=1, **raw)
    assert size == 3.0
    assert volume.dtype == np.uint8
    np.testing.assert_array_equal(volume, VOLUME != 1)
    volume, _ = read_reference(path, 3, phases={"pore": 2, "a": 0, "b": 1}, **raw)
    np.testing.assert_array_equal(volume, np.array([1, 2, 0])[VOLUME])


def test_reference_mistakes(tmp_path):
    path = tmp_path / "a.raw"
    VOLUME.tofile(path)
    for match, kwargs in [
        ("no voxel size", {"voxel_size_um": None}),
        ("no header", {}),
        ("both their shape and their type", {"shape": [5, 4, 6]}),
        ("120 bytes, but 5 x 4 x 7 voxels of uint8 are 140", {"shape": [5, 4, 7], "dtype": "uint8"}),
        ("no number type", {"shape": [5, 4, 6], "dtype": "uint9"}),
        ("plain integers", {"shape": [5, 4, 6], "dtype": "O"}),
        ("three positive", {"shape": [4, 30], "dtype": "uint8"}),
        ("more than the limit", {"shape": [10**5] * 3, "dtype": "uint8"}),
        ("no pore", {"shape": [5, 4, 6], "dtype": "uint8", "pore_value": 9}),
    ]:
        with pytest.raises(InputError, match=match):
            read_reference(path, **{"voxel_size_um": 1.0, **kwargs})
    with pytest.raises(InputError, match="3D volume"):
        read_reference(save(tmp_path / "b.png", VALUES), 1.0)
    with pytest.raises(InputError, match="no such file"):
        read_reference(tmp_path / "none.raw", 1.0, shape=[5, 4, 6], dtype="uint8")


# --- real data ----------------------------------------------------------------------------------------


def test_the_outlined_sandstone(shared_data):
    """Published areal pore + matrix 0.309, 448 grains; the class image outlines the same grains."""
    folder = shared_data / "thin_section"
    outlined = read_section(folder / "miocene_20_2_instances.npz", "instances", 1.0)
    assert outlined.porosity == pytest.approx(0.309, abs=5e-4)
    assert outlined.phase.shape == (1700, 2624)
    assert outlined.instances.max() == 448
    classes = read_section(folder / "miocene_20_2_mask.png", "binary", 1.0, {"pore": 0, "grain": [1, 2]})
    # The class image adds an outer boundary: what is grain in the outlines stays grain.
    assert classes.porosity < outlined.porosity
    assert (classes.phase[outlined.phase == 1] == 1).mean() > 0.98


def test_a_plate_is_no_reference(tmp_path):
    thin = np.zeros((3, 20, 20), np.uint8)
    thin[:, :10] = 1
    with pytest.raises(InputError, match="3 x 20 x 20 voxels are no volume to judge a twin by"):
        read_reference(save(tmp_path / "a.npy", thin), 1.0)


def test_the_berea_volume(shared_data):
    volume, _ = read_reference(shared_data / "berea" / "berea_400_pore1.tif", 5.345, pore_value=1)
    assert volume.shape == (400, 400, 400)
    assert (volume == 0).mean() == pytest.approx(0.196453, abs=5e-7)


@pytest.mark.parametrize(
    ("options", "stated"),
    [
        ({"imagej": True, "resolution": (0.5, 0.5), "metadata": {"unit": "um"}}, (2, 2)),
        ({"imagej": True, "resolution": (500, 1000), "metadata": {"unit": r"\u00B5m"}}, (0.002, 0.001)),
        ({"imagej": True, "resolution": (2, 2), "metadata": {"unit": "furlong"}}, None),
        ({"ome": True, "metadata": {"PhysicalSizeX": 0.5, "PhysicalSizeY": 500, "PhysicalSizeYUnit": "nm"}},
         (0.5, 0.5)),
        ({"ome": True, "metadata": {"PhysicalSizeX": 0.5}}, (0.5, 0.5)),
        ({"ome": True, "metadata": {"PhysicalSizeY": 0.5}}, (0.5, 0.5)),
        ({"resolution": (72, 72), "resolutionunit": "INCH"}, None),
    ],
)  # fmt: skip
def test_what_a_tiff_says_of_its_pixels(tmp_path, options, stated):
    path = tmp_path / "section.tif"
    tifffile.imwrite(path, np.eye(8, dtype=np.uint8), **options)
    assert stated_pixel_um(path) == (pytest.approx(stated) if stated else None)


def test_grains_that_a_crack_parts_are_instances_all_the_same(tmp_path):
    y, x = np.mgrid[:96, :96]
    numbered = (1 + 8 * (y // 12) + x // 12) * (np.hypot(y % 12 - 6, x % 12 - 6) < 5)
    numbered[[6, 30, 54]] = 0  # three rows of eight grains are cracked: 88 pieces of 64 grains
    np.save(tmp_path / "a.npy", numbered.astype(np.uint16))
    assert guess_kind(tmp_path / "a.npy")[0] == "instances"
