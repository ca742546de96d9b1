"""Scenario: derived quantities, sensor, TOML form; named scenarios."""

import dataclasses
import json
import math
import pickle

import gymnasium
import numpy as np
import pettingzoo
import pytest
from conftest import UNEQUAL

import rendezvous_env as rv
from rendezvous_env import Polygon, RewardWeights, Scenario, TimeStepWarning, graphs, scenarios
from rendezvous_env.first_initial_conditions import digest
from rendezvous_env.scenario.scenarios import digests, versioned
from train.compare.settings import DEFAULT_SCENARIOS

TRIANGLE = Polygon(((0.0, 0.0), (1.0, 0.0), (0.0, 1.0)))


def test_long_step_warns_with_certified_step():
    message = r"time_step is 0\.05 s, longer than the certified step 0\.025 s.*allow_long_step=True"
    with pytest.warns(TimeStepWarning, match=message) as caught:
        scenario = Scenario(time_step=0.05)
    assert caught[0].filename == __file__ and len(caught) == 1
    assert scenario.tau == 0.05 and scenario.certified_step == 0.025
    with pytest.warns(TimeStepWarning) as caught:
        Scenario().replace(time_step=0.05)
    assert caught[0].filename == __file__


@pytest.mark.parametrize(("step", "allowed"), [(0.025, False), (9.0, True)])
def test_other_steps_do_not_warn(step, allowed):
    assert Scenario(time_step=step, allow_long_step=allowed).tau == step


@pytest.mark.parametrize(
    ("limit", "tau", "steps"), [(1.0, 0.1, 10), (1.0, 0.3, 4), (0.3, 0.1, 3), (1e-6, 0.1, 1)]
)
def test_time_limit_is_rounded_up_to_steps(limit, tau, steps):
    scenario = Scenario(n_robots=2, time_limit=limit, time_step=tau, allow_long_step=True)
    assert scenario.max_steps == steps


class TestSpawnSize:
    def test_edges_bound_initial_positions(self):
        box = Scenario(n_robots=4, spawn_size=[2.0, 8.0])
        square = Scenario(n_robots=4, spawn_size=8.0)
        found = [rv.Simulator(scenario, 200) for scenario in (box, square)]
        for simulator in found:
            simulator.reset(0)
        extent = np.abs(found[0].positions).max(axis=(0, 1))
        assert (extent <= [1.0, 4.0]).all() and (extent > [0.95, 3.8]).all()
        assert box.spawn_edges == (2.0, 8.0) and square.spawn_edges == (8.0, 8.0)
        # the first robot of each team has the same random numbers
        scaled = found[1].positions[:, 0] * [0.25, 1.0]
        np.testing.assert_allclose(found[0].positions[:, 0], scaled)

    def test_equal_edges_are_one_number(self, tmp_path):
        assert Scenario(spawn_size=(3.0, 3.0)) == Scenario(spawn_size=3.0)
        box = Scenario(dim=3, spawn_size=np.array([1.0, 2.0, 2.0]), merge_radius=0.05)
        assert box.to_plain()["spawn_size"] == [1.0, 2.0, 2.0] and box.spawn_diagonal == 3.0
        box.to_toml(tmp_path / "box.toml")
        assert Scenario.from_toml(tmp_path / "box.toml").replace(name="custom") == box
        assert Scenario(spawn_size=3.0).spawn_diagonal == 3.0 * math.sqrt(2)

    @pytest.mark.parametrize(
        ("value", "message"),
        [
            ((1.0, 2.0, 3.0), r"spawn_size is \[1.0, 2.0, 3.0\]; it must be .* 2 numbers"),
            ((1.0, -2.0), r"spawn_size\[1\] is -2.0; it must be a positive"),
            ((1.0,), "spawn_size is .*; it must be a number, or one number for each dimension"),
        ],
    )
    def test_invalid_edges_are_named(self, value, message):
        with pytest.raises(ValueError, match=message):
            Scenario(spawn_size=value)


CONSTANTS = [
    # graph, n, D̄, a*
    ("complete", 2, 1.0, 1.0),
    ("complete", 5, 4.0, 1.0),
    ("path", 2, 1.0, 1.0),
    ("path", 7, 2.0, 1.0),
    ("cycle", 5, 2.0, 1.0),
    ("star", 5, 4.0, 1.0),
    (graphs.path((0.5, 2.0)), 6, 4.0, 0.5),
    (graphs.cycle(3.0), 6, 6.0, 3.0),
    (graphs.complete((0.5, 1.5)), 4, 4.5, 0.5),
    (graphs.random_tree((0.5, 2.0)), 6, 10.0, 0.5),
    (graphs.erdos_renyi(0.3, (0.5, 1.5)), 4, 4.5, 0.5),
    ([[0, 2, 0], [2, 0, 0.5], [0, 0.5, 0]], 3, 2.5, 0.5),  # a path: min(2·2, 2 + 0.5)
    (UNEQUAL, 5, 6.5, 0.9),  # W = 2 + .5 + 1.3 + .7 + 1.1 + .9 < 4·2; the tree 2, 1.3, 1.1, .9
]


