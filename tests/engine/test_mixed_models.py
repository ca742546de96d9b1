"""Teams of several robot models: motion, observations, actions of unequal width, interfaces."""

import math
from typing import NamedTuple

import gymnasium
import numpy as np
import pytest
from conftest import assert_same_state
from parameters import marked, slow

import rendezvous_env as rv
from rendezvous_env import baselines, rendezvous_v0

PLANE = ["single_integrator", "double_integrator", "unicycle", "double_integrator"]
SPACE = ["nonholonomic_3d", "single_integrator", "double_integrator", "nonholonomic_3d"]
STILL = ["double_integrator", "single_integrator", "single_integrator", "double_integrator"]
LONG_STEP = {"time_step": 0.02, "allow_long_step": True}
START = np.array([[-2.0, 0.0, 0.0], [0.5, -1.0, 0.5], [2.0, 1.0, 0.0], [-1.0, 2.0, 1.0]])
CLUTTER = {2: (rv.Disc((0.5, 0.3), 0.4),), 3: (rv.Sphere((0.5, 0.3, 0.0), 0.4),)}
LIMITS = {
    "max_speed": [0.5, 1.0, 2.0, 1.5],
    "max_turn_rate": [1.0, 2.0, 0.5, 3.0],
    "max_acceleration": [0.5, 4.0, 1.0, 2.0],
}


class Rail(NamedTuple):
    """A robot that moves along the x axis of its frame only: one action component."""

    duration: float
    speed_limit: float


@rv.kernel
def _along_rail(model, action, frame, memory):
    speed = min(max(action[0], -model.speed_limit), model.speed_limit)
    way = speed * model.duration
    return (way * frame[0], way * frame[2]), abs(way)


rv.describe_motion(Rail, rv.Motion(_along_rail))
rv.register_robot_model(
    rv.RobotModel(
        "rail",
        dims=(2,),
        constants=lambda scenario: Rail(scenario.tau, scenario.speed_limit),
        bounds=lambda scenario: [scenario.speed_limit],
        action="speed, m/s",
    )
)
RAILS = ["rail", "single_integrator", "unicycle", "rail"]
CASES = {"plane": (PLANE, 2), "space": (SPACE, 3), "still": (STILL, 3), "rails": (RAILS, 2)}
EVERY = pytest.mark.parametrize("case", CASES)
IN_PLANE = pytest.mark.parametrize(
    "case", marked(CASES, slow=["space", "rails"], own_path=["still"])
)
"""In fast tests the plane alone."""


def team(case: str, **fields) -> rv.Scenario:
    names, dim = CASES[case]
    given = {"obstacles": CLUTTER[dim], "start_positions": START[:, :dim], **LIMITS}
    return rv.Scenario(n_robots=4, dim=dim, robot_model=names, **{**given, **fields})


def played(scenario: rv.Scenario, batch: int, steps: int = 30) -> list[dict]:
    """States and observations of environment 0 under random actions that exceed every limit."""
    sim = rv.Simulator(scenario, batch)
    sim.reset(3)
    random, found = np.random.default_rng(0), []
    for _ in range(steps):
        one = random.uniform(-6.0, 6.0, (4, 5))[:, : scenario.action_size]
        sim.step(np.repeat(one[None], batch, axis=0))
        state = {name: array[:1].copy() for name, array in sim.get_state().items()}
        found.append(state | {"rows": sim.observe()[:1].copy(), "frames": sim.frames[:1]})
    return found


@IN_PLANE
def test_mixed_models_each_robot_moves_as_in_a_team_of_its_model(case):
    scenario = team(case, local_frames="global", merge_radius=0.05, **LONG_STEP)
    mixed, places = played(scenario, 1), scenario.start_positions
    for robot in range(4):
        pure = scenario.of_robot(robot).replace(start_positions=places)
        own = played(pure, 1)
        for one, other in zip(mixed, own, strict=True):
            assert (one["merged_into"] == np.arange(4)).all()
            np.testing.assert_array_equal(one["positions"][:, robot], other["positions"][:, robot])
            np.testing.assert_array_equal(one["frames"][:, robot], other["frames"][:, robot])
            sensed = other["rows"][
                :, robot, 3 + 2 * (scenario.dim == 2) + 8 * (scenario.dim == 3) :
            ]
            if sensed.size:
                np.testing.assert_array_equal(one["rows"][:, robot, -1], sensed[:, 0])
    assert np.ptp([one["positions"] for one in mixed], axis=0).max(axis=-1).min() > 0.0


