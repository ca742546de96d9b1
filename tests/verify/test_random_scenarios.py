"""``rendezvous verify --random-scenarios``: random scenarios reveal wrong certificates."""

import dataclasses
import itertools
import json
import math
from functools import partial

import numpy as np
import pytest
import test_verify
from parameters import marked, slow

import rendezvous_env as rv
from rendezvous_env.sensors.sensing import PER_ROBOT
from train.verify import adversaries, falsification, random_initial_conditions, random_scenarios
from train.verify.falsification import ask, climb, play, repeat, shrink, write
from train.verify.random_scenarios import CHOICES, Kind, Trial, trials_of

PLANE = Kind("single_integrator", 2, "fixed", True, "none")
PAIR = rv.Scenario(
    n_robots=2, start_positions=((0.0, 0.0), (1.0, 0.0)), local_frames="global", name="pair"
)
SQUARE = PAIR.replace(n_robots=4, start_positions=((0, 0), (1, 0), (1, 1), (0, 1)))


def trial(scenario=SQUARE, by="law", seed=0, **arguments):
    margin = {"min_alignment": 0.7} if by in ("heading", "tank") else {}
    return Trial(scenario, by, margin | arguments, seed=seed)


def promising(monkeypatch, **limits):
    """Replace a number of every certificate by another one, or by a fraction of it."""
    ask = falsification.ask

    def wrong(*given):
        found = ask(*given)
        changed = {
            name: limit[0] * found.limits.get(name, math.inf) if isinstance(limit, tuple) else limit
            for name, limit in limits.items()
        }
        return found._replace(limits=found.limits | changed)

    monkeypatch.setattr(falsification, "ask", wrong)


@pytest.mark.nightly
def test_random_scenarios_cover_all_kinds():
    drawn = [trials_of(0, number, number)[0].scenario for number in range(600)]
    assert {scenario.sensing_graph.kind for scenario in drawn} == {
        *("complete", "edges", "path", "cycle", "star", "random_tree", "erdos_renyi"),
        *("directed", "directed_cycle", "switching", "proximity"),
    }
    models = {"single_integrator", "double_integrator", "unicycle", "nonholonomic_3d"}
    assert {scenario.robot_model for scenario in drawn if not scenario.mixes_models} == models
    assert {scenario.n_robots for scenario in drawn} == {2, 3, 4, 5, 6}
    solid = [scenario for scenario in drawn if scenario.obstacles]
    assert {scenario.obstacle_contact for scenario in solid} == {"slide", "stop", "ignore"}
    obstacles = [np.atleast_1d(np.array(one.obstacles, dtype=object)) for one in solid]
    shapes = {type(one).__name__ for one in np.concatenate(obstacles)}
    assert shapes >= {"Disc", "Sphere", "Polygon", "Capsule", "ObstacleField", "WallField"}
    exact = vars(rv.Sensing())
    flaws = {name for one in drawn for name in exact if vars(one.sensing)[name] != exact[name]}
    assert flaws == set(exact) - {"custom"}
    steps = [scenario.tau / scenario.certified_step for scenario in drawn]
    assert min(steps) < 0.15 and max(steps) > 15
    given = [np.array(s.start_positions) for s in drawn if s.start_positions is not None]
    assert 300 < len(given) < 600


@pytest.mark.nightly
def test_random_scenarios_cover_clocks_and_events(monkeypatch):
    for share in ("_CLOCKED", "_EVENTFUL"):
        monkeypatch.setattr(random_scenarios, share, 0.9)
    drawn = [trials_of(0, number, number)[0].scenario for number in range(200)]
    clocks = {(one.activation.kind, one.hold) for one in drawn if not one.activation.synchronous}
    assert clocks == {*itertools.product(("periodic", "random", "bounded"), ("command", "stop"))}
    kinds = {"crash", "blind", "adversary", "compass", "slip", "disturbance", "noise"}
    assert set().union(*(one.events.kinds for one in drawn)) == kinds


@pytest.mark.nightly
def test_random_scenarios_cover_mixed_teams_sensors_of_robots_and_areas(monkeypatch):
    before = [trials_of(0, number, number)[0].scenario for number in range(150)]
    monkeypatch.setattr(random_scenarios, "_VARIED", 0.0)
    plain = [trials_of(0, number, number)[0].scenario for number in range(150)]
    changed = sum(one != other for one, other in zip(before, plain, strict=True))
    assert 5 < changed < 0.25 * 150
    monkeypatch.setattr(random_scenarios, "_VARIED", 0.9)
    drawn = [trials_of(0, number, number)[0].scenario for number in range(240)]
    models = {name for one in drawn if one.mixes_models for name in one.robot_model}
    assert models == {"single_integrator", "double_integrator", "unicycle", "nonholonomic_3d"}
    own = {name for one in drawn for name in one.sensing.per_robot}
    assert own == set(PER_ROBOT)
    assert {one.dim for one in drawn if isinstance(one.spawn_size, tuple)} == {2, 3}
    assert {len(one.start_region) for one in drawn if one.start_region} == {1, 2}
    bounded = [
        one for one in drawn
        if one.sensing.per_robot == ("dropout",)
        and rv.certificate(one).expected_time_bound < math.inf
    ]  # fmt: skip
    assert bounded


