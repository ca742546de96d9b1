"""``rendezvous compare``: metrics and files."""

import json
import math
import tracemalloc
from collections import defaultdict

import numpy as np
import pytest

import baselines
from baselines.policy import kind_of
from rendezvous_env import Scenario, rollout
from rendezvous_env.safety.theorems.certificate import certificate
from rendezvous_env.safety.theorems.descent import time_bound
from rendezvous_env.scenario import scenarios
from train import policies, recording, results
from train.compare import compare, playing, settings, statistics
from train.compare import evaluation as episodes
from train.compare.evaluation import Episodes, play
from train.report.input import read


def batch(**changed):
    """Four episodes: two collision-free, one with a contact, one time-out at 10 s."""
    nothing = np.zeros(4)
    values = dict.fromkeys(Episodes.__dataclass_fields__, nothing)
    values |= {
        "success": np.array([True, True, True, False]),
        "collision_free": np.array([True, True, False, False]),
        "time": np.array([2.0, 4.0, 3.0, 10.0]),
        "contacts": np.array([0, 0, 5, 0]),
        "time_bound": np.array([8.0, 8.0, 4.0, np.nan]),
        "clearance": np.array([0.5, 0.25, 0.0, 1.0]),
    }
    return Episodes(**(values | changed))


class TestFiles:
    def test_compare_writes_all_files_with_columns(self, compared):
        written = {path.name for path in compared.iterdir()}
        tables = {"results.csv", "episodes.csv", "paired.csv", "trajectories.npz", "run.json"}
        figures = {"success.png", "times.png", "trajectories-fig4.png"}
        assert written - {"report.html"} == tables | figures  # which other tests make of it
        assert (compared / "results.csv").read_text().splitlines()[0] == (
            "scenario,policy,episodes,success,success_low,success_high,collision_free_success,collision_free_low,"
            "collision_free_high,median_time,time_low,time_high,time_over_bound,path_length,min_clearance,"
            "max_rise_between_merges,min_alignment,contacts"
        )

    def test_results_follow_from_episodes(self, compared):
        of_cell = defaultdict(list)
        for episode in results.read_csv(compared / "episodes.csv"):
            of_cell[episode["scenario"], episode["policy"]].append(episode)
        for row in results.read_csv(compared / "results.csv"):
            own = of_cell[row["scenario"], row["policy"]]
            count = {"uav-6": 4, "fig4": 1}[row["scenario"]]  # that of fig4 is given
            assert [int(r["initial_condition"]) for r in own] == list(range(count))
            assert int(row["episodes"]) == count
            for name, column, of in (
                ("success", "success", np.mean),
                ("collision_free_success", "collision_free", np.mean),
                ("median_time", "time", np.median), ("path_length", "path_length", np.median),
                ("contacts", "contacts", np.mean), ("min_clearance", "clearance", min),
                ("max_rise_between_merges", "max_rise_between_merges", max),
            ):  # fmt: skip
                values = [float(r[column]) for r in own if r[column]]
                assert row[name] == "" if not values else float(row[name]) == of(values)

    def test_cells_are_numbers_or_empty(self, compared):
        rows = results.read_csv(compared / "results.csv")
        for row in rows:
            assert all(math.isfinite(float(row[n] or 0)) for n in results.RESULT_COLUMNS[2:])
            ends = [row[name] for name in row if name.endswith(("_low", "_high"))]
            assert all(ends) == (row["scenario"] == "uav-6") and any(ends) == all(ends)
            assert (row["min_clearance"] == "") == (row["scenario"] == "uav-6")

    def test_policies_share_initial_conditions(self, compared):
        rows = results.read_csv(compared / "episodes.csv")
        law, zero = (
            [r["initial_lyapunov"] for r in rows if r["policy"] in names]
            for names in (("bearing-only", "nonholonomic-3d"), ("zero",))
        )
        assert law == zero and len(set(zero)) == 1 + 4  # the start of fig4, four of uav-6

    def test_trajectories_are_recorded(self, compared):
        law = baselines.make("nonholonomic-3d", scenarios.get("uav-6"))
        alone = rollout("uav-6", law, seed=4, record="all")
        with np.load(compared / "trajectories.npz") as arrays:
            key = "uav-6/nonholonomic-3d/1/"
            assert np.array_equal(arrays[key + "positions"], alone.positions[:, 0])
            seen = read(compared).recordings["uav-6", "nonholonomic-3d", 1]["observations"]
            assert np.array_equal(seen, alone.observations[:, 0])
            assert not any(name.endswith("observations") for name in arrays)
            assert np.array_equal(arrays[key + "lyapunov"], alone.lyapunov[:, 0])
            assert arrays[key + "times"][-1] == alone.rendezvous_time[0]
            jumps = np.flatnonzero(~np.isnan(arrays[key + "lyapunov_before_merge"]))
            assert jumps[-1] == len(alone.times) - 1 and len(jumps) > 1
            assert arrays[key + "lyapunov_after_merge"][-1] == 0
            assert {name.split("/")[2] for name in arrays.files} == {"0", "1"}

    def test_run_json_is_sufficient_to_repeat(self, compared):
        run = json.loads((compared / "run.json").read_text())
        assert (run["seed"], run["episodes"]) == (3, 4)
        assert run["format_version"] == results.FORMAT_VERSION
        assert Scenario.from_plain(run["scenarios"]["fig4"]) == scenarios.get("fig4")
        assert run["policies"]["uav-6"] == ["nonholonomic-3d", "zero"]
        assert run["versions"]["rendezvous-env"] and run["merges_above_bound"] == 0
        digests = scenarios.digests()
        assert run["versioned"] == {
            name: {"field": f"rendezvous/{name}-v1", "digest": digests[f"{name}-v1"]}
            for name in ("fig4", "uav-6")
        }
        assert results.versioned(scenarios.get("duo").replace(time_limit=2.0)) == {}

    def test_paired_csv_matches_episodes(self, compared):
        rows = {(r["scenario"], r["policy"]): r for r in results.read_csv(compared / "paired.csv")}
        joined = rows["fig4", "tangent-merged"]
        assert joined["against"] == "bearing-only"
        assert float(joined["collision_free_difference"]) == 1.0  # law (1) touches every obstacle
        assert float(rows["uav-6", "zero"]["probability_of_improvement"]) == 0.0

    def test_incomplete_file_is_removed_and_old_one_kept(self, tmp_path):
        results.write_csv(table := tmp_path / "table.csv", [{"a": 0}])

        def rows():
            yield {"a": 1}
            raise OSError("disk full")

        with pytest.raises(OSError, match="disk full"):
            results.write_csv(table, rows())
        assert [*tmp_path.iterdir()] == [table] and results.read_csv(table) == [{"a": "0"}]


