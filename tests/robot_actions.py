"""Actions of one robot by itself beside those of the same robot in a batch."""

from collections.abc import Iterator

import numpy as np

import baselines
import rendezvous_env as rv


def neighbour_reading(
    seen, i: int, senses_gravity: bool
) -> tuple[np.ndarray, dict[str, np.ndarray]] | None:
    """Bearings and other arguments of ``act`` of robot i, from the split rows of a team.

    None for a merged robot that senses gravity.
    """
    rows = seen.neighbours[i][seen.neighbours[i].any(axis=-1)]
    told = {"weights": np.linalg.norm(rows, axis=-1)}
    if senses_gravity:
        if not seen.gravity[i].any():
            return None
        told["gravity"] = seen.gravity[i]
    return rows / told["weights"][:, None], told


def single_and_batch(
    policy: baselines.Policy, robot: baselines.RobotPolicy, steps: int = 250
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Actions of robot 1 in each step of an episode: from its own bearings, and of the policy."""
    simulator, layout = rv.Simulator(policy.scenario), policy.scenario.observation_layout
    observations = simulator.reset(3)
    for _ in range(steps):
        actions = policy(observations, simulator.time)
        seen = layout.split(observations[0, 1])
        rows = seen.neighbours[seen.neighbours.any(axis=-1)]
        edges = seen.obstacles[seen.obstacles.any(axis=(-1, -2))]
        yield robot.act(rows, edges), actions[0, 1]
        observations = simulator.step(actions).observations
    assert (simulator.positions[0, 1] != 0).any()
