"""Teams whose robots differ in sight, errors, detection and delay."""

import dataclasses
import json
import math
import pickle

import numpy as np
import pytest
from conftest import UNEQUAL, started
from parameters import marked
from test_sensing_engine import PLANE, RING, SPACE, WALLED, act

import rendezvous_env as rv
from rendezvous_env import baselines
from rendezvous_env.sensors.sensing import PER_ROBOT

SENSORS = {
    "range": [None, 3.0, 5.0, 4.0, 8.0],
    "field_of_view": [2.0 * math.pi, math.radians(66.0), 3.0, 1.0, 5.0],
    "noise": [0.0, 0.1, 0.3, 0.01, 0.5],
    "dropout": [0.0, 0.2, 0.4, 0.5, 0.7],
    "min_range": [0.0, 2.0, 4.0, 1.0, 0.5],
    "observer_bias": [0.1, 0.0, 0.3, 0.05, 1.0],
    "outliers": [0.0, 0.5, 0.1, 1.0, 0.0],
    "bias": [0.0, 0.1, 0.05, 1.0, 0.2],
    "delay": [1, 0, 3, 2, 0],
    "detection": [
        [[0.0, 1.0]],
        [[0.0, 1.0], [5.0, 0.8]],
        [[1.0, 0.5]],
        [[0.0, 0.9], [3.0, 0.5], [9.0, 0.7]],
        [[2.0, 0.4], [4.0, 0.9]],
    ],
    "persistence": [0.5, 0.0, 0.1, 3.0, 1e-9],
    "noise_correlation": [0.4, 0.1, 0.0, 2.0, 0.0],
    "sample_period": [0.0, 0.05, 0.0, 0.02, 0.03],
    "view_falloff": [0.0, 0.3, 0.0, 0.5, 0.1],
    "error": [0.0, 0.2, 0.01, 3.0, 0.0],
    "sectors": [None, 8, 720, 16, None],
    "occlusion": ["none", "robots", "both", "obstacles", "none"],
    "outlier_kind": ["uniform", "robot", "uniform", "robot", "uniform"],
}
SECONDS = [0.0, 0.04, 0.0, 0.0, 0.1]  # delay_time of robots without a delay
FIELDS = {
    "plain": (*PER_ROBOT[:5], "bias", "delay"),
    "white": ("noise", "noise_correlation", "dropout", "observer_bias", "bias", "error"),
    "measured": tuple(SENSORS),
}
"""Fields that differ."""
OTHERS = {"plain": {}, "white": {"field_of_view": 4.0}, "measured": {}}
TEAMS = {
    "plane": WALLED,
    "space": SPACE,
    "fewer rows": WALLED.replace(graph="cycle", local_frames="random"),
    "one way": WALLED.replace(graph=rv.graphs.directed(UNEQUAL), obstacles=()),
    "unicycles": WALLED.replace(robot_model="unicycle"),
}


def own(robot: int, others: str = "measured") -> dict:
    """Sensor fields of one robot."""
    late = {"delay_time": SECONDS[robot]} if others == "measured" else {}
    return {name: SENSORS[name][robot] for name in FIELDS[others]} | late


def mixed(others: str) -> rv.Sensing:
    """Sensor whose fields differ between robots."""
    late = {"delay_time": SECONDS} if others == "measured" else {}
    fields = {name: SENSORS[name] for name in FIELDS[others]} | late
    return rv.Sensing(**fields, **OTHERS[others])


def seen(scenario: rv.Scenario, batch: int, steps: int = 3) -> np.ndarray:
    """Observations of steps with actions that are independent of them, (steps, B, n, rows, d)."""
    sim, found = started(scenario, batch, 3), []
    for step in range(steps):
        found.append(sim.observe().copy())
        act(sim, step)
    return np.stack(found)


