"""Gains: the hull under any weights, how weights become gains, refusals."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import five
from filtered_teams import Seen

from rendezvous_env import Scenario, Sensing, graphs
from rendezvous_env.safety.gains import Gains, gain_range

TEAMS = 12
ROUNDING = 1e-6
"""Of float32 actions, m."""
WEIGHTS = ("random", "sharp", "one", "backwards", "switching", "none", "mixed")


def weights(scenario, num_envs, seed, kind):
    """Weights that try to get robots apart: (B, n, rows, d) and the step → (B, n, K)."""
    random = np.random.default_rng(seed)
    layout = scenario.observation_layout
    size = num_envs, scenario.n_robots, layout.neighbour_slots
    favourite = random.integers(size[2], size=size[:2])[..., None]
    own = random.integers(len(WEIGHTS) - 1, size=size[:2])[..., None]

    def choose(seen, step):
        f = layout.net_bearing(seen)
        along = np.einsum("bnkd,bnd->bnk", seen[:, :, : size[2]], f)
        chosen = {
            "random": random.random(size),
            "sharp": random.random(size) ** 20,
            "one": np.arange(size[2]) == favourite,
            "backwards": along == along.min(axis=-1, keepdims=True),
            "switching": np.broadcast_to(np.arange(size[2]) % 2 == step // 3 % 2, size),
            "none": np.zeros(size),
        }
        if kind != "mixed":
            return chosen[kind].astype(float)
        return np.choose(own, [table.astype(float) for table in chosen.values()])

    return choose


class Hulls(Seen):
    """Episodes under gains; lengths in m."""

    def __init__(self, scenario, *, kind="mixed", steps=None, made=Gains, **options):
        self.filter = made(scenario, TEAMS, frame="local", **options)
        u = np.random.default_rng(1).normal(size=(60, scenario.dim))
        self.u = u / np.linalg.norm(u, axis=-1, keepdims=True)
        self.growth, self.gains = -np.inf, []
        choose = weights(scenario, TEAMS, 0, kind)
        super().__init__(scenario, self.filter, choose, steps=steps)

    def watch(self, step):
        grown = reach(step.after, self.u) - reach(step.before, self.u)
        self.growth = max(self.growth, grown[step.on].max())
        self.gains.append(self.filter.gain[step.on])


def reach(moment, u):
    """max_i u·p_i over the robots that are left, (B, directions)."""
    along = moment.positions @ u.T
    return np.where(moment.active[..., None], along, -np.inf).max(axis=1)


# ---- the hull ------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", WEIGHTS)
@pytest.mark.parametrize("dim", [2, 3])
def test_the_hull_never_grows_and_all_meet(dim, kind):
    scenario = five(f"single_integrator-{dim}d", spawn_size=3.0, time_limit=300.0)
    seen = Hulls(scenario, kind=kind)
    assert seen.growth < ROUNDING and np.isfinite(seen.times).all()


GRAPHS = {
    "complete": graphs.complete(0.7),
    "path": graphs.path((0.5, 2.0)),
    "tree": graphs.random_tree((0.5, 2.0)),
}


@pytest.mark.parametrize("graph", GRAPHS)
@pytest.mark.parametrize("dim", [2, 3])
def test_the_hull_never_grows_at_the_longest_step(graph, dim):
    """The most that a robot may go is r, beyond its nearest neighbour it never gets."""
    scenario = Scenario(n_robots=6, dim=dim, graph=GRAPHS[graph], spawn_size=4.0, time_limit=200.0)
    most = scenario.merge_radius / scenario.tau
    scenario = scenario.replace(max_speed=most)
    seen = Hulls(scenario, min_gain=most, max_gain=most, steps=300)
    assert seen.growth < ROUNDING
    on = np.concatenate(seen.gains)
    np.testing.assert_allclose(on[on > 0], most)


def test_the_hull_never_grows_with_rows_that_come_and_go():
    sensing = Sensing(range=2.5, field_of_view=2.0, dropout=0.3, occlusion="robots")
    scenario = Scenario(n_robots=7, spawn_size=4.0, time_limit=20.0, sensing=sensing)
    seen = Hulls(scenario)
    gains = np.concatenate(seen.gains)
    assert seen.growth < ROUNDING and (gains == 0).any() and (gains > 0).any()


def test_v_may_rise():
    """Towards neighbours that hardly count, away from those that do: the hull is kept, V is not."""
    cliques = np.kron([[3.0, 0.05], [0.05, 3.0]], np.ones((5, 5))) * (1 - np.eye(10))
    scenario = Scenario(n_robots=10, graph=cliques, spawn_size=6.0)
    seen = Hulls(scenario, kind="backwards", steps=100, min_gain=1.0, max_gain=1.0)
    assert seen.growth < ROUNDING and seen.rise > 0.1


class GoesTooFar(Gains):
    """As if a robot could not go beyond its neighbour in one step."""

    def __init__(self, *args, **options):
        super().__init__(*args, **options)
        far = 4.0 * self.scenario.merge_radius / self.scenario.tau
        self._constants = self._constants._replace(min_gain=far, max_gain=far, speed_limit=far)


def test_a_hull_that_grows_is_caught():
    scenario = Scenario(n_robots=6, graph="path", spawn_size=3.0, max_speed=1e3, time_limit=20.0)
    assert Hulls(scenario, made=GoesTooFar, steps=40).growth > 0.01


# ---- how weights become gains --------------------------------------------------------------------


def observed(scenario, *rows):
    table = np.zeros((1, scenario.n_robots, *scenario.observation_layout.shape), np.float32)
    table[0, 0, : len(rows)] = rows
    return table


@pytest.mark.parametrize(
    ("chosen", "gain", "velocity"),
    [
        ((1, 1, 1), 3.0, (1.0, 2.0)),  # a sum that is within the range stays
        ((1, 0, 0), 1.0, (1.0, 0.0)),
        ((0.5, 0.25, 1), 1.0, (0.5, 0.5)),
        ((0.1, 0.1, 1), 0.5, (0.5 / 3, 1.0 / 3)),  # 0.3 is too little: all of them grow
        ((0, 0, 1), 3.0, (1.0, 2.0)),  # nobody is in the third row: all count alike
        ((0, 0, 0), 3.0, (1.0, 2.0)),
        ((-1, 0.5, 0), 1.0, (0.0, 1.0)),
        ((7, 2, 0), 3.0, (1.0, 2.0)),
    ],
)
def test_gains_by_hand(chosen, gain, velocity):
    scenario = Scenario(n_robots=4, max_speed=50.0)
    gains = Gains(scenario, 1, frame="local", min_gain=0.5, max_gain=4.0)
    held = np.zeros((1, 4, 3))
    held[0, 0] = chosen
    gains.hold(held)
    actions = gains.act(observed(scenario, [1.0, 0.0], [0.0, 2.0]))
    np.testing.assert_allclose(actions[0, 0], velocity, rtol=1e-6)
    assert gains.gain[0, 0] == pytest.approx(gain) and not actions[0, 1:].any()
    f = np.array([1.0, 2.0])
    assert gains.lyapunov_rate[0, 0] == pytest.approx(-2 * f @ velocity)
    aligned = f @ velocity / np.linalg.norm(f) / np.linalg.norm(velocity)
    assert gains.alignment[0, 0] == pytest.approx(aligned)
    assert np.isnan(gains.alignment[0, 1]) and gains.gain[0, 1] == 0.0


def test_too_much_is_scaled_down_and_a_speed_limit_too():
    scenario = Scenario(n_robots=3, max_speed=0.5)
    gains = Gains(scenario, 1, frame="local", max_gain=1.5)
    gains.hold(np.ones((1, 3, 2)))
    actions = gains.act(observed(scenario, [1.0, 0.0], [0.0, 1.0]))
    np.testing.assert_allclose(actions[0, 0], [0.5 / np.sqrt(2)] * 2, rtol=1e-6)
    assert gains.gain[0, 0] == pytest.approx(0.5 * np.sqrt(2))  # more than v_max
    away = gains.act(observed(scenario, [1.0, 0.0], [-1.0, 0.0]))
    assert gains.gain[0, 0] == pytest.approx(1.5) and not away.any()


def test_the_range_in_force():
    scenario = Scenario(n_robots=5, graph=graphs.path((0.5, 2.0)))
    safe = scenario.merge_radius / scenario.tau
    assert gain_range(scenario) == (0.5, scenario.max_degree) == (0.5, 4.0)
    assert gain_range(scenario, 6.0) == (6.0, 6.0)
    assert gain_range(scenario, max_gain=0.1) == (0.1, 0.1)
    assert gain_range(scenario, 1.0, 1e9) == (1.0, safe)
    slow = scenario.replace(time_step=2.0, allow_long_step=True)
    assert gain_range(slow) == (0.1, 0.1) == (slow.merge_radius / slow.tau,) * 2


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"min_gain": 0.0}, "min_gain is 0.0; it must be a positive"),
        ({"max_gain": np.nan}, "max_gain is nan; it must be"),
        ({"min_gain": "1"}, "min_gain is '1'; it must be"),
        ({"min_gain": 1e3}, r"min_gain is 1000.0; it must be at most r/τ"),
        ({"min_gain": 1.0, "max_gain": 0.5}, "max_gain is 0.5; it must be at least min_gain"),
    ],
)
def test_other_ranges_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        Gains(Scenario(), 1, **options)
