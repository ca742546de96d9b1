"""Networks without a filter: memory of a search, commands, training environment, training."""

import cmath
import math
from dataclasses import replace

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from parameters import slow
from robot_actions import single_and_batch
from training_runs import assert_goes_on

import baselines
import rendezvous_env as rv
from baselines.learned import feature_kernels
from baselines.learned.base_controller import make_controller
from baselines.learned.feature_kernels import CONTEXT_COLUMNS
from baselines.learned.learned_policy import LearnedPolicy
from baselines.learned.policy_settings import COMMANDS, PolicySettings
from baselines.learned.training_environment import FeatureVectorEnv, shares_of
from baselines.search import memory_kernels
from baselines.search.memory_kernels import COLUMNS, HARMONICS, PERIODS, SCALES
from train.checks import UserError
from train.learn import ppo

TEAM = rv.Scenario(
    n_robots=2, robot_model="unicycle", max_speed=0.1, max_turn_rate=0.5, merge_radius=0.4,
    time_step=0.1, allow_long_step=True,
)  # fmt: skip
AMONG = TEAM.replace(obstacles=(rv.Disc((9.0, 9.0), 1.0),))
UNIT = 4.0  # r/v_max, s
SETTINGS = PolicySettings(8, (16,), 0.2, 0.5, 0.05, 100.0, 0.25, guarantee="none")
SMALL = {"scenario": "utias-5", "set": ("time_limit=40.0", "spawn_size=3.0"), "guarantee": "none"}


def unit(*angles):
    return np.stack([np.cos(angles), np.sin(angles)], axis=-1)


def observed(scenario, neighbour=None, edges=None):
    """Observations (1, 2, rows, 2) in which robot 0 sees this bearing and these edges, rad."""
    layout = scenario.observation_layout
    seen = np.zeros((1, 2, *layout.shape), np.float32)
    if neighbour is not None:
        seen[0, 0, 0] = unit(neighbour)
    if edges is not None:
        seen[0, 0, layout.obstacles] = unit(*edges)
    return seen


def step(teams, seen, speed, rate):
    """One step of robot 0 with a speed and a turn rate in units of their limits."""
    teams.head(np.array([[[speed, rate], [0.0, 0.0]]]))
    return teams.apply(seen)


def features(teams, seen):
    """Parts of the features of robot 0."""
    layout = teams.perception.layout
    return layout.split(teams.show(np.zeros((1, 2, layout.size), np.float32), seen)[0, 0])


def weights(settings, layout, scale=0.5):
    """Random weights of an actor."""
    rng, width = np.random.default_rng(1), settings.set_width
    sizes = {
        "features_extractor.neighbour_net.0": (width, 3),
        "features_extractor.neighbour_net.2": (width, width),
        "features_extractor.obstacle_net.0": (width, 6),
        "features_extractor.obstacle_net.2": (width, width),
        "mlp_extractor.policy_net.0": (settings.hidden[0], 4 * width + layout.context_columns),
        "action_net": (settings.choices, settings.hidden[0]),
    }
    made = {f"{name}.weight": rng.normal(0.0, scale, shape) for name, shape in sizes.items()}
    return made | {f"{name}.bias": np.zeros(shape[0]) for name, shape in sizes.items()}


@pytest.mark.kernels
def test_memory_matches_sums_over_history():
    """Averages and places, recomputed from all rows and commands in a fixed frame."""
    rng, tau = np.random.default_rng(0), TEAM.tau
    teams, history, pose, visited = make_controller(SETTINGS, TEAM, 1), [], (0j, 0.0), [0j]
    for _ in range(60):
        bearing = rng.uniform(-0.5, 0.5) if rng.random() < 0.3 else None
        speed, rate = rng.uniform(-1.0, 1.0, 2)
        sent = step(teams, observed(TEAM, bearing), speed, rate)
        np.testing.assert_allclose(sent[0, 0], [0.1 * speed, 0.5 * rate], rtol=1e-6)
        place, yaw = pose
        history.append((bearing, yaw, 0.1 * speed, 0.5 * rate))
        turned = 0.5 * rate * tau
        chord = 2.0 * 0.1 * speed / (0.5 * rate) * math.sin(turned / 2)
        pose = place + chord * cmath.exp(1j * (yaw + turned / 2)), yaw + turned
        visited.append(pose[0])
    place, yaw = pose
    memory = teams.perception.get_state()
    last = max(k for k, (bearing, *_) in enumerate(history) if bearing is not None)
    for j, scale in enumerate(SCALES):
        kept = math.exp(-tau / UNIT / scale)
        ages = [kept ** (len(history) - k) * (1.0 - kept) for k in range(len(history))]
        seen = [(w, b + a - yaw) for w, (b, a, *_) in zip(ages, history, strict=True) if b]
        assert memory["counts"][0, 0, j] == pytest.approx(sum(w for w, _ in seen))
        for k in range(1, HARMONICS + 1):
            axes = [(w, a - yaw) for w, (_, a, *_) in zip(ages, history, strict=True)]
            looked = sum(w * cmath.exp(1j * k * angle) for w, angle in axes)
            found = sum(w * cmath.exp(1j * k * angle) for w, angle in seen)
            for name, expected in (("seen", found), ("looked", looked)):
                kept_here = memory[name][0, 0, j, k - 1]
                np.testing.assert_allclose(kept_here, [expected.real, expected.imag], atol=1e-12)
        inputs = [sum(w * h[n] / kept for w, h in zip(ages, history, strict=True)) for n in (2, 3)]
        np.testing.assert_allclose(memory["inputs"][0, 0, j], np.array(inputs) / [0.1, 0.5])
    for name, point in (("start", 0j), ("place", visited[last])):
        offset = (point - place) * cmath.exp(-1j * yaw) / 0.4
        np.testing.assert_allclose(memory[name][0, 0], [offset.real, offset.imag], atol=1e-12)
    bearing, at = history[last][:2]
    np.testing.assert_allclose(memory["last"][0, 0], unit(bearing + at - yaw)[0], atol=1e-6)
    assert memory["unseen"][0, 0] == pytest.approx((len(history) - last) * tau / UNIT)
    assert memory["turned"][0, 0] == pytest.approx(yaw - at)


