"""A user's mistake in the config or the sheet is one line that says where and what would be right."""

import dataclasses
import importlib.metadata
import json
import re
import string
import tomllib

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from packaging.specifiers import SpecifierSet

from grainfall import config
from grainfall.errors import InputError
from grainfall.packing import Parameters


@pytest.fixture(scope="module")
def sample_schema(root):
    return config.load_yaml(root / "workflow/schemas/samples.schema.yaml")


@pytest.fixture(scope="module")
def presets(root):
    return config.load_yaml(root / "config/presets.yaml")


def test_every_committed_config_is_valid(root, schema, presets, monkeypatch):
    monkeypatch.chdir(root)  # sheets are named from the working directory
    files = [root / "config/config.yaml", *sorted((root / "config/cases").glob("*.yaml"))]
    assert len(files) > 1
    for file in files:
        for preset in ("draft", "standard", "reference"):
            config.resolve({**config.load_yaml(file), "preset": preset}, schema, presets, str(file))


def test_precedence(schema, presets):
    low = config.resolve({"samples": "s.tsv", "preset": "draft"}, schema, presets)
    own = config.resolve(
        {"samples": "s.tsv", "preset": "draft", "grains": {"shapes_per_phase": 7}}, schema, presets
    )
    default = config.resolve({"samples": "s.tsv"}, schema, presets)
    assert default["grains"]["shapes_per_phase"] > low["grains"]["shapes_per_phase"] > 7
    assert own["grains"]["shapes_per_phase"] == 7
    whole = config.resolve(
        {"samples": "s.tsv", "variants": {"a": None, "b": {"scene": {"sizes_from": "f2d"}}}}, schema, presets
    )
    assert config.variant(whole, "a")["scene"]["sizes_from"] == "f3d"
    assert config.variant(whole, "b")["scene"]["sizes_from"] == "f2d"
    assert config.variant(whole, "b")["scene"]["edge_grains"] == whole["scene"]["edge_grains"]


def test_text_from_the_command_line_is_read_as_what_the_schema_asks_for(schema, sample_schema, presets):
    """Snakemake's --config gives the values of a mapping as text; to YAML 1e3 is a word."""
    asked = {"scene": {"edge_um": "1e3", "porosity": "null"}, "realizations": "3", "seed": "12"}
    variants = {"a": {"scene": {"voxel_size_um": "2.5"}}}
    whole = config.resolve({"samples": "s.tsv", **asked, "variants": variants}, schema, presets)
    assert (whole["scene"]["edge_um"], whole["scene"]["porosity"]) == (1000, None)
    assert (whole["realizations"], whole["seed"]) == (3, 12)
    assert whole["variants"]["a"]["scene"]["voxel_size_um"] == 2.5
    rows = config.read_samples({"x": {"kind": "synthetic", "pixel_size_um": "1e-1"}}, sample_schema)
    assert rows["x"]["pixel_size_um"] == 0.1
    for wrong in ("wide", "1_000", "nan", ""):
        with pytest.raises(InputError, match="edge_um"):
            config.resolve({"samples": "s.tsv", "scene": {"edge_um": wrong}}, schema, presets)


def reworded(content):
    """The same values with the keys in another order, and with a point in whole numbers."""
    if isinstance(content, dict):
        return {key: reworded(content[key]) for key in reversed(content)}
    if isinstance(content, list):
        return [reworded(item) for item in content]
    return float(content) if type(content) is int else content