@pytest.mark.parametrize("others", OTHERS)
@pytest.mark.parametrize("team", marked(TEAMS, own_path=["space"], kernels=["space"]))
def test_sensors_each_robot_observes_as_in_a_team_of_its_sensor(team, others):
    scenario, common = TEAMS[team], OTHERS[others]
    found = seen(scenario.replace(sensing=mixed(others)), 2)
    hidden = 0
    for robot in range(5):
        alone = seen(scenario.replace(sensing=rv.Sensing(**own(robot, others), **common)), 2)
        np.testing.assert_array_equal(found[:, :, robot], alone[:, :, robot])
        hidden += int((alone[:, :, robot] == 0.0).all(axis=-1).sum())
    assert hidden > 20 and found.any()


@pytest.mark.parametrize("others", OTHERS)
@pytest.mark.parametrize("team", marked(TEAMS, slow=["space"]))
def test_sensors_batch_equals_singles(team, others):
    scenario = TEAMS[team].replace(sensing=mixed(others))
    many = seen(scenario, 40)
    for team_number in (0, 17, 39):
        sim = rv.Simulator(scenario, 1)
        sim.reset(3 + team_number)
        assert (sim.observe()[0] == many[0, team_number]).all()


def test_sensors_view_falloff_ends_at_the_edge_of_each_robot():
    views = [2.0 * math.pi, 2.0, 3.0, 1.0, 5.0]
    scenario = WALLED.replace(sensing=rv.Sensing(field_of_view=views, view_falloff=0.4))
    found = seen(scenario, 40, 1)[0]
    exact = seen(WALLED, 40, 1)[0]
    rows = scenario.observation_layout.neighbours
    angles = np.abs(np.arctan2(exact[:, :, rows, 1], exact[:, :, rows, 0]))
    present, there = found[:, :, rows].any(axis=-1), exact[:, :, rows].any(axis=-1)
    half = 0.5 * np.array(views)[:, None]
    assert (present[:, 0] == there[:, 0]).all()
    assert not present[:, 1:][angles[:, 1:] > half[1:]].any()
    inside = there[:, 1:] & (angles[:, 1:] < half[1:] - 0.4)
    border = there[:, 1:] & (angles[:, 1:] < half[1:]) & (angles[:, 1:] > half[1:] - 0.4)
    assert present[:, 1:][inside].all() and 0.2 < present[:, 1:][border].mean() < 0.8


def test_sensors_given_one_by_one_are_fields_of_one_sensor():
    listed = [rv.Sensing(**own(robot)) for robot in range(5)]
    scenario = PLANE.replace(sensing=listed)
    assert scenario.sensing == rv.Sensing(**SENSORS, delay_time=SECONDS)
    assert set(scenario.sensing.per_robot) == set(PER_ROBOT)
    tables = [{name: value for name, value in own(k).items() if value} for k in range(5)]
    assert PLANE.replace(sensing=tables) == scenario


def test_sensors_that_see_all_round_need_no_view_falloff():
    cameras = [rv.Sensing(field_of_view=view, view_falloff=0.4) for view in (2.0, 3.0)]
    scenario = WALLED.replace(sensing=[rv.Sensing(), *cameras, rv.Sensing(), rv.Sensing()])
    views = [2.0 * math.pi, 2.0, 3.0, 2.0 * math.pi, 2.0 * math.pi]
    borders = [0.0, 0.4, 0.4, 0.0, 0.0]
    assert scenario.sensing == rv.Sensing(field_of_view=views, view_falloff=borders)
    common = scenario.replace(sensing=rv.Sensing(field_of_view=views, view_falloff=0.4))
    np.testing.assert_array_equal(seen(scenario, 2), seen(common, 2))


def test_sensors_survive_plain_data_and_toml(tmp_path):
    scenario = PLANE.replace(sensing=mixed("measured"))
    assert eval(repr(scenario.sensing), {"Sensing": rv.Sensing}) == scenario.sensing
    assert json.loads(json.dumps(scenario.to_plain())) == scenario.to_plain()
    assert rv.Scenario.from_plain(scenario.to_plain()) == scenario
    scenario.to_toml(tmp_path / "own.toml")
    again = rv.Scenario.from_toml(tmp_path / "own.toml")
    written = (tmp_path / "own.toml").read_text(encoding="utf-8")
    assert again == scenario and 'range = [\n    "unlimited",\n    3.0' in written
    assert 'sectors = [\n    "none",\n    8' in written