@pytest.mark.slow
@IN_PLANE
def test_mixed_models_batch_equals_singles(case):
    for one, other in zip(played(team(case), 1), played(team(case), 40), strict=True):
        for name in one:
            np.testing.assert_array_equal(one[name], other[name])


@pytest.mark.parametrize("case", ["plane", slow("space")])
def test_mixed_models_frames_of_all_robots_are_drawn(case):
    sim = rv.Simulator(team(case, obstacles=(), start_positions=None), 300)
    sim.reset(0)
    axes = sim.frames[..., :, 0]
    spread = 4.0 / math.sqrt(300.0)
    points = [i for i, name in enumerate(CASES[case][0]) if name.endswith("integrator")]
    assert np.abs(axes[:, points].mean(axis=0)).max() < spread
    squares = np.einsum("bni,bnj->nij", axes[:, points], axes[:, points]) / 300.0
    assert np.abs(squares - np.eye(sim.scenario.dim) / sim.scenario.dim).max() < spread


@pytest.mark.slow
def test_mixed_models_last_row_is_that_of_each_model():
    scenario = team("space", obstacles=())
    layout = scenario.observation_layout
    assert layout.rows == 4 and layout.gravity == layout.velocity == slice(3, 4)
    sim = rv.Simulator(scenario, 3)
    sim.reset(0)
    for _ in range(5):
        sim.step(np.ones((3, 4, 3)))
    seen = layout.split(sim.observe())
    pitch = sim.headings[..., 1]
    gravity = np.stack([-np.sin(pitch), 0.0 * pitch, -np.cos(pitch)], axis=-1)
    velocity = np.einsum("bnji,bnj->bni", sim.frames, sim.velocities)
    np.testing.assert_allclose(seen.gravity[:, [0, 3]], gravity[:, [0, 3]], atol=1e-6)
    np.testing.assert_allclose(seen.velocity[:, 2], velocity[:, 2], atol=1e-6)
    assert not seen.gravity[:, 1].any() and velocity[:, 2].any()
    box = rv.parallel_env(scenario).observation_space("robot_0")
    assert box.contains(sim.observe()[0, 0])


@pytest.mark.slow
def test_mixed_models_pad_actions_to_the_widest():
    scenario = team("rails", obstacles=())
    mask = [[True, False], [True, True], [True, True], [True, False]]
    assert scenario.pads_actions and (scenario.action_mask == mask).all()
    assert scenario.action_size == 2 and (scenario.robot_bounds[0] == [0.5, 0.0]).all()
    assert not team("plane").pads_actions and team("plane").action_mask.all()
    assert rv.Scenario(n_robots=3).action_mask.shape == (3, 2)
    one, other = rv.Simulator(scenario, 2), rv.Simulator(scenario, 2)
    one.reset(0), other.reset(0)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (2, 4, 2))
    one.step(actions), other.step(np.where(scenario.action_mask, actions, 7.0))
    assert_same_state(one, other)


@pytest.mark.slow
def test_mixed_models_agents_have_spaces_of_their_own():
    scenario = team("rails", obstacles=())
    env, aec = rv.parallel_env(scenario), rendezvous_v0.env(scenario)
    shapes = [env.action_space(name).shape for name in env.possible_agents]
    assert shapes == [(1,), (2,), (2,), (1,)]
    vector = rv.make_vec(scenario, num_envs=2)
    env.reset(seed=5), aec.reset(seed=5), vector.reset(seed=[5, 6])
    random = np.random.default_rng(0)
    for _ in range(10):
        padded = random.uniform(-1.0, 1.0, (4, 2)).astype(np.float32)
        own = {
            name: padded[robot, scenario.action_mask[robot]]
            for robot, name in enumerate(env.possible_agents)
        }
        rows = env.step(own)[0]
        for name in env.possible_agents:
            assert aec.agent_selection == name
            aec.step(own[name])
        seen = vector.step(np.stack([padded, padded]))[0]
    for robot, name in enumerate(env.possible_agents):
        np.testing.assert_array_equal(rows[name], seen[0, robot])
        np.testing.assert_array_equal(aec.observe(name), seen[0, robot])
    with pytest.raises(ValueError, match=r"action of robot_0 is .* 1 finite numbers"):
        env.step({name: np.zeros(2, np.float32) for name in env.agents})
    with pytest.raises(KeyError, match="robot_3 is alive but has no action"):
        env.step({name: own[name] for name in env.agents[:3]})


