"""The whole chain as a Snakemake user runs it."""

import ast
import copy
import json
import platform
import re
import shutil
import subprocess
import sys
import time
from datetime import date

import numpy as np
import pandas as pd
import pytest
import skimage.io
import zarr
from outputs import outputs, unchunked

from conftest import ROOT, TINY, planned, snakemake, write_config
from grainfall import cli, flow, io, packing, presets, stereology
from grainfall.export import FORMATS
from grainfall.io import read_volume
from grainfall.report import SUMMARY_COLUMNS
from grainfall.section import Mineral, synthesise
from grainfall.surface import core, solid_surface

AFTER_PACKING = {
    "packed_volume",
    "deficit",
    "second_packing",
    "twin",
    "measure_slices",
    "s2_chunk",
    "s2_slices",
    "s2_volume",
    "s2_envelope",
    "network",
    "flow",
    "flow_on_voxels",
    "contacts",
    "resettling",
    "plan",
    "metrics",
    "summary",
    "figure",
    "ensembles_figure",
    "report_page",
    "twin_provenance",
    "provenance",
    "all",
}


def twin(folder, realization=0):
    return folder / "results/tiny/full" / str(realization)


def another_house(folder, *left_out):
    """A copy of the workflow and its science, to be edited."""
    for part in ("workflow", "scripts", "config", "src", "envs"):
        shutil.copytree(ROOT / part, folder / part, ignore=shutil.ignore_patterns(*left_out))
    shutil.copy(ROOT / "Snakefile", folder)
    return folder


def changed(**over):
    config = copy.deepcopy(TINY)
    for key, value in over.items():
        config[key] = {**config.get(key, {}), **value} if isinstance(value, dict) else value
    return config


def reworded(content):
    """The same values, keys in another order, whole numbers with a point."""
    if isinstance(content, dict):
        return {key: reworded(content[key]) for key in reversed(content)}
    return float(content) if type(content) is int else content


def test_summary_and_report(finished):
    summary = pd.read_csv(finished / "results/summary.csv")
    assert tuple(summary.columns) == SUMMARY_COLUMNS
    assert summary.realization.tolist() == [0, 1]
    computed = ["porosity", "k_x_md", "k_ref_z_md", "s2_envelope_p", "w1_grains_um", "max_overlap", "wall_s"]
    assert summary[computed].notna().all(axis=None)
    assert (finished / "results/report.html").stat().st_size > 1e5


def test_every_output_column_is_documented(finished):
    text = (ROOT / "results/README.md").read_text()
    tables = sorted((finished / "results").rglob("*.csv"))
    columns = {(path.name, name) for path in tables for name in pd.read_csv(path, nrows=0).columns}
    assert len(columns) > 100
    word = r"(?<![\w.]){}(?![\w\[])"
    assert [pair for pair in sorted(columns) if not re.search(word.format(re.escape(pair[1])), text)] == []


def test_twin_keeps_its_contract(finished):
    path = twin(finished) / "twin.zarr.zip"
    group = zarr.open_group(zarr.storage.ZipStore(path, mode="r"), mode="r")
    phase, body = group["phase"][...], group["body"][...]
    assert phase.dtype == np.uint8
    assert set(np.unique(phase)) == {0, 1, 2}
    assert ((phase > 0) == (body > 0)).all()
    assert {"voxel_size_um", "phases", "seed", "grainfall_version", "ome"} <= set(group.attrs)
    bodies = pd.read_csv(twin(finished) / "bodies.csv")
    assert (bodies.kind == "grain").all()
    of_body = bodies.set_index("id").phase
    ids = np.unique(body[body > 0])
    for label in ids:
        assert (phase[body == label] == of_body[label - 1]).all()


def test_porosity_meets_the_target_where_scaling_was_applied(finished):
    for realization in (0, 1):
        report = json.loads((twin(finished, realization) / "correction.json").read_text())
        if report["applied"]:
            assert abs(report["after"]["porosity"] - report["target"]) <= 0.0005
        else:
            assert report["after"] == report["before"]
            assert report["reason"]
        assert abs(report["scale_factor"] - 1) < 0.01


def test_plan_says_why(finished):
    plan = json.loads((twin(finished) / "plan.json").read_text())
    optional = {
        "own_shapes",
        "virtual_spheres",
        "void_shapes",
        "densification",
        "cement",
        "compaction",
        "placement",
        "position_scaling",
        "phase_mixing",
        "refinement",
        "weight_limit",
    }
    assert optional <= set(plan)
    assert all(effect["reason"] for effect in plan.values())
    assert not any(effect["forced"] for effect in plan.values())
    assert plan["virtual_spheres"]["on"]
    assert plan["virtual_spheres"]["cost_s"] > 0
    assert not plan["cement"]["on"]


