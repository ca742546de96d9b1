"""Oracle laws: equations by hand, invariants, and lower bounds on the time."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import baselines
import rendezvous_env as rv
from baselines.references.enclosing_ball import smallest_enclosing_ball
from baselines.references.privileged_laws import circumcentres, farthest_steps

TEAM = rv.Scenario(n_robots=5, max_speed=1.0, time_step=0.05, allow_long_step=True, time_limit=60.0)
SPACE = TEAM.replace(dim=3)
NAMES = (
    "privileged-consensus", "privileged-circumcentre", "privileged-enclosing-ball",
    "privileged-nearest-pursuit",
)  # fmt: skip


def first_velocities(name, scenario, positions):
    """Scenario with global frames."""
    simulator, policy = rv.Simulator(scenario), baselines.make(name, scenario)
    seen = simulator.reset(0, {"positions": positions})
    policy.watch(simulator)
    return np.einsum("bnij,bnj->bni", simulator.frames, policy(seen, 0.0))[0]


def test_consensus_is_exponential_of_laplacian():
    """p(t) = exp(−L t) p(0), without a speed limit or a merge."""
    weights = np.array([[0, 0.5, 0, 0.2], [0.5, 0, 0.7, 0], [0, 0.7, 0, 0.3], [0.2, 0, 0.3, 0]])
    start = np.array([[0.0, 0.0], [3.0, 1.0], [4.0, -2.0], [-1.0, 2.0]])
    team = rv.Scenario(
        n_robots=4, graph=weights, max_speed=50.0, time_step=0.001, time_limit=0.5,
        allow_long_step=True, start_positions=tuple(map(tuple, start)),
    )  # fmt: skip
    found = rv.rollout(team, baselines.make("privileged-consensus", team))
    values, vectors = np.linalg.eigh(np.diag(weights.sum(axis=1)) - weights)
    exact = vectors @ np.diag(np.exp(-values * 0.5)) @ vectors.T @ start
    assert len(found.times) == 501
    np.testing.assert_allclose(found.positions[-1, 0], exact, atol=2e-3)


SIGHT_2 = {"sensing": rv.Sensing(range=2.0), "max_speed": 0.1}
PAIRS = [[0.0, 0.0], [1.0, 0.0], [1.0, 9.0], [0.0, 9.0], [50.0, 50.0]]
IN_PAIRS = [[0.1, 0], [-0.1, 0], [-0.1, 0], [0.1, 0], [0, 0]]
LINE = [[0.0, 0.0], [3.0, 0.0], [3.0, 2.0], [-4.0, 0.0], [20.0, 0.0]]


@pytest.mark.parametrize(
    ("name", "changes", "start", "wanted"),
    [
        # each to the other, and no farther, where steps are long
        ("privileged-consensus", {"n_robots": 2, "time_step": 2.0, "max_speed": 100.0},
         [[-2.0, 0.0], [2.0, 0.0]], [[2, 0], [-2, 0]]),
        # no farther than the sensor sees
        *((name, SIGHT_2, PAIRS, IN_PAIRS) for name in (NAMES[0], NAMES[1], NAMES[3])),
        ("privileged-nearest-pursuit", {}, LINE, [[1, 0], [0, 1], [0, -1], [1, 0], [-1, 0]]),
    ],
)  # fmt: skip
def test_first_velocities_match_hand_computation(name, changes, start, wanted):
    found = first_velocities(name, TEAM.replace(**changes), start)
    np.testing.assert_allclose(found, wanted, atol=1e-6)


class TestEnclosingBall:
    @given(st.integers(1, 12), st.integers(2, 3), st.integers(0, 10**6), st.booleans())
    def test_enclosing_ball_contains_points_and_is_minimal(self, count, d, seed, on_a_grid):
        """A convex function is minimal if no small step decreases it."""
        points = np.random.default_rng(seed).normal(size=(count, d)) * 4
        points = np.round(points) if on_a_grid else points
        centre, radius = smallest_enclosing_ball(points)
        assert np.linalg.norm(points - centre, axis=1).max() <= radius * (1 + 1e-9) + 1e-12
        for nudge in np.random.default_rng(0).normal(size=(200, d)) * 1e-3:
            assert np.linalg.norm(points - centre - nudge, axis=1).max() >= radius - 1e-9
        for no_points in (np.zeros((0, 2)), np.zeros(3), [[np.nan, 0.0]]):
            with pytest.raises(ValueError, match="points have shape"):
                smallest_enclosing_ball(no_points)

    def test_enclosing_ball_is_time_optimal(self):
        """T is between (R − (n − 1) r/2)/v_max and R/v_max plus the cost of merges."""
        policy = baselines.make("privileged-enclosing-ball", TEAM)
        found = rv.rollout(TEAM, policy, 0, num_envs=50)
        radii = np.array([smallest_enclosing_ball(p)[1] for p in found.positions[0]])
        late = found.rendezvous_time - radii / TEAM.speed_limit
        slack = 4 * (TEAM.merge_radius / 2 / TEAM.speed_limit + TEAM.tau)
        assert late.max() <= slack and late.min() >= -slack
        for name in ("unit-mean", "privileged-consensus"):
            other = rv.rollout(TEAM, baselines.make(name, TEAM), 0, num_envs=50)
            assert (other.rendezvous_time >= found.rendezvous_time - slack).all()
            assert other.rendezvous_time.mean() > found.rendezvous_time.mean() + TEAM.tau

    def test_centre_is_per_episode(self):
        """On straight lines to the centre; the second episode starts without a policy reset."""
        simulator, policy = rv.Simulator(TEAM, 2), baselines.make(NAMES[2], TEAM)
        seen = simulator.reset(0)
        policy.watch(simulator)
        for _ in range(2):
            centres = np.array([smallest_enclosing_ball(p)[0] for p in simulator.positions])
            ways = centres[:, None] - simulator.positions
            local = np.einsum("bnji,bnj->bni", simulator.frames, ways)
            local /= np.maximum(np.linalg.norm(local, axis=-1, keepdims=True), 1.0)
            np.testing.assert_allclose(policy(seen, simulator.time), local, atol=1e-5)
            while not simulator.ended.all():
                seen = simulator.step(policy(seen, simulator.time)).observations
            assert (simulator.active.sum(axis=1) == 1).all()
            seen = simulator.reset()

    def test_mask_restarts_some_environments(self):
        """Both teams are moved; the team without reset returns to its old centre."""
        simulator, policy = rv.Simulator(TEAM, 2), baselines.make(NAMES[2], TEAM)
        seen = simulator.reset(0)
        policy.watch(simulator)
        before, state = policy(seen, 0.0), simulator.get_state()
        simulator.set_state({**state, "positions": state["positions"] + 50.0})
        policy.reset(np.array([True, False]))
        change = np.abs(policy(seen, 0.0) - before).max(axis=(1, 2))
        assert change[0] < 1e-5 < 0.1 < change[1]


class TestCircumcentre:
    def test_circumcentres_match_hand_computation(self):
        positions = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 4.0]])
        linked = np.array([[0, 1, 0], [1, 0, 1], [0, 1, 0]], dtype=bool)
        found = circumcentres(positions, linked)
        np.testing.assert_allclose(found, [[1, 0], [1, 2], [2, 2]], atol=1e-9)

    def test_farthest_steps_match_hand_computation(self):
        """Towards a neighbour at distance d: (d + R)/2; away from it: (R − d)/2.

        Across: √((R/2)² − (d/2)²).
        """
        sight, d = 2.0, 1.2
        ways, linked = np.zeros((3, 3, 2)), np.zeros((3, 3), bool)
        ways[:, 1], linked[:, 1] = [d, 0.0], True
        towards = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0]])
        steps = farthest_steps(towards, ways, linked, sight)
        np.testing.assert_allclose(steps, [(d + sight) / 2, (sight - d) / 2, math.sqrt(0.64)])
        assert np.isinf(farthest_steps(towards, ways, ~linked & False, sight)).all()

    def test_circumcentre_law_keeps_links(self):
        """Law (1) and consensus lose links, since outer robots lag behind."""
        sight = 2.0
        team = TEAM.replace(
            n_robots=10, spawn_size=7.0, sensing=rv.Sensing(range=sight), max_speed=20.0,
            merge_radius=0.02, time_limit=2.0, require_connected=False,
        )  # fmt: skip
        for name in ("privileged-circumcentre", "bearing-only", "privileged-consensus"):
            found = rv.rollout(team, baselines.make(name, team), 0, num_envs=20)
            ways = found.positions[:, :, None] - found.positions[:, :, :, None]
            seen = np.linalg.norm(ways, axis=-1) <= sight + 1e-6
            whole = found.active[1:].all(axis=-1)[..., None, None]  # a merge moves its robots
            lost = (whole & seen[:-1] & ~seen[1:]).any()
            assert lost == (name != "privileged-circumcentre")


@pytest.mark.parametrize("name", [*NAMES, "privileged-planner"])
def test_oracles_without_simulator_raise(name):
    policy = baselines.make(name, TEAM)
    policy.reset()
    with pytest.raises(RuntimeError, match=rf"{name} reads positions: call its watch"):
        policy(np.zeros((5, *TEAM.observation_layout.shape), np.float32), 0.0)
    for watched in (None, "clutter-8", rv.Simulator(SPACE), rv.Simulator(TEAM.replace(n_robots=4))):
        with pytest.raises(ValueError, match="be a Simulator of 5 single integrators in 2-D"):
            policy.watch(watched)
