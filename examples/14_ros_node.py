"""One robot of a team of four that meets by bearings alone, as a ROS 2 node.

    python examples/14_ros_node.py --ros-args -r __ns:=/robot0 [-p differential_drive:=true]

It needs `pip install 'rendezvous-env[ros]'`, or a ROS 2 installation. Topics: `imu`, for the body's
yaw; `bearings` and `edges`, angles in rad from the body's x axis; `cmd_vel` out. A message that is
malformed is dropped and counted; without an orientation, or with one topic too old, it rests.
"""

import math
import signal
import time

import rclpy
from geometry_msgs.msg import Twist
from rclpy.clock import Clock, ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import Imu
from std_msgs.msg import Float64MultiArray

import rendezvous_env as rv
from baselines import RobotPolicy
from baselines.robot_readings import BodyReadings
from rendezvous_env.robots.differential_drive import DifferentialDrive, Machine

SCENARIO = rv.Scenario(
    name="hall", n_robots=4, merge_radius=0.4, max_speed=0.5, time_step=0.05, obstacle_slots=12
)
PERIOD = 0.03  # s, between ticks; with what a timer is late by, less than time_step
TOO_OLD = 0.2  # s: a robot that has not heard one of its topics for so long rests
MACHINE = Machine(
    wheel_radius=0.05,
    base_length=0.3,
    lead=0.1,
    wheel_speed=20.0,
    wheel_acceleration=60.0,
    timeout=PERIOD,  # in the first tick for which what was seen is too old
)


class RendezvousNode(Node):
    """Bearings in, Twist out."""

    def __init__(self):
        super().__init__("rendezvous")
        self.robot = RobotPolicy(SCENARIO, "learned-tank")
        self.robot.act([[1.0, 0.0]], [[[0.8, 0.6], [0.8, -0.6]]])  # compiles, if it must
        self.robot.reset()
        self.readings = BodyReadings(SCENARIO.observation_layout, TOO_OLD)
        self.ticked_at = None
        on_wheels = self.declare_parameter("differential_drive", False).value
        self.drive = DifferentialDrive(MACHINE) if on_wheels else None
        self.create_subscription(Imu, "imu", self.on_imu, 1)
        self.create_subscription(Float64MultiArray, "bearings", self.on_bearings, 1)
        self.create_subscription(Float64MultiArray, "edges", self.on_edges, 1)
        self.commands = self.create_publisher(Twist, "cmd_vel", 1)
        steady = Clock(clock_type=ClockType.STEADY_TIME)  # the node's own can be set back
        self.create_timer(PERIOD, self.tick, clock=steady)

    def on_imu(self, message):
        """An orientation."""
        q = message.orientation
        covariance = message.orientation_covariance
        self.check(self.readings.see_orientation(now(), (q.x, q.y, q.z, q.w), covariance))

    def on_bearings(self, message):
        """Bearings of neighbours."""
        self.check(self.readings.see_bearings(now(), message.data))

    def on_edges(self, message):
        """Edges of obstacles."""
        self.check(self.readings.see_edges(now(), message.data))

    def check(self, was_used):
        """Warn of a message that was dropped, once a second at most."""
        if not was_used:
            told = f"dropped so far: {self.readings.dropped}"
            self.get_logger().warning(told, throttle_duration_sec=1.0)

    def tick(self):
        """Publish what to do until the next tick."""
        command, time_now = Twist(), now()
        seen = self.readings.at(time_now)
        if seen is not None:
            late = PERIOD if self.ticked_at is None else max(time_now - self.ticked_at, 1e-6)
            x, y = self.robot.act(seen.bearings, seen.obstacles, dt=late)
            self.ticked_at = time_now
            if self.drive is None:
                c, s = math.cos(seen.yaw), math.sin(seen.yaw)
                command.linear.x, command.linear.y = c * x + s * y, c * y - s * x
            else:
                command.linear.x, command.angular.z = self.drive.command((x, y), seen.yaw, late)
        elif self.drive is not None:
            command.linear.x, command.angular.z = self.drive.hold(PERIOD)
        self.commands.publish(command)


def now():
    """s, by a clock that only goes forward."""
    return time.monotonic()


def main():
    """Run until Ctrl-C."""
    # ROS 2's handler takes the publisher away from a tick, and a KeyboardInterrupt may be lost in
    # compiled code: signals are noted instead, and read between callbacks
    signals = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _: signals.append(number))
    with rclpy.init(signal_handler_options=SignalHandlerOptions.NO):
        executor = SingleThreadedExecutor()
        executor.add_node(RendezvousNode())
        while not signals:  # the base stops when no cmd_vel comes
            executor.spin_once(timeout_sec=PERIOD)


if __name__ == "__main__":
    main()
