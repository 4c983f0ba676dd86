"""The command line: what it makes is valid, what it refuses is one line, and nothing is overwritten."""

import os
import re
import shutil
import signal
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest
import tifffile
import yaml
from PIL import Image

pytest.importorskip("typer")

from grainfall import cli
from grainfall import config as sheet
from grainfall.cli import doctor, look, study
from grainfall.cli.costs import Costs
from grainfall.errors import InputError

DEAF = (
    "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); "
    "print('on', flush=True); time.sleep(60)"
)
"""A program that does not heed being terminated."""


def test_an_interrupted_command_that_does_not_stop_is_killed(monkeypatch):
    monkeypatch.setattr(study, "PATIENCE_S", 0.2)
    with pytest.raises(KeyboardInterrupt), study._started([sys.executable, "-c", DEAF]) as process:
        assert process.stdout.readline() == "on\n"
        raise KeyboardInterrupt
    assert process.returncode == -signal.SIGKILL  # by itself it ends with 0


@pytest.fixture(scope="module")
def picture(tmp_path_factory):
    """A section of 64 discs of radius 9 pixels, black and white."""
    y, x = np.mgrid[:200, :200]
    discs = np.hypot(y % 25 - 12, x % 25 - 12) < 9
    path = tmp_path_factory.mktemp("image") / "my section.png"
    Image.fromarray((255 * discs).astype(np.uint8)).save(path)
    return path


def grainfall(capsys, *arguments):
    """Status, output and error of a command run in this process."""
    status = cli.run([str(a) for a in arguments])
    said = capsys.readouterr()
    return status, said.out, said.err


def test_targets_are_found_from_where_one_is(tmp_path, monkeypatch):
    """As a shell completes them; from the study's folder they stay as they are."""
    (tmp_path / "rock").mkdir()
    (tmp_path / "rock/config.yaml").write_text("samples: {a: {kind: synthetic, pixel_size_um: 2}}")
    opened = study.open_study(tmp_path / "rock")
    monkeypatch.chdir(tmp_path)
    wanted = "results/a/sizes.csv"
    for given in (wanted, f"rock/{wanted}", f"./rock/{wanted}", str(tmp_path / "rock" / wanted)):
        assert study.in_study(opened, given) == wanted
    assert study.in_study(opened, "validation") == "validation"
    monkeypatch.chdir(tmp_path / "rock")
    assert study.in_study(opened, wanted) == study.in_study(opened, f"./{wanted}") == wanted


def test_new_writes_a_study_that_a_run_accepts(capsys, picture, tmp_path):
    folder = tmp_path / "my rock!"
    status, said, _ = grainfall(capsys, "new", folder, "--image", picture, "--pixel-size", "1.5um")
    assert status == 0
    opened = study.open_study(folder)
    assert opened.samples["my-rock"]["kind"] == "binary"
    assert opened.samples["my-rock"]["pixel_size_um"] == 1.5
    assert (folder / "my section.png").read_bytes() == picture.read_bytes()
    text = (folder / "config.yaml").read_text()
    unwrapped = " ".join(line.removeprefix("# ") for line in text.splitlines())
    first, *lines, _ = said.splitlines()
    assert first.startswith(f"Reading {picture}")
    assert all(line.strip() in unwrapped for line in lines)
    assert max(map(len, lines)) <= 80
    # the time and its bounds are the fit's and its factor's
    cost = look.look(picture, 1.5).cost
    times = [look.duration(cost.cpu_s * f) for f in (1, 1 / cost.factor, cost.factor)]
    assert "about {} of one core ({} to {})".format(*times) in " ".join(said.split())
    # 64 whole discs of one size: the section's mean radius is that of a disc
    assert "64 grains, 64 of them whole" in said
    assert float(re.search(r"radius ([0-9.]+) um", said).group(1)) == pytest.approx(9 * 1.5, rel=0.03)
    assert f"Porosity {1 - np.mean(np.asarray(Image.open(picture)) > 0):.4f}" in said


@pytest.mark.parametrize(
    ("folder", "name"),
    [
        ("2024-05-01", "2024-05-01"),
        ("2024-13-01", "2024-13-01"),
        ("007", "007"),
        ("no", "no"),
        ("Data", "rock"),
    ],
)
def test_a_sample_is_named_as_the_folder_whatever_yaml_makes_of_that(capsys, picture, tmp_path, folder, name):
    new = ("new", tmp_path / folder, "--image", picture, "--pixel-size", "1um")
    assert grainfall(capsys, *new)[0] == 0
    opened = study.open_study(tmp_path / folder)
    assert list(opened.samples) == list(opened.config["samples"]) == [name]


