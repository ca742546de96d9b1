"""``rendezvous verify``: no violation of the theory, and detection of injected faults."""

import dataclasses
import io
from functools import partial

import numpy as np
import pytest
from faulty_filters import mistaken
from rich.console import Console

import baselines
from rendezvous_env import Scenario, graphs
from rendezvous_env.safety.heading import HeadingFilter
from rendezvous_env.safety.theorems.constants import merge_rise_allowance
from train.cli import main
from train.results import read_csv
from train.verify import claims as cases
from train.verify.adversaries import KINDS, Adversary
from train.verify.claims import BATCH, CLAIMS, Claim, bound_a
from train.verify.falsification import begin
from train.verify.monitors import BatchMoment
from train.verify.random_scenarios import Trial
from train.verify.verify import Config, run

BY_NAME = {claim.name: claim for claim in CLAIMS}


def command(tmp_path, *wrong, trials=BATCH, table="verify.csv", **options):
    """Exit status, rows of the CSV, and output."""
    printed = io.StringIO()
    config = Config(trials=trials, out=tmp_path, **options)
    status = run(config, wrong or CLAIMS, Console(file=printed, width=200))
    return status, read_csv(tmp_path / table), printed.getvalue()


def caught(tmp_path, claim, trials=4 * BATCH):
    """Fraction of violations and worst margin of a claim that must be violated."""
    status, (row,), printed = command(tmp_path, claim, trials=trials)
    assert status == 1
    assert row["first_violation"].startswith(f"rendezvous verify --claims {claim.name} --seed 0")
    assert row["first_violation"] in printed
    return int(row["violations"]) / int(row["trials"]), float(row["worst_margin"])


def test_no_claim_is_violated(tmp_path):
    status, rows, printed = command(tmp_path, trials=40)
    assert status == 0 and "0 violations" in printed
    assert [row["claim"] for row in rows] == list(BY_NAME)
    assert list(rows[0]) == [
        *("claim", "trials", "worst_margin", "worst_time_over_bound", "violations"),
        *("seconds", "first_violation"),
    ]
    for row in rows:
        assert row["trials"] == "40" and row["violations"] == "0" and row["first_violation"] == ""
        assert float(row["worst_margin"]) > -1e-6
        timed = BY_NAME[row["claim"]].bound is not cases.patience
        ratio = row["worst_time_over_bound"]
        assert 0 < float(ratio) <= 1 if timed else ratio == ""
    assert [path.name for path in tmp_path.iterdir()] == ["verify.csv"]


def test_equal_seed_gives_equal_results(tmp_path):
    found = [command(tmp_path, BY_NAME["theorem-2"], seed=seed)[1][0] for seed in (5, 5, 6)]
    margins = [row["worst_margin"] for row in found]
    assert margins[0] == margins[1] != margins[2]


def test_trials_cover_all_kinds():
    """Team sizes, dimensions, graphs, frames, speed limits and initial conditions all vary."""
    random = np.random.default_rng(0)
    drawn = [cases.draw_team(random, batch, 0.3) for batch in range(60)]
    scenarios = [trial.scenario for trial in drawn]
    assert {s.n_robots for s in scenarios} == {2, 3, 5, 8}
    assert {s.dim for s in scenarios} == {2, 3}
    assert {s.sensing_graph.kind for s in scenarios} == set(cases.FAMILIES)
    assert {s.local_frames for s in scenarios} == {"random", "global"}
    assert 0 < sum(s.max_speed is not None for s in scenarios) < 60
    assert 0 < sum(len(trial.starts) == BATCH for trial in drawn) < 60
    margins = [trial.arguments["min_alignment"] for trial in drawn]
    assert 0.3 <= min(margins) < 0.4 < max(margins)
    assert {trial.frame for trial in drawn} == {"net_bearing", "local"}


@pytest.mark.slow
def test_merges_raise_v_within_bound():
    """The row merge-rise is not empty."""
    trial = BY_NAME["merge-rise"].draw(np.random.default_rng(3), 0, 0.3)
    wrapped, seen, policy = begin(trial, 0.0, 64)
    teams, rises, excess = wrapped.unwrapped.simulator, [], []
    teams.set_max_steps(1500)
    while not teams.ended.all():
        seen, *_ = wrapped.step(policy(seen, BatchMoment(teams)))
        rises.append(wrapped.unwrapped.outcome.merge_rise.max())
        excess.append(wrapped.unwrapped.outcome.merge_excess.max())
    assert 0 < max(rises) < merge_rise_allowance(trial.scenario)
    assert max(excess) <= 1e-12


def flipped(trial, random):
    """Fault: motion away from the neighbours."""
    law = baselines.make("bearing-only", trial.scenario)
    return lambda seen, now: -law(seen, now.time)


def one_sided(random, batch, least_margin):
    """Fault: asymmetric weights."""
    trial = cases.draw_team(random, 1, least_margin, by="law", dims=(2,))
    weights = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 0.1], [0.1, 0.0, 0.0]])
    scenario = trial.scenario.replace(graph=graphs.directed(weights))
    return dataclasses.replace(trial, scenario=scenario, starts=())