@IN_PLANE
def test_mixed_models_in_gymnasium_and_vector_environments(case):
    scenario = team(case, obstacles=())
    one = gymnasium.make("rendezvous/Rendezvous-v0", scenario=scenario)
    many = rv.make_vec(scenario, num_envs=3)
    one.reset(seed=2), many.reset(seed=[2, 3, 4])
    one.action_space.seed(0)
    for _ in range(5):
        action = one.action_space.sample()
        seen = one.step(action)[0], many.step(np.stack([action] * 3))[0]
    np.testing.assert_array_equal(seen[0], seen[1][0])


@IN_PLANE
def test_mixed_models_in_training_environments_by_name(case):
    scenario = team(case, obstacles=(), on_merge="follow")
    settings = {"guarantee": None, "learning_preset": False, "flatten": False}
    named = rv.training_env(scenario, **settings)
    teams = rv.vector.training_env(scenario, 1, **settings)
    named.reset(seed=4), teams.reset(seed=4)
    padded = np.random.default_rng(0).uniform(-0.4, 0.4, (4, scenario.action_size))
    for _ in range(3):
        own = {
            name: padded[robot, scenario.action_mask[robot]]
            for robot, name in enumerate(named.possible_agents)
        }
        rows, seen = named.step(own)[0], teams.step(padded[None])[0]
    np.testing.assert_array_equal(np.stack([*rows.values()]), seen[0])


@pytest.mark.slow
@pytest.mark.parametrize("case", marked(["rails", "space"], slow=["rails"]))
def test_mixed_models_in_stable_baselines3(case):
    sb3 = pytest.importorskip("rendezvous_env.adapters.sb3")
    scenario = team(case, obstacles=(), on_merge="follow")
    settings = {"guarantee": None, "learning_preset": False, "flatten": False}
    robots = sb3.RobotVecEnv(rv.vector.training_env(scenario, 2, **settings))
    assert robots.action_space.shape == (scenario.action_size,)
    assert (robots.action_mask == np.tile(scenario.action_mask, (2, 1))).all()
    sim = rv.Simulator(scenario, 2)
    robots.seed(3)
    first = robots.reset()
    sim.reset(3)
    np.testing.assert_array_equal(first, sim.observe().reshape(first.shape))
    random = np.random.default_rng(0)
    for _ in range(5):
        actions = random.uniform(-0.4, 0.4, (8, scenario.action_size)).astype(np.float32)
        seen = robots.step(actions)[0]
        sim.step(actions.reshape(2, 4, -1))
    np.testing.assert_array_equal(seen, sim.observe().reshape(seen.shape))


@pytest.mark.parametrize("case", ["plane", slow("space"), slow("still")])
def test_mixed_models_meet_under_the_law_of_each_robot(case):
    scenario = team(
        case, obstacles=(), start_positions=None, spawn_size=3.0, time_limit=60.0,
        max_speed=None, max_turn_rate=None, max_acceleration=None,
    )  # fmt: skip
    law = baselines.make("by-model", scenario)
    assert rv.rollout(scenario, law, num_envs=20).success.mean() > 0.9


