"""What accuracy costs: paired differences, the front, the pick, and trials on volumes of known truth."""

import shutil
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from grainfall import accuracy, config, correlation, flow, io, network, presets, report, surface
from grainfall.accuracy import known
from grainfall.accuracy.figure import accuracy_figure
from grainfall.accuracy.observe import differences, relative_distance
from grainfall.errors import InputError
from grainfall.packing import parameters_of

FREE = known.Cost(1.0, 1.0, 100.0)


@pytest.fixture(scope="module")
def ready(root):
    """The presets."""
    return config.load_yaml(root / "config/presets.yaml")


def here(work):
    """Do the work in this process, at no cost."""
    return work(), FREE


def table(metric: str = "k", **rows: tuple) -> list[presets.Choice]:
    """Presets by (error, upper, cpu_s)."""
    return [presets.Choice(p, metric, error, upper, 5, cpu_s) for p, (error, upper, cpu_s) in rows.items()]


def repeats(differences: dict[str, list[float]], cpu_s: dict[str, float]) -> pd.DataFrame:
    return pd.DataFrame(
        [
            {
                **{"scene": "packing", "knob": "knob", "setting": s, "against": "finest", "repeat": n},
                **{"metric": "k", "difference": d, "wall_s": 1.0, "cpu_s": cpu_s[s], "peak_rss_mb": 1.0},
            }
            for s, found in differences.items()
            for n, d in enumerate(found)
        ]
    )


class TestFront:
    def test_nothing_on_it_is_dominated_and_all_else_is(self):
        rng = np.random.default_rng(0)
        cost, error = rng.integers(0, 12, (2, 60)).astype(float)  # with ties
        on = accuracy.front(cost, error)
        for i in range(60):
            dominated = any(
                cost[j] <= cost[i] and error[j] <= error[i] and (cost[j], error[j]) != (cost[i], error[i])
                for j in range(60)
            )
            assert on[i] == (not dominated)

    def test_is_a_staircase_from_the_cheapest_to_the_most_accurate(self):
        cost, error = np.random.default_rng(1).random((2, 40))
        on = accuracy.front(cost, error)
        steps = error[on][np.argsort(cost[on])]
        assert (np.diff(steps) < 0).all()
        assert on[np.argmin(cost)]
        assert on[np.argmin(error)]


