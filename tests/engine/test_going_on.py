"""Running episodes of every kind are taken out, put back, copied and pickled, and go on alike."""

import copy
import pickle

import numpy as np
import pytest
from conftest import MODELS, assert_same_state, five
from test_graphs_that_change import KINDS
from test_graphs_that_change import scenario as small
from test_sensing_engine import PLANE, WORST
from test_sparse import RING, WEB
from test_widths import towards_neighbours

import rendezvous_env as rv

TEAMS = 3
CASES = {
    **{kind: five(kind) for kind in MODELS},
    **{kind: small(**KINDS[kind], require_connected=False) for kind in KINDS},
    "sensing": PLANE.replace(sensing=WORST),
    "packing": rv.scenarios.get("robotarium-4"),
    "ring": RING,
    "web": WEB,
}
MERGES = CASES.keys() - {"packing", "nonholonomic_3d"}


def onwards(sim, seen, steps):
    """Everything that some steps give out, and the start of the next episodes."""
    found = [seen]
    for _ in range(steps):
        outcome = sim.step(towards_neighbours(sim.scenario, seen))
        seen = outcome.observations
        found += [seen, outcome.rewards, outcome.contact, sim.positions, sim.weights]
    return [*found, sim.reset()]


@pytest.mark.parametrize("name", CASES)
def test_an_episode_goes_on_from_a_copy(name):
    """In its midst, when in some teams robots have merged."""
    sim = rv.Simulator(CASES[name], TEAMS)
    seen = sim.reset(6)
    while sim.steps[0] < 12 or (sim.active.all() and name in MERGES):
        seen = sim.step(towards_neighbours(sim.scenario, seen)).observations
    state, restored = sim.get_state(), rv.Simulator(sim.scenario, TEAMS)
    restored.reset(99)
    restored.set_state(state)
    copies = [copy.copy(sim), pickle.loads(pickle.dumps(sim)), restored]
    np.testing.assert_array_equal(copies[0].lyapunov(), sim.lyapunov())
    future = onwards(sim, sim.observe(), 30)
    for twin in copies:
        assert_same_state(twin, state)  # independent of the original
        for own, other in zip(onwards(twin, twin.observe(), 30), future, strict=True):
            np.testing.assert_array_equal(own, other)
        assert_same_state(sim, twin)
