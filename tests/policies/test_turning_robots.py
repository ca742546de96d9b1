"""Unicycles among obstacles: what they see they do not meet, and V + ΣA never rises."""

import math

import numpy as np
import pytest

import baselines
import rendezvous_env as rv
from baselines.obstacle_rules.tank_policies import HEADING_X, HEADING_Y
from rendezvous_env import Simulator
from rendezvous_env.engine.memory import RENDEZVOUS
from rendezvous_env.trajectory import run

RULES = ("tangent-joined", "tangent-joined-tuned", "tank-joined")


def covered(observations, scenario):
    """Whether the body axis lies inside a silhouette by more than a little, (..., n)."""
    edges = scenario.observation_layout.split(observations).obstacles.astype(np.float64)
    last, first = (np.arctan2(edges[..., k, 1], edges[..., k, 0]) for k in (0, 1))
    width = (last - first) % (2 * np.pi)
    inside = (-first) % (2 * np.pi)
    seen = np.abs(edges[..., 0, :]).sum(axis=-1) > 0
    return (seen & (inside > 1e-3) & (inside < width - 1e-3)).any(axis=-1)


@pytest.mark.parametrize("name", RULES)
def test_no_rule_drives_into_what_it_sees(name):
    scenario = rv.scenarios.get("unicycle-clutter-24-slower").replace(time_limit=20.0)
    simulator, policy = Simulator(scenario, 20), baselines.make(name, scenario)
    rested = drove = 0
    for step in run(simulator, policy, simulator.reset(0)):
        blocked = covered(step.observations, scenario) & step.running[:, None]
        assert (step.actions[..., 0][blocked] == 0.0).all()
        rested += int(blocked.sum())
        drove += int((step.actions[..., 0] > 0.0).sum())
    assert rested > 100 and drove > 5000
    assert not simulator.contacts.any()


def test_what_it_remembers_stands_still_while_the_robot_turns():
    """Beside a wall from −0.5 to 0.5 rad about f it means to go at 0.7 rad, however it has turned;
    it turns on the spot, then drives.
    """
    scenario = rv.scenarios.get("unicycle-clutter-24-slower")
    policy = baselines.make("tank-joined", scenario, clearance=0.2)
    layout, yaw, speeds = scenario.observation_layout, 0.0, []
    for _ in range(40):
        seen = np.zeros((1, scenario.n_robots, *layout.shape), np.float32)
        angles = np.array([0.5, -0.5]) - yaw
        seen[0, 0, layout.neighbours.start] = math.cos(yaw), -math.sin(yaw)
        edges = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        seen[0, 0, layout.obstacles.start : layout.obstacles.start + 2] = edges
        speed, rate = policy(seen, 0.0)[0, 0].tolist()
        assert rate == pytest.approx(min(0.5, (0.7 - yaw) / scenario.tau), abs=1e-4)
        yaw += rate * scenario.tau
        speeds.append(speed)
        x, y = policy._memory[0, 0, [HEADING_X, HEADING_Y]]
        assert yaw + math.atan2(y, x) == pytest.approx(0.7, abs=1e-5)
    assert speeds[0] == 0.0 and speeds[-1] == pytest.approx(1.0, abs=0.4)
    assert yaw == pytest.approx(0.7, abs=1e-4)


def test_a_unicycle_leaves_a_bay_by_its_tank():
    """The only way out leads away from the other robot; a heading rests there for ever."""
    walls = [((0, -1.5), (0, 1.5)), ((-1.5, 1.5), (1.5, 1.5)), ((-1.5, -1.5), (1.5, -1.5))]
    bay = rv.scenarios.get("unicycle-clutter-24-slow").replace(
        name="bay",
        n_robots=2,
        start_positions=((-1.0, 0.3), (1.0, 0.0)),
        obstacles=tuple(rv.Capsule(ends=ends, radius=0.2) for ends in walls),
    )
    for name, meets in (("tangent-joined-tuned", False), ("tank-joined", True)):
        simulator, policy = Simulator(bay), baselines.make(name, bay)
        for _ in run(simulator, policy, simulator.reset(0)):
            pass
        assert (simulator.status[0] == RENDEZVOUS) == meets
        assert simulator.contacts[0] == 0


def test_the_planner_takes_unicycles_along_its_way():
    for name in ("unicycle-clutter-24-slower", "unicycle-rooms"):
        scenario = rv.scenarios.get(name)
        found = rv.rollout(scenario, baselines.make("privileged-planner", scenario), num_envs=20)
        assert found.success.all() and not found.contacts.any()
