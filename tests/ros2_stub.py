"""As much of ROS 2 as a node needs that subscribes, publishes and ticks; time is told to it."""

from __future__ import annotations

import sys
from types import ModuleType, SimpleNamespace
from typing import Any, NamedTuple


class Instant(NamedTuple):
    """A moment, or how long it is between two."""

    nanoseconds: int

    def __sub__(self, other):
        return Instant(self.nanoseconds - other.nanoseconds)


class Node:
    """A node on a bus of its own, whose clock is set from outside."""

    def __init__(self, name):
        self.now, self.heard, self.timers, self.sent = 0.0, {}, [], []

    def create_subscription(self, kind, topic, callback, depth):
        self.heard[topic] = kind, callback

    def create_publisher(self, kind, topic, depth):
        def publish(message):
            assert isinstance(message, kind)
            self.sent.append((topic, message))

        return SimpleNamespace(publish=publish)

    def create_timer(self, period, callback):
        self.timers.append((period, callback))

    def get_clock(self):
        return SimpleNamespace(now=lambda: Instant(round(self.now * 1e9)))

    def hear(self, topic, **fields: Any):
        kind, callback = self.heard[topic]
        message = kind()
        vars(message).update(fields)
        callback(message)


class Twist:
    def __init__(self):
        self.linear, self.angular = (SimpleNamespace(x=0.0, y=0.0, z=0.0) for _ in range(2))


class Imu:
    def __init__(self):
        self.orientation = SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)


class Float64MultiArray:
    def __init__(self):
        self.data = []


def install(monkeypatch):
    """Put it where the node looks for ROS 2."""
    said = []
    contents: dict[str, dict[str, Any]] = {
        "rclpy": {
            "init": lambda: said.append("init"),
            "spin": lambda node: said.append(node),
            "shutdown": lambda: said.append("shutdown"),
        },
        "rclpy.node": {"Node": Node},
        "geometry_msgs": {},
        "geometry_msgs.msg": {"Twist": Twist},
        "sensor_msgs": {},
        "sensor_msgs.msg": {"Imu": Imu},
        "std_msgs": {},
        "std_msgs.msg": {"Float64MultiArray": Float64MultiArray},
    }
    for name, names in contents.items():
        module = ModuleType(name)
        vars(module).update(names)
        monkeypatch.setitem(sys.modules, name, module)
    return said