def test_a_rock_denser_than_its_beds_is_told_to_take_longer(capsys, picture, tmp_path):
    y, x = np.indices((264, 264)) % 22
    dense = tmp_path / "dense.png"
    Image.fromarray((((y > 1) & (x > 1)) * 255).astype(np.uint8)).save(dense)
    for image, told in ((dense, True), (picture, False)):
        folder = tmp_path / image.stem
        status, said, _ = grainfall(capsys, "new", folder, "--image", image, "--pixel-size", "1um")
        assert status == 0
        assert ("two to four times as long" in " ".join(said.split())) == told


def test_what_may_not_be_read_is_one_line(capsys, picture, tmp_path, monkeypatch):
    def refuse(*_, **__):
        raise PermissionError(13, "Permission denied", "/closed/section.png")

    monkeypatch.setattr(look, "look", refuse)
    status, _, fault = grainfall(capsys, "new", tmp_path / "a", "--image", picture, "--pixel-size", "1um")
    assert status == 1
    assert fault.startswith("grainfall: /closed/section.png: may not be read or written")
    assert fault.count("\n") == 1


def test_the_command_line_computes_on_one_thread_unless_told_otherwise():
    pools = [f"{pool}_NUM_THREADS" for pool in ("OMP", "OPENBLAS", "MKL")]
    ours = {name: value for name, value in os.environ.items() if name not in pools} | {"MKL_NUM_THREADS": "3"}
    code = (
        "import os, sys; from grainfall import cli\n"
        "try: cli.main(['--help'])\n"
        "finally: print(*(os.environ[p] for p in sys.argv[1:]), file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code, *pools], env=ours, capture_output=True, text=True)
    assert (done.returncode, done.stderr.split()) == (0, ["1", "1", "3"])


def test_a_name_that_snakemake_cannot_take_is_mended(capsys, picture, tmp_path):
    image = shutil.copy(picture, tmp_path / "a{b}.png")
    new = [
        "new",
        tmp_path / "a",
        "--image",
        image,
        "--pixel-size",
        "1um",
        "--phases",
        "pore = 0; quartz = 255",
    ]
    status, said, _ = grainfall(capsys, *new)
    assert status == 0
    assert study.open_study(tmp_path / "a").samples["a"]["image"] == "a_b_.png"
    assert "taken for the pore" not in " ".join(said.split())


def test_what_is_taken_for_the_pore_is_said(capsys, picture, tmp_path):
    new = ["new", tmp_path / "a", "--image", picture, "--pixel-size", "1um"]
    said, told = (
        " ".join(grainfall(capsys, *new, *more)[1].split())
        for more in ([], ["--force", "--pore-value", "255"])
    )
    assert "The lower value is taken for the pore" in said
    assert "taken for the pore" not in told
    discs = np.array(Image.open(picture)) // 255
    discs[:, 100:] *= 2
    Image.fromarray(discs).save(tmp_path / "two.png")
    new[3] = tmp_path / "two.png"
    said, told = (
        " ".join(grainfall(capsys, *new, "--force", *more)[1].split())
        for more in ([], ["--phases", "pore=0;a=1;b=2"])
    )
    assert "The value 0 is taken for the pore, the others for minerals" in said
    assert "taken for the pore" not in told
    noise = np.random.default_rng(0).normal(0, 3, discs.shape)
    Image.fromarray((60 + 120 * (discs > 0) + noise).astype(np.uint8)).save(tmp_path / "grey.png")
    new[3] = tmp_path / "grey.png"
    said = " ".join(grainfall(capsys, *new, "--force")[1].split())
    level = float(re.search(r"The darkest class is taken for the pore, parted at (\d+)\.", said)[1])
    assert 60 < level < 180


def test_a_file_that_gives_other_pixels_is_told_so(capsys, picture, tmp_path):
    discs, path = np.array(Image.open(picture)), tmp_path / "a.tif"
    new = ("new", tmp_path / "a", "--image", path, "--pixel-size", "2um", "--force")
    for resolution, words in (
        ((0.5, 0.5), None),
        ((5, 5), "The file itself gives its pixels as 0.2 um"),
        ((0.5, 1), "The file gives its pixels as 2 x 1 um: make them square"),
    ):
        tifffile.imwrite(path, discs, imagej=True, resolution=resolution, metadata={"unit": "um"})
        said = " ".join(grainfall(capsys, *new)[1].split())
        assert words in said if words else "The file" not in said


def test_a_section_of_few_whole_grains_is_told_so(capsys, picture, tmp_path):
    small = Image.open(picture).crop((0, 0, 60, 60))  # four whole discs and five that are cut
    small.save(tmp_path / "small.png")
    new = ("--pixel-size", "1um")
    said = grainfall(capsys, "new", tmp_path / "a", "--image", tmp_path / "small.png", *new)[1]
    assert "Sizes and shapes rest on 4 whole grains" in " ".join(said.split())
    said = grainfall(capsys, "new", tmp_path / "b", "--image", picture, *new)[1]
    assert "rest on" not in said


def test_what_is_in_brackets_or_between_colons_is_shown(capsys, tmp_path, monkeypatch):
    folder = tmp_path / "x[y]:smile:"
    folder.mkdir()
    (folder / "config.yaml").write_text("samples: {a: {kind: synthetic, pixel_size_um: 2}}")
    monkeypatch.setattr(study, "jobs_left", lambda _: {})
    assert folder.name in "".join(grainfall(capsys, "status", folder)[1].split())


def test_a_long_list_of_rules_breaks_between_words(capsys, tmp_path, monkeypatch):
    (tmp_path / "config.yaml").write_text("samples: {a: {kind: synthetic, pixel_size_um: 2}}")
    rules = {f"some_rule_with_a_name_{n}": 2 for n in range(9)}
    monkeypatch.setattr(study, "jobs_left", lambda *_: rules)
    said = grainfall(capsys, "run", tmp_path, "--dry-run")[1]
    assert max(map(len, said.splitlines())) <= 80
    assert set(rules) <= set(said.split())


def test_where_nothing_may_be_written_it_says_so(capsys, monkeypatch, tmp_path):
    (tmp_path / "config.yaml").write_text("samples: {a: {kind: synthetic, pixel_size_um: 2}}")
    monkeypatch.setattr("os.access", lambda _, right, **__: right != os.W_OK)
    assert "may not be written to" in grainfall(capsys, "run", tmp_path)[2]
    status, said, _ = grainfall(capsys, "status", tmp_path)
    assert status == 0
    assert "cannot be told" in " ".join(said.split())


def test_the_image_may_lie_in_the_folder_already(capsys, picture, tmp_path):
    (tmp_path / "a").mkdir()
    image = shutil.copy(picture, tmp_path / "a")
    assert grainfall(capsys, "new", tmp_path / "a", "--image", image, "--pixel-size", "1um")[0] == 0
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / picture.name).write_text("another")
    (tmp_path / "c").mkdir()
    (tmp_path / "c/im_1_.png").write_text("another")
    braced = shutil.copy(picture, tmp_path / "im{1}.png")
    assert grainfall(capsys, "new", tmp_path / "c", "--image", braced, "--pixel-size", "1um")[0] == 1
    assert (tmp_path / "c/im_1_.png").read_text() == "another"
    status, _, fault = grainfall(capsys, "new", tmp_path / "b", "--image", picture, "--pixel-size", "1um")
    assert status == 1
    assert "is there already" in fault
    assert (tmp_path / "b" / picture.name).read_text() == "another"


