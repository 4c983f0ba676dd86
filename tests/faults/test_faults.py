"""Kills, full disks, wrong clocks, damaged files: one message, a clean state, a rerun's bytes the same."""

import json
import os
import random
import resource
import shutil
import subprocess
import sys
import time

import kills
import pytest
from outputs import outputs

pytestmark = pytest.mark.xdist_group("faults")

PACKED = "results/s/full/0/first/bodies.csv"
SECTION = "results/s/section.json"


@pytest.fixture(scope="session")
def undisturbed(tmp_path_factory):
    """A finished first packing; copy it before you break it."""
    folder = kills.prepare(tmp_path_factory.mktemp("faults") / "undisturbed")
    status, said = kills.run(folder, PACKED)
    assert status == 0, said[-3000:]
    return folder


@pytest.fixture
def copy(undisturbed, tmp_path):
    return shutil.copytree(undisturbed, tmp_path / "copy", symlinks=True)


def planned(folder, target=PACKED, *arguments):
    """Rules that a rerun would run."""
    status, said = kills.run(folder, target, "--dry-run", *arguments)
    assert status == 0, said[-3000:]
    return (
        set()
        if "Nothing to be done" in said
        else {w.split()[-1][:-1] for w in said.splitlines() if w[:5] == "rule "}
    )


def messages(said):
    """What the jobs themselves said was wrong."""
    assert "Traceback" not in said, said[-3000:]
    jobs = [line for line in said.splitlines() if line.startswith(("grainfall: ", "["))]
    return [line for line in jobs if line[0] == "g" or "Error: " in line]


def test_kill_after_kill(undisturbed, tmp_path):
    """The group, Snakemake alone, one worker, at moments of what was left; the group amid the packing."""
    folder, moment = kills.prepare(tmp_path / "killed"), random.Random(7)

    def checkpoints():
        return [*folder.glob("results/**/.checkpoints/*/*.npz")]

    for whom in ("group", "main", "worker", "group amid the packing"):
        amid = whom.endswith("packing")
        if amid:
            (folder / PACKED).unlink(missing_ok=True)  # where kills let a fast machine end
        process = kills.start(folder, PACKED)
        deadline = time.monotonic() + 120
        while process.poll() is None and time.monotonic() < deadline:
            if checkpoints() if amid else kills.children(process.pid):
                break
            time.sleep(0.05)
        time.sleep(0 if amid else moment.uniform(0, 6))
        if process.poll() is None:
            assert not kills.kill(process, whom.split()[0]), f"a job outlived its killed {whom}"
        process.wait(timeout=600)
    # a damaged checkpoint costs its time, no more
    assert checkpoints()
    for checkpoint in checkpoints():
        checkpoint.write_bytes(checkpoint.read_bytes()[:-20])
    status, said = kills.run(folder, PACKED)
    assert status == 0, said[-3000:]
    assert outputs(folder) == outputs(undisturbed)
    assert kills.litter(folder) == []


