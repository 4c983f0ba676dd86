"""Malformed images, configs and sample sheets, made from good ones by mutation.

``python tests/faults/fuzz.py --cases 2000`` runs them through the library in one process and fails on
anything but a good result or one line; ``cases(n)`` is what the tests take theirs from.
"""

import argparse
import io
import itertools
import os
import random
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import time
import traceback
import zipfile
import zlib
from pathlib import Path

import numpy as np
import tifffile
import yaml
import zarr
from PIL import Image

from grainfall import config
from grainfall.errors import InputError
from grainfall.section import read_section

ROOT = Path(__file__).resolve().parents[2]
CONFIG_SCHEMA = config.load_yaml(ROOT / "workflow/schemas/config.schema.yaml")
SAMPLE_SCHEMA = config.load_yaml(ROOT / "workflow/schemas/samples.schema.yaml")
PRESETS = config.load_yaml(ROOT / "config/presets.yaml")
CHECKED = ("png", "npz", "zarr.zip")
"""Formats whose checksums cover the pixels: what is accepted must be the image that was written."""

NASTY = [
    *("", " ", "\t", "\x00", "\x1b[31m", "‮", "é" * 40, "a" * 5000, "../../x", "$(touch x)", "`touch x`"),
    *(
        "<script>alert(1)</script>",
        "'; rm -rf x; '",
        "{sample}",
        "{",
        "%s%n",
        "nan",
        ".inf",
        "-1",
        "0",
        "1e400",
    ),
    *(
        "1_000",
        "1,5",
        "null",
        "~",
        "[1",
        "{a: 1}",
        "&a [*a]",
        "!!python/object/apply:os.system [touch x]",
        "off",
    ),
    *(
        "*missing",
        "|",
        "- -",
        "0x7fffffffffffffff",
        "99999999999999999999999",
        "2001-01-01",
        "?",
        '"',
        "a: b: c",
    ),
]


def images():
    """Name to bytes: one small section of 24 x 30 pixels, grains 200 in a pore of 10, in every format."""
    pixels = np.full((24, 30), 10, np.uint8)
    pixels[4:12, 5:14] = pixels[14:20, 18:27] = 200
    found = {}

    def written(name, save):
        stream = io.BytesIO()
        save(stream)
        found[name] = stream.getvalue()

    written("a.png", lambda s: Image.fromarray(pixels).save(s, "PNG"))
    written("b.png", lambda s: Image.fromarray(pixels.astype(np.uint16)).save(s, "PNG"))
    written("c.png", lambda s: Image.fromarray(pixels).quantize(4).save(s, "PNG"))
    written("d.png", lambda s: Image.fromarray(pixels > 100).save(s, "PNG"))
    written("a.tif", lambda s: tifffile.imwrite(s, pixels))
    written("b.tif", lambda s: tifffile.imwrite(s, pixels, compression="deflate", tile=(16, 16)))
    written("c.tif", lambda s: Image.fromarray(pixels).save(s, "TIFF", compression="tiff_lzw"))
    written("d.tif", lambda s: tifffile.imwrite(s, pixels, bigtiff=True, compression="lzma"))
    written("a.npy", lambda s: np.save(s, pixels.astype(np.float32)))
    written("a.npz", lambda s: np.savez_compressed(s, phase=pixels, other=pixels))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.zarr.zip"
        store = zarr.storage.ZipStore(path, mode="w")
        group = zarr.open_group(store, mode="w")
        group.create_array("phase", shape=pixels.shape, dtype="u1", chunks=(16, 16))[...] = pixels
        store.close()
        found["a.zarr.zip"] = path.read_bytes()
    return found