def test_every_comment_of_a_new_config_is_the_schemas(capsys, picture, tmp_path):
    grainfall(capsys, "new", tmp_path / "a", "--image", picture, "--pixel-size", "1um")
    text = (tmp_path / "a/config.yaml").read_text()
    flat = " ".join(line.strip(" #") for line in text.splitlines())
    properties = study.schema("config")["properties"]
    for key in yaml.safe_load(text):
        if "description" in properties[key] and "properties" not in properties[key]:
            assert properties[key]["description"] in flat


def test_nothing_is_overwritten(capsys, picture, tmp_path):
    new = ("new", tmp_path / "a", "--image", picture, "--pixel-size", "1um")
    assert grainfall(capsys, *new)[0] == 0
    config = tmp_path / "a/config.yaml"
    config.write_text(config.read_text() + "# mine\n")
    (tmp_path / "a/results").mkdir()
    status, _, fault = grainfall(capsys, *new)
    assert status == 1
    assert "--force" in fault
    assert config.read_text().endswith("# mine\n")
    assert grainfall(capsys, *new, "--force")[0] == 0
    assert not config.read_text().endswith("# mine\n")
    assert (tmp_path / "a/results").is_dir()


def test_jobs_that_run_at_once_are_kept_within_the_memory(capsys, root, tmp_path, monkeypatch):
    shutil.copy(root / "docs/tiny.yaml", tmp_path / "config.yaml")
    commands = []
    monkeypatch.setattr(study, "follow", lambda command, each: (commands.append(command) or 0, None))
    monkeypatch.setattr(doctor, "memory_limit", lambda: 20 * 2**30)
    assert grainfall(capsys, "run", tmp_path)[0] == 0
    (command,) = commands
    assert command[command.index("--resources") + 1] == f"mem_mb={round(0.9 * 20 * 1024)}"
    assert command[-1] == "--"  # all there is
    # a file that is wanted alone; a study may be named by its config
    assert grainfall(capsys, "run", tmp_path / "config.yaml", "-t", "results/tiny/sizes.csv")[0] == 0
    assert commands[1][-2:] == ["--", "results/tiny/sizes.csv"]
    assert "--keep-going" in commands[1]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["new"], "Missing"),
        (["nwe"], "No such command 'nwe'"),
        (["run", "--cores", "many"], "'many' is no number of cores"),
        (["run", "--cores", "0"], "'0' is no number of cores"),
        (["run", "{tmp}/nowhere"], "holds no config.yaml"),
        (["status", "{tmp}"], "holds no config.yaml"),
        (["view", "{tmp}/valid"], "there is no report yet"),
        (["export", "{tmp}/valid", "--format", "docx"], "'docx' is not known; one of: mhd"),
        (["export", "{tmp}/valid", "--format", "mhd", "--twin", "a/b/0"], "'a/b/0' is not in the study"),
        (["export", "{tmp}/valid", "--format", "mhd"], "valid/results/a/full/0: there is no twin yet"),
        (["export", "{tmp}/valid", "--format", "mhd", "--twin", "all"], "there is no twin yet"),
        (["verify", "{tmp}/valid"], "results/provenance.json"),
        (["verify", "{tmp}/nowhere"], "is no folder"),
        (["run", "{tmp}/invalid"], "did you mean 'edge_um'?"),
        (["run", "{tmp}/garbled"], "is not YAML"),
        (["run", "{tmp}/latin"], "config.yaml: is not UTF-8 text"),
        (["run", "{tmp}/template"], "which would be run as code"),
        (["status", "{tmp}/slice"], "data 'moon' is unknown"),
        (["run", "{tmp}/synthetic"], "did you mean 'porosity'?"),
        (["new", "{tmp}/x", "--image", "no.png", "--pixel-size", "1um"], "no.png: no such file"),
        (["new", "{tmp}/x", "--image", "{image}", "--pixel-size", "1 parsec"], "a length like 1.2um"),
        (["new", "{tmp}/x", "--image", "{image}", "--pixel-size", "0um"], "is no length"),
        (["new", "{tmp}/x", "--image", "{image}", "--pixel-size", "1um", "--kind", "x"], "'x' is unknown"),
        (
            ["new", "{tmp}/x", "--image", "{image}", "--pixel-size", "1um", "--preset", "reference"],
            "not been",
        ),
        (
            ["new", "{tmp}/x", "--image", "{image}", "--pixel-size", "1um", "--phases", "pore=0;a b=255"],
            "letters, digits, - and _",
        ),
        (["run", "{tmp}/moved"], "image gone.png does not exist; a path from {tmp}/moved"),
        (["view", "{tmp}/moved"], "there is no report yet"),
        (
            ["run", "{tmp}/a{{1}}"],
            "a{1}: has a brace in its path, which marks a wildcard; rename the folder",
        ),
        (["new", "{tmp}/x{{1}}", "--image", "{image}", "--pixel-size", "1um"], "has a brace"),
        (["new", "{tmp}/file", "--image", "{image}", "--pixel-size", "1um"], "is a file"),
        (["new", "{tmp}/file/rock", "--image", "{image}", "--pixel-size", "1um"], "{tmp}/file: is a file"),
        (["new", "{tmp}/x", "--image", "{tmp}/results", "--pixel-size", "1um"], "a study needs for itself"),
        (["new", "{tmp}/x", "--image", "{tmp}/b\udcff.png", "--pixel-size", "1um"], "is no UTF-8 text"),
        (["view", "{tmp}/a b"], "grainfall run '{tmp}/a b' makes it"),
        (["export", "{tmp}/a b", "-f", "mhd"], "grainfall run '{tmp}/a b' makes it"),
        (["status", "{tmp}/moved"], "image gone.png does not exist; a path from {tmp}/moved"),
    ],
)
def test_mistakes_are_one_line(capsys, picture, tmp_path, arguments, words):
    for name, text in {
        "valid": "samples: {a: {kind: synthetic, pixel_size_um: 2}}",
        "a b": "samples: {a: {kind: synthetic, pixel_size_um: 2}}",
        "invalid": "samples: {a: {kind: synthetic, pixel_size_um: 2}}\nscene: {edge_mu: 3}",
        "garbled": "samples: [",
        "latin": "title: caf\xe9\nsamples: {a: {kind: synthetic, pixel_size_um: 2}}",
        "a{1}": "samples: {a: {kind: synthetic, pixel_size_um: 2}}",
        "template": "__use_yte__: true\nsamples: {a: {kind: synthetic, pixel_size_um: 2}}",
        "slice": "samples: {a: {kind: slice, data: moon, slice: z3}}",
        "moved": "samples: {a: {kind: binary, pixel_size_um: 2, image: gone.png}}",
        "synthetic": "samples: {a: {kind: synthetic, pixel_size_um: 2, synthetic: {porosty: 0.5}}}",
    }.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / "config.yaml").write_text(text, encoding="latin-1")
    (tmp_path / "file").write_text("")
    filled = [a.format(tmp=tmp_path, image=picture) for a in arguments]
    status, _, fault = grainfall(capsys, *filled)
    assert status in (1, 2)
    assert words.replace("{tmp}", str(tmp_path)) in fault
    assert fault.startswith("grainfall: ")
    assert fault.count("\n") == 1
    assert not (tmp_path / "x").exists()
    assert not (tmp_path / "valid/results").exists()