def test_one_meaning_has_one_text(root, schema, sample_schema, presets):
    """Snakemake compares parameters as text."""
    for file in (root / "config/config.yaml", *sorted((root / "config/cases").glob("*.yaml"))):
        given = config.load_yaml(file)
        whole = config.resolve(given, schema, presets)
        again = config.resolve(reworded(given), schema, presets)
        assert repr(again["realizations"]) == repr(whole["realizations"])  # an integer may be written 2.0
        for name in whole["variants"]:
            one, other = (
                {**config.variant(w, name), "samples": None, "variants": None} for w in (whole, again)
            )
            assert repr(one) == repr(other)
        # what the user listed is shown in the user's order, that of a table in its own
        names = list(whole["variants"])
        assert list(again["variants"]) == (names if "sweep" in given else names[::-1])
    mapping = {"b": {"kind": "synthetic", "pixel_size_um": 2, "synthetic": {"exponent": 2, "dissolved": 0}}}
    one, other = (config.read_samples(m, sample_schema) for m in (mapping, reworded(mapping)))
    assert repr(one) == repr(other)


def test_bare_on_and_off_are_switches(schema, presets):
    """YAML 1.1 takes them for true and false."""
    text = (
        "{samples: s.tsv, effects: {cement: on, densification: off}, variants: {a: {effects: {cement: off}}}}"
    )
    whole = config.resolve(yaml.safe_load(text), schema, presets)
    assert (whole["effects"]["cement"], whole["effects"]["densification"]) == ("on", "off")
    assert config.variant(whole, "a")["effects"]["cement"] == "off"
    assert config.variant(whole, "a")["effects"]["virtual_spheres"] == "auto"


def test_names_are_text_whatever_yaml_reads_them_as(schema, sample_schema, presets):
    text = """
        samples: {2024-05-01: {kind: synthetic, pixel_size_um: 2}, 007: {kind: slice, data: "3", slice: z1}}
        variants: {300: {}, 1: }
        data: {3: {source: a.tif, voxel_size_um: 1, files: {%s: 0}}}
        accuracy_sweep: {packing: {5: ["300"]}, against: "1", chance: {300: "1"}}
    """
    whole = config.resolve(yaml.safe_load(text % (64 * "a")), schema, presets)
    assert (list(whole["samples"]), list(whole["variants"])) == (["2024-05-01", "7"], ["300", "1"])
    assert json.loads(json.dumps(whole)) == whole
    samples = config.samples_of(whole, schema, sample_schema, files=False)
    assert samples == config.read_samples(yaml.safe_load(text % "a")["samples"], sample_schema)
    assert list(samples) == ["2024-05-01", "7"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "{samples: s, variants: {no: {}}}",
            "variants: YAML reads a name there as False; put the name in quotes",
        ),
        ("{samples: {null: {kind: synthetic}}}", "samples: YAML reads a name there as None"),
        ("{samples: s, variants: {1.5: {}}}", "reads a name there as 1.5"),
        ("{samples: {7: {kind: synthetic}, '7': {kind: synthetic}}}", "samples: '7' stands there twice"),
        ("{samples: s, variants: {-1: {}}}", "variant '-1' is no name"),
        ("{samples: s, variants: {2024-05-01 10:00:00: {}}}", "is no name"),
    ],
)
def test_names_that_yaml_does_not_leave_as_written(schema, presets, text, words):
    with pytest.raises(InputError, match=re.escape(words)):
        config.resolve(yaml.safe_load(text), schema, presets)


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        ({"smaples": "x"}, "did you mean 'samples'"),
        ({"packing": {"engin": "physx"}}, "did you mean 'engine'"),
        ({"packing": {"engine": "phsyx"}}, "one of: physx, bullet"),
        ({"scene": {"porosity": 1.5}}, "scene.porosity"),
        ({"scene": {"edge_um": float("nan")}}, "not a finite number"),
        ({"realizations": 0}, "realizations"),
        ({"realizations": "two"}, "realizations"),
        ({"variants": {"a": {"stereology": {"method": "none"}}}}, "cannot differ between variants"),
        ({"variants": {"a": {"packing": {"engin": 1}}}}, "did you mean 'engine'"),
        ({"variants": {"a": {"sampels": 1}}}, "known keys: effects, feedback, flow, network, packing, scene"),
        ({"variants": {"a": {"scen": {}}}}, "did you mean 'scene'"),
        ({"variants": {"../a": {}}}, "is no name"),
        ({"feedback": {"limit": 0.05}}, "feedback.limit"),
        ({"effects": {"cement": "maybe"}}, "one of: auto, on, off"),
        ({"variants": {"full": {}, "Full": {}}}, "'full' and 'Full' differ in case only"),
        ({"effects": {"cememt": "on"}}, "did you mean 'cement'"),
    ],
)
def test_mistakes(schema, presets, bad, words):
    with pytest.raises(InputError, match=re.escape(words)):
        config.resolve({"samples": "s.tsv", **bad}, schema, presets)