def mutated(data, rng, others):
    """The bytes with one to four things done to them."""
    data = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 4))):
        where = rng.randrange(len(data) + 1)
        # headers are short and matter most
        where = rng.choice((where, min(where, rng.randrange(1, 200))))
        what = rng.randrange(8)
        if what == 0:
            data = data[:where]
        elif what == 1 and where < len(data):
            data[where] ^= 1 << rng.randrange(8)
        elif what == 2:
            data[where : where + 4] = rng.choice(
                (b"\xff\xff\xff\xff", b"\0\0\0\0", b"\x7f\xff\xff\xff", b"\0\1\0\0")
            )
        elif what == 3:
            data[where:where] = rng.randbytes(rng.randrange(1, 40))
        elif what == 4:
            del data[where : where + rng.randrange(1, 60)]
        elif what == 5:
            data[where : where + 30] = data[where // 2 : where // 2 + 30]
        elif what == 6:
            other = rng.choice(others)
            data[where:] = other[where:]
        else:
            data[where : where + 1] = b"PK\x03\x04"[: rng.randrange(1, 5)]
    return bytes(data)


def forged(data, rng):
    """A PNG or a zip with something wrong inside and every checksum right; None for another format."""
    if data.startswith(b"\x89PNG"):
        header = bytearray(data[16:29])
        header[rng.randrange(13)] = rng.choice((0, 1, 2, 3, 7, 16, 255))
        return data[:16] + header + zlib.crc32(b"IHDR" + header).to_bytes(4, "big") + data[33:]
    if data.startswith(b"PK"):
        entries = {}
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            entries = {name: archive.read(name) for name in archive.namelist()}
        name = rng.choice(sorted(entries))
        content = entries[name]
        if name.endswith(".json"):
            old = rng.choice(re.findall(rb"[0-9]+|\"[a-z_]+\"", content))
            new = rng.choice((b"0", b"-1", b"99999999", b"1e9", b"null", b"{}", b"[]", b'"x"', b'"int64"'))
            content = content.replace(old, new, 1)
        else:
            content = mutated(content, rng, [content])
        entries[rng.choice((name, name, "../x", "/x", "phase/c/9/9"))] = content
        stream = io.BytesIO()
        with zipfile.ZipFile(stream, "w") as archive:
            for entry, inside in entries.items():
                archive.writestr(entry, inside)
        return stream.getvalue()
    return None


def mutated_text(text, rng):
    """Lines swapped, doubled, cut; values and keys replaced by what hurts."""
    lines = text.splitlines()
    for _ in range(rng.choice((1, 1, 2, 3))):
        n = rng.randrange(len(lines))
        what = rng.randrange(7)
        if what == 0:
            lines[n] = lines[n].split(":")[0] + ": " + rng.choice(NASTY)
        elif what == 1:
            cells = lines[n].split("\t")
            cells[rng.randrange(len(cells))] = rng.choice(NASTY)
            lines[n] = "\t".join(cells)
        elif what == 2:
            lines.insert(n, lines[rng.randrange(len(lines))])
        elif what == 3:
            lines[n] = lines[n][: rng.randrange(len(lines[n]) + 1)]
        elif what == 4:
            lines[n] = rng.choice(NASTY) + lines[n]
        elif what == 5:
            lines[n] = lines[n].replace(rng.choice("aeiou:- \t{}1"), rng.choice(NASTY))
        else:
            del lines[n]
        lines = lines or [""]
    return "\n".join(lines)


def cases(n, seed=1):
    """n cases: kind (image, forged image, config, sheet), name of what was mutated, bytes."""
    rng = random.Random(seed)
    good = images()
    sheet = "sample\timage\tkind\tpixel_size_um\tphases\tporosity\nrock\ta.png\tbinary\t1.5\t\t0.4\n"
    whole = config.resolve(
        {"samples": {"rock": {"kind": "synthetic", "pixel_size_um": 2}}}, CONFIG_SCHEMA, PRESETS
    )
    configs = [
        (ROOT / "config/config.yaml").read_text(),
        yaml.safe_dump(whole),
        "samples: {rock: {image: a.png, kind: binary, pixel_size_um: 1.2}}\n"
        "variants: {a: {scene: {edge_um: 90}}}\n",
    ]
    for number in range(n):
        kind = ("image", "image", "forged", "config", "sheet")[number % 5]
        if kind == "image":
            name = rng.choice(sorted(good))
            yield kind, name, mutated(good[name], rng, list(good.values()))
        elif kind == "forged":
            name = rng.choice([name for name in sorted(good) if name.endswith(CHECKED)])
            yield kind, name, forged(good[name], rng)
        elif kind == "config":
            yield kind, "config.yaml", mutated_text(rng.choice(configs), rng).encode(errors="replace")
        else:
            yield kind, "samples.tsv", mutated_text(sheet, rng).encode(errors="replace")


def try_case(kind, name, data, folder):
    """Run one case as the workflow would: what came of it, ``refused`` or the result.

    Raises
    ------
    AssertionError
        Where a refusal is more than one printable line, or a result is not sound.
    """
    path = folder / name
    path.write_bytes(data)
    try:
        if kind in ("image", "forged"):
            section = read_section(path, "binary", 1.0)
            assert section.phase.ndim == 2
            assert set(np.unique(section.phase)) == {0, 1}
            return section
        rows = str(path)
        if kind == "config":
            given = config.load_yaml(path)
            whole = config.resolve(given, CONFIG_SCHEMA, PRESETS, str(path))
            assert set(whole) == set(CONFIG_SCHEMA["properties"])
            rows = whole["samples"]
        samples = config.read_samples(rows, SAMPLE_SCHEMA)
        for sample, row in samples.items():
            assert (folder / sample).resolve().parent == folder.resolve()
            assert row["pixel_size_um"] > 0
        return samples
    except InputError as fault:
        assert str(fault).isprintable(), repr(str(fault))
        assert len(str(fault)) < 2000
        return "refused"


def try_command_line(data, folder):
    """What Snakemake says to a config, in a folder that has results: not a trace, and nothing touched."""
    (folder / "c.yaml").write_bytes(data)
    kept = folder / "results/rock/section.zarr.zip"
    kept.parent.mkdir(parents=True, exist_ok=True)
    kept.write_text("kept")
    command = [
        sys.executable,
        "-m",
        "snakemake",
        "--snakefile",
        ROOT / "Snakefile",
        "--cores",
        "1",
        "--dry-run",
    ]
    done = subprocess.run(
        [*command, "--configfile", "c.yaml", "--quiet", "host"],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=60,
    )
    said = done.stdout + done.stderr
    assert "Traceback" not in said, said[-3000:]
    assert kept.read_text() == "kept"
    assert [path.name for path in (folder / "results").rglob("*") if path.is_file()] == [kept.name]
    return "refused" if done.returncode else "accepted"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=2000)
    parser.add_argument("--command-line", type=int, default=50, help="configs that go through Snakemake")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, help="folder for the cases that failed")
    given = parser.parse_args()
    # a bomb ends here, not in the swap of the machine
    resource.setrlimit(resource.RLIMIT_AS, (6 * 2**30, 6 * 2**30))
    good = images()["a.png"]
    truth = np.array(Image.open(io.BytesIO(good))) > 100
    counts, failed, slowest = {}, 0, 0.0
    with tempfile.TemporaryDirectory() as work:
        folder = Path(work)
        os.chdir(folder)
        (folder / "config").mkdir()
        shutil.copy(ROOT / "config/samples.tsv", folder / "config")
        (folder / "a.png").write_bytes(good)
        for number, (kind, name, data) in enumerate(cases(given.cases, given.seed)):
            began = time.monotonic()
            try:
                found = try_case(kind, name, data, folder)
                if kind == "image" and name.endswith(CHECKED) and not isinstance(found, str):
                    assert np.array_equal(found.phase, truth), "another image than was written"
            except BaseException:
                failed += 1
                print(f"--- case {number} ({kind} {name})")
                traceback.print_exc(limit=-4)
                if given.keep:
                    given.keep.mkdir(parents=True, exist_ok=True)
                    (given.keep / f"{number}-{name}").write_bytes(data)
                if isinstance(sys.exc_info()[1], KeyboardInterrupt):
                    raise
                found = "failed"
            slowest = max(slowest, time.monotonic() - began)
            outcome = found if isinstance(found, str) else "accepted"
            counts[kind, outcome] = counts.get((kind, outcome), 0) + 1
            (folder / "a.png").write_bytes(good)
        configs = (data for kind, _, data in cases(10**6, given.seed + 1) if kind == "config")
        for number, data in enumerate(itertools.islice(configs, given.command_line)):
            try:
                outcome = try_command_line(data, folder)
            except AssertionError:
                failed += 1
                outcome = "failed"
                print(f"--- command line, case {number}")
                traceback.print_exc(limit=-1)
                if given.keep:
                    given.keep.mkdir(parents=True, exist_ok=True)
                    (given.keep / f"command-line-{number}.yaml").write_bytes(data)
            key = "command line", outcome
            counts[key] = counts.get(key, 0) + 1
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    for key, count in sorted(counts.items()):
        print(*key, count)
    print(f"slowest {slowest:.2f} s, peak {peak:.2f} GiB, {time.process_time():.0f} CPU s, {failed} failed")
    return 1 if failed or peak > 2 or slowest > 30 else 0


if __name__ == "__main__":
    sys.exit(main())