@pytest.mark.kernels
def test_features_are_of_rows_now_and_of_memory():
    teams = make_controller(SETTINGS, TEAM, 1)
    assert teams.perception.layout.context_columns == COLUMNS > CONTEXT_COLUMNS
    for name in ("NEIGHBOUR_COLUMNS", "OBSTACLE_COLUMNS"):
        assert getattr(memory_kernels, name) == getattr(feature_kernels, name)
    before = features(teams, observed(TEAM))
    assert before.context[0] == 1.0 and not before.neighbours.any()
    parts = features(teams, observed(TEAM, 0.3))
    np.testing.assert_allclose(parts.neighbours[0], [math.cos(0.3), math.sin(0.3), 1.0], rtol=1e-6)
    np.testing.assert_allclose(parts.context[-21:-19], unit(0.3)[0], rtol=1e-6)
    step(teams, observed(TEAM, 0.3), 0.0, 1.0)
    parts = features(teams, observed(TEAM))
    np.testing.assert_allclose(parts.context[-21:-19], unit(0.25)[0], rtol=1e-5)
    np.testing.assert_allclose(parts.context[-6:-4], [0.0, 1.0])
    clock = unit(*(2.0 * np.pi * 0.1 / UNIT / period for period in PERIODS))[:, ::-1]
    np.testing.assert_allclose(parts.context[-4:], clock.ravel(), rtol=1e-6)
    assert np.abs(parts.context).max() <= 1.5 and not parts.neighbours.any()


@pytest.mark.kernels
def test_obstacles_are_remembered_for_a_merge_radius():
    teams = make_controller(SETTINGS, AMONG, 1)
    shown = features(teams, observed(AMONG, edges=(0.4, -0.2))).obstacles
    np.testing.assert_allclose(shown[0], [*unit(0.4, -0.2).ravel(), 0.0, 1.0], atol=1e-7)
    step(teams, observed(AMONG, edges=(0.4, -0.2)), 1.0, 1.0)
    shown = features(teams, observed(AMONG)).obstacles
    np.testing.assert_allclose(shown[0], [*unit(0.35, -0.25).ravel(), 0.025, 0.0], atol=1e-6)
    for _ in range(38):
        step(teams, observed(AMONG), -1.0, 0.0)
    assert features(teams, observed(AMONG)).obstacles.any()
    step(teams, observed(AMONG), -1.0, 0.0)
    assert not features(teams, observed(AMONG)).obstacles.any()


def test_forgetting_clears_one_environment():
    teams = make_controller(SETTINGS, TEAM, 2)
    seen = np.tile(observed(TEAM, 0.3), (2, 1, 1, 1))
    teams.choose(np.full((2, 2), 5))
    teams.apply(seen)
    teams.forget(np.array([True, False]))
    for part in (teams.perception, teams.steering):
        assert not any(array[0, 0].any() for array in part.get_state().values() if array.ndim < 4)
    assert teams.perception.get_state()["last"][1].any()


@pytest.mark.parametrize(
    ("method", "given", "message"),
    [
        (
            "choose",
            [[0, 17]],
            r"action of robot_1 in environment 0 is 17; it must be an .* below 17",
        ),
        ("head", [[[0.0, 0.0], [math.nan, 0.0]]], r"action of robot_1 in environment 0 is \[nan"),
    ],
)
def test_invalid_action_is_named(method, given, message):
    with pytest.raises(ValueError, match=message):
        getattr(make_controller(SETTINGS, TEAM, 1), method)(np.array(given))


def test_commands_are_in_units_of_limits():
    teams = make_controller(SETTINGS, TEAM, 1)
    for number, (speed, rate) in enumerate(COMMANDS):
        teams.choose(np.array([[number, 0]]))
        np.testing.assert_allclose(teams.apply(observed(TEAM))[0, 0], [0.1 * speed, 0.5 * rate])
    teams.head(np.array([[[3.0, -3.0], [0.0, 0.0]]]))
    np.testing.assert_allclose(teams.apply(observed(TEAM))[0, 0], [0.1, -0.5])