def test_sensors_that_are_equal_are_one():
    camera = rv.Sensing(
        range=4.0, field_of_view=2.0, noise=0.1, dropout=0.2, min_range=0.1, observer_bias=0.1,
        outliers=0.1, bias=0.1, delay=2, detection=[[1.0, 0.5], [2.0, 0.3]], persistence=0.3,
        noise_correlation=0.2, sample_period=0.1, view_falloff=0.3, error=0.1, sectors=90,
        occlusion="both", outlier_kind="robot",
    )  # fmt: skip
    equal = {name: [getattr(camera, name)] * 5 for name in PER_ROBOT}
    assert PLANE.replace(sensing=equal).sensing == camera
    assert rv.Sensing(**equal).departures() == camera.departures()
    assert rv.Sensing(range=[None] * 5, detection=[[], []], sectors=[None, "none"]).exact
    assert PLANE.replace(sensing={"detection": [[]] * 5, "delay_time": [0.0] * 5}) == PLANE
    assert PLANE.replace(sensing=[camera] * 5) == PLANE.replace(sensing=camera)
    assert PLANE.replace(sensing=[rv.Sensing()] * 5) == PLANE


OF_ANOTHER_KIND = {
    "detection": [[1.0, 0.5]], "sectors": 8, "occlusion": "robots", "outlier_kind": "robot",
}  # fmt: skip


def test_all_fields_but_custom_take_lists():
    assert {*PER_ROBOT, "custom"} == {one.name for one in dataclasses.fields(rv.Sensing)}


@pytest.mark.parametrize("name", PER_ROBOT)
def test_lists_of_equal_values_keep_their_length_in_copies(name):
    value = OF_ANOTHER_KIND.get(name, 1)
    views = {} if name == "field_of_view" else {"field_of_view": 3.0}
    copied = dataclasses.replace(rv.Sensing(**{name: [value] * 3}, **views), custom=())
    with pytest.raises(ValueError, match=f"sensing.{name} is .*; it must be 5 "):
        PLANE.replace(sensing=copied)
    with pytest.raises(ValueError, match=rf"sensing\[0\].{name} is .*one value, not a list"):
        PLANE.replace(sensing=[copied, *[rv.Sensing()] * 4])
    again = rv.Sensing(**copied.to_plain())
    assert again == copied == pickle.loads(pickle.dumps(copied)) and again.per_robot == (name,)


def test_robots_may_be_late_by_seconds():
    seconds = [0.0, 0.052, 0.02, 0.008, 0.06]
    late = PLANE.replace(time_step=0.02, sensing=rv.Sensing(delay_time=seconds))
    steps = late.replace(sensing=rv.Sensing(delay=[0, 3, 1, 0, 3]))
    assert late.delay_steps == 3
    np.testing.assert_array_equal(seen(late, 2), seen(steps, 2))


def test_robot_with_an_empty_table_detects_all_neighbours():
    tables = [[], [[0.0, 0.3]], [[0.0, 0.0]], [], [[1.0, 0.5]]]
    found, exact = (
        seen(WALLED.replace(sensing=rv.Sensing(detection=one)), 40, 1)[0] for one in (tables, [])
    )
    np.testing.assert_array_equal(found[:, [0, 3]], exact[:, [0, 3]])
    rows = WALLED.observation_layout.neighbours
    present, there = found[:, :, rows].any(axis=-1), exact[:, :, rows].any(axis=-1)
    assert not present[:, 2].any() and 0.15 < present[:, 1].sum() / there[:, 1].sum() < 0.45