def test_an_unexpected_error_is_one_line_too(capsys, monkeypatch, tmp_path):
    def fails(*_):
        raise ZeroDivisionError("of all things\nin two lines")

    monkeypatch.setattr(study, "open_study", fails)
    status, _, fault = grainfall(capsys, "run", tmp_path)
    assert (status, fault.count("\n")) == (1, 1)
    assert "ZeroDivisionError: of all things in two lines" in fault
    monkeypatch.setenv(cli.TRACE, "1")
    with pytest.raises(ZeroDivisionError):
        cli.run(["run", str(tmp_path)])


def test_without_a_checkout_the_missing_workflow_is_named(capsys, monkeypatch, tmp_path):
    monkeypatch.setattr(study.grainfall, "__file__", str(tmp_path / "site-packages/grainfall/__init__.py"))
    status, _, fault = grainfall(capsys, "run", tmp_path)
    assert status == 1
    assert "without its workflow" in fault or "holds no config" in fault
    with pytest.raises(InputError, match="clone the repository"):
        study.house()


def test_a_section_without_a_whole_grain_is_refused(tmp_path):
    one = np.full((60, 60), 255, np.uint8)
    one[:2] = 0  # a grain cut by three borders
    Image.fromarray(one).save(tmp_path / "one.png")
    with pytest.raises(InputError, match=r"one\.png: shows no whole grain; a larger section"):
        look.look(tmp_path / "one.png", 1.0)


