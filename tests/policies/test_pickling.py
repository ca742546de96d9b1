"""Every policy can be taken elsewhere in the middle of an episode, and goes on as if it had not."""

import copy
import pickle

import numpy as np
import pytest

import baselines
import rendezvous_env as rv
from rendezvous_env.trajectory import begin

SCENARIOS = ("clutter-8", "clutter-3d", "unicycle-6", "uav-6", "duo")
HEAVY = rv.Scenario(n_robots=3, robot_model="double_integrator")


def one_that_fits(name):
    known = map(rv.scenarios.get, SCENARIOS)
    return next((one for one in known if name in baselines.names(one)), HEAVY)


def through_pickle(pair):
    return pickle.loads(pickle.dumps(pair))


@pytest.mark.parametrize("travel", [through_pickle, copy.deepcopy])
@pytest.mark.parametrize("name", baselines.names())
def test_it_goes_on_bit_by_bit(name, travel):
    """With the teams that it steers, which privileged ones read."""
    scenario = one_that_fits(name)
    policy, simulator = baselines.make(name, scenario), rv.Simulator(scenario, 2)
    simulator.reset(5)
    begin(policy, simulator)
    for _ in range(7):
        simulator.step(policy(simulator.observe(), simulator.time))
    pairs = [(policy, simulator), travel((policy, simulator))]
    before = simulator.positions
    for _ in range(7):
        here, there = (each(teams.observe(), teams.time) for each, teams in pairs)
        np.testing.assert_array_equal(here, there)
        for (_, teams), actions in zip(pairs, (here, there), strict=True):
            teams.step(actions)
        np.testing.assert_array_equal(pairs[0][1].positions, pairs[1][1].positions)
    assert name == "zero" or (simulator.positions != before).any()
