"""Moving obstacles in environments, rollouts, pictures, recordings, reports and certificates."""

import os

os.environ.setdefault("SDL_VIDEODRIVER", "dummy")

import numpy as np
import pytest
from report_data import arrays_of, data_of

import rendezvous_env as rv
from rendezvous_env import baselines
from train.recording import is_recomputable

NAME = "crossing-traffic-8"


def random_actions(steps: int, *shape: int) -> np.ndarray:
    return np.random.default_rng(0).uniform(-1.0, 1.0, (steps, *shape)).astype(np.float32)


def expected(actions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    sim = rv.Simulator(NAME, 2)
    sim.reset(7)
    for one in actions:
        seen = sim.step(np.stack([one, one])).observations
    return seen[0], sim.obstacle_offsets[0]


def test_interfaces_move_the_same_obstacles():
    actions = random_actions(40, 8, 2)
    seen, offsets = expected(actions)
    env = rv.parallel_env(NAME)
    env.reset(seed=7)
    teams = rv.make_vec(NAME, num_envs=2)
    teams.reset(seed=[7, 8])
    for one in actions:
        rows = env.step({name: one[env.index(name)] for name in env.agents})[0]
        vector = teams.step(np.stack([one, one]))[0]
    np.testing.assert_array_equal(vector[0], seen)
    for name, row in rows.items():
        np.testing.assert_array_equal(row, seen[env.index(name)])
    np.testing.assert_array_equal(env.simulator.obstacle_offsets[0], offsets)
    np.testing.assert_array_equal(teams.unwrapped.simulator.obstacle_offsets[0], offsets)
    assert np.abs(offsets).max() > 0.5


def test_training_slots_move_obstacles():
    sb3 = pytest.importorskip("rendezvous_env.adapters.sb3")
    robots = sb3.RobotVecEnv(rv.vector.training_env(NAME, 2))
    robots.reset()
    for _ in range(10):
        robots.step(np.zeros((robots.num_envs, *robots.action_space.shape), np.float32))
    simulator = robots.slots.vector_env.unwrapped.simulator
    assert np.abs(simulator.obstacle_offsets).max() > 0.1


def test_rollout_records_offsets_and_saves_them(tmp_path):
    played = rv.rollout(NAME, baselines.make("tangent-merged", NAME), num_envs=2)
    assert played.obstacle_offsets.shape == (len(played.times), 2, 7, 2)
    assert not played.obstacle_offsets[0].any() and played.obstacle_offsets[-1].any()
    np.testing.assert_array_equal(played.obstacles[0], played.obstacles[1])
    kept = rv.Trajectory.load(played.save(tmp_path / "traffic.npz"))
    np.testing.assert_array_equal(kept.obstacle_offsets, played.obstacle_offsets)
    still = rv.rollout("duo", baselines.make("bearing-only", "duo"))
    assert still.obstacle_offsets.size == 0


def test_report_holds_offsets_of_every_frame(tmp_path):
    played = rv.rollout(NAME, baselines.make("tangent-merged", NAME), num_envs=1)
    data, texts = data_of(played.to_report(tmp_path / "replay.html").read_text(encoding="utf-8"))
    arrays = arrays_of(data["recordings"][0]["fields"], texts[0])
    offsets = arrays["obstacle_offsets"]
    assert offsets.shape[1:] == (7, 2) == (len(data["obstacles"][0]), 2)
    frames = np.rint(arrays["times"] / played.scenario.tau).astype(int)
    np.testing.assert_allclose(offsets, played.obstacle_offsets[frames, 0], atol=1e-5)
    assert not is_recomputable(played.scenario)


@pytest.mark.parametrize("dim", [2, 3])
def test_picture_shows_where_obstacles_are(dim):
    pytest.importorskip("pygame")
    shape = rv.Disc((0.0, 0.0), 0.8) if dim == 2 else rv.Sphere((0.0, 0.0, 0.0), 0.8)
    places = ((-4.0, -4.0, 0.0), (4.0, 4.0, 0.0))
    scenario = rv.Scenario(
        n_robots=2,
        dim=dim,
        obstacles=[rv.Moving(shape, velocity=(0.5,) + (0.0,) * (dim - 1))],
        start_positions=[place[:dim] for place in places],
    )
    env = rv.parallel_env(scenario, render_mode="rgb_array")
    env.reset(seed=0)
    orange = np.array([230, 159, 0])

    def centre() -> float:
        columns = np.nonzero(np.abs(env.render().astype(int) - orange).max(axis=-1) < 30)[1]
        return float(np.median(columns))

    before = centre()
    for _ in range(60):
        env.step({name: np.zeros(dim, np.float32) for name in env.agents})
    assert abs(centre() - before) > 15.0


@pytest.mark.parametrize("by", ["law", "heading", "tank", "gains", "links"])
def test_certificate_refuses_moving_obstacles_and_says_why(by):
    margin = {"min_alignment": 0.1} if by in ("heading", "tank") else {}
    wall = rv.Moving(rv.Disc((9.0, 9.0), 1.0), velocity=(0.1, 0.0))
    found = rv.certificate(rv.Scenario(n_robots=4, obstacles=[wall]), by=by, **margin)
    assert not found.guaranteed and np.isinf(found.lyapunov_bound)
    passed = rv.Scenario(n_robots=4, obstacles=[wall], obstacle_contact="ignore")
    assert rv.certificate(passed, by=by, **margin).guaranteed
