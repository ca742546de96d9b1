"""Bodies that pack, with the Robotarium's numbers: ``packing.py [SEEDS]`` plays teams of 2 to 20.

Law (1), which knows bearings, beside consensus, which knows distances: how many met, how near two
robots ever came, and how wide the team is once nothing moves any more. ``docked`` is law (1) of
robots that no longer look at whom they touch, as a link is gone with a merge.
"""

from __future__ import annotations

import sys
from typing import NamedTuple

import numpy as np

import baselines
import rendezvous_env as rv
from rendezvous_env import graphs
from rendezvous_env.engine.memory import RENDEZVOUS, RUNNING
from rendezvous_env.sensors.custom_sensors import Seen

SIZES = (2, 3, 4, 5, 6, 7, 8, 9, 10, 12, 14, 16, 18, 20)
BODY = 0.075  # m
EXACT = rv.Sensing()
COLLISION = 0.135
"""m; two robots nearer than this count as colliding there."""


TOUCHING = 0.155
"""m; robots this near need not look at each other."""


class Played(NamedTuple):
    """What became of many teams."""

    met: int
    closest: float
    """Least distance of two robots in any step, m."""
    diameter: float
    """Largest distance of two robots of a team at the end, mean, m."""
    seconds: float
    """Median time."""


@rv.sensor_imperfection("docked")
def docked(seen: Seen) -> None:
    """Whom a robot touches it does not see."""
    n = seen.positions.shape[1]
    others = np.array([[j for j in range(n) if j != i] for i in range(n)])
    offsets = seen.positions[:, others] - seen.positions[:, :, np.newaxis]
    seen.neighbours[np.linalg.norm(offsets, axis=-1) <= TOUCHING] = 0.0


def arena(robots: int, settled: bool = False, sensing: rv.Sensing = EXACT) -> rv.Scenario:
    """``robotarium-4`` with another number of robots; ``settled`` ends only once bodies touch to
    the last digit, or after 40 s.
    """
    scenario = rv.scenarios.get("robotarium-4")
    name, graph = f"robotarium-{robots}", graphs.complete(0.2 / (robots - 1))
    changes = {"merge_radius": 2.0 * BODY, "time_limit": 40.0} if settled else {}
    return scenario.replace(name=name, n_robots=robots, graph=graph, sensing=sensing, **changes)


def play(scenario: rv.Scenario, policy: str, seeds: int) -> Played:
    """The seeds from 0 on."""
    simulator, chosen = rv.Simulator(scenario, num_envs=seeds), baselines.make(policy, scenario)
    observations, closest = simulator.reset(list(range(seeds))), np.inf
    if watch := getattr(chosen, "watch", None):
        watch(simulator)
    pairs = np.triu_indices(scenario.n_robots, 1)
    while (simulator.status == RUNNING).any():
        actions = chosen(observations, simulator.steps * scenario.tau)
        observations = simulator.step(actions).observations
        apart = distances(simulator.positions, pairs)
        closest = min(closest, float(apart.min()))
    met = simulator.status == RENDEZVOUS
    seconds = float(np.median(simulator.steps)) * scenario.tau
    return Played(int(met.sum()), closest, float(apart.max(axis=1).mean()), seconds)


def distances(positions: np.ndarray, pairs: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Of all pairs of robots, (B, pairs), m."""
    return np.linalg.norm(positions[:, pairs[0]] - positions[:, pairs[1]], axis=-1)


def ratios(robots: int, seeds: int) -> tuple[Played, Played, float, float]:
    """Law (1) as its episodes end; consensus at rest; by how much wider law (1) is at rest, and
    where robots do not look at whom they touch.
    """
    law = play(arena(robots), "bearing-only", seeds)
    oracle = play(arena(robots, settled=True), "privileged-consensus", seeds)
    wide = [
        play(arena(robots, True, sensing), "bearing-only", seeds).diameter / oracle.diameter
        for sensing in (EXACT, rv.Sensing(custom=("docked",)))
    ]
    return law, oracle, wide[0], wide[1]


def main(seeds: int) -> None:
    """A table, a row for each size of team."""
    print("| n | met | median time, s | closest, m | consensus, m | law (1) | docked |")
    print("|---|---|---|---|---|---|---|")
    for robots in SIZES:
        law, oracle, plain, without = ratios(robots, seeds)
        print(
            f"| {robots} | {law.met} of {seeds} | {law.seconds:.1f} | {law.closest:.4f} | "
            f"{oracle.diameter:.3f} | {plain:.3f} | {without:.3f} |",
            flush=True,
        )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 1000)