class TestSummary:
    def test_error_is_of_single_runs_and_bias_of_their_mean(self):
        """Differences that cancel leave no bias, and an error all the same."""
        rows = accuracy.summarise(repeats({"a": [0.1, -0.1], "b": [0.1, 0.1]}, {"a": 1, "b": 2}))
        a, b = rows.to_dict("records")
        assert (a["error"], a["bias"]) == (pytest.approx(0.1), pytest.approx(0))
        assert (b["error"], b["bias"]) == (pytest.approx(0.1), pytest.approx(0.1))
        assert (a["front"], b["front"]) == (True, False)

    def test_interval_is_students(self):
        values = np.array([0.05, 0.08, 0.11, 0.2])
        row = accuracy.summarise(repeats({"a": list(values)}, {"a": 1})).iloc[0]
        half = 3.1824 * values.std(ddof=1) / 2  # t at 0.975 with three degrees of freedom
        assert row["upper"] == pytest.approx(values.mean() + half, rel=1e-4)
        assert row["lower"] == pytest.approx(max(0, values.mean() - half), rel=1e-3, abs=1e-9)
        assert (row["bias_lower"], row["bias_upper"]) == pytest.approx(
            (values.mean() - half, values.mean() + half), rel=1e-3
        )

    def test_twins_of_one_truth_count_once(self):
        """Two twins of one section err alike: ten of them say no more of other sections than one does."""
        errors = {"one": [0.1, 0.3], "two": [0.1, -0.1, 0.1, -0.1]}
        found = repeats({"a": [d for of in errors.values() for d in of]}, {"a": 1})
        found["repeat"] = [f"{truth}/{n}" for truth, of in errors.items() for n in range(len(of))]
        row = accuracy.summarise(found).iloc[0]
        assert (row["n"], row["error"], row["bias"]) == (2, pytest.approx(0.15), pytest.approx(0.1))
        half = 12.7062 * 0.1 / 2  # t at 0.975 with one degree of freedom, of 0.2 and 0.1
        assert row["upper"] == pytest.approx(0.15 + half, rel=1e-4)

    def test_a_single_run_has_no_interval(self):
        row = accuracy.summarise(repeats({"a": [0.1]}, {"a": 1})).iloc[0]
        assert row["n"] == 1
        assert np.isnan(row["upper"])

    def test_what_others_are_held_against_must_be_tried(self):
        rng = np.random.default_rng(0)
        with pytest.raises(InputError, match="1 is not among 2, 3"):
            next(known.coarsen(["2", "3"], rng, here))

    def test_settings_are_paired_by_repeat(self, tmp_path):
        """Two rocks of different K, a setting 10 % off in both: the error is 10 %, not the rocks' spread."""
        for sample, k in (("one", 100.0), ("two", 900.0)):
            for variant, factor in (("coarse", 1.1), ("finest", 1.0)):
                first = tmp_path / sample / variant / "0/first"
                first.mkdir(parents=True)
                (first / "observed.json").write_text(f'{{"porosity": 0.4, "k_md": {k * factor}}}')
                (first.parent / "benchmarks").mkdir()
                (first.parent / "benchmarks/first_packing.tsv").write_text(
                    "s\tmax_rss\tcpu_time\n5.0\t300\t4.0\n"
                )
        sweep = {
            "packing": {"knob": ["coarse"]},
            "against": "finest",
            "chance": {},
            "presets": [],
            "known": {},
        }
        # of another sweep's numbers, or of other code: nobody asked for it
        shutil.copytree(tmp_path / "one/coarse/0", tmp_path / "one/coarse/7")
        found = accuracy.gather(tmp_path, sweep, ["one", "two"], [])
        rows = accuracy.summarise(found).set_index(["setting", "metric"])
        row = rows.loc["coarse", "k"]
        assert row["n"] == 2
        assert (row["error"], row["upper"]) == (pytest.approx(0.1), pytest.approx(0.1))
        assert (row["cpu_s"], row["wall_s"], row["peak_rss_mb"]) == (4.0, 5.0, 300)
        assert np.isnan(rows.loc["finest", "k"]["error"])
        assert not rows.loc["finest", "k"]["front"]
        (tmp_path / "one/coarse/0/benchmarks/first_packing.tsv").unlink()
        found = accuracy.gather(tmp_path, sweep, ["one", "two"], [])
        unknown = found.query("repeat == 'one/0' and setting == 'coarse'")
        assert unknown["cpu_s"].isna().all()
        assert accuracy.gather(tmp_path, sweep | {"against": None}, ["one"], []).empty


