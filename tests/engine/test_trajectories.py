"""Stored trajectories of version 0.1, reproduced."""

import numpy as np
import pytest
from conftest import ROOT

import baselines
import rendezvous_env as rv

STEPS, EVERY = 150, 30
with np.load(ROOT / "tests/data/trajectories_v01.npz") as _file:
    MOTIONS = dict(_file)
NAMES = sorted({case.split("|")[0] for case in MOTIONS})


def one_of_each_scenario() -> list[str]:
    """One case per scenario, with as many different policies as possible."""
    chosen = []
    for k, name in enumerate(NAMES):
        policies = sorted(case for case in MOTIONS if case.startswith(f"{name}|"))
        chosen.append(policies[k % len(policies)])
    return chosen


@pytest.mark.parametrize(
    ("case", "steps"),
    [(case, 2 * EVERY) for case in one_of_each_scenario()]
    + [pytest.param(case, STEPS, marks=pytest.mark.slow) for case in MOTIONS],
)
def test_trajectories_match_version_01(case, steps):
    expected = MOTIONS[case][: 1 + steps // EVERY]
    name, policy = case.split("|")
    scenario = rv.scenarios.get(name)
    scenario = scenario.replace(time_limit=steps * scenario.tau)
    law = baselines.make(policy.replace("joined", "merged"), scenario)
    found = rv.rollout(scenario, law, 7, num_envs=2, record=()).positions
    kept = np.minimum(np.arange(0, steps + 1, EVERY), len(found) - 1)  # who has ended rests
    np.testing.assert_allclose(found[kept], expected, rtol=0, atol=1e-9)


def test_stored_trajectories_are_motions():
    """True for nearly all cases: "zero" rests, and a rule may rest at a wall."""
    still = {case for case, places in MOTIONS.items() if np.ptp(places, axis=0).max() < 0.01}
    moving_policies = {case.split("|")[1] for case in MOTIONS.keys() - still}
    assert len(MOTIONS) == 154
    assert all(case.startswith("wall|") or case.endswith("|zero") for case in still)
    assert moving_policies == {case.split("|")[1] for case in MOTIONS} - {"zero"}
