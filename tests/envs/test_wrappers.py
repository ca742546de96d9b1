"""HeadingVectorWrapper for PettingZoo: API suites, law (4) from what is seen, periods, memory."""

from __future__ import annotations

import copy
import pickle
import warnings

import numpy as np
import pytest
from conftest import five
from test_pettingzoo import api_suite

import rendezvous_env as rv
from rendezvous_env import HeadingVectorWrapper, Scenario, graphs, parallel_env
from rendezvous_env.safety.theorems.descent import time_bound
from rendezvous_env.safety.turning import mean_body_axis_2d, mean_body_axis_3d

with warnings.catch_warnings():  # PettingZoo imports its own old modules here
    warnings.simplefilter("ignore", DeprecationWarning)
    from pettingzoo.test import api_test, parallel_api_test, parallel_seed_test
    from pettingzoo.test.state_test import state_test
    from pettingzoo.utils.conversions import parallel_to_aec


def make(kind="single_integrator-2d", *, spawn_size=4.0, time_limit=8.0, changes=None, **options):
    scenario = five(kind, spawn_size=spawn_size, time_limit=time_limit, **(changes or {}))
    return HeadingVectorWrapper(parallel_env(scenario), **options)


def draw(env, random):
    """Raw vectors of all robots alive."""
    return {
        name: random.uniform(-1, 1, env.action_space(name).shape).astype(np.float32)
        for name in env.agents
    }


def constant(env, vector):
    return {name: np.array(vector, np.float32) for name in env.agents}


def same(a, b):
    """Whether two nested dicts of arrays are equal, bit for bit."""
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    if isinstance(a, np.ndarray):
        return a.dtype == b.dtype and np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
    return a == b or (a != a and b != b)


def rotation(dim, seed):
    matrix, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(dim, dim)))
    return matrix * np.sign(np.linalg.det(matrix)) if dim == 3 else _proper(matrix)


def _proper(matrix):
    return matrix if np.linalg.det(matrix) > 0 else matrix[:, ::-1]


# ---- the suites of PettingZoo --------------------------------------------------------------------


@api_suite
@pytest.mark.parametrize("period", [1, 3])
def test_parallel_api(kind, period, capsys):
    parallel_api_test(make(kind, decision_period=period), num_cycles=300)
    assert "Passed Parallel API test" in capsys.readouterr().out


@api_suite
def test_aec_api(kind, capsys):
    api_test(parallel_to_aec(make(kind)), num_cycles=100, verbose_progress=False)
    assert "Passed API test" in capsys.readouterr().out


@api_suite
def test_seeds(kind):
    parallel_seed_test(lambda: make(kind), num_cycles=100)
    first, second = (make(kind).reset(seed=seed)[0]["robot_0"] for seed in (1, 2))
    assert not np.array_equal(first, second)


def test_state_suite(kind):
    env = make(kind)
    state_test(parallel_to_aec(env), make(kind), num_cycles=20)
    np.testing.assert_array_equal(env.state_space.low, env.unwrapped.state_space.low)


def test_spaces_hold_what_is_seen_and_done(kind):
    env = make(kind)
    random = np.random.default_rng(0)
    observations, _ = env.reset(seed=3)
    k = {"single_integrator-2d": 2, "single_integrator-3d": 3, "unicycle": 1, "nonholonomic_3d": 2}
    assert env.action_space("robot_0").shape == (k[kind],)
    assert env.action_space("robot_0") is env.action_space("robot_0")
    seen = 0
    while env.agents:
        for name, rows in observations.items():
            assert env.observation_space(name).contains(rows)
            seen += 1
        observations, *_ = env.step(draw(env, random))
    assert seen > 50


# ---- law (4) from the observation's own rows -----------------------------------------------------


def spy(env):
    """The actions that reach the base environment, as they come."""
    base, reached = env.unwrapped, []
    step = base.step

    def noting(actions):
        reached.append({name: np.array(action) for name, action in actions.items()})
        return step(actions)

    base.step = noting
    return reached