def test_persistence_of_each_robot_has_its_correlation():
    tau, times = 0.02, [0.0, 0.02, 0.1, 0.4, 0.01]
    still = PLANE.replace(sensing=rv.Sensing(detection=[[0.0, 0.5]], persistence=times))
    sim = rv.Simulator(still.replace(time_step=tau, time_limit=1000.0), 400)
    sim.reset(seed=1)
    shown = []
    for _ in range(20):
        shown.append(sim.observe()[:, :, still.observation_layout.neighbours].any(axis=-1))
        sim.step(np.zeros((400, 5, 2), np.float32))
    seen_in_a_row = np.array(shown[:-1]) & np.array(shown[1:])
    again = seen_in_a_row.sum(axis=(0, 1, 3)) / np.array(shown[:-1]).sum(axis=(0, 1, 3))
    wanted = [0.5 + 0.5 * (math.exp(-tau / time) if time else 0.0) for time in times]
    np.testing.assert_allclose(again, wanted, atol=0.02)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"range": [1.0, 2.0]}, r"sensing.range is \[1.0, 2.0\]; it must be 5 numbers"),
        ({"noise": [0.1, 0.1]}, r"sensing.noise is \[0.1, 0.1\]; it must be 5 numbers"),
        ({"range": [None] * 4}, r"sensing.range is \[None, .*\]; it must be 5 numbers"),
        ({"dropout": [0.1, 0.2]}, "sensing.dropout is .*5 numbers, one for each robot"),
        ({"min_range": [0.0, -1.0]}, r"sensing.min_range\[1\] is -1.0; it must be a finite"),
        ({"field_of_view": [1.0, 7.0]}, r"sensing.field_of_view\[1\] is 7.0; it must be a pos"),
        ({"range": [1.0, "far"]}, r"sensing.range\[1\] is 'far'; .* m, or None for no limit$"),
        ({"noise": []}, r"sensing.noise is \[\]; it must be one value, or a list"),
        ({"view_falloff": 0.1, "field_of_view": [7.0]}, r"field_of_view\[0\]"),
        ({"detection": [[], []]}, r"sensing.detection is \[\(\), \(\)\]; it must be 5 tables"),
        ({"detection": [[], [1.0, 0.5]]}, r"sensing.detection\[1\]\[0\] is 1.0; .* pairs"),
        ({"detection": [[[1.0, 2.0]]]}, r"sensing.detection\[0\]\[0\]\[1\] is 2.0"),
        ({"delay": [1, 0]}, r"sensing.delay is \[1, 0\]; it must be 5 numbers"),
        ({"delay": [0, 0.5]}, r"sensing.delay\[1\] is 0.5; it must be an integer, 0 or more"),
        ({"delay_time": [1e6, 0.0, 0.0, 0.0, 0.0]}, "sensing.delay_time is .*10000 steps"),
        ({"delay": [0, 1], "delay_time": 0.2}, r"delay is \[0, 1\] steps and .* 0.2 s; .* one of"),
        ({"persistence": [0.1, -1.0]}, r"sensing.persistence\[1\] is -1.0"),
        ({"bias": [0.1, "much"]}, r"sensing.bias\[1\] is 'much'"),
        ({"delay": [0, 1], "delay_time": [0.1, 0.2]}, r"delay_time is \[0.1, 0.2\] s; .* one of"),
        ({"sectors": [8, 1]}, r"sensing.sectors\[1\] is 1; .*, or None for exact bearings$"),
        ({"occlusion": ["none", "fog"]}, r"sensing.occlusion\[1\] is 'fog'; .*'obstacles'"),
        ({"occlusion": ["none", "both"]}, "sensing.occlusion is .*; it must be 5 words, one for"),
        ({"outlier_kind": ["robot"]}, "sensing.outlier_kind is .*; it must be 5 words"),
        ({"error": [0.1, 4.0]}, r"sensing.error\[1\] is 4.0"),
        ({"sample_period": [0.1, -1.0]}, r"sensing.sample_period\[1\] is -1.0"),
        ({"view_falloff": [0.0, 0.1]}, r"view_falloff is \[0.0, 0.1\] rad and .* full circle"),
    ],
)
def test_sensors_are_refused_by_field_value_and_remedy(given, message):
    with pytest.raises(ValueError, match=message):
        PLANE.replace(sensing=given)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ([], "a Sensing, or a list of one for each robot"),
        (
            [{"custom": ["sunlight"]}] + [{}] * 4,
            r"sensing\[1\].custom is \(\); it must be \('sunlight',\) as .*every field but custom",
        ),
        ([{"noise": [0.1, 0.2]}] * 5, r"sensing\[0\].noise is \[0.1, 0.2\]; it must be one val"),
        ([{}, {"range": -1.0}, {}, {}, {}], r"sensing\[1\].range is -1.0"),
        ([1] * 5, r"sensing\[0\] is 1; it must be a Sensing"),
        ([{"noise": 0.1}] * 3, "sensing is .*; it must be 5 entries, one for each robot"),
    ],
)
def test_sensors_given_one_by_one_are_refused_by_field_value_and_remedy(given, message):
    rv.sensor_imperfection("sunlight", lambda seen: None)
    with pytest.raises(ValueError, match=message):
        PLANE.replace(sensing=given)


