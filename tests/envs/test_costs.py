"""Costs next to rewards: known values.

test_gymnasium_env compares environments, test_guarantee_wrappers decisions and their steps.
"""

import pickle

import numpy as np

import baselines
import rendezvous_env as rv
from rendezvous_env import graphs
from rendezvous_env.rewards.custom_terms import COSTS
from rendezvous_env.vector import training_env

ALL = tuple(COSTS)
APART = np.array([[[-1.0, 0.0], [1.0, 0.0]]], np.float32)
"""Actions away from each other, at 1 m/s."""


def pair(**fields):
    """Two robots, 2 m apart, with global frames."""
    starts = ((-1.0, 0.0), (1.0, 0.0))
    given = {"n_robots": 2, "start_positions": starts, "local_frames": "global", "time_step": 0.05}
    return rv.Scenario(**{**given, "max_speed": 1.0, "costs": ALL, **fields})


def test_rise_cost_is_relative_increase_of_v():
    env = rv.make_vec(pair(), 1)
    _, infos = env.reset(seed=0)
    assert not infos["cost"].any()
    for _ in range(3):  # ΔV = 2 a · 2 v τ of V₀ = 2 a · 2 m
        infos = env.step(APART)[4]
        np.testing.assert_allclose(infos["cost_rise"], [[0.05, 0.05]], rtol=1e-9)
        np.testing.assert_array_equal(infos["cost"], infos["cost_rise"])
    assert not env.step(-APART)[4]["cost"].any()


def test_contact_cost_is_one():
    wall = rv.Disc((-2.0, 0.0), 0.92)  # 8 cm behind robot 0
    env = rv.make_vec(pair(obstacles=wall, costs=("contact",)), 1)
    env.reset(seed=0)
    told = [env.step(APART)[4] for _ in range(3)]
    np.testing.assert_array_equal([one["cost"][0] for one in told], [[0, 0], [1, 0], [1, 0]])
    np.testing.assert_array_equal([one["cost"] for one in told], [one["contact"] for one in told])


def test_lost_link_costs_both_robots():
    sight = {"graph": graphs.proximity(), "sensing": rv.Sensing(range=2.15)}
    env = rv.make_vec(pair(**sight, require_connected=False, costs="link_lost"), 1)
    env.reset(seed=0)
    lost = [env.step(APART)[4]["cost"][0].tolist() for _ in range(4)]
    assert lost == [[0, 0], [1, 1], [0, 0], [0, 0]]  # at 2.2 m
    env.reset(seed=0)
    met = [env.step(-APART) for _ in range(18)]  # a merge is no loss
    assert met[-1][2].all() and not any(one[4]["cost"].any() for one in met)


def test_final_infos_keep_costs():
    teams = training_env("clutter-16", 8, guarantee=None, costs=ALL, time_limit=0.5)
    teams.reset(seed=0)
    for _ in range(10):
        infos = teams.step(np.ones(teams.action_space.shape, np.float32))[4]
    np.testing.assert_array_equal(infos["final_info"]["cost"], infos["cost"])
    one = rv.training_env("clutter-16", costs=ALL)
    one.reset(seed=0)
    told = one.step({name: np.zeros(2, np.float32) for name in one.agents})[4]
    assert all({"cost", *(f"cost_{name}" for name in ALL)} <= set(info) for info in told.values())


def test_inactive_environments_and_robots_cost_nothing():
    rv.reward_term("always", lambda step: np.ones(step.contact.shape))
    env = rv.make_vec(pair(costs="always"), 1)  # the next step after the end begins anew
    env.reset(seed=0)
    told = [env.step(-APART)[4]["cost"][0].tolist() for _ in range(19)]
    assert told == [[1, 1]] * 18 + [[0, 0]]
    many = rv.make_vec("clutter-8", 16, costs="always", autoreset_mode="disabled", n_robots=3)
    many.reset(seed=0)
    law = baselines.make("bearing-only", many.scenario)
    for _ in range(200):
        running, active = ~many.simulator.ended, many.simulator.active
        infos = many.step(law(many.simulator.observe(), 0.0))[4]
        np.testing.assert_array_equal(infos["cost"], running[:, None] & active)
    assert not active.all()


def test_no_cost_names_means_no_keys():
    bare, told = (rv.make_vec("clutter-8", 4, costs=names) for names in ((), ALL))
    bare.reset(seed=0), told.reset(seed=0)
    action = np.full(bare.action_space.shape, 0.5, np.float32)
    for _ in range(50):
        (*first, infos), (*second, more) = bare.step(action), told.step(action)
        for one, other in zip(first, second, strict=True):
            np.testing.assert_array_equal(one, other)
    assert not any("cost" in key for key in infos)
    new = {key.lstrip("_") for key in set(more) - set(infos)}
    assert new == {"cost", *(f"cost_{name}" for name in ALL)}


def test_costs_are_part_of_scenario():
    scenario = pair(costs=["contact", "rise"])
    assert scenario.costs == ("contact", "rise") and "costs" not in pair(costs=()).to_plain()
    env = pickle.loads(pickle.dumps(rv.make_vec(scenario, 1)))
    assert set(env.simulator.costs) == {"cost", "cost_contact", "cost_rise"}