class TestPick:
    TABLE = table(draft=(0.1, 0.2, 10.0), standard=(0.05, 0.09, 40.0), reference=(0.03, 0.05, 200.0))

    def test_is_the_cheapest_whose_interval_is_within(self):
        for tolerance, preset in ((0.3, "draft"), (0.1, "standard"), (0.06, "reference")):
            chosen = presets.choose("k", tolerance, self.TABLE)
            assert chosen.preset == preset
            assert chosen.upper <= tolerance
            assert all(row.upper > tolerance for row in self.TABLE if row.cpu_s < chosen.cpu_s)

    def test_it_says_what_of_the_config_was_not_measured(self, root):
        schema, sets = (
            config.load_yaml(root / name)
            for name in ("workflow/schemas/config.schema.yaml", "config/presets.yaml")
        )
        own = {"packing": {"overrides": {"hull_vertices": 8}}, "effects": {"cement": "off"}}
        given = {"preset": "draft", "samples": "samples.tsv"}
        alone = config.resolve(given, schema, sets)
        whole = config.resolve({**given, "scene": {"edge_grains": 6}, **own}, schema, sets)
        assert config.unmeasured(whole, alone) == ["effects.cement", "packing.overrides.hull_vertices"]
        assert config.unmeasured(alone, alone) == []
        worse = {"scene": {"edge_grains": 3, "voxels_per_grain": 4}, "flow": {"methods": ["estimate"]}}
        worse |= {"network": {"method": "snow2"}, "stereology": {"method": "none", "bootstrap": 3}}
        assert config.unmeasured(config.resolve({**given, **worse}, schema, sets), alone) == [
            "flow.methods", "network.method", "scene.edge_grains", "scene.voxels_per_grain",
            "stereology.method",
        ]  # fmt: skip

    def test_what_nothing_supports_says_what_the_best_is(self):
        with pytest.raises(InputError, match=r"within 0\.01.*at least 0\.05.*reference"):
            presets.choose("k", 0.01, self.TABLE)

    def test_the_tolerance_that_is_suggested_is_kept(self):
        one = table(one=(0.1, 0.12345, 1.0))
        with pytest.raises(InputError) as fault:
            presets.choose("k", 0.01, one)
        presets.choose("k", float(fault.value.right.split()[2].rstrip(",")), one)

    def test_a_single_run_supports_nothing(self):
        with pytest.raises(InputError, match="interval"):
            presets.choose("k", 1.0, table(draft=(0.0, np.nan, 1.0)))
        with pytest.raises(InputError, match="measured yet"):
            presets.choose("k", 1.0, [])

    def test_unknown_metric_is_told_the_nearest(self):
        with pytest.raises(InputError, match="did you mean 'porosity'"):
            presets.choose("porosty", 0.1, [*self.TABLE, *table("porosity", draft=(0.0, 0.0, 1.0))])

    def test_becomes_the_preset_of_the_config(self):
        asked = {"accuracy": {"metric": "k", "tolerance": 0.1}, "seed": 3}
        assert presets.with_accuracy(asked, self.TABLE) == {**asked, "preset": "standard"}
        with pytest.raises(InputError, match="leave out one"):
            presets.with_accuracy({**asked, "preset": "draft"}, self.TABLE)

    @pytest.mark.parametrize(
        "asked",
        [
            {"metric": "k"},
            {"metric": "k", "tolerance": "much"},
            {"metric": "k", "tolerance": 0},
            {"metric": 3, "tolerance": 1},
            {"metric": "kk", "tolerance": 1},
            {"metric": "k", "tolerance": 1e-9},
            "k",
        ],
    )
    def test_what_cannot_be_is_refused(self, schema, ready, asked):
        with pytest.raises(InputError, match="accuracy"):
            config.resolve({"samples": "s.tsv", "accuracy": asked}, schema, ready)

    def test_committed_table_holds_presets_that_exist(self, ready):
        rows = presets.measured()
        assert {row.preset for row in rows} <= set(ready)
        assert {row.metric for row in rows} <= set(presets.METRICS)
        assert all(0 <= row.error < row.upper and row.cpu_s > 0 for row in rows)

    def test_a_dearer_preset_is_nearer_in_something_beyond_chance(self):
        """By whole intervals: a front alone would take in one that is nearer by 1e-5."""
        table = pd.read_csv(presets.TABLE)
        dearer = [rows for _, rows in table.set_index("metric").groupby("preset")]
        dearer.sort(key=lambda rows: rows["cpu_s"].iloc[0])
        assert len(dearer) == table["preset"].nunique() > 1
        for cheap, dear in pairwise(dearer):
            assert (dear["upper"] < cheap["lower"]).any()

    def test_committed_table_picks_for_a_config(self, schema, ready):
        """The largest tolerance takes the cheapest preset, whose values the config then has."""
        cheapest = min((row for row in presets.measured() if row.metric == "k"), key=lambda row: row.cpu_s)
        whole = config.resolve(
            {"samples": "s.tsv", "accuracy": {"metric": "k", "tolerance": 100}}, schema, ready
        )
        assert whole["preset"] == cheapest.preset
        own = config.resolve({"samples": "s.tsv", "preset": cheapest.preset}, schema, ready)
        assert {**whole, "accuracy": None} == own


