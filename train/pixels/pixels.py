"""``rendezvous reproduce pixels``: policies that act on camera images alone."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rendezvous_env.baselines.observation_builder import ObservationBuilder

from rendezvous_env.deprecation import renamed_attribute
from rendezvous_env.engine.memory import RENDEZVOUS
from rendezvous_env.obstacles.fields import ObstacleField
from rendezvous_env.scenario.scenario import Scenario
from rendezvous_env.sensors.sensing import Sensing
from rendezvous_env.simulator import Simulator

from ..compare import evaluation
from ..compare.statistics import fraction_interval
from .detector import Detections, Detector
from .eyes import HEIGHT, LAMPS, Eyes
from .last_seen import make, unit

SCENARIO = Scenario(
    name="pixels",
    n_robots=4,
    merge_radius=0.4,
    max_speed=1.0,
    time_step=0.05,
    time_limit=60.0,
    spawn_size=10.0,
    obstacles=ObstacleField(8, (0.4, 1.0), region=8.0, keep_out=0.25),
    obstacle_slots=24,
)
"""``clutter-8`` at half its size, with lamps of diameter 0.4 m as robots."""
POLICIES = ("bearing-only", "tangent-merged-tuned", "learned", "learned-tank")

Watcher = Callable[[Simulator, Eyes, NDArray[np.uint8], list[Detections | None]], None]
"""Callback before every step: simulator, cameras, images, detections."""


@dataclass(frozen=True)
class Episode:
    """Result of one episode."""

    met: bool
    collision_free: bool
    time: float  # simulated, s
    steps: int
    work: float  # core time for rendering, detection, policy and motion, s

    clean = renamed_attribute("clean", "collision_free")


def play(policy: str, seeds: range, watch: Watcher | None = None) -> Iterator[Episode]:
    """Run episodes with the given seeds from images alone."""
    layout, n = SCENARIO.observation_layout, SCENARIO.n_robots
    simulator = Simulator(SCENARIO)
    simulator.reset(seeds[0])
    eyes, driver = Eyes(simulator), make(policy, SCENARIO)
    detector = Detector(np.array(LAMPS[:n]), HEIGHT, SCENARIO.obstacle_range)
    try:
        for seed in seeds:
            simulator.reset(seed)
            driver.reset()
            builders = [ObservationBuilder(layout, SCENARIO.max_degree) for _ in range(n)]
            began, steps = time.process_time(), 0
            while not simulator.ended[0]:
                eyes.place()
                pictures, active = eyes.look(), simulator.active[0]
                seen = [detector.find(pictures[i]) if active[i] else None for i in range(n)]
                if watch is not None:
                    watch(simulator, eyes, pictures, seen)
                rows = np.zeros((1, n, *layout.shape), np.float32)
                for i, found in enumerate(seen):
                    if found is not None:
                        edges = found.edges[: layout.obstacle_slots]
                        rows[0, i] = builders[i].rows(unit(found.bearings), unit(edges), None)
                simulator.step(driver(rows, float(simulator.time[0])))
                steps += 1
            met = bool(simulator.status[0] == RENDEZVOUS)
            free, work = met and not simulator.contacts[0], time.process_time() - began
            yield Episode(met, bool(free), float(simulator.time[0]), steps, work)
    finally:
        eyes.close()


def compare(policy: str, episodes: int, seed: int) -> dict[str, Any]:
    """Success from images, from exact sensors and from ``Sensing.camera()``."""

    def simulated(sensing: Sensing) -> float:
        """Collision-free success from the same initial conditions, without images."""
        scenario = SCENARIO.replace(sensing=sensing)
        own = partial(make, policy, scenario)
        found, _ = evaluation.play(scenario, own, margin=None, episodes=episodes, seed=seed)
        return float(found.collision_free.mean())

    found = list(play(policy, range(seed, seed + episodes)))
    free = np.array([one.collision_free for one in found])
    low, high = fraction_interval(free)
    return {
        "policy": policy,
        "episodes": episodes,
        "collision_free": float(free.mean()),
        "low": low,
        "high": high,
        "met": float(np.mean([one.met for one in found])),
        "time": float(np.median([one.time for one in found])),
        "predicted": simulated(Sensing.camera()),
        "exact": simulated(Sensing()),
        "steps_per_core_second": sum(one.steps for one in found) / sum(one.work for one in found),
    }