@pytest.mark.parametrize("kind", ["single_integrator-2d", "single_integrator-3d"])
@pytest.mark.parametrize("certified", [True, False])
def test_velocity_is_the_rows_sum_projected_on_the_heading(kind, certified):
    env = make(kind, frame="local", certified=certified)
    reached, random = spy(env), np.random.default_rng(1)
    observations, _ = env.reset(seed=2)
    while env.agents:
        raw = draw(env, random)
        before = observations
        observations, _, _, _, infos = env.step(raw)
        for name, velocity in reached[-1].items():
            i = int(name[6:])
            f = before[name].sum(axis=0, dtype=np.float64)
            h = env.steering.headings[0, i]
            np.testing.assert_allclose(velocity, h * (h @ f), atol=2e-7 * (1 + abs(h @ f)))
            assert np.linalg.norm(h) == pytest.approx(1, abs=1e-12)
            if not certified:
                q = raw[name].astype(np.float64)
                np.testing.assert_allclose(h, q / np.linalg.norm(q), atol=1e-12)
            margin = abs(h @ f) / np.linalg.norm(f)
            assert infos[name]["alignment"] == pytest.approx(margin, abs=1e-9)
            assert infos[name]["lyapunov_rate"] == pytest.approx(-2 * (h @ f) ** 2, abs=1e-9)
    assert len(reached) > 20


@pytest.mark.parametrize("kind", ["unicycle", "nonholonomic_3d"])
def test_speed_is_f_along_the_mean_axis_of_the_turn_executed(kind):
    env = make(kind, changes={"max_turn_rate": 2.0})
    reached, random, tau = spy(env), np.random.default_rng(1), env.unwrapped.scenario.tau
    layout = env.unwrapped.scenario.observation_layout
    observations, _ = env.reset(seed=2)
    while env.agents:
        before = observations
        observations, _, _, _, infos = env.step(draw(env, random))
        for name, (v, *rates) in reached[-1].items():
            f = layout.net_bearing(before[name])
            if kind == "unicycle":
                m = mean_body_axis_2d(rates[0], tau)
            else:
                gravity = before[name][-1].astype(np.float64)
                m = mean_body_axis_3d(*rates, np.arctan2(-gravity[0], -gravity[2]), tau)
            assert v == pytest.approx(m @ f, abs=1e-6)
            assert infos[name]["lyapunov_rate"] == pytest.approx(-2 * (m @ f) ** 2, abs=1e-6)
            assert infos[name]["alignment"] == pytest.approx(
                abs(f[0]) / np.linalg.norm(f), abs=1e-9
            )
            assert np.abs(rates).max() <= (3.0 if kind == "nonholonomic_3d" else 2.0) + 1e-6


def test_nothing_but_the_rows_is_looked_at():
    """The same rows in another place, at another scale: the same velocities."""
    starts = np.array([[0.0, 0.0], [3.0, 1.0], [1.0, 4.0], [-2.0, 3.0], [2.0, -3.0]])
    frames = np.stack([rotation(2, k) for k in range(5)])
    reached = []
    for scale, shift in ((1.0, 0.0), (8.0, 100.0)):
        env = make()
        base = spy(env)
        positions = starts * scale + shift
        env.reset(seed=0, options={"positions": positions, "frames": frames})
        env.step(constant(env, (0.3, -0.8)))
        reached.append(base[0])
    assert all(
        np.allclose(reached[0][name], reached[1][name], atol=1e-6) and np.any(reached[0][name])
        for name in reached[0]
    )


# ---- decision period -----------------------------------------------------------------------------


def by_hand(scenario, raw, seed, **options):
    """The same episode, every raw vector repeated one base step at a time, in the local frame."""
    env = HeadingVectorWrapper(parallel_env(scenario), frame="local", **options)
    env.reset(seed=seed)
    told = []
    while env.agents:
        told.append(env.step({name: raw[name] for name in env.agents}))
    return told


