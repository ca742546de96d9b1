"""The trajectories that version 0.1.0 wrote, to tell whether a change of the engine changes any
motion.
"""

from pathlib import Path

import numpy as np

import baselines
import rendezvous_env as rv

KEPT = Path(__file__).parent / "data" / "trajectories_v01.npz"
STEPS = 150
EVERY = 30
TEAMS = 2


def trajectory(name: str, policy_name: str, steps: int = STEPS) -> np.ndarray:
    """Positions (1 + steps/EVERY, TEAMS, n, d), m, of a policy in a named scenario."""
    scenario = rv.scenarios.get(name)
    simulator = rv.Simulator(scenario, TEAMS)
    policy = baselines.make(policy_name, scenario)
    if callable(forget := getattr(policy, "reset", None)):
        forget()
    observations = simulator.reset(seed=7)
    places = [simulator.positions]
    for step in range(1, steps + 1):
        actions = np.asarray(policy(observations, simulator.time), dtype=np.float32)
        observations = simulator.step(actions).observations
        if step % EVERY == 0:
            places.append(simulator.positions)
    return np.stack(places)