class TestMeasures:
    def test_collision_free_is_undefined_if_obstacles_are_ignored(self):
        done, _ = run_play(scenarios.get("fig3"), "bearing-only", 3)
        assert done.success.tolist() == [True] and done.clearance[0] < -0.5
        assert np.isnan(done.collision_free).all()
        stopped, _ = run_play(scenarios.get("fig4"), "bearing-only", 3)
        assert stopped.collision_free.tolist() == [0.0]

    def test_policy_may_modify_observations(self):
        def turned(seen, time):
            seen[..., 0] *= 0.1
            return 5.0 * seen.sum(axis=-2)

        duo, laws = scenarios.get("duo"), (lambda seen, time: turned(seen.copy(), time), turned)
        usual, spoilt = (
            play(duo, lambda law=law: law, margin=None, episodes=2, seed=0)[0] for law in laws
        )
        assert (usual.min_alignment < 0.9).all()
        np.testing.assert_array_equal(spoilt.min_alignment, usual.min_alignment)

    @pytest.mark.kernels
    def test_law_1_is_aligned_and_within_bound(self):
        scenario = scenarios.get("random-10")
        done, _ = run_play(scenario, "bearing-only", 5)
        assert done.success.all() and done.min_alignment == pytest.approx(1.0, abs=1e-6)
        assert (done.max_rise_between_merges <= 0).all() and (done.merge_excess == 0).all()
        bound = time_bound(scenario, done.initial_lyapunov)
        assert np.array_equal(done.time_bound, bound) and (done.time < bound).all()

    def test_hull_perimeter_is_measured_on_changing_graphs(self):
        scenario = scenarios.get("rotating-paths")
        law, _ = run_play(scenario, "bearing-only", 5)
        assert len(law.success) == 1, "one start, which is given"
        assert law.success.all() and (law.max_rise_of_size <= 0).all()
        chance, _ = run_play(scenario.replace(time_limit=1.0), "random", 5)
        assert (chance.max_rise_of_size > 0).all()
        fixed, _ = run_play(scenarios.get("duo"), "bearing-only", 2)
        assert np.isnan(fixed.max_rise_of_size).all()

    def test_certified_headings_keep_minimum_alignment(self):
        done, _ = run_play(scenarios.get("fig3"), "tangent-certified", 2)
        assert (done.min_alignment >= 0.1 - 1e-6).all()
        assert np.isfinite(done.time_bound).all()
        done, _ = run_play(scenarios.get("fig3").replace(time_limit=1.0), "tangent-merged", 2)
        assert np.isnan(done.time_bound).all()

    def test_unicycle_alignment_uses_body_axis(self):
        """Both robots face along y at right angles to each other: initial alignment 0."""
        scenario = Scenario(
            n_robots=2,
            robot_model="unicycle",
            start_positions=((0, 0), (3, 0)),
            start_headings=((math.pi / 2,), (math.pi / 4,)),
        )
        done, recordings = run_play(scenario, "unicycle", 1, keep=1)
        assert recordings[0]["alignment"][1] == pytest.approx([0, math.sqrt(0.5)], abs=1e-6)
        assert done.min_alignment[0] == pytest.approx(0, abs=1e-6)

    def test_chunk_size_does_not_change_results(self, monkeypatch):
        whole, _ = run_play(scenarios.get("duo"), "bearing-only", 5)
        monkeypatch.setattr(episodes, "CHUNK", 2)
        parts, _ = run_play(scenarios.get("duo"), "bearing-only", 5)
        for name in Episodes.__dataclass_fields__:
            np.testing.assert_array_equal(getattr(parts, name), getattr(whole, name))

    @pytest.mark.parametrize("most", [19, 20, 21, 22])
    def test_time_out_keeps_final_state(self, most, monkeypatch):
        monkeypatch.setattr(recording, "MAX_FRAMES", most)
        scenario = scenarios.get("duo").replace(time_limit=2.1)  # 21 steps
        _, (kept,) = run_play(scenario, "zero", 1, keep=1)
        assert kept["times"][-1] == pytest.approx(2.1)

    def test_long_episodes_are_subsampled(self, monkeypatch):
        monkeypatch.setattr(recording, "MAX_FRAMES", 20)
        scenario = scenarios.get("random-10")
        _, (full,) = run_play(scenario, "bearing-only", 1, keep=1)
        alone = rollout(scenario, policies.make("bearing-only", scenario))
        merges = np.flatnonzero((alone.active[:-1] != alone.active[1:]).any(axis=(1, 2))) + 1
        assert len(full["times"]) <= 20 + len(merges)
        assert np.isin(alone.times[merges], full["times"]).all()
        assert full["times"][0] == 0 and full["active"][-1].sum() == 1
        steps = np.rint(full["times"] / scenario.tau).astype(int)
        assert np.array_equal(full["positions"], alone.positions[steps, 0])


