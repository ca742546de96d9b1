"""The ROS 2 node of docs/robot.md, run: four of them and a world, each a process of its own."""

from __future__ import annotations

from importlib import util

import pytest

# of what ROS 2 reads its messages with
pytestmark = pytest.mark.filterwarnings("ignore:module 'sre_:DeprecationWarning")

if util.find_spec("rclpy") is None:
    pytest.skip("needs ROS 2", allow_module_level=True)

from one_robot import node_of
from team import percentile, run

TICK = 5e-3
"""s that 99 of 100 ticks keep within, of the processor: what else runs here is not the node's."""


@pytest.fixture
def node(monkeypatch):
    """A node that hears what it is told, and what it publishes."""
    import rclpy

    monkeypatch.setenv("ROS_DOMAIN_ID", "101")
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF")
    with rclpy.init(args=[]):
        made, sent = node_of()["RendezvousNode"](), []
        made.commands.publish = sent.append
        yield made, sent
        made.destroy_node()


def test_who_sees_nothing_rests(node):
    from rclpy.duration import Duration
    from std_msgs.msg import Float64MultiArray

    made, sent = node
    made.tick()
    made.on_bearings(Float64MultiArray(data=[0.5]))
    made.tick()
    assert made.robot.time == 0.0
    made.seen_at = made.get_clock().now() - Duration(seconds=1.0)
    made.tick()
    speeds = [(one.linear.x**2 + one.linear.y**2) ** 0.5 for one in sent]
    assert speeds == [0.0, pytest.approx(0.5, abs=1e-3), 0.0]
    assert sent[1].linear.y / sent[1].linear.x == pytest.approx(0.5463, abs=1e-3)  # tan 0.5


@pytest.mark.slow
def test_four_nodes_meet_among_obstacles(tmp_path):
    ticks = []
    for seed in (0, 1):
        (folder := tmp_path / str(seed)).mkdir()
        ended, took = run(seed, folder)  # a process that hangs is an error
        assert ended["begun"] and ended["met"] and ended["contacts"] == 0
        ticks += took
    assert len(ticks) > 300
    assert percentile([work for _, work in ticks], 0.99) < TICK