SHEET = "sample\timage\tkind\tpixel_size_um\n"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "no column 'sample'"),
        ("a\tb\n1\t2\n", "no column 'sample'"),
        ("sample,image\na,a.png\n", "columns separated by tabs"),
        ("sample  image\na  a.png\n", "columns separated by tabs"),
        (SHEET, "no row"),
        (SHEET + "a\t\tsynthetic\t\n", "pixel_size_um is missing"),
        (SHEET + "a\t\tsynthetic\tone\n", "'one' is not a number"),
        (SHEET + "a\t\tsynthetic\t-1\n", "pixel_size_um"),
        (SHEET + "a\t\tsynthetic\tnan\n", "not finite"),
        (SHEET + "a\tno.png\tbinary\t1\n", "no.png does not exist"),
        (SHEET + "a\t\tbinary\t1\n", "image is missing"),
        (SHEET + "a\t\tbinray\t1\n", "one of: instances"),
        (SHEET + "../a\t\tsynthetic\t1\n", "is no name"),
        (SHEET + "benchmarks\t\tsynthetic\t1\n", "is no name"),
        (SHEET + "a\t\tsynthetic\t1\na\t\tsynthetic\t1\n", "twice"),
        (SHEET + "a\t\tsynthetic\t1\nA\t\tsynthetic\t1\n", "'a' and 'A' differ in case only"),
        (SHEET.replace("kind", "knd") + "a\t\tsynthetic\t1\n", "knd"),
    ],
)
def test_sheet_mistakes(tmp_path, sample_schema, text, words):
    (tmp_path / "s.tsv").write_text(text)
    with pytest.raises(InputError, match=re.escape(words)):
        config.read_samples(str(tmp_path / "s.tsv"), sample_schema)


def test_sheet_and_mapping_agree(tmp_path, sample_schema):
    (tmp_path / "s.tsv").write_text(SHEET + "a\t\tsynthetic\t2.5\n")
    mapping = {"a": {"kind": "synthetic", "pixel_size_um": 2.5}}
    sheet = config.read_samples(str(tmp_path / "s.tsv"), sample_schema)
    assert sheet == config.read_samples(mapping, sample_schema)


SWEEP = "variant\tpacking.overrides.friction_static\tscene.porosity\tflow.methods\teffects.cement\n"


