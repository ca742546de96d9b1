"""HeadingFilter: V beside obstacles under any raw vectors; frames, arcs, limits."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import UNEQUAL, five
from tuples import mean_body_axis

import rendezvous_env as rv
from rendezvous_env import Scenario, Simulator
from rendezvous_env.safety.heading import HeadingFilter
from rendezvous_env.trajectory import run
from train.verify.adversarial_actions import Adversary
from train.verify.monitors import Moment

TEAMS = 48
ROUNDING = 2.0**-20
"""Of float32 rows and actions, relative to n D̄² τ ."""


class Watched:
    """How V rose in episodes of adversaries beside obstacles, in steps with a contact and without,
    m²/s; rounding aside.
    """

    def __init__(self, scenario, seed=3):
        adversary = Adversary(scenario, TEAMS, "heading", np.random.default_rng(seed))
        steering = HeadingFilter(scenario, TEAMS, frame="local")
        simulator = Simulator(scenario, TEAMS)

        def policy(seen, time):
            steering.hold(adversary(seen, Moment(simulator)))
            return steering.act(seen)

        self.rise_free = self.rise_in_contact = -np.inf
        self.rises_in_contact = self.contacts = 0
        tolerance = ROUNDING * scenario.n_robots * scenario.max_degree**2 * scenario.tau
        for step in run(simulator, policy, simulator.reset(seed)):
            out, on = step.outcome, step.running
            rise = out.lyapunov_before_merge - step.lyapunov - tolerance - 1e-12 * step.lyapunov
            touched = out.contact.any(axis=-1)
            self.rise_free = max(self.rise_free, rise[on & ~touched].max(initial=-np.inf))
            in_contact = rise[on & touched]
            self.rise_in_contact = max(self.rise_in_contact, in_contact.max(initial=-np.inf))
            self.rises_in_contact += int(np.sum(in_contact > 0))
            self.contacts += len(in_contact)


# ---- V beside obstacles; without any ``rendezvous verify`` looks at it ---------------------------


CLUTTERS = {
    "clutter-12": rv.scenarios.get("clutter-12"),
    "clutter-3d": rv.scenarios.get("clutter-3d"),
    "unicycle": rv.scenarios.get("clutter-12").replace(robot_model="unicycle"),
    "nonholonomic_3d": rv.scenarios.get("clutter-3d").replace(robot_model="nonholonomic_3d"),
}


@pytest.mark.parametrize("name", CLUTTERS)
def test_v_never_rises_where_robots_stop_at_obstacles(name):
    scenario = CLUTTERS[name].replace(obstacle_contact="stop", time_limit=15.0)
    watched = Watched(scenario)
    assert watched.contacts > 100
    assert watched.rise_free <= 0 and watched.rise_in_contact <= 0


@pytest.mark.parametrize("name", CLUTTERS)
def test_v_never_rises_in_a_step_without_a_contact_where_robots_slide(name):
    scenario = CLUTTERS[name].replace(time_limit=15.0)
    watched = Watched(scenario)
    assert watched.contacts > 100 and watched.rise_free <= 0
    # a slide along an obstacle takes away the inward part of h hᵀf and may leave an uphill one
    assert watched.rises_in_contact <= watched.contacts
    bound = scenario.tau * scenario.n_robots * scenario.max_degree**2
    assert watched.rise_in_contact <= bound


# ---- arcs ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", ["unicycle", "nonholonomic_3d"])
def test_v_falls_by_twice_the_certified_rate_less_the_curvature_on_held_arcs(model):
    """V(t+τ) ≤ V − 2τ Σ (mᵀf)² + (2τ²/r) Σ D (mᵀf)² ≤ V − τ Σ (mᵀf)², m the mean body axis."""
    scenario = five(model, spawn_size=4.0, max_turn_rate=8.0)
    tau, radius = scenario.tau, scenario.merge_radius
    simulator = Simulator(scenario, TEAMS)
    steering = HeadingFilter(scenario, TEAMS, max_turn_rate=8.0)
    observations = simulator.reset(1)
    random = np.random.default_rng(0)
    degree = UNEQUAL.sum(axis=1)
    compared = 0
    for _ in range(20):
        steering.hold(random.uniform(-1, 1, (*simulator.headings.shape[:2], scenario.dim - 1)))
        actions = steering.act(observations)
        before, places, apart = simulator.lyapunov(), simulator.positions, simulator.active
        m = mean_axes(scenario, actions, observations)
        along = np.sum(m * scenario.observation_layout.net_bearing(observations), axis=-1)
        frames = simulator.frames
        outcome = simulator.step(actions)
        observations = outcome.observations
        whole = apart.all(axis=-1) & outcome.active.all(axis=-1)
        fall = (before - outcome.lyapunov_before_merge)[whole]
        rate = np.sum((along**2)[whole], axis=-1)
        curvature = 2 * tau**2 / radius * np.sum((degree * along**2)[whole], axis=-1)
        assert (fall >= 2 * tau * rate - curvature - 1e-6 * tau).all()
        assert (fall >= tau * rate - 1e-6 * tau).all()
        moved = np.einsum("bnij,bnj->bni", frames, m) * along[..., None] * tau
        np.testing.assert_allclose(
            (simulator.positions - places)[whole], moved[whole], atol=2e-6 * tau * 5
        )
        compared += int(whole.sum())
    assert compared > 300


def mean_axes(scenario, actions, observations):
    """m of the turn rates executed, in the body frames, (B, n, d)."""
    rates = actions[..., 1:].astype(np.float64)
    if scenario.dim == 2:
        return mean_body_axis(rates[..., 0], 0.0, 0.0, scenario.tau)[..., :2]
    gravity = observations[..., -1, :].astype(np.float64)
    pitch = np.arctan2(-gravity[..., 0], -gravity[..., 2])
    return mean_body_axis(rates[..., 0], rates[..., 1], pitch, scenario.tau)


def test_the_axis_at_the_start_of_the_step_would_not_do():
    """Held over an arc, v = hᵀf can raise V where v = mᵀf lets it fall (theory 4)."""
    scenario = Scenario(
        n_robots=2,
        robot_model="unicycle",
        merge_radius=0.2,
        max_turn_rate=20.0,
        start_positions=((0.0, 0.0), (1.0, 0.0)),
        start_headings=((1.2,), (1.2 + np.pi,)),
    )
    rise = {}
    for law in ("h", "m"):
        simulator = Simulator(scenario)
        f = scenario.observation_layout.net_bearing(simulator.reset(0))[0]
        rate = np.full(2, 20.0)
        m = mean_body_axis(rate, 0.0, 0.0, scenario.tau)[:, :2]
        v = f[:, 0] if law == "h" else np.sum(m * f, axis=-1)
        before = simulator.lyapunov()[0]
        simulator.step(np.stack([v, rate], axis=-1)[None])
        rise[law] = simulator.lyapunov()[0] - before
    assert rise["h"] > 1e-3 and rise["m"] < 0


# ---- limits and frames ------------------------------------------------------------------------


def test_the_turn_limit_is_the_smaller_one():
    slow = five("unicycle", max_turn_rate=0.5)
    for scenario, limit in ((slow, 0.5), (five("unicycle"), 3.0)):
        steering = HeadingFilter(scenario, 1, certified=False)
        observations = Simulator(scenario).reset(0)
        steering.hold(np.ones((1, 5, 1)))
        np.testing.assert_allclose(steering.act(observations)[..., 1], limit, rtol=1e-6)


def test_headings_turn_by_at_most_the_limit():
    scenario = five("single_integrator-2d")
    steering = HeadingFilter(scenario, 1, max_turn_rate=1.0, frame="local")
    observations = Simulator(scenario).reset(0)
    f = scenario.observation_layout.net_bearing(observations)[0]
    first = f / np.linalg.norm(f, axis=-1, keepdims=True)
    steering.hold(np.stack([-f[:, 1], f[:, 0]], axis=-1)[None])
    for k in range(1, 4):
        steering.act(observations)
        cosines = np.sum(steering.headings[0] * first, axis=-1)
        np.testing.assert_allclose(np.arccos(cosines), k * scenario.tau * 1.0, rtol=1e-6)


@pytest.mark.parametrize("rows", [2, 3])
def test_in_space_rounding_does_not_choose_the_second_axis(rows):
    """The parts across f of two neighbours are equal and opposite: the first row counts."""
    scenario = Scenario(n_robots=rows + 1, dim=3, graph="complete")
    random = np.random.default_rng(0)
    axis = None
    for _ in range(200):
        turn, _ = np.linalg.qr(random.normal(size=(3, 3)))
        turn *= np.sign(np.linalg.det(turn))
        seen = np.zeros((1, rows + 1, rows, 3), np.float32)
        table = np.array([[0.6, 0.8, 0.0], [0.8, -0.8, 0.0], [0.1, 0.0, 0.0]])[:rows]
        seen[0, 0] = table @ turn.T
        view = HeadingFilter(scenario, 1).view(seen)[0, 0]
        axis = view if axis is None else axis
        np.testing.assert_allclose(view, axis, atol=1e-6)
    assert axis[0, 1] == pytest.approx(0.8, abs=1e-6)
