"""The ROS 2 node of docs/robot.md, run: four of them, each with a clock and a yaw of its own."""

import re
from types import SimpleNamespace

import numpy as np
import pytest
import ros2_stub
from conftest import ROOT

import rendezvous_env as rv
from rendezvous_env.engine.memory import RENDEZVOUS, RUNNING


@pytest.fixture
def page(monkeypatch):
    """The names of the node's file, and what it told ROS 2."""
    said = ros2_stub.install(monkeypatch)
    text = (ROOT / "docs/robot.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(# rendezvous_node\.py\n.*?)```", text, flags=re.DOTALL)
    names = {"__name__": "rendezvous_node"}
    exec(compile(code, "rendezvous_node.py", "exec"), names)
    return SimpleNamespace(**names, said=said)


def look(node, rows, layout, yaw):
    """Tell a node what it sees, as angles from its body's x axis; the world's frame is another."""
    seen = layout.split(rows)
    present = seen.neighbours[seen.neighbours.any(axis=-1)]
    edges = seen.obstacles[seen.obstacles.any(axis=(1, 2))]
    half = SimpleNamespace(x=0.0, y=0.0, z=np.sin(0.5 * yaw), w=np.cos(0.5 * yaw))
    node.hear("imu", orientation=half)
    node.hear("bearings", data=(np.arctan2(present[:, 1], present[:, 0]) - yaw).tolist())
    node.hear("edges", data=(np.arctan2(edges[..., 1], edges[..., 0]) - yaw).ravel().tolist())


def test_four_nodes_meet_among_obstacles(page):
    """They turn on the spot at random, and tick 30 to 50 ms after their last tick."""
    random = np.random.default_rng(0)
    scenario = page.SCENARIO.replace(
        obstacles=rv.scenarios.get("clutter-8").obstacles,
        spawn_size=16.0,
        time_step=0.01,
        time_limit=120.0,
    )
    assert scenario.observation_layout == page.SCENARIO.observation_layout
    nodes, simulator = [page.RendezvousNode() for _ in range(4)], rv.Simulator(scenario)
    rows, yaws = simulator.reset(1), random.uniform(-3.0, 3.0, 4)
    velocities, due = np.zeros((1, 4, 2), np.float32), np.zeros(4)
    while simulator.status[0] == RUNNING:
        for i in np.flatnonzero(due <= simulator.steps[0]):
            node = nodes[i]
            node.now = 0.01 * float(simulator.steps[0])
            look(node, rows[0, i], scenario.observation_layout, yaws[i])
            ((period, tick),) = node.timers
            tick()
            assert period == page.PERIOD
            sent, c, s = node.sent[-1][1].linear, np.cos(yaws[i]), np.sin(yaws[i])
            velocities[0, i] = c * sent.x - s * sent.y, s * sent.x + c * sent.y
            due[i] += random.integers(3, 6)
            yaws[i] += random.normal(0.0, 0.05)
        rows = simulator.step(velocities).observations
    assert simulator.status[0] == RENDEZVOUS
    assert all(0.0 < node.robot.time <= node.now for node in nodes)


def test_who_sees_nothing_rests(page):
    node = page.RendezvousNode()
    ((_, tick),) = node.timers
    tick()
    node.hear("bearings", data=[0.5])
    tick()
    node.now = 1.0
    tick()
    speeds = [np.hypot(sent.linear.x, sent.linear.y) for _, sent in node.sent]
    assert speeds[0] == speeds[2] == 0.0 and speeds[1] == pytest.approx(0.5, abs=1e-3)
    assert np.arctan2(node.sent[1][1].linear.y, node.sent[1][1].linear.x) == pytest.approx(0.5)


def test_the_program_spins_a_node(page):
    page.main()
    first, node, last = page.said
    assert (first, last) == ("init", "shutdown") and isinstance(node, page.RendezvousNode)