def test_a_period_is_that_many_base_steps_with_the_raw_vector_held(kind):
    scenario = five(kind, spawn_size=3.0, time_limit=5.0)
    random = np.random.default_rng(5)
    env = HeadingVectorWrapper(parallel_env(scenario), frame="local", decision_period=4)
    env.reset(seed=8)
    raw = draw(env, random)
    singles = by_hand(scenario, raw, seed=8)
    ended_within = 0
    for first in range(0, len(singles), 4):
        part = singles[first : first + 4]
        alive = env.agents.copy()
        observations, rewards, ends, cuts, infos = env.step({name: raw[name] for name in alive})
        assert set(observations) == set(rewards) == set(ends) == set(cuts) == set(alive)
        for name in alive:
            own = [step for step in part if name in step[0]]
            assert rewards[name] == pytest.approx(sum(step[1][name] for step in own), abs=1e-12)
            np.testing.assert_array_equal(observations[name], own[-1][0][name])
            assert ends[name] == own[-1][2][name] and cuts[name] == own[-1][3][name]
            assert same(infos[name], own[-1][4][name])
            ended_within += len(own) < len(part)
    assert not env.agents
    assert ended_within > 0 or not any(step[2].get("robot_4") for step in singles)


def test_a_robot_that_merges_on_the_way_ends_with_its_last_observation():
    scenario = Scenario(n_robots=3, graph="path", merge_radius=0.2, spawn_size=4.0)
    starts = [[0.0, 0.0], [0.5, 0.0], [6.0, 0.0]]
    env = HeadingVectorWrapper(parallel_env(scenario), decision_period=10)
    env.reset(seed=0, options={"positions": starts})
    observations, _, ends, cuts, infos = env.step(constant(env, (1.0, 0.0)))
    assert ends == {"robot_0": False, "robot_1": True, "robot_2": False}
    assert not any(cuts.values()) and env.agents == ["robot_0", "robot_2"]
    assert infos["robot_1"]["merged_into"] == 0
    assert not observations["robot_1"].any() and observations["robot_0"].any()
    with pytest.raises(KeyError, match="robot_1 has merged into robot_0"):
        env.step({name: np.ones(2, np.float32) for name in ("robot_0", "robot_1", "robot_2")})


def test_the_time_limit_may_fall_within_a_period():
    env = make(decision_period=5)
    env.max_cycles = 7
    env.reset(seed=0)
    *_, cuts, _ = env.step(constant(env, (1.0, 0.0)))
    assert not any(cuts.values()) and len(env.agents) == 5
    *_, cuts, infos = env.step(constant(env, (1.0, 0.0)))
    assert all(cuts.values()) and len(cuts) == 5 and env.agents == []
    assert infos["robot_0"]["summary"]["time"] == pytest.approx(7 * env.unwrapped.scenario.tau)
    assert env.step({}) == ({}, {}, {}, {}, {})


def test_the_certified_heading_follows_f_within_a_period():
    """Passing by a neighbour f swings round; a held heading would lose the margin, h does not."""
    env = make(decision_period=40, min_alignment=0.5, max_turn_rate=1.0)
    margins, swings, base = [], [], env.unwrapped
    step = base.step

    def noting(actions):
        f = base.scenario.observation_layout.net_bearing(env._observed[0])
        strong = np.linalg.norm(f, axis=-1) >= 2 * base.scenario.dead_zone
        margins.extend(env.steering.alignment[0][strong])
        swings.append(f)
        return step(actions)

    base.step = noting
    env.reset(seed=4)
    while env.agents:
        env.step(constant(env, (0.0, 1.0)))
    assert min(margins) >= 0.5 - 1e-9 and len(margins) > 50
    first, last = (swings[k][0] / np.linalg.norm(swings[k][0]) for k in (0, 30))
    assert first @ last < 0.999


# ---- memory --------------------------------------------------------------------------------------


def test_state_pickle_and_deepcopy_go_on_alike(kind):
    env = make(kind, decision_period=2)
    random = np.random.default_rng(0)
    env.reset(seed=3)
    for _ in range(6):
        env.step(draw(env, random))
    fresh = make(kind, decision_period=2)
    fresh.set_state(env.get_state())
    copies = [fresh, copy.deepcopy(env), pickle.loads(pickle.dumps(env))]
    compared = 0
    while env.agents and compared < 30:
        raw = draw(env, random)
        result = env.step(raw)
        for other in copies:
            assert all(same(a, b) for a, b in zip(result, other.step(raw), strict=True))
            assert same(env.get_state(), other.get_state())
        compared += 1
    assert compared > 5


