"""Packing of robot bodies with Robotarium parameters: ``packing.py [SEEDS]``.

For teams of 2 to 20 robots, the table compares law (1), from bearings, with consensus, from
distances: success, smallest distance of two robots, and diameter at rendezvous and at rest.
"""

from __future__ import annotations

import sys
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import baselines
import rendezvous_env as rv
from rendezvous_env import graphs
from rendezvous_env.engine.memory import RENDEZVOUS, RUNNING

Array = NDArray[np.float64]
ON = 25.0
"""Additional time after the last rendezvous, s, after which all robots rest."""
STILL = 1e-8
"""Displacement in a step below which a robot counts as resting, m."""
COMPARED = 300
"""Number of seeds for which diameters are measured."""


class PackingResult(NamedTuple):
    """Results of many teams."""

    met: int
    closest: float
    """Smallest distance of two robots in any step, m."""
    diameter: float
    """Mean over teams of the largest distance of two robots at rendezvous, m."""
    at_rest: float
    """As ``diameter``, at rest."""
    seconds: float
    """Median rendezvous time."""


def arena(robots: int) -> rv.Scenario:
    """Scenario ``robotarium-4`` with another number of robots."""
    scenario, graph = rv.scenarios.get("robotarium-4"), graphs.complete(0.2 / (robots - 1))
    return scenario.replace(name=f"robotarium-{robots}", n_robots=robots, graph=graph)


def play(scenario: rv.Scenario, policy: str, seeds: int) -> PackingResult:
    """Run the seeds from 0 on."""
    simulator, chosen = rv.Simulator(scenario, num_envs=seeds), baselines.make(policy, scenario)
    observations, closest = simulator.reset(list(range(seeds))), np.inf
    if watch := getattr(chosen, "watch", None):
        watch(simulator)
    while (simulator.status == RUNNING).any():
        actions = chosen(observations, simulator.steps * scenario.tau)
        observations = simulator.step(actions).observations
        apart = distances(simulator.positions)
        closest = min(closest, float(apart.min()))
    rest, nearest = go_on(simulator.positions[:COMPARED], scenario, policy)
    return PackingResult(
        met=int((simulator.status == RENDEZVOUS).sum()),
        closest=min(closest, nearest),
        diameter=float(apart[:COMPARED].max(axis=1).mean()),
        at_rest=float(distances(rest).max(axis=1).mean()),
        seconds=float(np.median(simulator.steps)) * scenario.tau,
    )


def go_on(positions: Array, scenario: rv.Scenario, policy: str) -> tuple[Array, float]:
    """Positions at rest of teams (B, n, 2), m, and the smallest distance on the path.

    Episodes end at rendezvous but robots move on, so each step starts an episode.
    """
    simulator = rv.Simulator(scenario, num_envs=len(positions))
    chosen, closest = baselines.make(policy, scenario), np.inf
    if watch := getattr(chosen, "watch", None):
        watch(simulator)
    for _ in range(round(ON / scenario.tau)):
        before = positions.copy()
        seen = simulator.reset(0, {"positions": before})
        simulator.step(chosen(seen, simulator.steps * scenario.tau))
        positions = simulator.positions
        closest = min(closest, float(distances(positions).min()))
        if np.abs(positions - before).max() <= STILL:
            break
    return positions, closest


def distances(positions: Array) -> Array:
    """Distances of all pairs of robots, (B, pairs), m."""
    first, second = np.triu_indices(positions.shape[1], 1)
    return np.linalg.norm(positions[:, first] - positions[:, second], axis=-1)


def main(seeds: int) -> None:
    """Print a table with a row per team size; ratios are law (1) over consensus."""
    print("| n | met | median time, s | closest, m | when met, m | ratio | at rest, m | ratio |")
    print("|---|---|---|---|---|---|---|---|")
    for robots in range(2, 21):
        law = play(arena(robots), "bearing-only", seeds)
        other = play(arena(robots), "privileged-consensus", min(seeds, COMPARED))
        print(
            f"| {robots} | {law.met} of {seeds} | {law.seconds:.1f} | {law.closest:.4f} | "
            f"{law.diameter:.3f} | {law.diameter / other.diameter:.3f} | "
            f"{law.at_rest:.3f} | {law.at_rest / other.at_rest:.3f} |",
            flush=True,
        )


if __name__ == "__main__":
    given = sys.argv[1] if len(sys.argv) > 1 else "1000"
    if not given.isdecimal() or int(given) == 0:
        sys.exit(f"SEEDS is {given!r}; it must be an integer, 1 or more")
    main(int(given))
