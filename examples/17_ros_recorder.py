"""Recorder of bearings and ground truth in ROS 2, for ``rendezvous sensor``.

    python examples/17_ros_recorder.py OUT robot0 robot1 robot2 robot3

It needs `pip install '.[ros,logs]'`. For each robot it records ``bearings``, which the
node of 14_ros_node.py receives, and ``pose``, geometry_msgs/PoseStamped of motion capture, until
Ctrl-C. OUT is a folder of rosbag2 in MCAP. Times are those of arrival, so one clock stamps all.
"""

import signal
import sys
import time
from pathlib import Path

import rclpy
from geometry_msgs.msg import PoseStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Float64MultiArray

from train.sensors.recorder import Recorder

TOPICS = {"bearings": Float64MultiArray, "pose": PoseStamped}


class RecorderNode(Node):
    """Node that writes serialised messages as they arrive."""

    def __init__(self, recorder, robots):
        super().__init__("recorder")
        every = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)
        for robot in robots:
            for what, kind in TOPICS.items():
                self.create_subscription(
                    kind,
                    f"/{robot}/{what}",
                    lambda raw, robot=robot, what=what: recorder.write(
                        robot, what, time.time_ns(), bytes(raw)
                    ),
                    every,
                    raw=True,
                )


def main(out, robots):
    """Record until Ctrl-C."""
    signals = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _: signals.append(number))
    with (
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO),
        Recorder(Path(out)) as recorder,
    ):
        executor = SingleThreadedExecutor()
        executor.add_node(RecorderNode(recorder, robots))
        while not signals:
            executor.spin_once(timeout_sec=0.1)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