def test_virtual_spheres_take_the_shapes_of_voids(finished, tmp_path):
    """Or stay round, where told to, and their sizes a sphere's: grains, first packing and its circles are the
    same to the byte either way."""
    folder = shutil.copytree(finished, tmp_path / "round")
    write_config(folder, changed(realizations=1, effects={"void_shapes": "off"}), "round.yaml")
    wanted = [f"results/tiny/full/0/{name}" for name in ("bodies.csv", "plan.json")]
    done = snakemake(folder, "--", *wanted, config="round.yaml")
    assert done.returncode == 0, done.stdout[-6000:]
    before, after = (
        pd.read_csv(f / "results/tiny/grains3d/library.csv", float_precision="round_trip")
        for f in (folder, finished)
    )
    pd.testing.assert_frame_equal(after[after.phase > 0], before)
    assert (after.phase[len(before) :] == 0).all()
    plain, shaped = twin(folder), twin(finished)
    for name in ("first/bodies.csv", "first/pores2d.csv"):
        assert (shaped / name).read_bytes() == (plain / name).read_bytes()
    assert (shaped / "virtual_spheres.csv").read_bytes() != (plain / "virtual_spheres.csv").read_bytes()
    poured = pd.read_csv(shaped / "second/bodies.csv")
    held = poured["shape"] >= len(before)
    assert held.any()
    assert (poured.kind[held] == "virtual").all()
    assert (pd.read_csv(plain / "second/bodies.csv")["shape"] < len(before)).all()
    effects = [json.loads((t / "plan.json").read_text())["void_shapes"] for t in (shaped, plain)]
    assert [(effect["on"], effect["forced"]) for effect in effects] == [(True, False), (False, True)]
    for t in (shaped, plain):
        met = io.read_json(t / "correction.json")["after"]["porosity"]
        assert met == pytest.approx(TINY["scene"]["porosity"], abs=0.0005)


def test_a_bed_settles_anew_where_it_lies_in_its_box_wherever_its_region_does(finished, tmp_path):
    folder = shutil.copytree(finished, tmp_path / "moved")
    bed, change = twin(folder) / "second", twin(folder) / "resettling.json"
    before, moved = io.read_json(change), (8.0, -8.0, 4.0)
    change.unlink()
    (twin(folder) / "logs/second_packing.json").unlink()  # the record that would tell of the change
    io.write_table(bed / "bodies.csv", packing.move(io.read_table(bed / "bodies.csv"), moved))
    report = io.read_json(bed / "packing.json")
    io.write_json(bed / "packing.json", {**report, "placement": {**report["placement"], "moved_um": moved}})
    done = snakemake(folder, "--rerun-triggers", "mtime", "--", change.relative_to(folder))
    assert done.returncode == 0, done.stdout[-6000:]
    after = io.read_json(change)
    # the way of its grains is that of the same bed; the region, a tenth of its width away, is another
    assert after["moved_mean"] == pytest.approx(before["moved_mean"], rel=0.05)
    assert after["porosity_before"] != before["porosity_before"]


DENSE = 0.086  # Fontainebleau sandstone


def dense(**effects):
    """Variants too dense for their grains, by what they leave off of what is called for."""
    off = {name: {"densification": "off", **over} for name, over in effects.items()}
    return {name: {"scene": {"porosity": DENSE}, "effects": over} for name, over in off.items()}


COMPARED = dense(pressed={}, cemented={"compaction": "off"})
SHORT = {"realizations": 1, "correlation": {"chunks": 1}, "contacts": {"resettled": 0}}


@pytest.fixture(scope="module")
def consolidated(finished, tmp_path_factory):
    """Beside the finished twins some of a rock that no packing is as dense as."""
    folder = shutil.copytree(finished, tmp_path_factory.mktemp("dense") / "run")
    twins = {name: f"results/tiny/{name}/0" for name in ("pressed", "cemented", "bare")}
    wanted = [f"{twins['cemented']}/{file}" for file in ("metrics.csv", "plan.json", "figures/twin.svg")]
    wanted += [f"{twins['pressed']}/{file}" for file in ("twin.zarr.zip", "plan.json")]
    missing = [f"{twins['bare']}/{file}" for file in ("flow.csv", "plan.json")]
    for variants, files in ((COMPARED, wanted), (dense(bare={"cement": False}), missing)):
        write_config(folder, changed(variants=variants, **SHORT), "dense.yaml")
        done = snakemake(folder, "--", *files, config="dense.yaml")
        assert done.returncode == 0, done.stdout[-6000:]
    return folder