@pytest.mark.parametrize(("graph", "n", "degree", "bottleneck"), CONSTANTS)
def test_derived_constants_match_hand_computation(graph, n, degree, bottleneck):
    scenario = Scenario(n_robots=n, graph=graph, merge_radius=0.3)
    assert scenario.max_degree == pytest.approx(degree, rel=1e-12)
    assert scenario.bottleneck_weight == pytest.approx(bottleneck, rel=1e-12)
    assert scenario.dead_zone == pytest.approx(bottleneck / (2 * n), rel=1e-12)
    assert scenario.certified_step == scenario.tau == pytest.approx(0.15 / degree, rel=1e-12)
    assert scenario.speed_limit == scenario.turn_limit == pytest.approx(degree, rel=1e-12)
    limited = scenario.replace(max_speed=0.4, max_turn_rate=0.7)
    assert (limited.speed_limit, limited.turn_limit) == (0.4, 0.7)


@pytest.mark.parametrize(
    ("model", "dim", "bounds"),
    [
        ("single_integrator", 2, [0.5, 0.5]),
        ("single_integrator", 3, [0.5, 0.5, 0.5]),
        ("unicycle", 2, [0.5, 0.7]),
        ("nonholonomic_3d", 3, [0.5, 7.0, 0.7]),
    ],
)
def test_action_bounds_match_model(model, dim, bounds):
    scenario = Scenario(robot_model=model, dim=dim, max_speed=0.5, max_turn_rate=0.7)
    np.testing.assert_allclose(scenario.action_bounds, bounds)
    assert scenario.action_size == len(bounds)


def test_equal_scenarios_are_equal_and_hashable():
    a = Scenario(graph=UNEQUAL, obstacles=[TRIANGLE], time_limit=10)
    b = Scenario(graph=UNEQUAL.tolist(), obstacles=(TRIANGLE,), time_limit=10.0)
    assert a == b and hash(a) == hash(b) and len({a, b}) == 1
    assert a.max_degree == 6.5 and a == b  # what is cached is no part of it
    assert pickle.loads(pickle.dumps(a)) == a
    others = [a.replace(name="other"), a.replace(time_limit=11.0), a.replace(graph="complete")]
    assert all(a != other for other in others) and len({a, *others}) == 4
    assert Scenario() == Scenario(graph="complete")


@pytest.mark.parametrize("name", scenarios.names())
def test_named_scenarios_round_trip_toml(name, tmp_path):
    scenario = scenarios.get(name)
    assert scenario.name == name
    scenario.to_toml(tmp_path / "scenario.toml")
    again = Scenario.from_toml(tmp_path / "scenario.toml")
    assert again == scenario and hash(again) == hash(scenario)
    assert list(tmp_path.iterdir()) == [tmp_path / "scenario.toml"]