@pytest.mark.parametrize(
    ("text", "um"),
    [("1.2um", 1.2), ("1.2 µm", 1.2), ("800nm", 0.8), ("0.02mm", 20.0), ("3", 3.0), ("1e-1um", 0.1)],
)
def test_lengths(text, um):
    assert look.length_um(text) == pytest.approx(um)


@pytest.mark.parametrize("text", ["", "um", "1.2.3um", "-1um", "1km", "1um2", "inf", "nan", "1e999um"])
def test_what_is_no_length(text):
    with pytest.raises(InputError, match="is no length"):
        look.length_um(text)


@pytest.mark.parametrize(("voxels", "text"), [(143_055_667, "140"), (262_144, "0.26"), (2**31, "2100")])
def test_millions_are_written_out(voxels, text):
    assert look._millions(voxels) == text


def test_a_known_law_is_found_again():
    """Costs made by a power law and straight lines come back from the fit."""
    rng = np.random.default_rng(0)
    table = pd.DataFrame({"preset": ["draft", "standard"] * 4, "grains": rng.uniform(200, 4000, 8).round()})
    table["voxels"] = rng.uniform(1e5, 4e6, 8)
    table["solid_fraction"] = 0.6
    factor = np.where(table.preset == "draft", 0.002, 0.005)
    table["packing_cpu_s"] = factor * table.grains**1.4
    table["other_cpu_s"] = 30 + 1e-5 * table.voxels
    table["peak_rss_mb"] = 300 + 2e-4 * table.voxels
    costs = Costs(table)
    assert costs.factor == pytest.approx(1)
    scene = {
        "edge_um": 80.0, "margin_um": 10.0, "probabilities": [0.5, 0.5], "mean_volumes_um3": [400.0, 800.0],
        "shape_zyx": [40, 40, 40],
    }  # fmt: skip
    cost = costs.twin("standard", scene)
    assert cost.grains == 1000  # 0.6 of a cube of 100 um in grains of 600 um3
    assert cost.cpu_s == pytest.approx(0.005 * 1000**1.4 + 30 + 0.64)
    assert cost.memory_mb == pytest.approx(300 + 12.8)
    most = table.grains.max()
    for times, measured in ((1.9, True), (2.1, False)):
        edge = (times * most * 600 / 0.6) ** (1 / 3) - 2 * scene["margin_um"]
        assert costs.twin("standard", scene | {"edge_um": edge}).measured is measured