@pytest.mark.xdist_group("dense")
def test_rock_too_dense_for_its_grains_is_cemented(consolidated):
    """A target below any packing: met to a voxel, the minerals unchanged, the cement a phase of its own."""
    folder = consolidated
    pressed, cemented, bare = [folder / f"results/tiny/{name}/0" for name in ("pressed", "cemented", "bare")]
    group = zarr.open_group(zarr.storage.ZipStore(cemented / "twin.zarr.zip", mode="r"), mode="r")
    phase = group["phase"][...]
    assert group.attrs["phases"] == ["pore", "quartz", "feldspar", "cement"]
    assert set(np.unique(phase)) == {0, 1, 2, 3}
    assert abs(np.count_nonzero(phase == 0) - DENSE * phase.size) <= 1
    metrics = pd.read_csv(cemented / "metrics.csv").set_index("metric")["value"]
    without, _ = read_volume(bare / "twin.zarr.zip", "phase")
    # shares of the minerals are shares of the grains, with their rims or without; of a little more of the bed
    for name, mineral in (("phase_fraction_1", 1), ("phase_fraction_2", 2)):
        share = (without == mineral).sum() / (without > 0).sum()
        assert metrics[name] == pytest.approx(share, abs=0.1)
    assert metrics["cement_share"] == pytest.approx((phase == 3).mean())
    uncemented = pd.read_csv(bare / "flow.csv").set_index(["method", "axis"])["k_md"]
    assert metrics["k_z_md"] < uncemented["network", "z"]
    assert (cemented / "first/bodies.csv").read_bytes() == (bare / "first/bodies.csv").read_bytes()
    # the bed is the same one, smaller by the room for the rims
    room = json.loads((cemented / "cement.json").read_text())["room"]
    assert room < 1
    grains, plain = (pd.read_csv(twin / "bodies.csv") for twin in (cemented, bare))
    assert grains["scale"].to_numpy() == pytest.approx(room * plain["scale"].to_numpy())
    assert grains["x"].diff().to_numpy()[1:] == pytest.approx(room * plain["x"].diff().to_numpy()[1:])
    plan, missed = (json.loads((twin / "plan.json").read_text()) for twin in (cemented, bare))
    assert plan["cement"]["on"]
    assert plan["densification"]["forced"]
    assert "rims of" in plan["cement"]["reason"]
    # switched off, it visibly misses
    assert not missed["cement"]["on"]
    assert "although the packing leaves a porosity of" in missed["cement"]["reason"]
    assert (without == 0).mean() - DENSE > 0.1
    assert missed["compaction"]["reason"] == "there are no rims"
    # the section's grains are rougher than such rims; pressed into each other they keep more of their surface
    assert "pressed to" in json.loads((pressed / "plan.json").read_text())["compaction"]["reason"]
    rougher, size = read_volume(pressed / "twin.zarr.zip", "phase")
    assert (rougher == 0).sum() == (phase == 0).sum()
    assert (rougher == 3).sum() < (phase == 3).sum()
    rough, smooth = (solid_surface(core(v), size["voxel_size_um"]).per_um for v in (rougher, phase))
    assert rough > smooth
    assert metrics["solid_surface_per_um"] == pytest.approx(smooth)


def test_the_first_variant_is_what_others_are_compared_with(finished, tmp_path):
    """In another order the table of the same twins is another."""
    folder = shutil.copytree(finished, tmp_path / "order")
    shutil.copytree(folder / "results/tiny/full", folder / "results/tiny/same")
    table = "results/summary.csv"
    write_config(folder, changed(variants={"full": {}, "same": {}}))
    done = snakemake(folder, "--", table)
    assert done.returncode == 0, done.stdout[-3000:]
    assert len(pd.read_csv(folder / table)) == 4
    assert planned(folder, "--", table) == {}
    write_config(folder, changed(variants={"same": {}, "full": {}}))
    assert planned(folder, "--", table) == {"summary": 1}


def test_second_run_does_nothing(finished):
    assert planned(finished) == {}
    # nor does one whose config says the same in other words
    write_config(finished, reworded(TINY))
    try:
        assert planned(finished) == {}
    finally:
        write_config(finished, TINY)


@pytest.mark.parametrize(
    ("gone", "again"),
    [
        ("tiny/full/1/twin.zarr.zip", "twin"),
        ("tiny/full/0/bodies.csv", "twin"),
        ("tiny/full/1/flow.csv", "flow"),
        ("tiny/full/0/network_throats.csv", "network"),
        ("tiny/labels.zarr.zip", "morphology"),
        ("tiny/section.zarr.zip", "synthesise"),
        ("tiny/grains3d", "grain_library"),
        ("tiny/section.json", "morphology"),
        ("tiny/full/scene.json", "scene"),
        ("tiny/full/s2_envelope.json", "s2_envelope"),
        ("tiny/full/1/virtual_spheres.csv", "deficit"),
        ("tiny/full/0/figures/s2.svg", "figure"),
        ("tiny/figures/ensembles.svg", "ensembles_figure"),
    ],
)
def test_what_is_deleted_is_made_again(finished, tmp_path, gone, again):
    """As the message of a damaged file asks for."""
    folder = shutil.copytree(finished, tmp_path / "damaged")
    gone = folder / "results" / gone
    shutil.rmtree(gone) if gone.is_dir() else gone.unlink()
    assert planned(folder).get(again) == 1