def test_without_its_memory_the_episode_would_go_on_differently():
    env, other = make(max_turn_rate=0.5), make(max_turn_rate=0.5)
    env.reset(seed=3)
    for _ in range(20):
        env.step(constant(env, (0.0, 1.0)))
    other.set_state(env.get_state())
    other.steering.forget()
    env.step(constant(env, (0.0, 1.0)))
    other.step(constant(other, (0.0, 1.0)))
    assert not np.array_equal(env.steering.headings, other.steering.headings)


def test_a_state_is_a_copy_and_can_be_put_back():
    env = make()
    env.reset(seed=3)
    env.step(constant(env, (0.5, 0.5)))
    state = env.get_state()
    kept = copy.deepcopy(state)
    first = [env.step(constant(env, (0.1, -0.9))) for _ in range(5)]
    assert same(state, kept)
    env.set_state(state)
    second = [env.step(constant(env, (0.1, -0.9))) for _ in range(5)]
    assert all(same(a[0], b[0]) and same(a[1], b[1]) for a, b in zip(first, second, strict=True))


def test_a_reset_forgets_the_headings(kind):
    env, fresh = make(kind, max_turn_rate=0.5), make(kind, max_turn_rate=0.5)
    random = np.random.default_rng(0)
    env.reset(seed=1)
    for _ in range(10):
        env.step(draw(env, random))
    observations, _ = env.reset(seed=9)
    assert not env.steering.headings.any()
    again, _ = fresh.reset(seed=9)
    assert same(observations, again) and same(env.get_state(), fresh.get_state())


# ---- frame="net_bearing" -------------------------------------------------------------------------


def rotated_run(dim, world, turn, steps=25, frame="net_bearing"):
    """Observations and positions of one episode, with the world and the local frames rotated."""
    random = np.random.default_rng(11)
    starts = random.uniform(-2, 2, (5, dim))
    frames = np.stack([rotation(dim, k) for k in range(5)])
    turned = np.stack([world @ frame @ turn(k) for k, frame in enumerate(frames)])
    env = make(f"single_integrator-{dim}d", frame=frame)
    observations, _ = env.reset(seed=0, options={"positions": starts @ world.T, "frames": turned})
    seen, places = [observations], [env.unwrapped.simulator.positions[0]]
    for _ in range(steps):
        if not env.agents:
            break
        observations, *_ = env.step(draw(env, random))
        seen.append(observations)
        places.append(env.unwrapped.simulator.positions[0])
    return seen, np.array(places)


@pytest.mark.parametrize("dim", [2, 3])
def test_rotating_world_and_frames_changes_nothing_seen_and_rotates_the_motion(dim):
    world = rotation(dim, 77)
    plain, places = rotated_run(dim, np.eye(dim), lambda k: np.eye(dim))
    for turn in (lambda k: np.eye(dim), lambda k: rotation(dim, 100 + k)):
        seen, moved = rotated_run(dim, world, turn)
        assert len(seen) == len(plain) > 10
        for a, b in zip(plain, seen, strict=True):
            assert a.keys() == b.keys()
            for name in a:
                np.testing.assert_allclose(a[name], b[name], atol=2e-5)
        np.testing.assert_allclose(moved, places @ world.T, atol=2e-5)
    assert np.abs(places[-1] - places[0]).max() > 0.3


@pytest.mark.parametrize("dim", [2, 3])
def test_in_the_local_frame_it_would_not_be_so(dim):
    world = rotation(dim, 77)
    plain, _ = rotated_run(dim, np.eye(dim), lambda k: np.eye(dim), 1, "local")
    seen, _ = rotated_run(dim, world, lambda k: rotation(dim, 100 + k), 1, "local")
    assert np.abs(plain[0]["robot_1"] - seen[0]["robot_1"]).max() > 0.1


@pytest.mark.parametrize("dim", [2, 3])
def test_f_lies_along_x_unless_it_is_weak(dim):
    env = make(f"single_integrator-{dim}d", spawn_size=3.0)
    scenario, random = env.unwrapped.scenario, np.random.default_rng(2)
    strong = weak = 0
    for seed in range(4):
        observations, _ = env.reset(seed=seed)
        while env.agents:
            for rows in observations.values():
                f = rows.sum(axis=0, dtype=np.float64)
                if np.linalg.norm(f) >= 1.01 * scenario.dead_zone:
                    np.testing.assert_allclose(f[1:], 0, atol=2e-6)
                    assert f[0] > 0
                    strong += 1
                else:
                    weak += 1
            observations, *_ = env.step(draw(env, random))
    assert strong > 100


