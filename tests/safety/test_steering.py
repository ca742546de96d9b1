"""HeadingFilter: V beside obstacles under any raw vectors; frames, arcs, limits."""

import math

import numpy as np
import pytest
from conftest import five

import rendezvous_env as rv
from rendezvous_env import Scenario, Simulator
from rendezvous_env.safety.heading import HeadingFilter
from rendezvous_env.trajectory import run
from train.verify.adversaries import Adversary
from train.verify.monitors import Moment

TEAMS = 48
ROUNDING = 2.0**-20
"""Of float32 rows and actions, relative to n D̄² τ ."""
CLUTTERS = {
    "clutter-12": rv.scenarios.get("clutter-12"),
    "clutter-3d": rv.scenarios.get("clutter-3d"),
    "unicycle": rv.scenarios.get("clutter-12").replace(robot_model="unicycle"),
    "nonholonomic_3d": rv.scenarios.get("clutter-3d").replace(robot_model="nonholonomic_3d"),
}


@pytest.mark.parametrize("contact", ["stop", "slide"])
@pytest.mark.parametrize("name", CLUTTERS)
def test_v_never_rises_beside_obstacles_but_while_a_robot_slides(name, contact):
    """A slide takes away the inward part of h hᵀf and may leave an uphill one; whatever the raw
    vectors. What certificates promise holds without obstacles, see test_promises.
    """
    scenario = CLUTTERS[name].replace(obstacle_contact=contact, time_limit=15.0)
    adversary = Adversary(scenario, TEAMS, "heading", np.random.default_rng(3), 3.0)
    steering, simulator = HeadingFilter(scenario, TEAMS, frame="local"), Simulator(scenario, TEAMS)

    def policy(seen, time):
        steering.hold(adversary(seen, Moment(simulator)))
        return steering.act(seen)

    most, contacts = scenario.tau * scenario.n_robots * scenario.max_degree**2, 0
    for step in run(simulator, policy, simulator.reset(3)):
        out, on = step.outcome, step.running
        rise = out.lyapunov_before_merge - step.lyapunov - ROUNDING * most - 1e-12 * step.lyapunov
        slides = on & out.contact.any(axis=-1) & (contact == "slide")
        assert (rise[on & ~slides] <= 0).all() and (rise[slides] <= most).all()
        contacts += int((on & out.contact.any(axis=-1)).sum())
    assert contacts > 100


def test_the_turn_limit_is_the_smaller_one():
    slow = five("unicycle", max_turn_rate=0.5)
    for scenario, limit in ((slow, 0.5), (five("unicycle"), 3.0)):
        steering = HeadingFilter(scenario, 1, certified=False)
        observations = Simulator(scenario).reset(0)
        steering.hold(np.ones((1, 5, 1)))
        np.testing.assert_allclose(steering.act(observations)[..., 1], limit, rtol=1e-6)


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


def test_a_robot_goes_slower_by_what_errors_could_feign():
    scenario = Scenario(n_robots=3)
    options = {"frame": "local", "min_alignment": 0.5}
    wary, sure = (HeadingFilter(scenario, 1, **options, bearing_error=e) for e in (0.3, 0.0))
    observations = Simulator(scenario).reset(0)
    f = scenario.observation_layout.net_bearing(observations)
    actions = []
    for steering in (wary, sure):
        steering.hold(f)
        actions.append(np.linalg.norm(steering.act(observations), axis=-1))
    strength = np.linalg.norm(f, axis=-1)
    slower = np.maximum(strength - 2 * math.sin(0.15) * 2.0, 0.0)
    np.testing.assert_allclose(actions[0], slower, atol=1e-6)
    np.testing.assert_allclose(actions[1], strength, atol=1e-6)
    np.testing.assert_allclose(wary.lyapunov_rate, -2 * strength * slower, atol=1e-5)
