"""``rendezvous verify --policy``: counterexamples of a policy, minimised and reproduced."""

import io
import json
import sys

import numpy as np
import pytest
from rich.console import Console

import rendezvous_env as rv
from train.checks import UserError
from train.results import read_csv
from train.verify import policy_search
from train.verify.falsification import patience_of, play, repeat
from train.verify.monitors import SEARCHED
from train.verify.verify import Config, run

POLICIES = '''
import numpy as np
from rendezvous_env import baselines


def half(scenario):
    layout = scenario.observation_layout
    return lambda seen, time: 0.5 * layout.net_bearing(seen)


def around(scenario):
    """Velocity across f: V rises, and distances do not decrease."""
    layout = scenario.observation_layout

    def law(seen, time):
        f = layout.net_bearing(seen)
        return np.stack([-f[..., 1], f[..., 0]], axis=-1)

    return law


def resting(scenario):
    return lambda seen, time: np.zeros((*seen.shape[:-2], 2))


def certified(scenario):
    return baselines.HeadingPolicy(scenario, lambda seen: seen[..., 0, :])


def late(scenario):
    """Fails in the second step."""

    def law(seen, time):
        if np.max(time) > 0:
            raise RuntimeError("no second step")
        return np.zeros((*seen.shape[:-2], 2))

    return law


def of_three(scenario):
    return half(scenario) if scenario.n_robots == 3 else None
'''


@pytest.fixture
def own(tmp_path, monkeypatch):
    """The policies above as a user's module."""
    (tmp_path / "searched_policies.py").write_text(POLICIES, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "searched_policies", raising=False)
    return "searched_policies:"


def search(out, policy, trials=24, **options):
    """Exit status, rows of the table, and output."""
    printed = io.StringIO()
    config = Config(trials=trials, policy=policy, out=out, jobs=1, **options)
    status = run(config, console=Console(file=printed, width=200))
    return status, read_csv(out / "policy.csv"), printed.getvalue()


@pytest.mark.slow
def test_search_finds_nothing_wrong_with_a_law_that_converges(own, tmp_path):
    status, rows, printed = search(tmp_path / "out", own + "half")
    assert status == 0
    assert "24 initial conditions of 4 random scenarios under searched_policies:half" in printed
    assert "0 counterexamples, " in printed
    assert [row["searched"] for row in rows] == list(SEARCHED)
    assert {(row["draws"], row["violations"]) for row in rows} == {("4", "0")}
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["policy.csv"]


@pytest.mark.slow
def test_search_looks_for_what_it_is_asked_for(own, tmp_path):
    """Certified headings prevent increases of V, but not of the hull perimeter."""
    wanted = ("rise", "deadlock")
    status, rows, _ = search(tmp_path / "kept", own + "certified", search=wanted)
    assert status == 0
    assert tuple(row["searched"] for row in rows) == wanted
    status, rows, _ = search(tmp_path / "grown", own + "certified", search=("growth",))
    assert status == 1
    assert [row["searched"] for row in rows] == ["growth"]


def test_search_finds_and_shrinks_every_kind_of_counterexample(own, tmp_path):
    status, rows, printed = search(tmp_path / "out", own + "around", trials=6)
    assert status == 1
    assert {row["violations"] for row in rows} == {"1"}
    for number in SEARCHED:
        path = tmp_path / f"out/policy-0-{number}.toml"
        assert str(path) in printed
        scenario = rv.Scenario.from_toml(path)
        assert (scenario.n_robots, scenario.sensing_graph.kind) == (2, "complete")
        assert np.array_equal(scenario.start_positions, np.round(scenario.start_positions, 2))
        violation = repeat(path).violation
        assert violation.number == number
        assert violation.found > violation.promised
        how = json.loads(path.with_suffix(".json").read_text(encoding="utf-8"))
        assert how["policy"] == own + "around"
        assert len(how["choices"]) == violation.step
    assert f"--scenario {path} --policy {own}around" in printed