def test_all_that_the_report_reads_is_kept():
    """It leaves out what is missing, so nothing of it may be: what is deleted is made again first."""
    rules = (ROOT / "workflow/rules/common.smk").read_text()
    kept = dict(re.findall(r"^KEPT_OF_(\w+) = (\([^)]*\))", rules, re.MULTILINE))
    kept = {(level.lower(), name) for level, names in kept.items() for name in ast.literal_eval(names)}
    pages = (ROOT / "src/grainfall/report/html.py").read_text()
    read = set(re.findall(r'"(sample|variant|twin):([\w./]+)"', pages))
    elsewhere = {  # inputs of their own, of what not every study has, or the beginnings of names
        *(("twin", f"{packing}/volume.zarr.zip") for packing in ("first", "second")),
        *(("sample", f"reference_{name}") for name in ("s2.csv", "flow.csv", "network")),
        ("sample", "truth_sizes.csv"),
        ("sample", "grains3d/library.csv"),
        ("twin", "network"),
    }
    assert elsewhere < read
    assert read - elsewhere <= kept


@pytest.mark.parametrize(("name", "stays"), [(platform.node(), False), ("", True), ("another", True)])
def test_only_the_locks_of_a_run_that_was_killed_here_are_cleared(finished, tmp_path, name, stays):
    """A run leaves its machine's name until it ends: without it a lock is somebody else's, who is at work."""
    folder = shutil.copytree(finished, tmp_path / "copy")
    lock = folder / ".snakemake/locks/0.output.lock"
    lock.parent.mkdir(exist_ok=True)
    lock.write_text("results/other.csv\n")
    (folder / ".snakemake/grainfall.lock").write_text(name)
    # as a process of its own, which ends as a user's does
    words = ["-m", "snakemake", "--cores", "1", "--dry-run", "--configfile", "config.yaml", "--snakefile"]
    command = [sys.executable, *words, ROOT / "Snakefile"]
    subprocess.run(command, cwd=folder, check=True, capture_output=True)
    assert lock.exists() == stays
    assert not (folder / ".snakemake/grainfall.lock").read_text()


def test_a_copy_that_looks_new_is_done(finished, tmp_path):
    subprocess.run(["cp", "-r", finished, tmp_path / "copied"], check=True)  # copytree keeps dates of folders
    assert planned(tmp_path / "copied") == {}


def test_a_sweep_of_parameters_grows_by_its_rows(finished, tmp_path):
    folder = shutil.copytree(finished, tmp_path / "sweep")
    write_config(folder, {**TINY, "sweep": "sweep.tsv"})
    (folder / "sweep.tsv").write_text("variant\tscene.porosity\nfull\t\n")
    done = snakemake(folder, "--", "results/sweep.csv")
    assert done.returncode == 0, done.stdout[-3000:]
    table, summary = (
        pd.read_csv(run / f"results/{name}.csv") for run, name in ((folder, "sweep"), (finished, "summary"))
    )
    pd.testing.assert_frame_equal(table, summary)
    (folder / "sweep.tsv").write_text("variant\tscene.porosity\nfull\t\nloose\t0.46\n")
    jobs = planned(folder, "--", "results/sweep.csv")
    assert (jobs["scene"], jobs["first_packing"], jobs["sweep_table"]) == (1, 2, 1)
    assert not {"synthesise", "morphology", "unfold_sizes", "grain_library", "reference_flow"} & set(jobs)


def test_an_accuracy_asked_for_is_expected_and_measured(finished, tmp_path):
    """The cheapest preset is that of the finished run, so nothing is packed anew."""
    folder = shutil.copytree(finished, tmp_path / "asked")
    asked = {key: value for key, value in TINY.items() if key != "preset"}
    write_config(folder, {**asked, "accuracy": {"metric": "k", "tolerance": 0.5}})
    wanted = [f"results/tiny/full/0/{name}" for name in ("metrics.csv", "plan.json")]
    assert set(planned(folder, "--", *wanted)) <= {"metrics", "plan"}
    done = snakemake(folder, "--", *wanted)
    assert done.returncode == 0, done.stdout[-3000:]
    metrics = pd.read_csv(folder / wanted[0]).set_index("metric")
    k, of_truth = (metrics.loc[[f"{k}_{a}_md" for a in "xyz"], "value"].mean() for k in ("k", "k_ref"))
    assert metrics.loc["accuracy_error", "value"] == pytest.approx(abs(k / of_truth - 1))
    draft = next(row for row in presets.measured() if (row.preset, row.metric) == ("draft", "k"))
    target = metrics.loc["accuracy_error_target"]
    assert (target["value"], target["upper"]) == (pytest.approx(draft.error), 0.5)
    assert "draft is measured to miss permeability by" in (folder / wanted[1]).read_text()