def bare(trial, random):
    """Choices that keep headings, or nonholonomic bodies, across f."""
    turn_rate = trial.arguments["max_turn_rate"]
    adversary = Adversary(trial.scenario, BATCH, trial.by, random, turn_rate)
    adversary.kinds[:] = 0 if trial.scenario.model.nonholonomic else KINDS.index("across")
    if trial.scenario.model.bounded:
        return lambda seen, now: adversary.desired(now)
    return adversary.controls


@pytest.mark.parametrize("name", ["theorem-1", "certified-step"])
def test_flipped_law_is_detected(tmp_path, name):
    claim = dataclasses.replace(BY_NAME[name], law=flipped)
    found, worst = caught(tmp_path, claim, trials=2 * BATCH)
    assert found == 1.0 and worst < -1e-3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "bound", "share"), [("theorem-2", 20.0, 1.0), ("gate", 60.0, 0.9)]
)
def test_uncertified_headings_are_detected(tmp_path, name, bound, share, monkeypatch):
    mistaken(monkeypatch, HeadingFilter, lambda known: {"certified": False})

    def draw(random, batch, least_margin):
        """Policy with a new choice in each step, in the robots' own frames."""
        trial = BY_NAME[name].draw(random, batch, least_margin)
        arguments = trial.arguments | {"max_turn_rate": 3.0}
        return dataclasses.replace(trial, arguments=arguments, frame="local")

    claim = dataclasses.replace(
        BY_NAME[name],
        draw=draw,
        law=bare,
        bound=lambda trial, teams: np.full(teams.num_envs, bound),
        numbers=("time",),
    )
    assert caught(tmp_path, claim, trials=2 * BATCH)[0] >= share


@pytest.mark.slow
def test_long_unscaled_step_is_detected(tmp_path, monkeypatch):
    draw = partial(cases.draw_team, step_factors=(4.0, 4.0 + 1e-9))
    claim = dataclasses.replace(BY_NAME["local-scaling"], draw=draw)
    assert command(tmp_path, claim, trials=4 * BATCH)[0] == 0
    mistaken(monkeypatch, HeadingFilter, lambda known: {"speed_scaled": False})
    assert caught(tmp_path, claim)[1] < -1e-3


def light_link_left(random, batch, least_margin):
    """The heavy link is short and soon contracted; the remaining a* is 0.5 (theory 3)."""
    scenario = Scenario(
        n_robots=3,
        graph=graphs.from_edges([(0, 1, 2.0), (1, 2, 0.5)]),
        start_positions=((0.0, 0.0), (0.4, 0.0), (10.4, 0.0)),
        merge_radius=0.2,
    )
    return Trial(scenario, "law", {})


def with_max_a(trial, teams):
    """Bound of theorem A with the largest weight in place of the bottleneck weight."""
    scenario = trial.scenario
    heaviest = scenario.sensing_graph.base_weights(scenario.n_robots).max()
    return bound_a(trial, teams) * (scenario.bottleneck_weight / heaviest) ** 2


def test_wrong_bottleneck_weight_is_detected(tmp_path):
    right = dataclasses.replace(BY_NAME["bound-A"], draw=light_link_left)
    status, (row,), _ = command(tmp_path, right)
    assert status == 0 and float(row["worst_time_over_bound"]) < 0.6

    wrong = dataclasses.replace(right, bound=with_max_a)
    status, (row,), printed = command(tmp_path, wrong)
    assert status == 1 and int(row["violations"]) == BATCH
    assert "bound-A is violated" in printed and row["worst_time_over_bound"] == "inf"


def test_directed_graph_violation_repeats_from_batch(tmp_path):
    """Lemma 1 does not cover directed graphs."""
    soon = lambda *given: np.ones(BATCH)  # noqa: E731
    claim = dataclasses.replace(BY_NAME["lemma-1"], draw=one_sided, bound=soon)
    status, (row,), _ = command(tmp_path, claim, trials=5 * BATCH)
    assert status == 1 and float(row["worst_margin"]) < -0.1
    number = int(row["first_violation"].split("--only-batch ")[1].split()[0])
    _, (again,), _ = command(tmp_path, claim, only_batch=number)
    assert 0 < int(again["violations"]) <= int(row["violations"])
    assert again["first_violation"] == row["first_violation"]


def test_command_line_options_work(tmp_path, capsys, monkeypatch):
    flags = ["verify", "--trials", "3", "--claims", "lemma-1", "bound-A", "--out", str(tmp_path)]
    assert main(flags) == 0
    rows = read_csv(tmp_path / "verify.csv")
    assert [(row["claim"], row["trials"]) for row in rows] == [("lemma-1", "3"), ("bound-A", "3")]
    claims = [claim for claim in CLAIMS if isinstance(claim, Claim)]
    wrong = tuple(dataclasses.replace(claim, law=flipped) for claim in claims)
    monkeypatch.setattr(run, "__defaults__", (wrong, None))
    assert main([*flags[:3], "--claims", "theorem-1", *flags[-2:]]) == 1
    said = capsys.readouterr().out.replace("\n", " ")
    assert "rendezvous verify --claims theorem-1 --seed 0" in said