@IN_PLANE
def test_mixed_models_state_and_files_are_complete(case, tmp_path):
    scenario = team(case)
    scenario.to_toml(tmp_path / "own.toml")
    assert rv.Scenario.from_toml(tmp_path / "own.toml").replace(name="custom") == scenario
    one, other = rv.Simulator(scenario, 2), rv.Simulator(scenario, 2)
    one.reset(0), other.reset(9)
    actions = np.full((2, 4, scenario.action_size), 0.3)
    one.step(actions)
    other.set_state(one.get_state())
    one.step(actions), other.step(actions)
    assert_same_state(one, other)


@pytest.mark.slow
@pytest.mark.kernels
def test_mixed_models_clocks_of_an_adversary_follow_each_model():
    scenario = team("plane", activation=rv.Activation(kind="bounded", max_wait=3))
    for one, other in zip(played(scenario, 1), played(scenario, 5), strict=True):
        np.testing.assert_array_equal(one["positions"], other["positions"])


@pytest.mark.parametrize(
    ("names", "dim", "message"),
    [
        (
            ["single_integrator", "double_integrator", "unicycle", "rail"],
            2,
            "robot_model is .* it must be a list of at most 3 different models",
        ),
        (
            ["single_integrator", "rail", "rail", "rail"],
            3,
            r"robot_model\[1\] is 'rail'; it must be a model for dim 3; rail is for 2",
        ),
        (["single_integrator", "rail"], 2, "robot_model is .*4 entries, one for each robot"),
    ],
)
def test_mixed_models_are_refused_by_field_value_and_remedy(names, dim, message):
    with pytest.raises(ValueError, match=message):
        rv.Scenario(n_robots=4, dim=dim, robot_model=names)


@EVERY
def test_mixed_models_with_inertia_or_rails_have_no_certificate_and_no_filter(case):
    scenario = team(case, obstacles=())
    found = rv.certificate(scenario)
    name = "rail" if case == "rails" else "double_integrator"
    assert not found.guaranteed and f"no theorem covers {name} robots" in found.theorem
    with pytest.raises(ValueError, match=rf"scenario has {name} robots \(robot "):
        rv.vector.HeadingVectorWrapper(rv.make_vec(scenario, num_envs=2))
    with pytest.raises(ValueError, match=r"events.disturbance is 0.1; .* robot_model=\('"):
        scenario.replace(events=rv.Events(disturbance=0.1))


@pytest.mark.parametrize("given", ["scenario", "options"])
def test_global_frames_of_single_integrators_ignore_headings(given):
    models = ["unicycle", "single_integrator", "single_integrator"]
    headings = [[0.5], [1.0], [-2.0]]
    scenario = rv.Scenario(n_robots=3, robot_model=models, local_frames="global")
    options = {"headings": headings} if given == "options" else None
    if given == "scenario":
        scenario = scenario.replace(start_headings=headings)
    sim = rv.Simulator(scenario, 2)
    sim.reset(0, options)
    np.testing.assert_array_equal(sim.frames[:, 1:], np.broadcast_to(np.eye(2), (2, 2, 2, 2)))
    np.testing.assert_allclose(sim.frames[:, 0, :, 0], [[math.cos(0.5), math.sin(0.5)]] * 2)
    before, velocity = sim.positions, np.tile(np.float32([0.25, 0.125]), (2, 3, 1))
    sim.step(velocity)
    moved = (sim.positions - before)[:, 1:] / scenario.tau
    np.testing.assert_allclose(moved, velocity[:, 1:], atol=1e-12)
    turned = rv.Simulator(scenario.replace(local_frames="random", start_headings=headings), 1)
    turned.reset(0)
    np.testing.assert_allclose(turned.frames[0, 1, :, 0], [math.cos(1.0), math.sin(1.0)])


def test_frames_of_single_integrators_stay_beside_unicycles():
    scenario = rv.Scenario(n_robots=3, robot_model=["unicycle", *["single_integrator"] * 2])
    sim = rv.Simulator(scenario.replace(spawn_size=40.0), 40)
    sim.reset(0)
    before = sim.frames
    for _ in range(3):
        sim.step(np.full((40, 3, 2), 0.5, np.float32))
    np.testing.assert_array_equal(sim.frames[:, 1:], before[:, 1:])
    assert (sim.frames[:, 0] != before[:, 0]).any(axis=(1, 2)).all()
