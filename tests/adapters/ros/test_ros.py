"""Node of examples/14_ros_node.py: four nodes and a world in separate processes."""

import ctypes
import signal
from importlib import util
from itertools import pairwise

import numpy as np
import pytest

# of what ROS 2 reads its messages with
pytestmark = pytest.mark.filterwarnings("ignore:module 'sre_:DeprecationWarning")

if util.find_spec("rclpy") is None:
    pytest.skip("needs ROS 2", allow_module_level=True)

from one_robot import node_of
from team import percentile, run

TICK = 5e-3
"""Limit of 99 % of the ticks, s of processor time, independent of other processes."""


@pytest.fixture
def alone(monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", "101")
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF")


@pytest.fixture
def node(alone, request):
    """A node with messages and its published commands; parameters are optional."""
    import rclpy

    with rclpy.init(args=getattr(request, "param", [])):
        made, sent = node_of()["RendezvousNode"](), []
        made.commands.publish = sent.append
        yield made, sent
        made.destroy_node()


def look(made, bearings, edges=()):
    """Publish all required topics to a node whose body points along x."""
    from sensor_msgs.msg import Imu
    from std_msgs.msg import Float64MultiArray

    made.on_imu(Imu())
    made.on_bearings(Float64MultiArray(data=bearings))
    made.on_edges(Float64MultiArray(data=edges))


@pytest.mark.parametrize("topic", ["imu", "bearings", "edges"])
def test_node_rests_without_topics(node, topic):
    made, sent = node
    made.tick()
    look(made, [0.5])
    made.tick()
    assert made.robot.time == 0.0  # its first tick; what was compiled with is forgotten
    made.readings.heard_at[topic] -= 1.0
    made.tick()
    speeds = [(one.linear.x**2 + one.linear.y**2) ** 0.5 for one in sent]
    assert speeds == [0.0, pytest.approx(0.5, abs=1e-3), 0.0]
    assert sent[1].linear.y / sent[1].linear.x == pytest.approx(0.5463, abs=1e-3)  # tan 0.5


NAN = float("nan")


@pytest.mark.parametrize(
    ("topic", "data"),
    [
        ("bearings", [NAN]),
        ("bearings", [0.1, 0.2, 0.3, 0.4]),  # a ghost: there are three others
        ("edges", [0.3]),
        ("edges", [0.3, float("inf")]),
        ("edges", [0.1 * k for k in range(26)]),
    ],
)
def test_the_node_drops_and_counts_a_malformed_message(node, topic, data):
    from std_msgs.msg import Float64MultiArray

    made, sent = node
    made.readings.max_age = 60.0  # the first warning takes long
    look(made, [0.5])
    getattr(made, f"on_{topic}")(Float64MultiArray(data=data))
    made.tick()
    assert made.readings.dropped[topic] == 1
    assert sent[0].linear.y / sent[0].linear.x == pytest.approx(0.5463, abs=1e-3)  # as before it


def test_the_node_rests_without_an_orientation(node):
    from sensor_msgs.msg import Imu
    from std_msgs.msg import Float64MultiArray

    made, sent = node
    nothing = Imu()
    nothing.orientation_covariance[0] = -1.0
    turned = Imu()
    turned.orientation.z, turned.orientation.w = NAN, 1.0
    for imu in (nothing, turned):
        made.on_imu(imu)
        made.on_bearings(Float64MultiArray(data=[0.5]))
        made.on_edges(Float64MultiArray(data=[]))
        made.tick()
    assert [(one.linear.x, one.linear.y) for one in sent] == 2 * [(0.0, 0.0)]
    assert made.readings.dropped == {"imu": 2, "bearings": 2, "edges": 2}


ON_WHEELS = ["--ros-args", "-p", "differential_drive:=true"]


@pytest.mark.parametrize("node", [ON_WHEELS], indirect=True)
def test_node_turns_wheels_towards_bearing_and_stops_without(node):
    made, sent = node
    machine, wheels = made.drive.machine, []
    most = machine.wheel_acceleration * machine.timeout  # by which wheels change in a tick
    made.tick()
    for late in (0.0, 1.0):  # the first tick, and one after which wheels turn as they should
        look(made, [0.5])
        if late:
            made.ticked_at -= late
        made.tick()
        wheels.append(made.drive.wheels)
    assert max(wheels[0]) == pytest.approx(most) and max(wheels[1]) > 2 * most
    made.readings.heard_at["edges"] -= 1.0
    for _ in range(20):
        made.tick()
        wheels.append(made.drive.wheels)
    assert all(
        max(after) == pytest.approx(max(max(before) - most, 0.0))
        for before, after in pairwise(wheels[1:])
    )
    going, turning = sent[2].linear.x, machine.lead * sent[2].angular.z
    assert turning / going == pytest.approx(np.tan(0.5), abs=1e-3)
    assert np.hypot(going, turning) == pytest.approx(0.5, abs=1e-3)
    for one in (sent[0], sent[-1]):
        assert (one.linear.x, one.linear.y, one.angular.z) == (0.0, 0.0, 0.0)


@pytest.fixture
def handlers():
    """Restore the previous signal handlers."""
    kept = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in kept.items():
        signal.signal(number, handler)


def test_node_ends_on_sigint(alone, handlers):
    names, ticks = node_of(), []

    @ctypes.CFUNCTYPE(None)  # as kernels call back: what is raised within is printed and lost
    def interrupted():
        signal.raise_signal(signal.SIGINT)

    def tick(self):
        assert not ticks, "the node goes on"
        ticks.append(interrupted())

    names["RendezvousNode"].tick = tick
    names["main"]()
    assert len(ticks) == 1


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "parameters"), [(0, ()), (3, ("differential_drive",))])
def test_four_nodes_meet_among_obstacles(tmp_path, seed, parameters):
    ended, ticks = run(seed, tmp_path, *parameters)  # a process that hangs is an error
    assert not ended["missing"] and ended["met"] and ended["contacts"] == 0
    assert len(ticks) > 300
    assert not any(kernels for *_, kernels in ticks)  # all are there before the node is
    assert percentile([work for _, work, _ in ticks], 0.99) < TICK


@pytest.mark.slow
@pytest.mark.skipif(util.find_spec("rosbags") is None, reason="needs rosbags")
def test_recorder_writes_a_log_that_the_fit_reads(tmp_path):
    """The world's bearings are exact; arrival times of two topics differ by less than a step."""
    from rendezvous_env.calibration import fit_sensor
    from train.sensors.reading import read_log

    ended, _ = run(1, tmp_path, recording=tmp_path / "bag")
    assert ended["met"]
    log = read_log(tmp_path / "bag")
    assert log.names == ("robot0", "robot1", "robot2", "robot3") and log.frames == "listed"
    fit = fit_sensor(log)
    assert fit.parameters["noise"].value < 0.01 and "field_of_view" not in fit.fields
    assert abs(fit.parameters["delay_time"].value) < 0.03
    assert fit.parameters["outliers"].value < 0.05