def test_range_without_a_limit_has_a_name_in_files():
    assert rv.Sensing(range="unlimited") == rv.Sensing()
    assert PLANE.replace(sensing=[{"range": "unlimited"}] + [{"range": 2.0}] * 4).sensing.range == (
        *(None, 2.0, 2.0, 2.0, 2.0),
    )


@pytest.mark.parametrize("field", ["range", "field_of_view"])
def test_sensors_of_a_proximity_graph_are_alike(field):
    sensing = rv.Sensing(
        **{"range": 30.0, field: [20.0 if field == "range" else 2.0, 3.0, *[6.0] * 3]}
    )
    with pytest.raises(ValueError, match=f"sensing.{field} is .*; it must be one number for all"):
        PLANE.replace(graph="proximity", sensing=sensing)


def test_certificate_of_misses_is_that_of_the_robot_that_detects_least():
    own, worst = (RING.replace(sensing=rv.Sensing(dropout=p)) for p in ([0.1] * 5 + [0.4], 0.4))
    directed = [
        one.replace(graph=rv.graphs.directed_cycle()) for one in (own, worst)
    ]  # where theorem E[L] is the only one
    bounds = [rv.certificate(one).expected_time_bound for one in directed]
    assert bounds[0] == bounds[1] < math.inf
    assert rv.certificate(own).expected_time_bound >= rv.certificate(worst).expected_time_bound


def test_certificate_of_delays_is_that_of_the_robot_that_is_latest():
    late = [
        RING.replace(time_step=0.016, sensing=rv.Sensing(delay=steps))
        for steps in ([0, 1, 2, 0, 0, 2], 2)
    ]
    own, worst = map(rv.certificate, late)
    assert own.guaranteed and own.time_bound == worst.time_bound
    assert own.lyapunov_bound == worst.lyapunov_bound and "by up to 2 steps" in own.theorem
    played = rv.rollout(late[0], baselines.make("bearing-only", late[0]), seed=0, num_envs=8)
    assert played.success.all() and (played.rendezvous_time <= own.time_bound).all()


def test_mean_time_of_robots_that_detect_differently_is_that_of_the_worst():
    tables, times = [[[1.0, 0.5]]] * 5 + [[[1.0, 0.6]]], [0.01] * 5 + [0.02]
    own = rv.Sensing(detection=tables, persistence=times)
    worst = rv.Sensing(detection=[[1.0, 0.5]], persistence=0.02)
    cycle = RING.replace(graph=rv.graphs.directed_cycle())
    bounds = [
        rv.certificate(cycle.replace(sensing=one)).expected_time_bound for one in (own, worst)
    ]
    assert bounds[0] == bounds[1] < math.inf
    found = rv.certificate(RING.replace(sensing=rv.Sensing(bias=[0.1] + [0.0] * 5)))
    assert not found.guaranteed and "bias" in found.theorem