def run_play(scenario, name, count, keep=0):
    done = compare.play_job(compare.Job(scenario, name), episodes=count, seed=0, keep=keep)
    return done.episodes, list(done.recordings.values())


TEN_SECONDS = Scenario(n_robots=2, time_step=0.1, time_limit=10.0)


class TestStatistics:
    def test_summary_row_matches_hand_computation(self):
        row = statistics.summarise(TEN_SECONDS, "p", batch())
        assert (row["success"], row["collision_free_success"], row["contacts"]) == (0.75, 0.5, 1.25)
        assert row["median_time"] == 3.5  # of 2, 3, 4 and later than 10
        assert (row["time_over_bound"], row["min_clearance"]) == (0.75, 0.0)

    def test_fraction_interval_is_wilson(self):
        """Newcombe 1998, table I: 81 of 263."""
        found = statistics.fraction_interval(np.arange(263) < 81)
        assert found == pytest.approx((0.2553, 0.3662), abs=5e-5)

    def test_time_outs_rank_after_all_times(self):
        times, met = np.array([1.0, 2.0, 10.0, 10.0]), np.array([True, True, False, False])
        median, (low, high) = statistics.censored_median(times, met, 10.0)
        assert (median, high) == (10.0, 10.0) and 1.0 <= low < 10.0

    def test_median_interval_is_censored(self):
        times = np.random.default_rng(1).exponential(size=400)
        median, (low, high) = statistics.censored_median(times, times > -1, 99.0)
        assert low < median < high
        assert low < math.log(2) < high and high - low < 0.35

    def test_single_sample_has_no_interval(self):
        median, interval = statistics.censored_median(np.ones(1), np.ones(1, bool), 9.0)
        assert median == 1.0 and np.isnan(interval).all()
        assert np.isnan(statistics.fraction_interval(np.ones(1, bool))).all()

    def test_collision_free_is_undefined_without_contacts(self):
        through = batch(collision_free=np.full(4, np.nan))
        row = statistics.summarise(TEN_SECONDS, "p", through)
        assert np.isnan(
            [row["collision_free_success"], row["collision_free_low"], row["collision_free_high"]]
        ).all()
        assert row["success"] == 0.75 and row["success_low"] > 0
        assert [episode["collision_free"] for episode in through.rows()] == [None] * 4
        sooner = batch(collision_free=through.collision_free, time=np.array([1.0, 1, 1, 10]))
        (pair,) = statistics.compare_pairs("s", {"bearing-only": through, "other": sooner})
        assert np.isnan(pair["collision_free_difference"])
        assert pair["probability_of_improvement"] == (1 + 1 + 1 + 0.5) / 4  # by meeting sooner

    def test_paired_rows_match_hand_computation(self):
        better = batch(
            collision_free=np.array([True, True, True, False]), time=np.array([1.0, 4, 9, 10])
        )
        played = {"bearing-only": batch(), "other": better}
        (row,) = statistics.compare_pairs("s", played)
        assert (row["policy"], row["against"]) == ("other", "bearing-only")
        assert row["collision_free_difference"] == 0.25
        assert row["probability_of_improvement"] == (1 + 0.5 + 1 + 0.5) / 4
        (row,) = statistics.compare_pairs("s", played, against="other")
        assert (row["policy"], row["collision_free_difference"]) == ("bearing-only", -0.25)

    @pytest.mark.slow
    def test_bootstrap_of_many_samples_uses_little_memory(self):
        """All resamples of 20,000 episodes at once would take 320 MB, and as much for indices."""
        tracemalloc.start()
        low, high = statistics.bootstrap_interval((np.arange(20_000) % 2,), np.mean)
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert most < 3e8 and 0.49 < low < 0.5 < high < 0.51

    def test_default_reference_without_law_1_is_best(self):
        two = {"a": batch(collision_free=np.zeros(4, bool)), "b": batch()}
        assert [row["policy"] for row in statistics.compare_pairs("s", two)] == ["a"]


