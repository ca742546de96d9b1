"""Robots with inertia in every environment: API suites, spaces, files, what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from guarantees import GUARANTEES, api_suite, draw, suites
from gymnasium.utils.env_checker import check_env

import baselines
import rendezvous_env as rv
from rendezvous_env import rendezvous_v0
from rendezvous_env.envs.gymnasium_env import make_env

DIMENSIONS = pytest.mark.parametrize("dim", [2, pytest.param(3, marks=pytest.mark.slow)])
"""Robots of space need kernels that few other tests have."""


def team(dim: int = 2, **changes: object) -> rv.Scenario:
    given = {"n_robots": 3, "dim": dim, "robot_model": "double_integrator", "time_limit": 5.0}
    return rv.Scenario(**given | changes)


@api_suite
@DIMENSIONS
def test_api_suites(dim):
    suites.parallel_api_test(rendezvous_v0.parallel_env(team(dim)), num_cycles=300)
    suites.api_test(rendezvous_v0.env(team(dim)), num_cycles=200, verbose_progress=False)
    check_env(make_env(team(dim)), skip_render_check=True)


@DIMENSIONS
def test_observations_stay_in_their_space_and_end_with_the_velocity(dim):
    scenario = team(dim, max_speed=0.7, max_acceleration=50.0)
    env, random = rv.parallel_env(scenario), np.random.default_rng(0)
    observations, _ = env.reset(0)
    assert observations["robot_0"].shape == (2 + 1, dim)
    space = env.observation_space("robot_0")
    np.testing.assert_allclose(space.high[-1], 0.7, rtol=1e-6)
    np.testing.assert_allclose(env.action_space("robot_0").high, 50.0)
    fastest = 0.0
    while env.agents:
        observations, *_ = env.step(draw(env, random))
        for seen in observations.values():
            assert space.contains(seen)
            fastest = max(fastest, float(np.linalg.norm(seen[-1])))
    assert 0.69 < fastest <= 0.7000001


def test_autoreset_begins_at_rest():
    venv = rv.make_vec(team(time_limit=0.3), num_envs=6)
    venv.reset(seed=0)
    push = np.full(venv.action_space.shape, 1.0, np.float32)
    for _ in range(venv.simulator.max_steps):
        venv.step(push)
    assert (np.linalg.norm(venv.simulator.velocities, axis=-1) > 0.1).all()
    observations, rewards, *_ = venv.step(push)
    np.testing.assert_array_equal(venv.simulator.velocities, 0.0)
    np.testing.assert_array_equal(observations[:, :, -1], 0.0)
    assert (rewards == 0).all() and (venv.simulator.steps == 0).all()


def test_files(tmp_path):
    scenario = team(max_acceleration=2.5, max_speed=1.5)
    scenario.to_toml(tmp_path / "team.toml")
    assert rv.Scenario.from_toml(tmp_path / "team.toml") == scenario
    assert scenario.acceleration_limit == 2.5 and team().acceleration_limit == 4 * 2.0
    with pytest.raises(ValueError, match=r"max_acceleration is -1; it must be a positive"):
        team(max_acceleration=-1)


def test_headings_do_not_steer_them():
    message = r"scenario has double_integrator robots, whose action is acceleration, m/s²; law"
    bases = rv.parallel_env(team()), rv.make_vec(team(), 2)
    for around, base in zip(GUARANTEES["heading"].both, bases, strict=True):
        with pytest.raises(ValueError, match=message):
            around(base)
    with pytest.raises(ValueError, match='headings: double_integrator robots have none; give "fra'):
        rv.Simulator(team()).reset(0, {"headings": [0.0, 0.0, 0.0]})


def test_actions_keep_their_direction_within_the_limit():
    scenario = team(max_acceleration=1.0, max_speed=9.0)
    policy = baselines.make("damped", scenario, damping=100.0)
    seen = np.zeros((1, 3, 3, 2), np.float32)
    seen[..., -1, :] = (0.3, 0.4)
    np.testing.assert_allclose(policy(seen, 0.0), np.broadcast_to((-0.6, -0.8), (1, 3, 2)))