@pytest.mark.slow
def test_search_takes_rest_for_a_deadlock_only(own, tmp_path):
    _, rows, printed = search(tmp_path / "out", own + "resting", trials=6)
    found = {row["searched"]: row["violations"] for row in rows}
    assert found == {"rise": "0", "growth": "0", "deadlock": "1"}
    assert "6 initial conditions of 1 random scenario under " in printed
    assert "1 counterexample, " in printed


@pytest.mark.slow
def test_search_takes_a_policy_that_fits_some_teams_only(own, tmp_path):
    status, _, _ = search(tmp_path / "out", own + "of_three", trials=60)
    assert status == 0


def test_search_names_a_policy_that_fails(own, tmp_path):
    with pytest.raises(UserError, match=r"late' for . robots: RuntimeError: no second step"):
        search(tmp_path / "out", own + "late", trials=6)


@pytest.mark.slow
def test_search_takes_policies_and_scenarios_by_name(own, tmp_path):
    status, rows, _ = search(
        tmp_path, "bearing-only", trials=6, scenario="trap", set=("n_robots=3",)
    )
    found = {row["searched"]: row["violations"] for row in rows}
    assert found["rise"] == "0"
    assert status == int(found["deadlock"] != "0")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"scenario": "ring-12"}, "--scenario is ring-12; add --policy"),
        (
            {"policy": "bearing-only", "any": True},
            "--policy is bearing-only; --random-scenarios checks certificates",
        ),
        ({"policy": "bearing-only", "claims": ("lemma-1",)}, "--policy checks no claims"),
        ({"policy": "no-such"}, "policy 'no-such' is unknown"),
        ({"policy": "bearing-only", "scenario": "unicycle-6"}, "bearing-only"),
    ],
)
def test_search_refuses_flags_that_do_not_go_together(options, words, tmp_path):
    with pytest.raises(UserError, match=words):
        run(Config(out=tmp_path, **options), console=Console(file=io.StringIO()))


def test_draws_vary_size_graph_weights_and_starts():
    scenario = rv.scenarios.resolve("fig3")
    trials = [policy_search.draw("half", scenario, 0, number) for number in range(60)]
    assert trials[0].scenario == scenario
    kinds = {trial.scenario.sensing_graph.kind for trial in trials}
    assert kinds >= {"complete", "edges", "path", "cycle", "star", "random_tree", "erdos_renyi"}
    assert {trial.scenario.n_robots for trial in trials} == {2, 3, 4, 5, 6}
    assert 0 < sum(trial.scenario.start_positions is None for trial in trials) < 60
    assert 0 < sum(trial.generations > 0 for trial in trials) < 60
    weights = {trial.scenario.sensing_graph.weight_range for trial in trials}
    assert len(weights) > 5


def test_draws_keep_what_a_scenario_cannot_do_without():
    packing = rv.Scenario(n_robots=4, body_radius=0.1, meeting="pack")
    for number in range(9):
        drawn = policy_search.draw("", packing, 0, number).scenario
        n = drawn.n_robots
        assert drawn.sensing_graph.most_links(n) == n * (n - 1) // 2
    sighted = rv.scenarios.resolve("range-12")
    kinds = {policy_search.draw("", sighted, 0, k).scenario.sensing_graph.kind for k in range(9)}
    assert kinds == {"proximity"}


def test_patience_outlasts_the_slowest_law():
    for scenario in (rv.scenarios.resolve("ring-12"), rv.scenarios.resolve("unicycle-6")):
        assert patience_of(scenario) >= 200 * scenario.tau
    slow = rv.Scenario(n_robots=2, robot_model="unicycle", max_turn_rate=0.01)
    assert patience_of(slow) == 4 * np.pi / 0.01


def test_a_played_trial_counts_time_without_progress():
    trial = policy_search.draw("zero", rv.scenarios.resolve("fig3"), 0, 0)
    violation = play(trial).violation
    assert violation.number == "deadlock"
    assert violation.found == pytest.approx(patience_of(trial.scenario), abs=2 * trial.scenario.tau)
