"""The world of four nodes: moves the robots as ``cmd_vel`` says, and tells them what they see.

    python world.py SEED SECONDS

It runs by the clock on the wall, and prints how the run ended as JSON. Which way a robot's body
points is its own affair: it turns on the spot at random, and the node has to undo that. Bearings
are those from LEAD ahead of the axle, about which a base on wheels turns.
"""

import json
import math
import sys
import time

import numpy as np
import rclpy
from geometry_msgs.msg import Twist
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu
from std_msgs.msg import Float64MultiArray

import rendezvous_env as rv
from rendezvous_env.engine.memory import RENDEZVOUS
from rendezvous_env.obstacles.fields import ObstacleField

STEP = 0.01  # s
LATE = 0.2  # s: without a command for so long a base stands still
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
    """Simulator in, angles out."""

    def __init__(self, seed):
        super().__init__("world")
        self.simulator = rv.Simulator(SCENARIO)
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
        newest = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
        for i in range(4):
            self.create_subscription(
                Twist, f"/robot{i}/cmd_vel", lambda said, i=i: self.on_command(i, said), newest
            )
        self.began = None
        self.create_timer(STEP, self.go_on)

    def on_command(self, robot, said):
        self.commands[robot] = said.linear.x, said.linear.y, said.angular.z
        self.heard_at[robot] = time.monotonic()

    def go_on(self):
        """Steps as time has passed; it begins once all robots are there."""
        now = time.monotonic()
        if self.began is None:
            self.tell()
            if np.isfinite(self.heard_at).all():
                self.began = now
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
            self.sent[i]["imu"].publish(turned)
            self.sent[i]["bearings"].publish(_angles(present, yaw))
            self.sent[i]["edges"].publish(_angles(edges, yaw))


def _angles(vectors, yaw):
    angles = np.arctan2(vectors[..., 1], vectors[..., 0]) - yaw
    return Float64MultiArray(data=angles.ravel().tolist())


def main(seed, seconds):
    rclpy.init(args=[])
    world, until = World(seed), time.monotonic() + seconds
    while time.monotonic() < until and not world.simulator.ended[0]:
        rclpy.spin_once(world, timeout_sec=0.1)
    simulator = world.simulator
    found = {
        "begun": world.began is not None,
        "met": bool(simulator.status[0] == RENDEZVOUS),
        "contacts": int(simulator.contacts[0]),
        "time": float(simulator.time[0]),
    }
    world.destroy_node()
    rclpy.shutdown()
    print(json.dumps(found), flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]), float(sys.argv[2]))