def test_a_weak_f_keeps_the_last_frame():
    """The middle robot of three has f = 0 once it stands between the others."""
    scenario = Scenario(n_robots=3, graph="path", merge_radius=0.2)
    env = HeadingVectorWrapper(parallel_env(scenario))
    states = []
    for middle in (0.5, 0.0):
        positions = [[-2.0, 0.0], [0.0, middle], [2.0, 0.0]]
        observations, _ = env.reset(
            seed=0, options={"positions": positions, "frames": np.stack([np.eye(2)] * 3)}
        )
        states.append(observations["robot_1"].copy())
    # from the start on weak: the local frame; x is not along f there
    np.testing.assert_allclose(states[1], [[-1, 0], [1, 0]], atol=1e-6)
    # strong first: x looks down, along f
    np.testing.assert_allclose(states[0].sum(axis=0)[1], 0, atol=1e-6)
    env.reset(seed=0, options={"positions": [[-2.0, 0], [0, 0.5], [2.0, 0]]})
    frame = env.steering.get_state()["frames"][0, 1]
    env._observed[0, 1] = env._observed[0, 1] * 0.0
    env.steering.view(env._observed)
    np.testing.assert_array_equal(env.steering.get_state()["frames"][0, 1], frame)
    assert not np.array_equal(frame, np.eye(2))


def test_in_space_the_second_axis_comes_from_the_most_prominent_row():
    scenario = Scenario(n_robots=4, dim=3, graph="star")
    env = HeadingVectorWrapper(parallel_env(scenario))
    for seed in range(10):
        observations, _ = env.reset(seed=seed)
        rows = observations["robot_0"].astype(np.float64)
        most = rows[np.argmax(np.linalg.norm(rows[:, 1:], axis=-1))]
        assert most[1] > 0 and most[2] == pytest.approx(0, abs=1e-6)


# ---- what it is worth ----------------------------------------------------------------------------


def stalled_pair(certified):
    """Two robots one above the other, with headings frozen sideways."""
    scenario = Scenario(n_robots=2, local_frames="global", time_limit=60.0)
    env = HeadingVectorWrapper(
        parallel_env(scenario), min_alignment=0.5, frame="local", certified=certified
    )
    env.reset(seed=0, options={"positions": [[0.0, 0.0], [0.0, 3.0]]})
    while env.agents:
        *_, infos = env.step(constant(env, (1.0, 0.0)))
    return infos["robot_0"]["summary"], infos["robot_0"]["alignment"]


def test_frozen_headings_stall_where_h_is_across_f_and_meet_under_the_certificate():
    bare, alignment = stalled_pair(certified=False)
    assert not bare["success"] and bare["path_length"] == 0.0 and bare["lyapunov"] == 6.0
    assert alignment == 0.0
    kept, alignment = stalled_pair(certified=True)
    assert kept["success"] and alignment >= 0.5 - 1e-9
    # the gap of 2.8 m closes at 2 ε² m/s, faster while the headings turn aside
    assert 0.85 < kept["time"] / (2.8 / (2 * 0.5**2)) < 1.0


def test_uncertified_frozen_headings_stall_from_most_starts():
    """They move until h ⟂ f for every robot, and stay there: lines in space seldom cross."""
    env = make("single_integrator-3d", certified=False, frame="local", time_limit=60.0)
    random = np.random.default_rng(0)
    stalled = 0
    for seed in range(6):
        env.reset(seed=seed)
        raw = draw(env, random)
        while env.agents:
            *_, infos = env.step({name: raw[name] for name in env.agents})
        summary = next(iter(infos.values()))["summary"]
        if not summary["success"]:
            stalled += 1
            assert summary["lyapunov"] > 1
            assert max(abs(info["lyapunov_rate"]) for info in infos.values()) < 0.01
    assert stalled >= 4


