"""The trajectories of version 0.1, to tell whether a change of the engine changes any motion.

``python tests/trajectories_v01.py OUT.npz`` writes those of the installed version; the ones kept
in ``tests/data/trajectories_v01.npz`` were written by version 0.1.0.
"""

import sys
from pathlib import Path

import numpy as np

import baselines
import rendezvous_env as rv
from baselines.policy import kind_of

KEPT = Path(__file__).parent / "data" / "trajectories_v01.npz"
STEPS = 150
EVERY = 30
TEAMS = 2
SCENARIOS = (
    "fig3 fig4 duo swarm-20 ring-12 tree-12 random-10 unicycle-6 uav-6 cloud-8 clutter-4 clutter-8 "
    "clutter-12 clutter-16 clutter-24 clutter-16-team-3 clutter-16-team-8 clutter-16-team-16 "
    "clutter-16-team-32 clutter-3d wall"
).split()


def policies(scenario: rv.Scenario) -> list[str]:
    """All scripted policies that fit and read observations only, in a fixed order."""
    return sorted(
        n for n in baselines.names(scenario) if kind_of(n) not in ("privileged", "learned")
    )


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


def cases() -> list[tuple[str, str]]:
    """Every pair of a named scenario and a policy that fits it."""
    return [(name, policy) for name in SCENARIOS for policy in policies(rv.scenarios.get(name))]


if __name__ == "__main__":
    found = {f"{name}|{policy}": trajectory(name, policy) for name, policy in cases()}
    np.savez_compressed(sys.argv[1], **found)