def test_the_table_of_costs_is_a_measurement():
    """Of both presets, over a range of sizes, and told better by the fit than by a guess."""
    costs = Costs.measured()
    assert set(costs.presets) == {"draft", "standard"}
    for _, rows in costs.table.groupby("preset"):
        assert rows.grains.max() > 1.5 * rows.grains.min()
        assert (rows.packing_cpu_s > 0).all()
    assert 1 <= costs.factor < 3


def test_every_command_is_documented(root):
    text = (root / "docs/cli.md").read_text()
    from grainfall.cli.app import app

    for command in app.registered_commands:
        assert f"`grainfall {command.callback.__name__}" in text


def test_a_checkout_is_a_study(root):
    opened = study.open_study(root)
    assert opened.file == root / "config/config.yaml"
    assert opened.twins[0] == ("demo", "full", 0)


def test_what_a_run_says_is_understood():
    known = study.Followed()
    for line in ("total   56", "rule morphology:", "3 of 56 steps (5%) done", "localrule all:"):
        known.read(line)
    assert (known.done, known.total, known.rule, known.fault) == (3, 56, "all", "")
    known.read("grainfall: a.png: truncated; copy it again")
    known.read("grainfall: another")
    assert known.fault == "a.png: truncated; copy it again"


@pytest.mark.parametrize(
    ("said", "fault"),
    [
        (
            ['WorkflowError in file "common.smk", line 7:', "results: may not be written to"],
            "results: may not",
        ),
        (
            ["RuleException:", 'CalledProcessError in file "a.smk", line 5:', "Command 'cp' failed"],
            "Command 'cp'",
        ),
        (["Error in rule flow:", "    jobid: 3", "WorkflowError:", "At least one job"], "At least one job"),
        (["LockException:", "Error: Directory cannot be locked."], "the study is locked"),
        (
            [
                "RuleException:",
                "Command 'python /a/tmp1.flow.py' died with <Signals.SIGKILL: 9>.",
                "grainfall: b",
            ],
            "a job of rule flow was ended by SIGKILL, as a machine short of memory does",
        ),
        (["grainfall: a.png: truncated", "WorkflowError:", "At least one job"], "a.png: truncated"),
    ],
)
def test_the_first_fault_is_the_one_that_is_told(said, fault):
    known = study.Followed()
    for line in said:
        known.read(line)
    assert known.fault.startswith(fault)