def test_a_sweep_is_the_same_as_variants(tmp_path, schema, presets):
    path = tmp_path / "sweep.tsv"
    path.write_text(f"# a comment\n{SWEEP}a\t0.10\t\testimate;network\toff\nb\t\t.4\n")
    own = {"full": {"scene": {"porosity": 0.3}}}
    rows = {
        "a": {
            "packing": {"overrides": {"friction_static": 0.1}},
            "flow": {"methods": ["estimate", "network"]},
            "effects": {"cement": "off"},
        },
        "b": {"scene": {"porosity": 0.4}},
    }
    base = {"samples": "s.tsv", "variants": own}
    swept = config.resolve({**base, "sweep": str(path)}, schema, presets)
    listed = config.resolve({**base, "variants": {**own, **rows}}, schema, presets)
    assert list(swept["variants"]) == ["full", "a", "b"]
    assert {**swept, "sweep": None} == listed
    # alone, the table brings all variants there are
    assert list(config.resolve({"samples": "s.tsv", "sweep": str(path)}, schema, presets)["variants"]) == [
        "a",
        "b",
    ]
    assert config.parameters(swept)["b"] == {
        "effects.cement": "auto",
        "flow.methods": ["network", "estimate"],
        "packing.overrides.friction_static": None,
        "scene.porosity": 0.4,
    }
    assert "variants" not in config.variant(swept, "a")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("scene.porosity\n0.4\n", "no column 'variant'"),
        (SWEEP, "no row"),
        (SWEEP + "a\tsome\n", "variant a: packing.overrides.friction_static: 'some' is not a number"),
        (SWEEP + "a\t1\t7\n", "variants.a: scene.porosity"),
        (SWEEP + "a\t1\t\tguess\n", "one of: estimate"),
        (SWEEP + "a\t1\na\t2\n", "variant 'a' stands there twice"),
        (SWEEP + "full\t1\n", "variant 'full' is in the config, too"),
        (SWEEP + "../a\t1\n", "is no name"),
        ("variant\tscene.porosty\na\t0.4\n", "did you mean 'scene.porosity'"),
        ("variant\tstereology.method\na\tnone\n", "cannot differ between variants"),
    ],
)
def test_sweep_mistakes(tmp_path, schema, presets, text, words):
    (tmp_path / "sweep.tsv").write_text(text)
    study = {"samples": "s.tsv", "variants": {"full": {}}, "sweep": str(tmp_path / "sweep.tsv")}
    with pytest.raises(InputError, match=re.escape(words)):
        config.resolve(study, schema, presets)


def test_a_row_of_a_sweep_does_not_take_the_place_of_what_runs_without_it(tmp_path, schema, presets):
    (tmp_path / "sweep.tsv").write_text("variant\tscene.porosity\nfull\t0.4\n")
    study = {"samples": "s.tsv", "sweep": str(tmp_path / "sweep.tsv")}
    with pytest.raises(InputError, match="'full' is what a config without variants runs; another name"):
        config.resolve(study, schema, presets)
    (tmp_path / "sweep.tsv").write_text("variant\tscene.porosity\nfull\t\nless\t0.4\n")
    assert list(config.resolve(study, schema, presets)["variants"]) == ["full", "less"]


def test_a_length_in_grains_is_not_hidden_by_one_in_um(tmp_path, schema, presets):
    (tmp_path / "s.tsv").write_text(
        "variant\tscene.edge_grains\tscene.voxels_per_grain\nrow\t6\t\nfine\t\t24\n"
    )
    variants = {
        "full": None,
        "small": {"scene": {"edge_grains": 5}},
        "both": {"scene": {"edge_grains": 5, "edge_um": 99}},
        "wide": {"scene": {"edge_um": 400}},
    }
    base = {"samples": "s", "variants": variants, "sweep": str(tmp_path / "s.tsv")}
    whole = config.resolve({**base, "scene": {"edge_um": 300, "voxel_size_um": 2}}, schema, presets)
    scenes = {name: config.variant(whole, name)["scene"] for name in whole["variants"]}
    assert {name: (s["edge_um"], s["voxel_size_um"]) for name, s in scenes.items()} == {
        "full": (300, 2), "small": (None, 2), "both": (99, 2), "wide": (400, 2),
        "row": (None, 2), "fine": (300, None),
    }  # fmt: skip
    # the table of a sweep tells so, and has no column of what is null anyway
    assert config.parameters(whole)["row"]["scene.edge_um"] is None
    bare = config.resolve({**base, "variants": {"full": {}}}, schema, presets)
    assert set(config.parameters(bare)["row"]) == {"scene.edge_grains", "scene.voxels_per_grain"}


@pytest.mark.parametrize("written", ["010", "-007", "0x10", "0b11", "1_000", "12:30", "1_0.5", "007.5"])
@pytest.mark.parametrize("where", ["{a: %s}", "{%s: a}", "[{a: [1, %s]}]", "{a: b, c: {d: %s}}"])
def test_numbers_that_are_others_to_yaml_are_refused(tmp_path, written, where):
    """Snakemake, too, would read them so: a pixel of 010 um would be one of 8."""
    (tmp_path / "c.yaml").write_text("# config\n{x: %s}\n" % (where % written))
    for ours in (False, True):
        with pytest.raises(
            InputError, match=rf"c.yaml: line 2: {written} is .* to YAML; write it as a plain"
        ):
            config.load_yaml(tmp_path / "c.yaml", ours=ours)