def test_single_integrators_meet_within_the_bound_whatever_the_policy():
    for seed, kind in enumerate(["single_integrator-2d", "single_integrator-3d"] * 3):
        env = make(kind, spawn_size=2.0, min_alignment=0.5, decision_period=3)
        env.reset(seed=seed)
        simulator, scenario = env.unwrapped.simulator, env.unwrapped.scenario
        bound = float(time_bound(scenario, simulator.lyapunov()[0], min_alignment=0.5))
        env.max_cycles = int(np.ceil(bound / scenario.tau)) + 1
        random = np.random.default_rng(seed)
        while env.agents:
            *_, infos = env.step(draw(env, random))
        summary = next(iter(infos.values()))["summary"]
        assert summary["success"] and summary["time"] <= bound


# ---- bad arguments -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"min_alignment": 0.0}, "min_alignment is 0.0; it must be at least 1e-06"),
        ({"min_alignment": 1.0}, "min_alignment is 1.0"),
        ({"min_alignment": float("nan")}, "min_alignment is nan"),
        ({"decision_period": 0}, "decision_period is 0; it must be a whole number"),
        ({"decision_period": 2.0}, "decision_period is 2.0"),
        ({"decision_period": True}, "decision_period is True"),
        ({"frame": "global"}, "frame is 'global'; it must be one of"),
        ({"max_turn_rate": 0.0}, "max_turn_rate is 0.0; it must be a positive"),
        ({"max_turn_rate": float("inf")}, "max_turn_rate is inf"),
    ],
)
def test_bad_options_are_refused_by_name(kind, options, message):
    with pytest.raises(ValueError, match=message):
        make(kind, **options)


def test_a_vector_environment_is_sent_to_its_own_wrapper():
    with pytest.raises(TypeError, match=r"RendezvousVectorEnv.*vector\.HeadingVectorWrapper"):
        rv.HeadingVectorWrapper(rv.make_vec("duo", num_envs=2))


BAD_ACTIONS = {
    "NaN": (lambda raw: raw | {"robot_2": raw["robot_2"] * np.nan}, ValueError, "robot_2"),
    "inf": (lambda raw: raw | {"robot_0": raw["robot_0"] + np.inf}, ValueError, "robot_0"),
    "wrong shape": (lambda raw: raw | {"robot_1": np.zeros(7)}, ValueError, "robot_1"),
    "a word": (lambda raw: raw | {"robot_1": "left"}, ValueError, "robot_1"),
    "missing": (lambda raw: {k: v for k, v in raw.items() if k != "robot_3"}, KeyError, "robot_3"),
    "unknown": (lambda raw: raw | {"robot_9": raw["robot_0"]}, KeyError, "robot_9"),
}


@pytest.mark.parametrize("wrong", BAD_ACTIONS)
def test_bad_actions_are_refused_by_name_and_change_nothing(kind, wrong):
    spoil, error, name = BAD_ACTIONS[wrong]
    env = make(kind)
    env.reset(seed=0)
    random = np.random.default_rng(0)
    env.step(draw(env, random))
    before = env.get_state()
    with pytest.raises(error, match=name):
        env.step(spoil(draw(env, random)))
    assert same(before, env.get_state())


def test_a_state_that_does_not_fit_is_refused_and_changes_nothing():
    env, other = make(), HeadingVectorWrapper(rv.parallel_env("duo"))
    env.reset(seed=0)
    other.reset(seed=0)
    before = env.get_state()
    with pytest.raises(ValueError, match="observed must be an array of shape"):
        env.set_state(other.get_state())
    broken = env.get_state()
    broken["env"]["simulator"].pop("weights")
    broken["steering"]["headings"] += 1.0
    with pytest.raises(ValueError, match="weights"):
        env.set_state(broken)
    assert same(before, env.get_state())


def test_a_graph_without_links_moves_nobody():
    lonely = Scenario(
        n_robots=2, graph=graphs.from_edges([], 2), require_connected=False, time_step=0.1
    )
    env = HeadingVectorWrapper(parallel_env(lonely.replace(time_limit=1.0)))
    env.reset(seed=0)
    while env.agents:
        *_, infos = env.step(constant(env, (1.0, 0.0)))
    assert infos["robot_0"]["summary"]["path_length"] == 0.0
    assert np.isnan(infos["robot_0"]["alignment"])
