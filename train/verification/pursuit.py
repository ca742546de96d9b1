"""Pursuit by robots with a turn limit (guarantees 13, E2)."""

from __future__ import annotations

import numpy as np

from baselines.pursuit import Pursuit
from rendezvous_env.trajectory import Policy

from .cases import Case


def pursuit(case: Case, num_envs: int, random: np.random.Generator) -> Policy:
    """Pursuers at the scenario's speed limit; each would rather pursue somebody else."""
    n, rows = case.scenario.n_robots, case.scenario.observation_layout.neighbour_slots
    order = np.argsort(-random.random((num_envs, n, rows)), axis=-1)
    return Pursuit(case.scenario, case.scenario.speed_limit, order)