def test_numbers_as_people_write_them_are_read(tmp_path):
    numbers = {
        "0": 0,
        "-3": -3,
        "+12": 12,
        "100": 100,
        "0.0": 0.0,
        "-0.25": -0.25,
        ".5": 0.5,
        "2.5e-3": 0.0025,
    }
    (tmp_path / "c.yaml").write_text("\n".join(f"k{n}: {text}" for n, text in enumerate(numbers)))
    assert list(config.load_yaml(tmp_path / "c.yaml").values()) == list(numbers.values())
    (tmp_path / "c.yaml").write_text("{'010': a, b: '0x10', 2024-05-01: c}")
    assert list(config.load_yaml(tmp_path / "c.yaml").values()) == ["a", "0x10", "c"]


def test_own_keys_go_before_merged_ones(tmp_path):
    rows = "{a: &r {kind: binary, pixel_size_um: 2}, q: &q {kind: grey}, b: {<<: [*q, *r], pixel_size_um: 3}}"
    (tmp_path / "c.yaml").write_text(rows)
    assert config.load_yaml(tmp_path / "c.yaml")["b"] == {"kind": "grey", "pixel_size_um": 3}
    (tmp_path / "c.yaml").write_text("{a: &r {kind: binary}, b: {<<: *r, k: 1, k: 2}}")
    with pytest.raises(InputError, match="line 1: key 'k' stands there twice"):
        config.load_yaml(tmp_path / "c.yaml")


def test_columns_that_a_spreadsheet_leaves_empty_are_none(tmp_path, sample_schema):
    head = SHEET.rstrip("\n")
    (tmp_path / "s.tsv").write_text(f"{head}\t\t\na\t\tsynthetic\t1\t\t\nb\t\tsynthetic\t2\n")
    assert list(config.read_samples(str(tmp_path / "s.tsv"), sample_schema)) == ["a", "b"]
    (tmp_path / "s.tsv").write_text(f"{head}\t\t\na\t\tsynthetic\t1\t\t7\n")
    with pytest.raises(InputError, match=r"s.tsv: column 6 has no name; a name above its cells"):
        config.read_samples(str(tmp_path / "s.tsv"), sample_schema)
    (tmp_path / "s.tsv").write_text("sample\t\timage\tkind\tpixel_size_um\na\t\t\tsynthetic\t1\n")
    assert config.read_samples(str(tmp_path / "s.tsv"), sample_schema)["a"]["pixel_size_um"] == 1


def test_phases():
    assert config.parse_phases("pore=-1;a=0") == {"pore": -1, "a": 0}
    assert config.parse_phases("pore=0;quartz=128") == {"pore": 0, "quartz": 128}
    assert config.parse_phases("pore;quartz") == ["pore", "quartz"]
    assert config.parse_phases("") is None
    assert config.parse_phases("pore = 0; quartz = 128 ") == {"pore": 0, "quartz": 128}
    with pytest.raises(InputError, match="value of quartz, '1,clay=2', is no whole number"):
        config.parse_phases("pore=0;quartz=1,clay=2")
    for bad in ("pore=0;quartz", "pore;pore"):
        with pytest.raises(InputError):
            config.parse_phases(bad)


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=8,
)


@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_config_is_accepted_or_refused(schema, presets, data):
    keys = st.sampled_from(sorted(schema["properties"])) | st.text(string.printable, max_size=8)
    content = data.draw(st.dictionaries(keys, VALUES, max_size=4))
    try:
        whole = config.resolve({"samples": "s.tsv", **content}, schema, presets)
    except InputError:
        pass
    else:
        assert set(whole) >= {"seed", "scene", "packing"}