def test_the_scheduler_looks_for_jobs_no_more_often_than_it_says(finished, tmp_path):
    """Once for each job that ends and once a second, not once a second for each job that has ended."""
    folder = shutil.copytree(finished, tmp_path / "looks")
    rows = "".join(f"v{n:02d}\t{0.4 + n / 1000}\n" for n in range(16))
    (folder / "sweep.tsv").write_text(f"variant\tscene.porosity\n{rows}")
    write_config(folder, {**TINY, "sweep": "sweep.tsv"})
    begun = time.monotonic()
    done = snakemake(folder, "--verbose", "--until", "scene", "--", "results/sweep.csv", cores=1)
    lasted = time.monotonic() - begun
    assert done.returncode == 0, done.stdout[-3000:]
    jobs = done.stdout.count("Finished jobid")
    assert jobs == 16
    looks = done.stdout.count("Ready jobs:")
    assert jobs <= looks <= jobs + lasted


def test_verify_says_what_changed(finished, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(finished)
    assert cli.run(["verify"]) == 0, capsys.readouterr().out
    assert "nothing has changed" in capsys.readouterr().out
    folder = shutil.copytree(finished, tmp_path / "copy", ignore=shutil.ignore_patterns(".snakemake"))
    monkeypatch.chdir(folder)
    with (twin(folder) / "bodies.csv").open("a") as table:
        table.write("0,grain,1\n")
    write_config(folder, changed(seed=4))
    assert cli.run(["verify"]) == 1
    said = capsys.readouterr().out.splitlines()
    assert said[0] == "config: seed was 3, is 4"
    assert said[1] == "output: results/tiny/full/0/bodies.csv is not what rule twin wrote"
    assert len(said) == 3


def test_packing_parameter_reruns_packing_and_what_follows(finished):
    write_config(finished, changed(packing={"overrides": {"friction_static": 0.3}}), "friction.yaml")
    rerun = planned(finished, config="friction.yaml")
    assert "first_packing" in rerun
    assert set(rerun) <= AFTER_PACKING | {"first_packing", "scene", "section_as_resolved"}
    assert not {"synthesise", "morphology", "unfold_sizes", "grain_library"} & set(rerun)


@pytest.mark.parametrize(
    ("over", "rerun", "spared"),
    [
        ({"correlation": {"envelope_slices": 79}}, "s2_envelope", {"deficit", "s2_chunk", "measure_slices"}),
        ({"correlation": {"chunks": 3}}, "s2_chunk", {"deficit", "measure_slices"}),
        ({"contacts": {"resettled": 2}}, "resettling", {"contacts", "twin"}),
        ({"effects": {"refinement": "on"}}, "first_packing", {"scene", "section_as_resolved"}),
        ({"feedback": {"passes": 9}}, "second_packing", {"first_packing", "deficit"}),
        ({"effects": {"compaction": "off"}}, "twin", {"first_packing", "second_packing", "deficit"}),
    ],
)
def test_an_edit_reruns_what_goes_by_it(finished, over, rerun, spared):
    write_config(finished, changed(**over), "edited.yaml")
    jobs = set(planned(finished, config="edited.yaml"))
    assert rerun in jobs
    assert not spared & jobs


def test_grains_are_taken_for_what_the_config_says(tmp_path):
    """By default for what they are where they come outlined, else for spheres."""
    rock = synthesise(
        np.random.default_rng(5), (64, 192, 192), 2.0, [Mineral("quartz", 1.0, 14.0, 0.25, 0.3)]
    )
    phase, outlines = rock.section(1.0)
    np.savez(tmp_path / "outlined.npz", outlines)
    skimage.io.imsave(tmp_path / "binary.png", 255 * phase, check_contrast=False)
    rows = {
        "outlined": {"kind": "instances", "image": "outlined.npz", "pixel_size_um": 1},
        "binary": {"kind": "binary", "image": "binary.png", "pixel_size_um": 1},
    }

    def means(particles, *names):
        """Mean radii in space of grains and pores, by sample."""
        effects, how = {"void_shapes": "off"}, {"particles": particles}
        write_config(tmp_path, {**TINY, "samples": rows, "effects": effects, "stereology": how})
        done = snakemake(tmp_path, "--", *(f"results/{name}/sizes.csv" for name in names))
        assert done.returncode == 0, done.stdout[-3000:]
        tables = [io.read_table(tmp_path / f"results/{name}/sizes.csv") for name in names]
        return [(s[1, "grain"].mean(), s[0, "pore"].mean()) for s in map(stereology.from_table, tables)]

    outlined, binary = means("auto", *rows)
    as_spheres, as_grains = means("spheres", "outlined")[0], means("grains", "binary")[0]
    # Uneven blocks are wider than spheres: their profiles are smaller. Pores are circles anyway.
    assert outlined[0] > 1.01 * as_spheres[0]
    assert as_grains[0] > 1.01 * binary[0]
    assert (outlined[1], binary[1]) == (as_spheres[1], as_grains[1])


def test_a_section_is_read_again_for_what_it_was_read_by_only(tmp_path):
    row = {"kind": "binary", "image": "rock.png", "pixel_size_um": 1}
    image = np.kron(np.random.default_rng(1).random((30, 30)) < 0.6, np.ones((8, 8)))
    write_config(tmp_path, {**TINY, "samples": {"rock": row}})
    skimage.io.imsave(tmp_path / "rock.png", (255 * image).astype(np.uint8), check_contrast=False)
    volume = (np.random.default_rng(2).random((40, 40, 40)) < 0.6).astype(np.uint8)
    np.save(tmp_path / "volume.npy", volume)
    section = "results/rock/section.zarr.zip"
    done = snakemake(tmp_path, "--", section)
    assert done.returncode == 0, done.stdout[-3000:]
    judged = {**row, "reference": "volume.npy", "reference_voxel_size_um": 1, "porosity": 0.4}
    for over, again in (
        ({"samples": {"rock": judged}}, {}),
        ({"samples": {"rock": row}, "section": {"max_pixels": 10**8}}, {}),
        ({"samples": {"rock": {**row, "pore_value": 255}}}, {"read_section": 1}),
    ):
        write_config(tmp_path, {**TINY, **over})
        assert planned(tmp_path, "--", section) == again
    # what judges it is measured as it was given
    write_config(tmp_path, {**TINY, "samples": {"rock": judged}})
    done = snakemake(tmp_path, "--", "results/rock/reference_s2.csv")
    assert done.returncode == 0, done.stdout[-3000:]
    measured = io.read_table(tmp_path / "results/rock/reference_s2.csv")
    assert measured["s2"][0] == pytest.approx(volume.mean())
    # raw numbers, as micro-CT is shared, are the same volume
    volume[1:].astype(">u2").tofile(tmp_path / "volume.raw")
    raw = judged | {"reference": "volume.raw", "reference_shape": "39;40;40", "reference_dtype": ">u2"}
    write_config(tmp_path, {**TINY, "samples": {"rock": raw}})
    done = snakemake(tmp_path, "--", "results/rock/reference.zarr.zip")
    assert done.returncode == 0, done.stdout[-3000:]
    read, _ = io.read_volume(tmp_path / "results/rock/reference.zarr.zip", "phase")
    np.testing.assert_array_equal(read, volume[1:])


def test_voxels_may_be_finer_than_the_pixels_of_the_section(finished, tmp_path):
    """Slices are measured on the section's pixels, whatever the twin's voxels."""
    folder = shutil.copytree(finished, tmp_path / "run")
    write_config(folder, changed(scene={"voxel_size_um": 1.25}, **SHORT), "fine.yaml")
    wanted = [
        f"results/tiny/full/{name}" for name in ("0/grains2d.csv", "0/s2_slices.csv", "s2_envelope.json")
    ]
    done = snakemake(folder, "--", *wanted, config="fine.yaml")
    assert done.returncode == 0, done.stdout[-3000:]
    before, after = (io.read_table(run / "results/tiny/full/0/grains2d.csv") for run in (finished, folder))
    assert after["index"].max() < 40
    # whole pixels of the section, which voxels of 1.25 um would not add up to
    pixels = after["area_um2"] / TINY["samples"]["tiny"]["pixel_size_um"] ** 2
    assert len(pixels)
    np.testing.assert_allclose(pixels, pixels.round(), atol=1e-6)
    means = [np.average(table["r_um"], weights=table["weight"]) for table in (before, after)]
    # another packing of few grains; voxels taken for pixels would halve or double it
    assert means[1] == pytest.approx(means[0], rel=0.3)


def test_a_variant_that_measures_otherwise_is_not_held_against_the_reference(finished):
    variants = {
        "coarse": {"network": {"coarsen": 2}},
        "direct": {"flow": {"methods": ["direct"]}},
        "full": {},
    }
    write_config(finished, changed(variants=variants), "otherwise.yaml")
    wanted = [f"results/tiny/{name}/0/metrics.csv" for name in variants]
    done = snakemake(finished, "--dry-run", "--forcerun", "metrics", "--", *wanted, config="otherwise.yaml")
    inputs = dict(
        zip(variants, sorted(re.findall(r"rule metrics:\n +input: (.*)", done.stdout)), strict=True)
    )
    held = {name for name, files in inputs.items() if "tiny/reference_flow.csv" in files}
    assert held == {"full", "direct"}
    assert {name for name, files in inputs.items() if "tiny/reference_network_pores.csv" in files} == held
    assert all("tiny/reference_s2.csv" in files for files in inputs.values())


def test_another_method_of_flow_solves_no_other_again(finished, tmp_path):
    """What takes hours on voxels depends neither on the others nor on the network."""
    folder = shutil.copytree(finished, tmp_path / "flow")
    write_config(folder, changed(flow={"methods": ["network", "estimate", "elliptic"]}))
    table = "results/tiny/full/0/flow.csv"
    done = snakemake(folder, "--", table, "results/tiny/reference_flow.csv")
    assert done.returncode == 0, done.stdout[-3000:]
    found = pd.read_csv(folder / table)
    assert found["method"].tolist() == ["network"] * 3 + ["estimate"] * 3 + ["elliptic"] * 3
    before = pd.read_csv(finished / table)
    pd.testing.assert_frame_equal(found[:6].drop(columns="wall_s"), before.drop(columns="wall_s"))
    pore, voxel = read_volume(folder / "results/tiny/full/0/twin.zarr.zip", "phase")
    k = flow.permeability(pore == 0, voxel["voxel_size_um"], "elliptic").k_md
    assert found["k_md"][6:].to_numpy() == pytest.approx(k.to_numpy(), rel=1e-6)
    again = {"flow": {"methods": ["elliptic", "direct", "network"]}, "network": {"persistence": 0.3}}
    write_config(folder, changed(**again))
    jobs = planned(folder, "--", table)
    assert jobs == {"network": 1, "flow_on_voxels": 1, "flow": 1}


def test_edit_of_a_late_chapter_reruns_what_it_touches(finished, tmp_path):
    house = another_house(tmp_path / "house", "__pycache__")
    with (house / "src/grainfall/contacts/find.py").open("a") as module:
        module.write("\n# edited\n")
    rerun = planned(finished, "--rerun-triggers", "params", snakefile=house / "Snakefile")
    assert "contacts" in rerun
    assert not {"first_packing", "twin", "network", "flow", "s2_volume"} & set(rerun)


@pytest.mark.parametrize(
    ("module", "rule", "file", "again"),
    [
        ("resample", "section_as_resolved", "section_surface.json", True),
        ("resample", "deficit", "0/deficit.json", True),
        ("resample", "measure_slices", "0/grains2d.csv", True),
        ("resample", "twin", "0/bodies.csv", True),
        ("raster", "twin", "0/bodies.csv", False),
    ],
)
def test_edit_of_an_early_module_reruns_what_uses_it(finished, tmp_path, module, rule, file, again):
    house = another_house(tmp_path / "house", "__pycache__")
    with (house / f"src/grainfall/section/{module}.py").open("a") as source:
        source.write("\n# edited\n")
    alone = ["--rerun-triggers", "params", "--allowed-rules", rule, "--", f"results/tiny/full/{file}"]
    rerun = planned(finished, *alone, snakefile=house / "Snakefile")
    assert rerun == ({rule: 1} if again else {})


def test_slabs_asked_for_later_pack_nothing_anew(finished):
    write_config(finished, changed(slabs=2), "slabs.yaml")
    rerun = planned(finished, config="slabs.yaml")
    assert "twin_slab" in rerun
    assert not {"first_packing", "deficit", "second_packing"} & set(rerun)


@pytest.fixture(scope="session")
def thin_chunks(tmp_path_factory):
    """The workflow with chunks of 16 planes, not 128, so that a tiny volume has three layers of them."""
    # with what numba has compiled
    house = another_house(tmp_path_factory.mktemp("chunks") / "house", "*.tmp.*", "*.pyc.*")
    module = house / "src/grainfall/io.py"
    module.write_text(module.read_text().replace("CHUNK = 128", "CHUNK = 16"))
    return house / "Snakefile"


def test_one_core_slabs_and_other_chunks_give_the_same_bytes(finished, thin_chunks, tmp_path):
    """A twin from its packing to its row of the summary, and the truth's measures."""
    folder = shutil.copytree(finished, tmp_path / "again")
    shutil.rmtree(twin(folder))
    for path in (folder / "results/tiny").glob("reference_*.csv"):
        path.unlink()
    write_config(folder, changed(correlation={"chunks": 3}, slabs=2))
    last = ("summary_row.csv", "resettling.json", "plan.json", "second/volume.zarr.zip")
    wanted = ("--rerun-triggers", "mtime", "--", *(f"results/tiny/full/0/{name}" for name in last))
    done = snakemake(folder, *wanted, snakefile=thin_chunks, cores=1)
    assert done.returncode == 0, done.stdout[-6000:]
    for rule in ("packed_volume_slab", "twin_slab", "s2_volume_slab", "network_slab"):
        assert rule in done.stdout
    assert not [*(folder / "results").rglob("slabs/*"), *(folder / "results").rglob("*-of-*.npz")]
    first, second = outputs(finished, unchunked), outputs(folder, unchunked)
    assert first.keys() == second.keys()
    assert [name for name in first if first[name] != second[name]] == []


@pytest.mark.xdist_group("dense")
def test_any_number_of_slabs_gives_the_same_cement(consolidated, thin_chunks, tmp_path):
    """Which is done as a whole; with more slabs than layers, of which one is empty. Nor do cores tell."""
    rims = [f"results/tiny/cemented/0/{name}" for name in ("twin.zarr.zip", "bodies.csv")]
    found = []
    for slabs, cores in ((1, 1), (4, 2)):
        folder = shutil.copytree(consolidated, tmp_path / str(slabs))
        for path in rims:
            (folder / path).unlink()
        write_config(folder, changed(slabs=slabs, variants=COMPARED, **SHORT))
        mtime = ("--rerun-triggers", "mtime")
        done = snakemake(folder, *mtime, "--", *rims, snakefile=thin_chunks, cores=cores)
        assert done.returncode == 0, done.stdout[-6000:]
        assert ("twin_slab" in done.stdout) == (slabs > 1)
        for path in rims:
            assert unchunked(consolidated / path) == unchunked(folder / path), path
        found.append([(folder / path).read_bytes() for path in rims])
    assert found[0] == found[1]
    assert json.loads((folder / "results/tiny/cemented/0/cement.json").read_text())["on"]


def test_cache_between_workflows(finished, tmp_path, monkeypatch):
    """Two users share grain library and packings, whatever comes after; realizations are never mixed up.

    Whatever the first makes from the section on, on one core, is what two have made.
    """
    monkeypatch.setenv("SNAKEMAKE_OUTPUT_CACHE", str(tmp_path / "cache"))
    (tmp_path / "cache").mkdir()
    packings = [f"results/tiny/full/{realization}/first/bodies.csv" for realization in (0, 1)]
    cubes = {"one": 2, "two": 3}
    for user, over in (("one", {}), ("two", {"effects": {"virtual_spheres": "off"}})):
        folder = write_config(tmp_path / user, changed(reference_cubes=cubes[user], **over))
        last = f"results/tiny/cube_{cubes[user] - 1}/reference.zarr.zip"
        done = snakemake(folder, "--cache", "--", *packings, last, cores=1)
        assert done.returncode == 0, done.stdout[-4000:]
    one, two = ((tmp_path / user / "results/tiny/cube_1/reference.zarr.zip").read_bytes() for user in cubes)
    assert one == two
    there, here = outputs(tmp_path / "one"), outputs(finished)
    both = there.keys() & here.keys()
    assert {*packings, "results/tiny/sizes.csv"} <= both
    assert [name for name in sorted(both) if there[name] != here[name]] == []
    assert all((tmp_path / "two" / path).read_bytes() == there[path] for path in packings)
    worked, spared = (
        tmp_path / user / "results/tiny/full/0/logs/first_packing.log" for user in ("one", "two")
    )
    assert worked.stat().st_size > 0
    assert not spared.exists() or spared.stat().st_size == 0


@pytest.mark.parametrize(
    ("over", "words"),
    [
        ({"scene": {"edge_mu": 3}}, "did you mean 'edge_um'"),
        (
            {"samples": {"a": {"kind": "binary", "image": "no.png", "pixel_size_um": 1}}},
            "no.png does not exist",
        ),
        ({"packing": {"engine": "havok"}}, "one of: physx, bullet"),
    ],
)
def test_mistake_is_one_line_before_any_job(tmp_path, over, words):
    folder = write_config(tmp_path, {**TINY, **over})
    done = snakemake(folder)
    assert done.returncode != 0
    assert words in done.stdout
    assert "Traceback" not in done.stdout
    assert not (folder / "results").exists()


def test_numbers_and_dates_are_names(tmp_path):
    over = {"samples": {date(2024, 5, 1): TINY["samples"]["tiny"]}, "variants": {300: {}, 400: {}}}
    folder = write_config(tmp_path, {**TINY, **over})
    assert planned(folder)["first_packing"] == 4


def test_bad_image_is_one_line_and_loses_nothing(tmp_path):
    folder = write_config(
        tmp_path, {**TINY, "samples": {"a": {"kind": "binary", "image": "a.png", "pixel_size_um": 1}}}
    )
    (folder / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n and no more")
    done = snakemake(folder, "--quiet", "all", "--", "results/a/section.json")
    assert done.returncode != 0
    assert "grainfall: a.png: " in done.stdout
    assert "Traceback" not in done.stdout
    assert not (folder / "results/a/section.zarr.zip").exists()


@pytest.mark.parametrize("flag", ["--dag", "--rulegraph", "--summary"])
def test_the_tools_of_a_snakemake_user(finished, flag):
    done = snakemake(finished, flag)
    assert done.returncode == 0, done.stdout[-3000:]


def test_snakemake_report(finished):
    done = snakemake(finished, "--report", "snakemake-report.html")
    assert done.returncode == 0, done.stdout[-3000:]
    page = (finished / "snakemake-report.html").read_text()
    assert "report.html" in page


def test_exports(finished, tmp_path):
    copy = shutil.copytree(finished, tmp_path / "copy")
    done = snakemake(copy, "--", "results/tiny/full/0/export/twin.mhd")
    assert done.returncode == 0, done.stdout[-3000:]
    folder = twin(copy) / "export"
    size = json.loads((finished / "results/tiny/full/scene.json").read_text())["shape_zyx"]
    assert (folder / "twin.raw").stat().st_size == np.prod(size)
    assert {p.name for p in folder.iterdir()} == {name for kind in FORMATS.values() for name in kind.files}
    # one that was asked for alone, or is gone, is no reason to have no others
    (folder / "network.csv").unlink()
    assert planned(copy, "--", "exports") == {"export": 2, "exports": 1}