@pytest.mark.slow
def test_random_gains_of_each_robot_are_within_those_of_all(monkeypatch):
    before = [trials_of(0, number, number)[3] for number in range(120)]
    monkeypatch.setattr(random_scenarios, "_VARIED", 0.0)
    plain = [trials_of(0, number, number)[3] for number in range(120)]
    own = 0
    for one, other in zip(before, plain, strict=True):
        if one.arguments != other.arguments:
            low, high = (np.array(one.arguments[name]) for name in ("min_gain", "max_gain"))
            assert len(low) == one.scenario.n_robots and (low <= high).all()
            assert low.min() == other.arguments["min_gain"]
            assert high.max() == other.arguments["max_gain"]
            alike = next(falsification._simpler(one))
            assert alike.arguments == other.arguments
            own += 1
    assert own > 2


def test_shrunk_scenarios_leave_out_robots_with_their_sensors():
    sensing = rv.Sensing(dropout=[0.1, 0.2, 0.3, 0.4])
    fewer = [
        one.scenario
        for one in falsification._simpler(trial(SQUARE.replace(sensing=sensing)))
        if one.scenario.n_robots == 3
    ]
    assert [one.sensing.dropout for one in fewer] == [
        (0.2, 0.3, 0.4), (0.1, 0.3, 0.4), (0.1, 0.2, 0.4), (0.1, 0.2, 0.3),
    ]  # fmt: skip


def test_equal_seed_gives_equal_scenario():
    assert trials_of(3, 17) == trials_of(3, 17) != trials_of(3, 18)
    assert [one.by for one in trials_of(3, 17)] == list(CHOICES)
    assert trials_of(3, 17)[0].scenario != trials_of(4, 17)[0].scenario


@pytest.mark.parametrize("by", marked(CHOICES, own_path=[*CHOICES][2:]))
def test_valid_certificate_is_checked_to_its_bound(by):
    played = play(trial(PAIR, by))
    timed = {name for name, what in played.counts if what == "time"}
    assert timed and all(name.startswith(f"{by}: ") for name in timed)
    assert played.violation is None and played.ratio.keys() == timed
    assert all(0 < ratio <= 1 for ratio in played.ratio.values())


@pytest.mark.parametrize(
    ("by", "theorems"),
    [
        ("law", {"A", "V", "G", "G, the hull", "N1"}),
        ("heading", {"C", "V", "N1'"}),
        ("tank", {"D", "D, the bound on V"}),
        ("gains", {"G", "G, the hull"}),
        ("links", {"R"}),
    ],
)
def test_applicable_theorems_are_named(by, theorems):
    found = ask(SQUARE, by, trial(by=by).arguments)
    assert set(found.theorems) == {f"{by}: {name}" for name in theorems}
    assert {number for own in found.theorems.values() for number in own} == set(found.limits)


LOOSE = trial(SQUARE.replace(graph="cycle"), "heading", min_alignment=0.05)
"""Scenario with many kinds of events."""
NOISY = trial(PAIR.replace(sensing=rv.Sensing(noise=0.3)))
"""Episodes take 0.4 s without noise."""


@pytest.mark.parametrize(
    ("number", "limit", "given"),
    [
        ("time", (0.05,), trial()),
        slow("expected_time", (1 / 8,), NOISY),
        ("lyapunov", (0.3,), trial(by="tank", budget=1.0)),
        ("hull", 2.0, LOOSE),
        ("link_growth", -0.5, LOOSE),
        ("nested", 0.0, LOOSE),
        ("links", 0.0, LOOSE),
        ("descent", 0.0, trial(by="tank", budget=1.0, min_alignment=0.05)),
        ("ledger", -0.02, trial(by="tank", budget=1.0, min_alignment=0.05)),
    ],
)
def test_false_bound_is_found(number, limit, given, monkeypatch):
    if given is NOISY:  # of means the others see nothing
        played = play(given)
        assert played.violation is None and played.counts["law: E[T]", number]
    promising(monkeypatch, **{number: limit})
    found = play(given).violation
    assert found.number == number and found.found > found.promised


@pytest.mark.parametrize(
    ("by", "number"), [("law", "time"), ("heading", "descent"), ("tank", "ledger")]
)
def test_excessive_bearing_errors_are_found(by, number, monkeypatch):
    path = SQUARE.replace(graph="path")
    off = 0.5 * rv.certificate(path, by=by, **trial(by=by).arguments).tolerated_bearing_error
    misled = trial(path, by, bearing_error=off)
    played = play(misled)
    assert played.violation is None and any("η > 0" in name for name, _ in played.counts)
    monkeypatch.setattr(adversaries, "_ROUNDED", 2.0 / off)
    assert play(misled).violation.number == number


