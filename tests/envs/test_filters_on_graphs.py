"""Wrappers on the engine's own directed, switching and proximity graphs, under random choices."""

import numpy as np
import pytest

import rendezvous_env as rv
from rendezvous_env import vector

TEAMS = 12
CYCLE = rv.Scenario(n_robots=6, graph=rv.graphs.directed_cycle(), time_limit=300.0)
SWITCHING, RANGE = rv.scenarios.get("switching-8"), rv.scenarios.get("range-12")


def played(wrap, scenario, steps=600):
    """Whether teams met, the largest change of L in a step, m, and how many links were lost while
    nobody merged."""
    venv = wrap(rv.make_vec(scenario, TEAMS, autoreset_mode="Disabled"))
    venv.reset(seed=3)
    simulator, random = venv.unwrapped.simulator, np.random.default_rng(0)
    space, size = venv.single_action_space, simulator.size()
    met, rise, lost = np.zeros(TEAMS, dtype=bool), -np.inf, 0
    for _ in range(steps):
        before = simulator.weights > 0, simulator.merged_into
        choices = random.uniform(space.low, space.high, (TEAMS, *space.shape))
        met |= venv.step(choices.astype(np.float32))[2]
        now = simulator.size()
        rise, size = max(rise, float((now - size).max())), now
        alone = (simulator.merged_into == before[1]).all(axis=1)
        lost += int((before[0] & ~(simulator.weights > 0))[alone].sum())
        if met.all():
            break
    return met, rise, lost


@pytest.mark.parametrize("scenario", [CYCLE, SWITCHING], ids=["directed cycle", "switching"])
def test_under_gains_the_hull_never_grows_and_all_meet(scenario):
    met, rise, _ = played(vector.GainWrapper, scenario)
    assert met.all() and rise <= 1e-6


def test_links_of_limited_range_are_kept_and_all_meet():
    met, rise, lost = played(vector.LinkKeepingWrapper, RANGE)
    assert met.all() and lost == 0 and rise <= 1e-6


def test_other_guarantees_lose_links_and_let_the_hull_grow():
    """The checks above can fail."""
    _, _, lost = played(vector.HeadingVectorWrapper, RANGE)
    assert lost > 0
    _, rise, _ = played(lambda env: vector.EnergyTankWrapper(env, budget=20.0), SWITCHING)
    assert rise > 0.01