def keys_of(schema, prefix=""):
    for key, sub in schema["properties"].items():
        if "properties" in sub:
            yield from keys_of(sub, f"{prefix}{key}.")
        else:
            yield prefix + key, sub


def test_every_key_is_documented(root, schema, sample_schema):
    text = (root / "config/README.md").read_text()
    for key, sub in [*keys_of(schema), *keys_of(sample_schema)]:
        assert f"| `{key}` |" in text, key
        assert sub.get("description"), key


def test_what_a_sweep_could_not_find_is_refused_at_once(schema, presets):
    own = {"samples": "samples.tsv", "variants": {"fine": {}, "coarse": {}}}
    for sweep, wrong in (
        ({"packing": {"knob": ["coarse"]}}, "against: is missing"),
        ({"packing": {"knob": ["corse"]}, "against": "fine"}, "no variant is called 'corse'"),
        ({"chance": {"again": "fine"}}, "no variant is called 'again'"),
        ({"presets": ["draft"]}, "no variant is called 'draft'"),
    ):
        with pytest.raises(InputError, match=wrong):
            config.resolve({**own, "accuracy_sweep": sweep}, schema, presets)


def test_defaults_of_packing_parameters_are_documented(root, schema):
    text = (root / "config/README.md").read_text()
    found = dict(re.findall(r"^\| `packing\.overrides\.(\w+)` \|.*\| `(.*)` \|$", text, re.M))
    known = schema["properties"]["packing"]["properties"]["overrides"]["properties"]
    assert found == {name: str(getattr(Parameters(), name)) for name in known}


def test_presets_are_documented_as_they_are(root, schema, presets):
    cells = r"^\| `(\w+)` \| (\d+) \| (\d+) \| (.*) \| (.*) \| (\d+) \| (\d+) \|"
    rows = re.findall(cells, (root / "docs/choosing.md").read_text(), re.M)
    assert [row[0] for row in rows] == list(presets)
    for name, edge, vertices, points, rest, shapes, bootstrap in rows:
        whole = config.resolve({"samples": "s.tsv", "preset": name}, schema, presets)
        p = Parameters.named(**whole["packing"]["overrides"])
        assert (float(edge), int(vertices)) == (whole["scene"]["edge_grains"], p.hull_vertices)
        assert {"kept from step to step": "persistent", "all anew": "full"}[points] == p.contact_manifold
        assert rest == f"{p.rest_windows}, {p.sleep_speed:g}, {p.sleep_steps}"
        assert int(shapes) == whole["grains"]["shapes_per_phase"]
        assert int(bootstrap) == whole["stereology"]["bootstrap"]


def test_every_packing_parameter_can_be_set(schema):
    """Overrides are the fields of Parameters without a key of their own, and take what the schema lets."""
    known = schema["properties"]["packing"]["properties"]["overrides"]["properties"]
    own = {"engine", "decomposition"}
    assert set(known) == {field.name for field in dataclasses.fields(Parameters)} - own
    for name, sub in known.items():
        for bound in ("minimum", "maximum"):
            if bound in sub:
                Parameters.named("default", **{name: sub[bound]})


def test_environments_are_in_step(root):
    """Each conda environment lists the core and its group, at the versions of the lock."""
    project = tomllib.loads((root / "pyproject.toml").read_text())["project"]
    lock = dict(line.split("==") for line in (root / "requirements.lock").read_text().split())
    name = re.compile(r"[A-Za-z0-9_.-]+")
    for group in ("analysis", "packing", "report"):
        wanted = [*project["dependencies"], *project["optional-dependencies"][group]]
        pins = {f"{name.match(w).group()}=={lock[name.match(w).group()]}" for w in wanted}
        env = yaml.safe_load((root / f"envs/{group}.yaml").read_text())
        listed = next(d["pip"] for d in env["dependencies"] if isinstance(d, dict))
        assert set(listed) == pins