class TestWhatItGot:
    """The report says what was expected and what came of it."""

    def verdict(self, errors: dict) -> tuple[str, str]:
        asked = {"metric": "k", "tolerance": 0.1, "expected": 0.05}
        metrics = report.metrics_table(report.accuracy_values(asked, errors))
        (judged,) = report.judge(metrics)
        return judged.status, judged.target

    def test_against_a_reference(self):
        assert self.verdict({"k": -0.08, "porosity": 0.5}) == ("met", "0.05 (0 to 0.1)")
        assert self.verdict({"k": 0.11})[0] == "missed"

    def test_without_one_nothing_is_claimed(self):
        assert self.verdict({"porosity": 0.0})[0] == "not computed"

    def test_tables_say_what_the_volume_says(self):
        """A twin is judged by the files of its jobs, the study by volumes: they must agree."""
        pore = known.pack(np.random.default_rng(0), 4, 8)
        seen = accuracy.observe(pore, 2.0)
        sizes = network.element_sizes(network.extract(pore, 2.0))
        by_tables = accuracy.from_tables(
            correlation.s2_volume(~pore, 2.0), flow.permeability(pore, 2.0), "network", sizes
        )
        errors = accuracy.differences(by_tables, seen)
        assert set(errors) == {"k", "pore_sizes", "s2"}
        assert all(abs(error) < 1e-12 for error in errors.values())


def test_volumes_of_one_rock_are_pooled():
    one, other = (accuracy.observe(known.pack(np.random.default_rng(n), 4, 8), 2.0) for n in (0, 1))
    same, both = accuracy.pooled([one, one]), accuracy.pooled([one, other])
    assert all(abs(error) < 1e-12 for error in accuracy.differences(same, one).values())
    for name in ("porosity", "k_md"):
        assert both[name] == pytest.approx((one[name] + other[name]) / 2)
    np.testing.assert_allclose(both["s2"], (one["s2"] + other["s2"]) / 2)
    volumes = [seen["pores"]["pore_volume_um3"].sum() for seen in (one, other, both)]
    assert volumes[2] == pytest.approx(volumes[0] + volumes[1])


class TestKnownTruths:
    def test_volumes_match_their_formulas_as_voxels_shrink(self):
        """Porosity, S2, pore radii and K of touching spheres, wherever between voxels their centres lie."""
        trials = [known.voxels_per_grain(["5", "20"], np.random.default_rng(n), here) for n in range(6)]
        found = pd.DataFrame({"setting": t.setting, **t.differences} for one in trials for t in one)
        error = found.set_index("setting").abs().groupby(level=0).mean()
        for metric, bound in (("porosity", 0.003), ("s2", 0.004), ("pore_sizes", 0.05), ("k", 0.12)):
            assert error.loc["20", metric] < bound, metric
            assert error.loc["20", metric] < error.loc["5", metric], metric

    def test_s2_of_the_formula_is_that_of_the_voxels(self):
        solid = ~known.spheres(40.0, 1, (0.0, 0.0, 0.0))
        lag = np.arange(41)
        counted = [(solid & np.roll(solid, int(h), axis=2)).mean() for h in lag]
        assert counted == pytest.approx(known.spheres_s2(lag / 40), abs=0.002)

    def test_all_slices_of_a_volume_are_the_volume(self):
        pore = known.pack(np.random.default_rng(0), 3, 8)
        exact = dict(zip(("lag_um", "s2"), known.axial_s2(pore, 1.0), strict=True))
        every = [(axis, i) for axis in range(3) for i in range(24)]
        found = known._slice_s2(~pore, every)
        assert accuracy.differences(found, exact)["s2"] < 1e-12

    def test_the_inversion_beats_none_and_more_sections_beat_fewer(self):
        rng = np.random.default_rng(3)
        rules = {t.setting: t.differences for t in known.stereology_rule(["none", "adaptive"], rng, here)}
        assert rules["adaptive"]["grain_sizes"] < 0.5 * rules["none"]["grain_sizes"]
        few, many = known.sections(["50", "5000"], rng, here)
        assert many.differences["grain_sizes"] < few.differences["grain_sizes"]

    def test_sections_are_cut_in_proportion_to_size(self):
        """Mean section radius over mean radius: (pi / 4)(1 + CV^2), CV that of the radii."""
        cv = known.TRUE_RADII.std() / known.TRUE_RADII.mean()
        mean = known._sections(200_000, np.random.default_rng(0)).mean() / known.TRUE_RADII.mean()
        assert mean == pytest.approx(np.pi / 4 * (1 + cv**2), rel=0.003)

    def test_a_setting_is_measured_alone(self):
        """Its own memory and time, whatever its parent has used."""
        value, little = known.alone(lambda: 7)
        _, much = known.alone(lambda: np.ones(30_000_000).sum())
        assert value == 7
        assert much.peak_rss_mb - little.peak_rss_mb == pytest.approx(229, abs=40)
        assert little.cpu_s < 0.05

    def test_one_that_ends_without_an_answer_says_so(self):
        with pytest.raises(RuntimeError, match="without an answer"):
            known.alone(lambda: __import__("os")._exit(3))


