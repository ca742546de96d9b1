"""Digest of a scenario's first initial conditions, to decide whether results are comparable."""

import hashlib
import json

import numpy as np

from .scenario.scenario import Scenario
from .scenario.scenarios import ScenarioLike, resolve
from .simulator import Simulator

STARTS = 1000
"""Number of seeds in the digest, from 0."""
_DECIMALS = 9  # significant decimals; the last bits of a cosine depend on the machine
_NOT_OF_THE_FIELD = ("name", "reward", "costs")


def digest(scenario: ScenarioLike) -> str:
    """SHA-256 of a scenario's non-default fields and its first 1,000 initial conditions.

    Rewards and costs are excluded. Initial conditions are positions, headings, frames, weights and
    obstacles, to 1e-9, and the steps of failures.

    Raises:
        RuntimeError: if there is no space for an initial condition.
    """
    scenario = resolve(scenario)
    usual = Scenario().to_plain()
    fields = {
        key: value
        for key, value in scenario.to_plain().items()
        if key not in _NOT_OF_THE_FIELD and usual.get(key) != value
    }
    found = hashlib.sha256(json.dumps(fields, sort_keys=True).encode())
    simulator = Simulator(scenario, STARTS, num_threads=1)
    simulator.reset(0)
    for name in ("positions", "headings", "frames", "weights", "obstacles"):
        rounded = np.round(getattr(simulator, name), _DECIMALS) + 0.0  # no negative zero
        found.update(f"{name} {rounded.shape} ".encode() + rounded.astype("<f8").tobytes())
    if simulator.scenario.events.fails:
        found.update(b"faults " + simulator.get_state()["faults"].astype("<i8").tobytes())
    return found.hexdigest()
