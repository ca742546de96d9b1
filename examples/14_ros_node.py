"""ROS 2 node of one robot in a team of four that meets from bearings only.

    python examples/14_ros_node.py --ros-args -r __ns:=/robot0 [-p differential_drive:=true]

It needs `pip install '.[ros]'`, or a ROS 2 installation. Input topics are `imu`, for
the body's yaw, and `bearings` and `edges`, angles in rad from the body's x axis. The output is
`cmd_vel`. A malformed message is dropped and counted. Without an orientation, or with one topic too
old, the robot rests.
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
PERIOD = 0.03  # s, between ticks; less than time_step by the timer's delay
TOO_OLD = 0.2  # s: maximum age of a topic; beyond it the robot rests
MACHINE = Machine(
    wheel_radius=0.05,
    base_length=0.3,
    lead=0.1,
    wheel_speed=20.0,
    wheel_acceleration=60.0,
    timeout=PERIOD,  # the first tick with outdated measurements
)


class RendezvousNode(Node):
    """Node that converts bearings to a Twist."""

    def __init__(self):
        super().__init__("rendezvous")
        self.robot = RobotPolicy(SCENARIO, "learned-tank")
        self.robot.act([[1.0, 0.0]], [[[0.8, 0.6], [0.8, -0.6]]])  # compile in advance
        self.robot.reset()
        self.readings = BodyReadings(SCENARIO.observation_layout, TOO_OLD)
        self.ticked_at = None
        on_wheels = self.declare_parameter("differential_drive", False).value
        self.drive = DifferentialDrive(MACHINE) if on_wheels else None
        self.create_subscription(Imu, "imu", self.on_imu, 1)
        self.create_subscription(Float64MultiArray, "bearings", self.on_bearings, 1)
        self.create_subscription(Float64MultiArray, "edges", self.on_edges, 1)
        self.commands = self.create_publisher(Twist, "cmd_vel", 1)
        steady = Clock(clock_type=ClockType.STEADY_TIME)  # the node's clock can be set back
        self.create_timer(PERIOD, self.tick, clock=steady)

    def on_imu(self, message):
        """Store an orientation."""
        q = message.orientation
        covariance = message.orientation_covariance
        self.check(self.readings.see_orientation(now(), (q.x, q.y, q.z, q.w), covariance))

    def on_bearings(self, message):
        """Store bearings of neighbours."""
        self.check(self.readings.see_bearings(now(), message.data))

    def on_edges(self, message):
        """Store edges of obstacles."""
        self.check(self.readings.see_edges(now(), message.data))

    def check(self, was_used):
        """Log a warning for a dropped message, at most once per second."""
        if not was_used:
            told = f"dropped so far: {self.readings.dropped}"
            self.get_logger().warning(told, throttle_duration_sec=1.0)

    def tick(self):
        """Publish the command until the next tick."""
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
    """Time of a monotonic clock, s."""
    return time.monotonic()


def main():
    """Run until Ctrl-C."""
    # ROS 2's handler would invalidate the publisher in a tick, and compiled code may swallow a
    # KeyboardInterrupt: signals are recorded instead, and checked between callbacks
    signals = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _: signals.append(number))
    with rclpy.init(signal_handler_options=SignalHandlerOptions.NO):
        executor = SingleThreadedExecutor()
        executor.add_node(RendezvousNode())
        while not signals:  # the base stops without cmd_vel
            executor.spin_once(timeout_sec=PERIOD)


if __name__ == "__main__":
    main()