class TestChance:
    """A bias is held against none, a distance, which is never 0, against that of the same thing again."""

    def told(self, differences: list[float], metric: str, again: list[float]) -> bool:
        rows = repeats({"setting": differences, "again": again}, {"setting": 1, "again": 1})
        rows = accuracy.summarise(rows.assign(metric=metric))
        setting = rows["setting"] == "setting"
        return accuracy.beyond_chance(rows[setting], rows[~setting]).item()

    def test_a_bias_within_its_scatter_is_chance(self):
        assert not self.told([0.2, -0.1, 0.1], "k", [0.01, 0.01, 0.01])

    def test_a_bias_beyond_its_scatter_is_not(self):
        assert self.told([-0.2, -0.21, -0.19], "k", [0.03, -0.02, 0.01])

    def test_repeats_that_happen_to_agree_are_judged_by_how_others_scatter(self):
        """Of 40 settings without any effect one in twenty would be told by its own three repeats alone."""
        rng = np.random.default_rng(0)
        by_themselves = told = 0
        for _ in range(20):
            names = [f"setting_{i}" for i in range(40)]
            drawn = repeats({name: list(rng.normal(0, 0.1, 3)) for name in names}, dict.fromkeys(names, 1))
            rows = accuracy.summarise(drawn.assign(metric="k"))
            by_themselves += ((rows["bias_lower"] > 0) | (rows["bias_upper"] < 0)).sum()
            told += accuracy.beyond_chance(rows, rows[:0]).sum()
        assert by_themselves > 20
        assert told <= 3

    def test_a_distance_is_chance_up_to_that_of_the_same_again(self):
        assert not self.told([0.20, 0.21, 0.19], "s2", [0.3, 0.3, 0.3])
        assert self.told([0.20, 0.21, 0.19], "s2", [0.1, 0.1, 0.1])

    def test_where_chance_was_not_measured_nothing_is_hidden(self):
        rows = accuracy.summarise(repeats({"setting": [0.2, 0.2]}, {"setting": 1}).assign(metric="s2"))
        assert accuracy.beyond_chance(rows, rows[:0]).item()

    def test_where_nothing_but_chance_is_measured_yet_nothing_is_told(self):
        rows = accuracy.summarise(repeats({"again": [0.2, 0.1, 0.3]}, {"again": 1}).assign(metric="s2"))
        assert accuracy.beyond_chance(rows[:0], rows).empty

    def test_a_single_repeat_tells_nothing_and_is_shown(self):
        assert self.told([0.2], "k", [0.1])