@pytest.mark.parametrize(
    ("field", "values"),
    [("range", [5.0, 9.0]), ("min_range", [0.0, 0.1]), ("field_of_view", [3.0, 6.0])],
)
def test_certificate_refuses_sensors_that_hide_neighbours(field, values):
    scenario = RING.replace(sensing=rv.Sensing(**{field: values + [values[0]] * 4}))
    for by in ("law", "links"):
        found = rv.certificate(scenario, by=by)
        assert not found.guaranteed and field in found.theorem


def test_certificate_of_errors_is_that_of_the_robot_that_errs_most():
    errors = {"error": [0.01, 0.0, 0.02, 0.01, 0.0, 0.02], "sectors": [None, None, 900, *[800] * 3]}
    own = RING.replace(graph="complete", sensing=rv.Sensing(**errors))
    worst = own.replace(sensing=rv.Sensing(error=0.02 + math.pi / 800))
    bounds = [rv.certificate(one) for one in (own, worst)]
    assert bounds[0].guaranteed and bounds[0].time_bound == bounds[1].time_bound < math.inf
    assert bounds[0].bearing_error == bounds[1].bearing_error == 0.02 + math.pi / 800


def test_certificate_of_robots_some_of_which_are_occluded_is_that_of_all_occluded():
    hidden = [
        RING.replace(graph="complete", sensing=rv.Sensing(occlusion=kinds))
        for kinds in (["robots", *["none"] * 5], "robots", [*["robots"] * 5, "both"])
    ]
    some, every, behind = map(rv.certificate, hidden)
    assert some.guaranteed and some.time_bound == every.time_bound < math.inf
    assert not behind.guaranteed and "occlusion = ('robots'," in behind.theorem
    assert "sensing.occlusion is ['robots', 'none'" in rv.certificate(hidden[0], by="links").theorem


def test_mean_time_needs_one_sample_period():
    periods = [0.1] * 5 + [0.2]
    for more in ({"dropout": 0.2}, {}):
        found = rv.certificate(RING.replace(sensing=rv.Sensing(sample_period=periods, **more)))
        assert not found.guaranteed and found.expected_time_bound == math.inf
        assert "sample_period" in found.theorem


def test_rows_of_each_robot_are_held_for_its_sample_period():
    tau, periods = 0.02, [0.0, 0.04, 0.08, 0.02, 0.4]
    still = PLANE.replace(time_step=tau, sensing=rv.Sensing(noise=0.1, sample_period=periods))
    found = seen(still, 1, 21)[:, 0]
    changes = (found[1:] != found[:-1]).any(axis=(2, 3))
    assert changes.sum(axis=0).tolist() == [20, 10, 5, 20, 1]


def test_sensors_of_each_robot_in_interfaces():
    sb3 = pytest.importorskip("rendezvous_env.adapters.sb3")
    scenario = PLANE.replace(sensing=mixed("measured"), on_merge="follow")
    settings = {"guarantee": None, "learning_preset": False, "flatten": False}
    robots = sb3.RobotVecEnv(rv.vector.training_env(scenario, 2, **settings))
    named, teams = rv.parallel_env(scenario), rv.make_vec(scenario, num_envs=2)
    sim = rv.Simulator(scenario, 2)
    robots.seed(7), robots.reset()
    named.reset(seed=7), teams.reset(seed=7), sim.reset(7)
    actions = np.random.default_rng(0).uniform(-0.3, 0.3, (4, 5, 2)).astype(np.float32)
    for one in actions:
        wanted = sim.step(np.stack([one, one])).observations
        rows = named.step(dict(zip(named.agents, one, strict=True)))[0]
        np.testing.assert_array_equal(np.stack([*rows.values()]), wanted[0])
        np.testing.assert_array_equal(teams.step(np.stack([one, one]))[0], wanted)
        slots = robots.step(np.concatenate([one, one]))[0]
        np.testing.assert_array_equal(slots, wanted.reshape(slots.shape))