def test_toml_matches_hand_written_file(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text("n_robots = 3\n")
    assert Scenario.from_toml(path).name == "mine"  # without a name it is that of its file
    path.write_text(
        """
        name = "three"
        n_robots = 3
        graph = {edges = [[0, 1, 2.0], [1, 2, 0.5]], n_nodes = 3}
        time_limit = 12
        [reward]
        time_penalty = 0
        [sensing]
        range = 4
        delay = 2
        """
    )
    expected = Scenario(
        name="three",
        n_robots=3,
        graph=[[0, 2.0, 0], [2.0, 0, 0.5], [0, 0.5, 0]],
        time_limit=12.0,
        reward=RewardWeights(time_penalty=0.0),
        sensing=rv.Sensing(range=4.0, delay=2),
    )
    assert Scenario.from_toml(path) == expected and "sensing" not in Scenario().to_plain()
    assert scenarios.resolve(path) == expected
    assert scenarios.resolve(str(path), n_robots=3).max_degree == 2.5


WRONG = {
    "range": (0.0, -1.0, math.nan, math.inf, "far", True, 1e12),
    "field_of_view": (0.0, -1.0, 6.3, math.nan, math.inf, None, "wide"),
    "noise": (-0.1, math.nan, math.inf, 7.0, None, "much", False),
    "bias": (-1e-9, math.nan, math.inf, 7.0),
    "error": (-0.1, 3.2, math.nan, math.inf, "left"),
    "dropout": (-0.1, 1.1, math.nan, math.inf, None),
    "delay": (-1, 1.5, 10_001, math.nan, None, True, 10**400),
    "sectors": (1, 0, -4, 2.5, 10**7, math.inf, "many"),
    "occlusion": ("all", "", None, True, {"both"}),
}
UNLIKE = {
    "range": 3.0, "field_of_view": 2.0, "noise": 0.1, "bias": 0.2, "error": 0.3,
    "dropout": 0.25, "delay": 4, "sectors": 12, "occlusion": "both",
}  # fmt: skip


def test_fields_and_defaults_are_stable():
    fields = {field.name: field.default for field in dataclasses.fields(rv.Sensing)}
    assert fields == {
        "range": None, "field_of_view": 2 * math.pi, "noise": 0.0, "bias": 0.0, "error": 0.0,
        "dropout": 0.0, "delay": 0, "sectors": None, "occlusion": "none", "custom": (),
        "min_range": 0.0, "sample_period": 0.0, "delay_time": 0.0, "observer_bias": 0.0,
        "noise_correlation": 0.0,
        "detection": (), "view_falloff": 0.0, "persistence": 0.0, "outliers": 0.0,
        "outlier_kind": "uniform",
    }  # fmt: skip
    assert rv.Sensing().exact and rv.Scenario().sensing == rv.Sensing()


def test_camera_is_a_sensing_preset():
    """Its parameters are those of docs/worlds.md, and hidden robots have no row."""
    camera = rv.Sensing.camera()
    assert camera.occlusion == "both" and not camera.exact
    assert math.degrees(camera.noise) == pytest.approx(0.43, abs=0.01)
    assert rv.Sensing(**camera.to_plain()) == camera == rv.Sensing.camera()
    discs = (rv.Disc((0.0, 0.0), 0.5), rv.Capsule(((90.0, 0.0), (91.0, 0.0)), 0.5))
    places = ((-2.0, 0.0), (2.0, 0.0), (0.0, 3.0))
    scenario = rv.Scenario(n_robots=3, start_positions=places, obstacles=discs, sensing=camera)
    seen = rv.Simulator(scenario, 100).reset(0)
    shares = scenario.observation_layout.split(seen).neighbours.any(-1).mean(0).sum(-1)
    assert shares[:2] == pytest.approx(1.0, abs=0.1) and shares[2] == pytest.approx(2.0, abs=0.2)
    assert not rv.certificate(scenario).guaranteed


@pytest.mark.slow
def test_mrclam_preset_loses_robots_in_the_blind_zone_and_outside_its_view():
    """Two robots face each other at each distance, and one faces away."""
    sensing = rv.Sensing.mrclam()
    assert rv.Sensing(**sensing.to_plain()) == sensing
    seen = {}
    for distance in (0.7, 1.75, 4.5):
        scenario = rv.Scenario(
            n_robots=3, start_positions=((0.0, 0.0), (distance, 0.0), (0.0, 9.0)),
            local_frames="global", sensing=sensing, time_step=0.1, merge_radius=0.35,
            allow_long_step=True,
        )  # fmt: skip
        rows = scenario.observation_layout.split(rv.Simulator(scenario, 2000).reset(0)).neighbours
        seen[distance] = rows.any(-1).mean(axis=0)
        assert not seen[distance][2].any()  # the others are behind or beside it
    assert not seen[0.7][:2].any()
    assert seen[1.75][0, 0] == pytest.approx(0.55, abs=0.05)
    assert seen[4.5][0, 0] == pytest.approx(0.21, abs=0.05)


def test_wifi_preset_has_outliers_without_line_of_sight():
    clear, blocked = rv.Sensing.wifi(), rv.Sensing.wifi(line_of_sight=False)
    assert clear.outliers == 0.0 and 0.13 <= blocked.outliers <= 0.23
    assert 0.10 <= clear.noise <= 0.15 and 0.12 <= blocked.noise <= 0.27


@pytest.mark.parametrize("field", UNLIKE)
def test_each_sensing_field_round_trips(field, tmp_path):
    one = rv.Sensing(**{field: UNLIKE[field]})
    assert not one.exact and one != rv.Sensing()
    again = rv.Sensing(**{field: UNLIKE[field]})
    assert one == again and hash(one) == hash(again)
    assert one.departures() == f"{field} = {UNLIKE[field]}"
    scenario = rv.Scenario(name="erring", sensing=one)
    assert scenario != rv.Scenario(name="erring")
    scenario.to_toml(tmp_path / "erring.toml")
    assert rv.Scenario.from_toml(tmp_path / "erring.toml") == scenario
    assert "[sensing]" in (tmp_path / "erring.toml").read_text(encoding="utf-8")
    assert rv.Scenario.from_plain(json.loads(json.dumps(scenario.to_plain()))) == scenario
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(one, field, UNLIKE[field])


@pytest.mark.parametrize(("field", "value"), [(f, v) for f, vs in WRONG.items() for v in vs])
def test_invalid_value_is_named(field, value):
    with pytest.raises(ValueError, match=rf"^sensing\.{field} is .*; it must be ") as refused:
        rv.Sensing(**{field: value})
    shown = "integer of about" if value == 10**400 else repr(value)
    assert shown in str(refused.value)


FIELD = (
    "noisy-8", "fov-8", "occluded-8", "range-12", "switching-8", "pursuit-6", "rssdoa-15",
    "huettenrauch-20", "huettenrauch-20-sight-40", "robotarium-4", "robotarium-10", "robotarium-20",
    "utias-5", "utias-10", "utias-5-clutter", "utias-5-pack", "camera-8",
)  # fmt: skip
QUICK = ("clutter-8", "clutter-16")


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[] if name in QUICK else [pytest.mark.slow])
        for name in scenarios.names()
    ],
)
def test_scenario_matches_its_version(name):
    kept = versioned(name).removeprefix("rendezvous/")
    found = digest(name)
    assert found == digests()[kept], (
        f"the field {name} or its first 1,000 starts have changed, so results on it do not compare "
        f"with those of {kept} any more: raise its version in scenario/digests.json; its digest is "
        f"{found}. If nothing was meant to change, find out what did."
    )