class TestTheStudy:
    def test_config_names_what_there_is(self, root, schema, ready):
        study = config.resolve(config.load_yaml(root / "config/cases/accuracy.yaml"), schema, ready)
        sweep = study["accuracy_sweep"]
        used = {v for found in sweep["packing"].values() for v in found} | set(sweep["presets"])
        used |= {sweep["against"], *sweep["chance"], *sweep["chance"].values()}
        assert used == set(study["variants"])
        described = schema["properties"]["accuracy_sweep"]["properties"]["known"]["properties"]
        assert set(described) == set(known.KNOBS)

    def test_preset_variants_pack_as_the_presets_do(self, root, schema, ready):
        whole = config.resolve(config.load_yaml(root / "config/cases/accuracy.yaml"), schema, ready)
        for preset in whole["accuracy_sweep"]["presets"]:
            own = config.resolve({"samples": "s.tsv", "preset": preset}, schema, ready)
            study = config.variant(whole, preset)
            poured = [parameters_of(one["packing"], one["effects"]) for one in (study, own)]
            assert poured[0] == poured[1]
            assert study["effects"] == own["effects"]
            assert study["feedback"] == own["feedback"]

    def test_page_draws_what_is_there(self, root):
        """Half a sweep gives half a page; a setting is named where it differs by more than chance."""
        sweep = config.load_yaml(root / "config/cases/accuracy.yaml")["accuracy_sweep"]
        rows = repeats({"coarse": [0.2, 0.21, 0.2], "fine": [0.02, -0.02, 0.01]}, {"coarse": 1, "fine": 9})
        figure = accuracy_figure(accuracy.summarise(rows.assign(knob="together")), sweep)
        said = [text.get_text() for part in figure.subfigs for axis in part.axes for text in axis.texts]
        assert said == ["coarse"]

    def test_every_knob_has_its_panel(self):
        rows = repeats({"1": [0.2, 0.3], "2": [0.05, 0.04]}, {"1": 1, "2": 9})
        rows = pd.concat([rows.assign(scene=knob, knob=knob, against="truth") for knob in known.KNOBS])
        sweep = {"against": "finest", "known": dict.fromkeys(known.KNOBS)}
        figure = accuracy_figure(accuracy.summarise(rows), sweep)
        titles = [axis.get_title("left") for axis in figure.subfigs[-1].axes]
        assert len(set(filter(None, titles))) == len(known.KNOBS)

    def test_drawn_before_anything_has_an_error(self):
        only = repeats({"finest": [0.0, 0.0]}, {"finest": 1.0}).assign(knob="base", difference=np.nan)
        sweep = {"packing": {"base": ["finest"]}, "against": "finest", "presets": [], "known": {}}
        figure = accuracy_figure(accuracy.summarise(only), sweep)
        assert figure.subfigs[0].axes[0].get_ylim()[0] == 0

    def test_a_knob_that_is_never_off_says_so(self):
        rows = repeats({"network": [0.0, 0.0]}, {"network": 1.0})
        rows = rows.assign(scene="flow_tier", knob="flow_tier", against="truth")
        figure = accuracy_figure(accuracy.summarise(rows), {"against": "finest", "known": {"flow_tier": []}})
        said = [text.get_text() for part in figure.subfigs for axis in part.axes for text in axis.texts]
        assert said == ["no setting is off"]


def test_differences_have_the_sign_of_what_is_found_and_the_scale_of_what_is_held():
    def sizes(radius):
        return {"pore_radius_um": np.array([radius]), "pore_volume_um3": np.ones(1)}

    lag = np.arange(3.0)
    found = {"porosity": 0.3, "k_md": 150.0, "pores": sizes(3.0), "lag_um": lag, "s2": [0.6, 0.5, 0.4]}
    held = {"porosity": 0.2, "k_md": 100.0, "pores": sizes(2.0), "lag_um": lag, "s2": [0.6, 0.4, 0.4]}
    errors = {"porosity": 0.1, "k": 0.5, "pore_sizes": 0.5, "s2": 0.1}
    assert differences(found, held) == pytest.approx(errors)


def test_s2_is_compared_to_the_last_lag_both_have():
    found = {"lag_um": np.arange(3.0), "s2": np.array([0.6, 0.4, 0.3])}
    held = {"lag_um": np.arange(5.0), "s2": np.array([0.6, 0.4, 0.2, 0.0, 0.0])}
    assert differences(found, held) == pytest.approx({"s2": 0.1})