def test_search_improves_initial_conditions(monkeypatch, tmp_path):
    """The error of the bound shows only for other initial conditions."""
    time = max(play(trial()).ratio.values()) * ask(SQUARE, "law", {}).limits["time"]
    promising(monkeypatch, time=time + 0.05)
    assert play(trial()).violation is None
    monkeypatch.setattr(random_initial_conditions, "STRIDES", (0.5, 1.0))
    better, played = climb(dataclasses.replace(trial(), generations=30))
    assert played.violation.number == "time" and better.scenario != SQUARE
    assert repeat(write(tmp_path, "found", better, played)).violation.number == "time"


def from_elsewhere(play):
    """Hide violations from the trial's own initial condition during the search."""

    def played(trial, **asked):
        found = play(trial, **asked)
        alone = not trial.generations or trial.starts or "choices" in asked
        return found if alone else dataclasses.replace(found, violation=None)

    return played


@pytest.mark.parametrize("generations", [0, 3])
def test_violation_by_rotated_bearings_repeats_alone(generations, monkeypatch, tmp_path):
    """A team has the same errors separately as in a batch, at any index."""
    path, teams = SQUARE.replace(graph="path"), set()
    off = 0.5 * rv.certificate(path, 0.7).tolerated_bearing_error
    promising(monkeypatch, descent=-0.2)
    if generations:  # nothing is found from the start itself
        monkeypatch.setattr(falsification, "play", from_elsewhere(falsification.play))
    for seed in range(4):
        misled = trial(path, "heading", seed=seed, bearing_error=off)
        found, played = climb(dataclasses.replace(misled, generations=generations))
        file = write(tmp_path, f"found-{seed}", found, played)
        assert json.loads(file.with_suffix(".json").read_text())["teams"] == 1
        again = repeat(file).violation
        assert (again.number, again.step) == ("descent", played.violation.step)
        assert again.found == played.violation.found
        teams.add(played.violation.team)
    assert teams != {0}


def test_violation_is_shrunk_and_repeatable(monkeypatch, tmp_path):
    promising(monkeypatch, lyapunov=(0.3,))
    large = SQUARE.replace(
        max_speed=3.0, time_step=0.01, on_merge="follow",
        obstacles=(rv.Capsule(((9.0, 9.0), (9.0, 9.1)), 0.1),),
        sensing=rv.Sensing(error=1e-4), start_positions=None, spawn_size=2.0,
    )  # fmt: skip
    large = trial(large, "tank", budget=1.0)
    small, played = shrink(large, play(large))
    plain = small.scenario
    assert plain.n_robots == 2 and not plain.obstacles and plain.sensing.exact
    assert plain.max_speed is None and plain.time_step is None and plain.on_merge == "remove"
    file = write(tmp_path, "found", small, played)
    again = repeat(file)
    assert again.violation.number == "lyapunov"
    assert rv.Scenario.from_toml(file).n_robots == 2
    monkeypatch.undo()
    assert repeat(file).violation is None  # of the right certificate


def test_refused_certificate_is_not_simulated():
    alone = SQUARE.replace(graph=rv.graphs.from_edges([(0, 1)], 4), require_connected=False)
    played = play(trial(alone, "tank"))
    assert not played.counts and played.steps == 0


command = partial(test_verify.command, any=True, table="any.csv", jobs=1)


@pytest.fixture
def one_kind(monkeypatch):
    """Scenarios with compiled code of one kind only."""
    monkeypatch.setattr(random_scenarios, "draw_kind", lambda random: PLANE)


@pytest.mark.slow
def test_no_violation_is_found(tmp_path, one_kind):
    status, rows, printed = command(tmp_path, trials=30)
    assert status == 0 and printed.count("0 violations") == 1
    assert sum(int(row["granted"]) for row in rows) > 250
    for row in rows:
        assert row["violations"] == "0"
        assert math.isnan(ratio := float(row["worst_time_over_bound"] or "nan")) or ratio <= 1.0
    assert [path.name for path in tmp_path.iterdir()] == ["any.csv"]


@pytest.mark.slow
def test_violations_are_written_with_status_1(tmp_path, monkeypatch, one_kind):
    promising(monkeypatch, lyapunov=(0.5,))
    status, rows, printed = command(tmp_path, trials=36)
    assert status == 1 and sum(int(row["violations"]) for row in rows) > 0
    files = sorted(tmp_path.glob("any-0-*.toml"))
    assert files and all(repeat(file).violation is not None for file in files)
    assert str(files[0]) in printed


@pytest.mark.nightly
def test_a_thousand_random_scenarios_hold(tmp_path):
    """More of them, of all kinds: ``rendezvous verify --random-scenarios``."""
    status, rows, printed = command(tmp_path, trials=1_000, kinds=8, jobs=None)
    assert status == 0, printed
    granted = {row["theorem"]: int(row["granted"]) for row in rows}
    assert sum(granted.values()) > 700 and len(granted) > 30


@pytest.mark.nightly
def test_scenarios_of_larger_teams_hold(tmp_path, monkeypatch):
    """Many neighbours may surround a robot with ever smaller margins."""
    monkeypatch.setattr(random_scenarios, "_SIZES", (8, 12, 16))
    status, rows, printed = command(tmp_path, trials=300, kinds=3)
    assert status == 0, printed
    assert sum(int(row["granted"]) for row in rows) > 300