def test_what_is_locked_runs_on_any_python_3_11(root):
    """Debian 12 has 3.11.2: a package that wants 3.11.5 cannot be installed there."""
    pins = [line for line in (root / "requirements.lock").read_text().splitlines() if "==" in line]
    wants = {pin: importlib.metadata.metadata(pin.split("==")[0]).get("Requires-Python") for pin in pins}
    assert len(wants) > 100
    assert [pin for pin, want in wants.items() if "3.11.0" not in SpecifierSet(want or "")] == []


def test_no_download_address_is_locked(root):
    for file in (root / "requirements.lock", root / "pyproject.toml", *sorted((root / "envs").iterdir())):
        assert "://" not in file.read_text(), file


def test_a_sample_has_its_own_synthetic_rock(schema):
    whole = config.resolve({"samples": "s.tsv", "synthetic": {"exponent": 2}}, schema, {})
    rock = config.synthesis(whole, {"synthetic": {"porosity": 0.5}}, schema, "here")
    assert (rock["exponent"], rock["porosity"]) == (2, 0.5)
    assert whole["synthetic"]["porosity"] is None
    with pytest.raises(InputError, match="did you mean 'porosity'"):
        config.synthesis(whole, {"synthetic": {"porosty": 0.5}}, schema, "here")


def test_rules_are_held_against_the_minerals_that_are_named(schema, sample_schema, presets):
    image = {"kind": "grey", "image": "a.png", "pixel_size_um": 1}
    named = {**image, "phases": "pore=0;quartz=128;clay=255"}

    def read(rule, sample):
        given = {"samples": {"a": sample}, "section": {"rules": [rule]}}
        whole = config.resolve(given, schema, presets)
        return config.samples_of(whole, schema, sample_schema, files=False)

    rule = {"phase": "clay", "feature": "r_um", "above": 3}
    assert read(rule, named)
    for sample in (named, {"kind": "synthetic", "pixel_size_um": 1}):
        with pytest.raises(InputError, match=r"sample a: section.rules.1.: phase 'nosuch' is unknown"):
            read({**rule, "phase": "nosuch"}, sample)
    assert read({**rule, "phase": "nosuch"}, image)  # whose names the image brings
    for bounds, words in (({}, "neither above nor below"), ({"above": 3, "below": 1}, "nothing is above 3")):
        with pytest.raises(InputError, match=f"config: section.rules.1.: {words}"):
            read({"phase": "clay", "feature": "r_um", **bounds}, image)


def test_a_slice_names_its_volume(sample_schema, tmp_path):
    rows = config.read_samples({"a": {"kind": "slice", "data": "rock", "slice": "z3"}}, sample_schema)
    (tmp_path / "rock.tif").write_bytes(b"")
    for source in (str(tmp_path / "rock.tif"), "http://rock.invalid/a.zip"):
        config.check_data(rows, {"rock": {"source": source}})
    for source, words in (("no.tif", "does not exist"), ("/dev/zero", "neither a file")):
        with pytest.raises(InputError, match=words):
            config.check_data(rows, {"rock": {"source": source}})
    with pytest.raises(InputError, match="data 'rock' is unknown"):
        config.check_data(rows, {})
    with pytest.raises(InputError, match="slice is missing"):
        config.read_samples({"a": {"kind": "slice", "data": "rock"}}, sample_schema)


def test_every_case_is_a_valid_config(root, schema, sample_schema, monkeypatch):
    monkeypatch.chdir(root)
    presets = config.load_yaml(root / "config/presets.yaml")
    for path in sorted((root / "config/cases").glob("*.yaml")):
        whole = config.resolve(config.load_yaml(path), schema, presets)
        if path.stem == "thin_section" or isinstance(whole["samples"], str):
            continue  # their section is named on the command line, their sheet by the working directory
        samples = config.read_samples(whole["samples"], sample_schema)
        config.check_data(samples, whole["data"])
        for row in samples.values():
            config.synthesis(whole, row, schema, path.name)