def test_the_permeability_of_a_table_is_that_of_its_method():
    s2 = pd.DataFrame({"axis": ["x"], "lag_um": [0.0], "s2": [0.6]})
    flow = pd.DataFrame({"method": ["network", "network", "direct"], "k_md": [1.0, 3.0, 50.0]})
    assert accuracy.from_tables(s2, flow, "network", {})["k_md"] == 2


def test_a_distance_of_radii_is_in_their_mean():
    assert relative_distance(np.array([6.0]), np.array([4.0])) == 0.5


def test_costs_are_of_all_jobs_and_the_median_of_repeats(tmp_path):
    for number, seconds in enumerate((5, 6, 70)):
        twin = tmp_path / f"rock/draft/{number}"
        (twin / "benchmarks").mkdir(parents=True)
        io.write_json(twin / "observed.json", {"porosity": 0.3})
        for job, share in (("one", 1), ("two", 3)):
            head, row = "s\tmax_rss\tcpu_time", f"{share * seconds}\t{100 * share}\t{2 * share * seconds}"
            (twin / f"benchmarks/{job}.tsv").write_text(f"{head}\n{row}\n")
    io.write_json(tmp_path / "rock/observed.json", {"porosity": 0.2})
    sweep = {"packing": {}, "against": None, "chance": {}, "presets": ["draft"], "known": {}}
    row = accuracy.summarise(accuracy.gather(tmp_path, sweep, ["rock"], ["one", "two"], twins=3)).iloc[0]
    assert (row["wall_s"], row["cpu_s"], row["peak_rss_mb"]) == (24, 48, 300)
    assert (row["n"], row["bias"]) == (1, pytest.approx(0.1))


def test_spheres_of_a_pack_have_the_diameter_asked_for():
    """Surface by volume of lognormal spheres of mean radius R: 3 / R (1 + CV^2)^2, where few touch."""
    pore = known.pack(np.random.default_rng(0), 4, 16, porosity=0.6)
    seen = surface.specific_surface(pore, 1.0) / (1 - pore.mean())
    assert seen == pytest.approx(3 / 8 / (1 + known.CV**2) ** 2, rel=0.15)


def test_realizations_cost_what_all_of_them_do(monkeypatch):
    pores = {"pore_radius_um": np.ones(1), "pore_volume_um3": np.ones(1)}
    seen = {"porosity": 0.4, "k_md": 1.0, "lag_um": np.arange(3.0), "s2": np.ones(3), "pores": pores}
    monkeypatch.setattr(known, "pack", lambda *_: np.ones((120,) * 3, bool))
    monkeypatch.setattr(known, "observe", lambda *_: seen)
    costs = iter([known.Cost(9.0, 9.0, 900.0), *(known.Cost(n, 2.0 * n, 100.0 * n) for n in (3.0, 1, 2))])
    trials = known.realizations(["1", "3"], np.random.default_rng(0), lambda work: (work(), next(costs)))
    assert [trial.cost for trial in trials] == [(3, 6, 300), (6, 12, 300)]


def test_a_distance_has_to_exceed_what_both_scatter():
    """Nine repeats each, standard deviation 1: by the one's alone 0.61 would do, by both's 0.86 is needed."""
    scatter = stats.norm.ppf((np.arange(9) + 0.5) / 9)
    scatter /= scatter.std(ddof=1)

    def told(more):
        row = {"scene": "packing", "knob": "knob", "against": "finest", "metric": "s2", "wall_s": 1.0}
        row |= {"cpu_s": 1.0, "peak_rss_mb": 1.0}
        rows = [
            {**row, "setting": setting, "repeat": n, "difference": 10 + away + d}
            for setting, away in (("setting", more), ("again", 0.0))
            for n, d in enumerate(scatter)
        ]
        table = accuracy.summarise(pd.DataFrame(rows))
        setting = table["setting"] == "setting"
        return accuracy.beyond_chance(table[setting], table[~setting]).item()

    assert not told(0.81)  # its own interval, 0.77 either way, lies beyond
    assert told(0.91)