def test_every_scenario_has_one_version():
    assert [entry.rpartition("-v")[0] for entry in digests()] == scenarios.names()
    assert len(set(digests().values())) == len(digests())
    assert all(json.dumps(entry).isascii() for entry in digests())


def test_digest_covers_physics_not_learning_settings():
    base = rv.scenarios.get("duo")
    same = base.replace(name="other", costs="contact", reward=rv.RewardWeights(progress=2.0))
    assert digest(same) == digest(base) == digests()["duo-v1"]
    others = [base.replace(merge_radius=0.21), base.replace(spawn_size=9.0)]
    assert len({digest(base), *map(digest, others)}) == 3


@pytest.mark.parametrize(
    "name", ["clutter-16-v1", "rendezvous/clutter-16-v1", "rendezvous/clutter-16"]
)
def test_versioned_name_is_accepted(name):
    assert scenarios.get(name) == scenarios.get("clutter-16")
    env, plain = rv.make_vec(name, 2), rv.make_vec("clutter-16", 2)
    np.testing.assert_array_equal(env.reset(seed=5)[0], plain.reset(seed=5)[0])


def test_other_versions_and_names_are_rejected():
    for call, name, said in (
        (scenarios.get, "clutter-16-v2", "is of another version; .* rendezvous/clutter-16-v1"),
        (scenarios.get, "rendezvous/cluter-16-v1", "is unknown; did you mean 'clutter-16"),
        (scenarios.get, "bluster-v1", "is unknown"),
        (versioned, "nothing", "it must be one of"),
    ):
        with pytest.raises(ValueError, match=f"'{name}'.* {said}"):
            call(name)


def test_gymnasium_and_pettingzoo_register_every_scenario():
    for name in scenarios.names():
        assert versioned(name) in gymnasium.registry
    one = gymnasium.make("rendezvous_env:rendezvous/clutter-8-v1", obstacle_range=1.5)
    assert one.unwrapped.scenario == scenarios.get("clutter-8").replace(obstacle_range=1.5)
    many = gymnasium.make_vec("rendezvous_env:rendezvous/clutter-8-v1", num_envs=3)
    assert many.unwrapped.scenario.name == "clutter-8" and many.num_envs == 3
    if hasattr(pettingzoo, "make"):
        named = pettingzoo.make("parallel", "rendezvous/clutter-8-v1")
        assert named.unwrapped.scenario == scenarios.get("clutter-8")


def test_compare_takes_other_scenarios_on_request():
    assert set(FIELD) <= set(scenarios.names()) and not set(FIELD) & set(DEFAULT_SCENARIOS)