@pytest.mark.slow
def test_wall_scenario_defeats_all_policies():
    """Passing the wall would require an increase of V (theory 6)."""
    scenario = scenarios.get("wall")
    for name in baselines.names(scenario):
        done, _ = run_play(scenario, name, 64)
        assert not done.success.any(), name


@pytest.mark.parametrize(
    ("merge_radius", "excess", "status"),
    [(0.2, 0.5, 1), (1e-5, 1e-11, 1), (200.0, 1e-8, 0)],
)
def test_merge_excess_is_reported_as_error(
    tmp_path, monkeypatch, capsys, merge_radius, excess, status
):
    """Rounding of V is up to 10⁻⁹ r D̄, here with D̄ = 1 m/s."""
    scenario = scenarios.get("duo").replace(start_positions=None, merge_radius=merge_radius)
    scenario.replace(spawn_size=10 * merge_radius).to_toml(path := tmp_path / "a.toml")
    config = compare.Config(
        (str(path),), ("bearing-only",), episodes=2, out=tmp_path / "out", figures=False
    )
    real = playing.play

    def broken(*args, **options):
        done, recordings = real(*args, **options)
        done.merge_excess[0] = excess
        return done, recordings

    monkeypatch.setattr(playing, "play", broken)
    assert compare.run(config) == status
    said = "in 1 episode a merge raised V above its bound"
    assert (said in capsys.readouterr().err) == (status == 1)