def test_decision_time_scales_with_robots():
    assert SETTINGS.decision_period(TEAM) == round(0.25 * UNIT / 0.1)
    assert SETTINGS.decision_period(TEAM.replace(max_speed=0.2)) == round(0.125 * UNIT / 0.1)


@pytest.mark.parametrize("name", ["utias-5", "utias-5-clutter"])
def test_single_robot_acts_as_one_of_a_batch(name):
    scenario = rv.scenarios.get(name)
    drawn = weights(SETTINGS, SETTINGS.layout_of(scenario))
    policy = LearnedPolicy(scenario, drawn, SETTINGS)
    robot = baselines.RobotPolicy(scenario, LearnedPolicy(scenario, drawn, SETTINGS))
    commands = set()
    for alone, together in single_and_batch(policy, robot):
        np.testing.assert_allclose(alone, together, atol=1e-6)
        commands.add(tuple(together.tolist()))
    assert len(commands) > 2 and policy.guarantee is None


@pytest.mark.kernels
def test_ticks_at_another_rate_move_memory_by_elapsed_time():
    drawn = weights(SETTINGS, SETTINGS.layout_of(TEAM))
    drawn["action_net.bias"][COMMANDS.index((0.0, 1.0))] = 1e3  # turns at 0.5 rad/s
    robot = baselines.RobotPolicy(TEAM, LearnedPolicy(TEAM, drawn, SETTINGS))
    np.testing.assert_allclose(robot.act(unit(2.0)), [0.0, 0.5], atol=1e-6)
    for dt in (0.02, 0.05, 0.1, 0.1):
        robot.act(np.zeros((0, 2)), dt=dt)
    memory = robot.policy._controller.perception.get_state()
    # the last command is booked for a whole step
    np.testing.assert_allclose(memory["last"][0, 0], unit(2.0 - 0.5 * 0.37)[0], atol=1e-6)
    assert memory["unseen"][0, 0] == pytest.approx(0.37 / UNIT)


def test_other_robots_are_refused():
    points = rv.Scenario(n_robots=2)
    with pytest.raises(ValueError, match=r"single_integrator robots; a network without a filter"):
        LearnedPolicy(points, weights(SETTINGS, SETTINGS.layout_of(points)), SETTINGS)
    with pytest.raises(UserError, match=r"a network without a filter \(guarantee 'none'\)"):
        ppo.check(ppo.Config(scenario="clutter-4", guarantee="none"))
    with pytest.raises(UserError, match=r"--clearance is 0\.5; no filter uses it"):
        ppo.check(ppo.Config(**SMALL, clearance=0.5))


def test_shares_add_up_to_decrease_of_lyapunov_function():
    """Over short steps: Σ s_i/n = (V⁻ − V)/V(0); a robot at rest has no share."""
    scenario = rv.scenarios.get("utias-5")
    simulator = rv.Simulator(scenario, 4)
    simulator.reset(0)
    actions = np.zeros((4, 5, 2), np.float32)
    actions[:, 1:] = np.random.default_rng(0).uniform(-1, 1, (4, 4, 2)) * scenario.action_bounds
    total, start = np.zeros(4), simulator.lyapunov()
    for _ in range(50):
        before = simulator.positions.copy()
        simulator.step(actions)
        shares = shares_of(simulator, before)
        assert not shares[:, 0].any() and shares[:, 1:].all()
        total += shares.mean(axis=1)
    decrease = (start - simulator.lyapunov()) / start
    assert np.abs(decrease).min() > 1e-3
    np.testing.assert_allclose(total, decrease, rtol=1e-3, atol=1e-6)


def test_environment_pays_own_progress_to_robots():
    scenario = rv.scenarios.get("utias-5").replace(on_merge="follow")
    plain, paid = (
        FeatureVectorEnv(
            rv.make_vec(scenario, 3, autoreset_mode=AutoresetMode.SAME_STEP),
            replace(SETTINGS, decision_time=0.2),
            own_progress=price,
        )
        for price in (0.0, 2.0)
    )
    for env in (plain, paid):
        env.reset(seed=1)
    choices = np.random.default_rng(0).integers(len(COMMANDS), size=(3, 5))
    before = plain.env.simulator.positions.copy()
    usual, extra = plain.step(choices), paid.step(choices)
    shares = 2.0 * shares_of(plain.env.simulator, before)
    assert np.abs(shares).max() > 1e-3
    more = extra[4]["robot_rewards"] - usual[4]["robot_rewards"]
    np.testing.assert_allclose(more, shares)
    np.testing.assert_allclose(extra[1] - usual[1], shares.mean(axis=1))
    np.testing.assert_array_equal(extra[0], usual[0])


@pytest.mark.parametrize("memory", [{}, slow({"memory": "recurrent", "memory_units": 8})])
def test_resumed_training_is_identical(memory, tmp_path):
    """With the memory of features alone, and with a recurrent unit on top of it."""
    brief = {"decision_period": 10, "num_envs": 6, "total_steps": 3 * 6 * 5 * 16, "eval_every": 0}
    assert_goes_on(tmp_path, 2, **SMALL, own_progress=1.0, **brief, **memory)