def test_export_replaces_only_by_force(capsys, tmp_path):
    folder = tmp_path / "valid"
    twin = folder / "results/a/full/0"
    (twin / "export").mkdir(parents=True)
    (folder / "config.yaml").write_text("samples: {a: {kind: synthetic, pixel_size_um: 2}}")
    columns = ["id", "kind", "phase", "shape", "scale", "x", "y", "z"]
    pd.DataFrame([[0, "grain", 1, 0, 5.0, 1, 2, 3]], columns=columns).to_csv(twin / "bodies.csv", index=False)
    (twin / "export/grains.data").write_text("mine")
    status, _, fault = grainfall(capsys, "export", folder, "--format", "lammps")
    assert status == 1
    assert "--force" in fault
    assert (twin / "export/grains.data").read_text() == "mine"
    assert grainfall(capsys, "export", folder, "--format", "lammps", "--force")[0] == 0
    assert "1 atoms" in (twin / "export/grains.data").read_text()
    assert [path.name for path in (twin / "export").iterdir()] == ["grains.data"]
    status, said, _ = grainfall(capsys, "export", folder)
    assert status == 0
    assert "statoil" in said


def test_every_twin_is_exported_at_once(capsys, tmp_path):
    (tmp_path / "config.yaml").write_text(
        "samples: {a: {kind: synthetic, pixel_size_um: 2}}\nrealizations: 2"
    )
    bodies = pd.DataFrame(
        {"id": [0], "kind": "grain", "phase": 1, "shape": 0, "scale": 5.0, "x": 1, "y": 2, "z": 3}
    )
    for n in (0, 1):
        (tmp_path / f"results/a/full/{n}").mkdir(parents=True)
        bodies.to_csv(tmp_path / f"results/a/full/{n}/bodies.csv", index=False)
    export = ("export", tmp_path, "--format", "lammps", "--twin", "all")
    assert grainfall(capsys, *export)[0] == 0
    beside = sorted(tmp_path.glob("results/a/full/*/export/grains.data"))
    assert len(beside) == 2
    status, _, fault = grainfall(capsys, *export)
    assert status == 1
    assert "--force" in fault
    assert grainfall(capsys, *export, "--to", tmp_path / "out")[0] == 0
    assert sorted(path.parent.name for path in (tmp_path / "out").rglob("grains.data")) == ["0", "1"]


@pytest.mark.filterwarnings("ignore::PendingDeprecationWarning")
def test_documentation_builds_without_a_warning(root, tmp_path):
    pytest.importorskip("sphinx")
    from sphinx.cmd.build import main

    assert main(["-W", "-q", "-b", "html", str(root / "docs"), str(tmp_path)]) == 0
    keys = (tmp_path / "config.html").read_text()
    assert "morphology.grain_persistence" in keys
    assert "s2_inside_envelope" in (tmp_path / "results.html").read_text()
    library = (tmp_path / "api.html").read_text()
    modules = sorted((root / "src/grainfall").iterdir())
    chapters = {m.stem for m in modules if not m.name.startswith("_")} - {"cli"}
    assert {c for c in chapters if f'id="module-grainfall.{c}"' not in library} == set()
    # it reads the same without a network: nothing comes from elsewhere, the browser draws the equations
    loaded = re.compile(r"""<(?:script|link|img|iframe)\b[^>]*\b(?:src|href)=["']?(?:https?:)?//[^>]*>""")
    assert [tag for page in tmp_path.rglob("*.html") for tag in loaded.findall(page.read_text())] == []
    sheets = "".join(sheet.read_text() for sheet in tmp_path.rglob("*.css"))
    assert not re.search(r"@import|url\(\s*[\"']?(?:https?:)?//", sheets)
    method = (tmp_path / "method.html").read_text()
    assert method.count("<math") == (root / "docs/method.md").read_text().replace("$$", "$").count("$") / 2
    assert "\\frac" not in method


def test_study_can_be_made_from_a_zarr_folder(capsys, tmp_path):
    import zarr

    y, x = np.mgrid[:100, :100]
    discs = (np.hypot(y % 25 - 12, x % 25 - 12) < 9).astype(np.uint8)
    zarr.create_group(tmp_path / "s.zarr").create_array("phase", data=discs)
    image = tmp_path / "s.zarr"
    status, _, fault = grainfall(capsys, "new", tmp_path / "a", "--image", image, "--pixel-size", "1um")
    assert (status, fault) == (0, "")
    shutil.rmtree(image)
    assert sheet.load_yaml(tmp_path / "a/config.yaml")["samples"]["a"]["image"] == "s.zarr"
    assert study.open_study(tmp_path / "a").samples