def test_first_failure_is_recorded(tmp_path):
    """The rule without avoidance fails on an initial condition that is not recorded otherwise."""
    words = {"scenarios": ("clutter-8",), "policies": ("bearing-only",), "figures": False}
    config = compare.Config(**words, episodes=12, keep=1, seed=2, out=tmp_path / "out")
    assert compare.run(config) == 0
    rows = results.read_csv(config.out / "episodes.csv")
    failed = [int(row["initial_condition"]) for row in rows if row["collision_free"] == "0"]
    kept = {key[2]: one for key, one in read(config.out).recordings.items()}
    assert failed and sorted(kept) == sorted({0, failed[0]})
    row, last = rows[failed[0]], kept[failed[0]]
    assert last["times"][-1] == float(row["time"])
    assert last["contacts"][-1].sum() == int(row["contacts"])


@pytest.mark.parametrize(
    ("scenario", "policy", "promised"),
    [
        ("pursuit-6", "bearing-only", True),
        ("switching-8", "bearing-only", True),
        ("range-12", "link-keeping", True),
        ("ring-12", "link-keeping", True),
        ("pursuit-6", "learned", False),
        ("noisy-8", "bearing-only", False),
        ("noisy-8", "learned", False),
    ],
)
def test_a_time_is_compared_with_the_bound_of_the_certificate(scenario, policy, promised):
    team = scenarios.get(scenario)
    by = {"by": "links", "share": 1.0} if policy == "link-keeping" else {"by": "law"}
    bound = certificate(team, **by).time_bound if promised else math.nan
    done = playing.play_job(settings.Job(team, policy), episodes=3, seed=0)
    np.testing.assert_array_equal(done.episodes.time_bound, np.full(3, bound))
    share = playing.summary(done)["time_over_bound"]
    assert share == done.episodes.time.max() / bound < 1.0 if promised else np.isnan(share)


def test_an_undirected_graph_has_the_bound_of_each_start():
    team = scenarios.get("duo")
    done = playing.play_job(settings.Job(team, "bearing-only"), episodes=3, seed=0).episodes
    np.testing.assert_array_equal(done.time_bound, time_bound(team, done.initial_lyapunov))
    assert len(set(done.time_bound)) == 3


def test_named_scenarios_are_compared_under_every_policy_that_fits():
    def policies_of(**flags):
        return {job.policy for job in settings.plan(settings.Config(**flags))}

    assert {"pursuit", "windshield", "unicycle"} <= policies_of(scenarios=("fov-8",))
    named = policies_of(scenarios=("clutter-8",))
    fitting = {n for n in baselines.names("clutter-8") if kind_of(n) not in ("blind", "privileged")}
    assert named == fitting
    usual = [job for job in settings.plan(settings.Config()) if job.scenario.name == "clutter-8"]
    assert {job.policy for job in usual} < named and len(usual) == 11


def test_a_run_of_all_scenarios_plays_little_more_than_before():
    jobs = settings.plan(settings.Config())
    among_obstacles = [job for job in jobs if job.scenario.obstacles]
    assert len(among_obstacles) == 13 * 11 + 2 * 11
    assert len(jobs) < 1.35 * 190  # what is added has no obstacles, and is over soon
