"""Provenance: sums that tell files apart, records that move with their folder, changes in plain words."""

import copy
import os
import tomllib

import pytest
import yaml

from grainfall import cli, config, io, provenance
from grainfall.errors import InputError


@pytest.fixture
def study(tmp_path, monkeypatch, root):
    """A finished run in small: one input, one twin, two jobs, all provenance written."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rock.png").write_bytes(b"image")
    given = {"samples": {"rock": {"kind": "binary", "image": "rock.png", "pixel_size_um": 2.0}}}
    (tmp_path / "my.yaml").write_text(yaml.safe_dump(given))
    twin = tmp_path / "results/rock/full/0"
    io.write_text("results/rock/section.csv", "section\n")
    io.write_text(twin / "twin.csv", "twin\n")
    sample_log, twin_log = "results/rock/logs/read.json", twin / "logs/twin.json"
    provenance.write_record(sample_log, "read", ["rock.png"], ["results/rock/section.csv"], {"a": 1})
    provenance.write_record(twin_log, "twin", ["results/rock/section.csv"], [str(twin / "twin.csv")], {})
    whole, rows = provenance._resolved(root, ["my.yaml"], {"seed": 4})
    io.write_text(twin / "figure.svg", "later")
    provenance.write_record(
        twin / "logs/figure.json", "figure", [str(twin / "twin.csv")], [str(twin / "figure.svg")], {}
    )
    document = provenance.of_twin(
        twin, [twin / "twin.csv"], config.variant(whole, "full"), rows["rock"], whole["seed"]
    )
    io.write_json(twin / "provenance.json", document)
    io.write_text("results/summary.csv", "summary\n")
    summary = "results/summary.csv", "results/logs/summary.json"
    provenance.write_record(summary[1], "summary", [str(twin / "figure.svg")], [summary[0]], {})
    run = provenance.of_run(
        "results", summary[:1], root, files=["my.yaml"], overrides={"seed": 4}, config=whole, samples=rows
    )
    io.write_json("results/provenance.json", run)
    return tmp_path


def changes(root):
    return provenance.verify("results", root)[0]


def test_a_twin_tells_all_it_rests_on(study):
    twin = io.read_json("results/rock/full/0/provenance.json")
    assert (twin["sample"], twin["variant"], twin["realization"], twin["seed"]) == ("rock", "full", "0", 4)
    assert twin["config"]["packing"]["engine"] == "physx"
    read = twin["jobs"]["../../logs/read.json"]
    assert read["inputs"] == {"../../../rock.png": provenance.checksum("rock.png")}
    assert read["versions"] == provenance.versions()
    # what was drawn from the twin is not what it rests on
    assert sorted(twin["jobs"]) == ["../../logs/read.json", "logs/twin.json"]


def test_nothing_changed(study, root):
    assert changes(root) == []
    assert cli.run(["verify"]) == 0


@pytest.mark.parametrize(
    ("path", "content", "line"),
    [
        ("rock.png", "other", "input: rock.png is not the file that was used"),
        ("rock.png", None, "input: rock.png is gone"),
        (
            "results/rock/full/0/twin.csv",
            "other",
            "output: results/rock/full/0/twin.csv is not what rule twin wrote",
        ),
        ("results/rock/full/0/twin.csv", None, "output: results/rock/full/0/twin.csv is gone (rule twin)"),
        (
            "results/rock/full/0/figure.svg",
            "x",
            "output: summary.csv of results came from another results/rock",
        ),
        ("my.yaml", None, "config: cannot be read as it was: my.yaml: No such file"),
    ],
)
def test_change_of_a_file_in_plain_words(study, root, capsys, path, content, line):
    (study / path).unlink()
    if content:
        (study / path).write_text(content)
    assert any(change.startswith(line) for change in changes(root)), changes(root)
    assert cli.run(["verify"]) == 1
    assert line in capsys.readouterr().out


def test_change_of_a_key_or_a_version_in_plain_words(study, root, monkeypatch):
    given = config.load_yaml("my.yaml")
    given["scene"] = {"porosity": 0.3}
    given["samples"]["rock"]["pixel_size_um"] = 3.0
    (study / "my.yaml").write_text("# a remark changes nothing\n" + yaml.safe_dump(given))
    assert changes(root) == [
        "config: scene.porosity was None, is 0.3",
        "config: sample rock.pixel_size_um was 2, is 3",
    ]
    later = {**provenance.versions(), "numpy": "99"}
    monkeypatch.setattr(provenance, "versions", lambda: later)
    assert any(c.startswith("version: numpy was") and c.endswith("is '99'") for c in changes(root))


def test_result_of_another_file_than_the_rest(study, root):
    """A section made anew behind the back of its twin."""
    io.write_text("results/rock/section.csv", "another\n")
    provenance.write_record(
        "results/rock/logs/read.json", "read", ["rock.png"], ["results/rock/section.csv"], {}
    )
    twin = study / "results/rock/full/0"
    document = io.read_json(twin / "provenance.json")
    jobs = provenance.behind([twin / "twin.csv"], [study / "results/rock", twin])
    document["jobs"] = {os.path.relpath(path, twin): record for path, record in jobs.items()}
    io.write_json(twin / "provenance.json", document)
    assert changes(root) == [
        "output: twin.csv of results/rock/full/0 came from another results/rock/section.csv"
    ]


def test_a_damaged_file_is_not_used(study):
    provenance.check_files(["results/rock/section.csv"])
    provenance.check_files(["rock.png"])  # nobody recorded it
    (study / "results/rock/section.csv").write_text("damaged")
    with pytest.raises(InputError, match="is not what read wrote"):
        provenance.check_files(["results/rock/section.csv"])


def test_of_two_records_the_first_by_name_counts(study):
    for name, content in (("b", "later\n"), ("a", "section\n")):
        io.write_text("results/rock/section.csv", content)
        provenance.write_record(f"results/rock/logs/{name}.json", name, [], ["results/rock/section.csv"], {})
    provenance.check_files(["results/rock/section.csv"])  # as "a" wrote it
    io.write_text("results/rock/section.csv", "later\n")
    with pytest.raises(InputError, match="is not what a wrote"):
        provenance.check_files(["results/rock/section.csv"])


def test_a_record_counts_while_any_of_its_outputs_is_there(study):
    one, other = "results/rock/one.csv", "results/rock/other.csv"
    for path in (one, other):
        io.write_text(path, "as made")
    provenance.write_record("results/rock/logs/both.json", "both", [], [one, other], {})
    (study / one).unlink()
    io.write_text(other, "damaged")
    with pytest.raises(InputError, match="is not what both wrote"):
        provenance.check_files([other])


def test_a_run_rests_on_all_files_of_its_samples(study, root):
    run = io.read_json("results/provenance.json")
    row = {**run["samples"]["rock"], "grey": "grey.tif", "reference": "rock.tif"}
    for path in ("grey.tif", "rock.tif"):
        io.write_text(path, path)
    found = provenance.of_run(
        "results", [], root, files=[], overrides={}, config=run["config"]["resolved"], samples={"rock": row}
    )
    assert found["inputs"] == {
        path: provenance.checksum(path) for path in ("rock.png", "grey.tif", "rock.tif")
    }


@pytest.mark.parametrize(
    ("key", "line"),
    [("lock", "requirements.lock is another"), ("source", "the source of grainfall is another")],
)
def test_another_lock_and_another_source_are_told(study, root, key, line):
    run = io.read_json("results/provenance.json")
    io.write_json("results/provenance.json", {**run, key: "x"})
    (change,) = changes(root)
    assert change.startswith(f"version: {line}")


def test_jobs_of_other_versions_are_named(study, root):
    path = study / "results/rock/full/0/provenance.json"
    document = io.read_json(path)
    document["jobs"]["logs/twin.json"]["versions"]["numpy"] = "1"
    io.write_json(path, document)
    (change,) = changes(root)
    assert change.startswith("version: numpy was '1'")
    assert change.endswith("(jobs twin)")


def test_records_are_read_once_however_many_files(study, monkeypatch):
    read = []
    once = provenance.records
    monkeypatch.setattr(provenance, "records", lambda folder: read.append(folder) or once(folder))
    provenance.check_files(["results/rock/section.csv"] * 20 + ["rock.png"] * 20)
    assert len(read) == len(set(read)) <= 2 * provenance.LEVELS


def test_records_move_with_their_folder(study):
    (study / "results").rename(study / "moved")
    provenance.check_files(["moved/rock/section.csv"])
    (study / "moved/rock/section.csv").write_text("damaged")
    with pytest.raises(InputError):
        provenance.check_files(["moved/rock/section.csv"])


def test_sum_of_a_folder_is_of_names_and_contents(tmp_path):
    for name in ("a", "b", "c"):
        io.write_text(tmp_path / name / "in/x.txt", "1")
    io.write_text(tmp_path / "b/.snakemake_timestamp", "")
    (tmp_path / "c/in/x.txt").rename(tmp_path / "c/in/y.txt")
    sums = [provenance.checksum(tmp_path / name) for name in ("a", "b", "c")]
    assert sums[0] == sums[1] != sums[2]
    io.write_text(tmp_path / "a/in/x.txt", "2")
    assert provenance.checksum(tmp_path / "a") != sums[0]


def test_packages_are_those_of_the_project(root):
    project = tomllib.loads((root / "pyproject.toml").read_text())["project"]
    extras = copy.deepcopy(project["optional-dependencies"])
    wanted = {
        name.split(">")[0] for name in [*project["dependencies"], *extras["packing"], *extras["analysis"]]
    }
    assert wanted == set(provenance.PACKAGES)
