"""World of four nodes: moves the robots by ``cmd_vel`` and publishes their measurements.

    python world.py SEED SECONDS

The world runs in real time and prints the result of the run as JSON. If a topic has only one end at
READY, it prints the topic. The yaw of each body is random and changes at random, which the node has
to compensate. Bearings are measured LEAD ahead of the axle, about which a wheeled base turns.
"""

import json
import math
import sys
import time

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped, Twist
from rclpy.clock import Clock, ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu
from std_msgs.msg import Float64MultiArray

import rendezvous_env as rv
from rendezvous_env.engine.memory import RENDEZVOUS
from rendezvous_env.obstacles.fields import ObstacleField

STEP = 0.01  # s
LATE = 0.05  # s: without a command for so long a base stands still
READY = 300.0  # s that robots may take to be there, since they may have to compile
LEAD = 0.1  # m
SCENARIO = rv.Scenario(
    name="hall",
    n_robots=4,
    merge_radius=0.4,
    max_speed=0.5,
    time_step=STEP,
    time_limit=120.0,
    spawn_size=5.0,
    obstacles=ObstacleField(8, (0.2, 0.4), region=4.0, keep_out=0.15),
    obstacle_slots=12,
)


class World(Node):
    """Node that publishes the simulator's bearings as angles."""

    def __init__(self, seed, seconds):
        super().__init__("world")
        self.seconds = seconds
        self.simulator = rv.Simulator(SCENARIO)
        self.simulator.reset(seed)
        self.simulator.step(np.zeros((1, 4, 2), np.float32))  # compiles, if it must
        self.rows = self.simulator.reset(seed)
        self.random = np.random.default_rng(seed)
        self.yaws = self.random.uniform(-3.0, 3.0, 4)
        self.commands, self.heard_at = np.zeros((4, 3)), np.full(4, -math.inf)
        self.sent = [
            {
                "imu": self.create_publisher(Imu, f"/robot{i}/imu", 1),
                "bearings": self.create_publisher(Float64MultiArray, f"/robot{i}/bearings", 1),
                "edges": self.create_publisher(Float64MultiArray, f"/robot{i}/edges", 1),
            }
            for i in range(4)
        ]
        self.truth = [self.create_publisher(PoseStamped, f"/robot{i}/pose", 1) for i in range(4)]
        newest = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
        for i in range(4):
            self.create_subscription(
                Twist, f"/robot{i}/cmd_vel", lambda said, i=i: self.on_command(i, said), newest
            )
        self.began, self.until = None, time.monotonic() + READY
        self.create_timer(STEP, self.go_on, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def on_command(self, robot, said):
        self.commands[robot] = said.linear.x, said.linear.y, said.angular.z
        self.heard_at[robot] = time.monotonic()

    def missing(self):
        """Topics with an end that has not been found yet."""
        told = [one for sent in self.sent for one in sent.values()]
        unheard = [one.topic_name for one in told if not one.get_subscription_count()]
        return unheard + [f"/robot{i}/cmd_vel" for i in np.flatnonzero(np.isinf(self.heard_at))]

    def go_on(self):
        """Step in real time, after all robots are present."""
        now = time.monotonic()
        if self.began is None:
            self.tell()
            if not self.missing():
                self.began, self.until = now, now + self.seconds
            return
        while self.simulator.time[0] < now - self.began and not self.simulator.ended[0]:
            self.step(now)
        self.tell()

    def step(self, now):
        c, s = np.cos(self.yaws), np.sin(self.yaws)
        x, y, turn = np.where(now - self.heard_at < LATE, self.commands.T, 0.0)
        y = y + LEAD * turn
        velocities = np.stack([c * x - s * y, s * x + c * y], axis=-1)[np.newaxis]
        self.rows = self.simulator.step(velocities.astype(np.float32)).observations
        self.yaws += STEP * turn + self.random.normal(0.0, 0.01, 4)

    def tell(self):
        for i in np.flatnonzero(self.simulator.active[0]).tolist():
            seen, yaw = SCENARIO.observation_layout.split(self.rows[0, i]), self.yaws[i]
            present = seen.neighbours[seen.neighbours.any(axis=-1)]
            edges = seen.obstacles[seen.obstacles.any(axis=(1, 2))]
            turned = Imu()
            turned.orientation.z, turned.orientation.w = math.sin(yaw / 2), math.cos(yaw / 2)
            self.truth[i].publish(self.pose_of(i))
            self.sent[i]["imu"].publish(turned)
            self.sent[i]["bearings"].publish(_angles(present, yaw))
            self.sent[i]["edges"].publish(_angles(edges, yaw))

    def pose_of(self, i):
        """Ground truth: the body turns in a local frame, which is turned in the world."""
        frame, place = self.simulator.frames[0, i], self.simulator.positions[0, i]
        heading = self.yaws[i] + math.atan2(frame[1, 0], frame[0, 0])
        pose = PoseStamped()
        pose.pose.position.x, pose.pose.position.y = place.tolist()
        pose.pose.orientation.z = math.sin(heading / 2)
        pose.pose.orientation.w = math.cos(heading / 2)
        return pose


def _angles(vectors, yaw):
    angles = np.arctan2(vectors[..., 1], vectors[..., 0]) - yaw
    return Float64MultiArray(data=angles.ravel().tolist())


def main(seed, seconds):
    with rclpy.init(args=[]):
        world, executor = World(seed, seconds), SingleThreadedExecutor()
        executor.add_node(world)
        simulator = world.simulator
        while time.monotonic() < world.until and not simulator.ended[0]:
            executor.spin_once(timeout_sec=0.1)
        found = {
            "missing": world.missing(),
            "met": bool(simulator.status[0] == RENDEZVOUS),
            "contacts": int(simulator.contacts[0]),
            "time": round(float(simulator.time[0]), 2),
        }
        print(json.dumps(found), flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]), float(sys.argv[2]))