def test_a_killed_command_line_takes_its_run_along(tmp_path):
    """Snakemake would wait for ever, locked, for somebody to read what it says."""
    folder = kills.prepare(tmp_path / "killed")
    process = subprocess.Popen(
        [sys.executable, "-m", "grainfall.cli", "run", str(folder), "--cores", "1"],
        env={**os.environ, "PYTHONPATH": str(kills.ROOT / "src")},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    run, jobs, deadline = [], [], time.monotonic() + 120
    while not jobs and time.monotonic() < deadline:
        time.sleep(0.05)
        run = kills.children(process.pid)
        jobs = [job for pid in run for job in kills.children(pid)]
    assert jobs
    process.kill()
    process.wait()
    deadline = time.monotonic() + 10
    while any(map(kills.alive, run + jobs)) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not any(map(kills.alive, run + jobs))
    assert planned(folder)


def test_dates_do_not_matter(copy):
    """Copied, touched or written while the clock was wrong: what counts is the content."""
    for path, when in (("section.png", 4e9), ("results/s/section.zarr.zip", 4e9)):
        os.utime(copy / path, (when, when))
    assert planned(copy) == set()
    # another image with an old date is another image
    kills.Image.fromarray(kills.section()[::-1]).save(copy / "section.png")
    os.utime(copy / "section.png", (1e9, 1e9))
    assert {"read_section", "first_packing"} <= planned(copy)


def test_damaged_result_is_found_before_it_is_used(copy, undisturbed):
    damaged, before = copy / "results/s/labels.zarr.zip", outputs(undisturbed)
    data = bytearray(damaged.read_bytes())
    data[len(data) // 2] ^= 1
    damaged.write_bytes(data)
    shutil.rmtree(copy / "results/s/grains3d")
    status, said = kills.run(copy, "results/s/grains3d")
    assert status == 1
    (message,) = messages(said)
    assert "results/s/labels.zarr.zip: is not what morphology wrote" in message
    assert "delete it" in message
    damaged.unlink()
    status, said = kills.run(copy, "results/s/grains3d")
    assert status == 0, said[-3000:]
    assert outputs(copy) == before


def test_broken_image_costs_nothing_that_was_there(copy, undisturbed):
    whole = (copy / "section.png").read_bytes()
    (copy / "section.png").write_bytes(whole[:200])
    status, said = kills.run(copy, SECTION)
    assert status == 1
    (message,) = messages(said)
    assert "section.png: damaged or truncated file" in message
    assert outputs(copy) == outputs(undisturbed)
    assert kills.litter(copy) == []


@pytest.fixture
def small_disk(tmp_path):
    """A folder ``results`` of 100 kB."""
    disk = tmp_path / "disk"
    disk.mkdir()
    if subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=120k", "tmpfs", disk], capture_output=True
    ).returncode:
        pytest.skip("mounting a small disk needs rights that this user has not")
    yield disk
    subprocess.run(["umount", "-l", disk], check=True)


def test_full_disk_then_read_only_then_room(small_disk, tmp_path):
    folder = kills.prepare(tmp_path / "user")
    (folder / "results").symlink_to(small_disk)
    (small_disk / "filler").write_bytes(bytes(75_000))
    status, said = kills.run(folder, SECTION)
    assert status == 1
    (message,) = messages(said)
    assert "[morphology s] OSError: [Errno 28] No space left on device" in message
    assert not (folder / SECTION).exists()
    assert kills.litter(folder) == []
    (small_disk / "filler").unlink()
    subprocess.run(["mount", "-o", "remount,ro", small_disk], check=True)
    status, said = kills.run(folder, SECTION)
    assert status == 1
    assert f"{small_disk}: may not be written to" in said
    assert "Traceback" not in said
    subprocess.run(["mount", "-o", "remount,rw,size=10m", small_disk], check=True)
    assert kills.run(folder, SECTION)[0] == 0


def limited(folder, what, most):
    """A run under a limit of the system."""
    command = [sys.executable, "-m", "snakemake", "--snakefile", kills.ROOT / "Snakefile", "--cores", "1"]
    done = subprocess.run(
        [*command, "--configfile", "config.yaml", "--", SECTION],
        cwd=folder,
        capture_output=True,
        text=True,
        preexec_fn=lambda: resource.setrlimit(what, (most, most)),
    )
    return done.returncode, done.stdout + done.stderr


def test_largest_file_reached(tmp_path):
    folder = kills.prepare(tmp_path / "user")
    # Snakemake writes its rules to a file too: the results must be the larger ones
    kills.Image.fromarray(kills.np.tile(kills.section(), (6, 6))).save(folder / "section.png")
    status, said = limited(folder, resource.RLIMIT_FSIZE, 40_000)
    assert status == 1
    assert any("OSError: [Errno 27] File too large" in line for line in messages(said)), said[-2000:]
    assert kills.litter(folder) == []


def test_memory_reached(tmp_path):
    """An image that fits, in a job whose memory does not."""
    folder = kills.prepare(tmp_path / "user")
    large = kills.np.kron(kills.section(), kills.np.ones((40, 40), "u1"))
    kills.Image.fromarray(large).save(folder / "section.png", compress_level=1)
    status, said = limited(folder, resource.RLIMIT_AS, 2_000_000_000)
    assert status == 1
    assert any("emory" in line for line in messages(said)), said[-2000:]
    assert (folder / "results/s/section.zarr.zip").exists()
    assert not (folder / SECTION).exists()
    assert kills.litter(folder) == []


def test_damaged_copy_in_the_cache_between_workflows(undisturbed, tmp_path, monkeypatch):
    cache = tmp_path / "cache"
    cache.mkdir()
    monkeypatch.setenv("SNAKEMAKE_OUTPUT_CACHE", str(cache))
    one, two = (shutil.copytree(undisturbed, tmp_path / user) for user in ("one", "two"))
    for user in (one, two):
        shutil.rmtree(user / "results/s/grains3d")
        shutil.rmtree(user / "results/s/full")
    assert kills.run(one, "results/s/grains3d", "--cache")[0] == 0
    (cached,) = cache.rglob("shapes.npz")
    data = bytearray(cached.read_bytes())
    data[len(data) // 2] ^= 1
    cached.chmod(0o644)
    cached.write_bytes(data)
    status, said = kills.run(two, PACKED, "--cache")
    assert status == 1
    (message,) = messages(said)
    assert "results/s/grains3d: is not what grain_library wrote" in message
    assert "cache" in message


def test_records_tell_where_a_result_comes_from(undisturbed):
    record = json.loads((undisturbed / "results/s/full/0/logs/first_packing.json").read_text())
    library = json.loads((undisturbed / "results/s/logs/grain_library.json").read_text())
    assert record["inputs"]["../../../grains3d"] == library["outputs"]["../grains3d"]
    assert record["parameters"]["stream"] == {"seed": 5, "sample": "s", "realization": 0}
    assert {"python", "numpy", "sapien", "grainfall"} <= set(record["versions"])
