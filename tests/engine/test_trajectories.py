"""The motions of version 0.1, kept as numbers."""

import numpy as np
import pytest
from trajectories_v01 import EVERY, KEPT, STEPS, trajectory

with np.load(KEPT) as _file:
    MOTIONS = dict(_file)
NAMES = sorted({case.split("|")[0] for case in MOTIONS})


def one_of_each_scenario() -> list[str]:
    """A case for every scenario; of their policies, as many different ones as there are."""
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
def test_motions_are_those_of_version_01(case, steps):
    expected = MOTIONS[case][: 1 + steps // EVERY]
    found = trajectory(*case.split("|"), steps=steps)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)


def test_what_is_kept_are_motions():
    """Of nearly all cases: "zero" stands still, and before a wall a rule may, too."""
    still = {case for case, places in MOTIONS.items() if np.ptp(places, axis=0).max() < 0.01}
    moving_policies = {case.split("|")[1] for case in MOTIONS.keys() - still}
    assert len(MOTIONS) == 154
    assert all(case.startswith("wall|") or case.endswith("|zero") for case in still)
    assert moving_policies == {case.split("|")[1] for case in MOTIONS} - {"zero"}
