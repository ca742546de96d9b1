"""Sums of rows that filters keep, and partial observations after resets, change no bit."""

import copy
import pickle

import numpy as np
import pytest

import rendezvous_env as rv
from rendezvous_env.safety.heading import HeadingFilter
from rendezvous_env.safety.robot_lanes import LANES
from rendezvous_env.safety.safety_filter import SafetyFilter
from rendezvous_env.vector import EnergyTankWrapper, HeadingVectorWrapper, training_env

pytestmark = pytest.mark.kernels
SCENARIOS = {
    "merging": {"n_robots": 4, "spawn_size": 3.0, "time_limit": 0.4},
    "two robots": {"n_robots": 2, "spawn_size": 2.0, "time_limit": 0.4},
    "long steps": {"n_robots": 4, "time_step": 0.5, "allow_long_step": True},
    "directed": {"n_robots": 4, "graph": rv.graphs.directed_cycle(4)},
    "imperfect": {"n_robots": 4, "sensing": {"noise": 0.1, "occlusion": "robots", "delay": 2}},
    "obstacles": {"n_robots": 4, "obstacles": rv.ObstacleField(3), "time_limit": 0.4},
    "mixed": {"n_robots": 4, "robot_model": ["single_integrator", "unicycle"] * 2},
    "unicycles": {"n_robots": 4, "robot_model": "unicycle"},
    "3-D": {"n_robots": 4, "dim": 3},
}
FILTERS = {
    "headings": (HeadingVectorWrapper, {}),
    "headings, error": (HeadingVectorWrapper, {"bearing_error": 0.1, "decision_period": 3}),
    "headings, local": (HeadingVectorWrapper, {"frame": "local"}),
    "tank": (EnergyTankWrapper, {"budget": 0.5, "observe_level": True}),
}
NUM_ENVS = 37


def numbers_of(given):
    """All arrays of numbers in nested tuples and dicts, in order."""
    if isinstance(given, dict):
        return [array for key in sorted(given) for array in numbers_of(given[key])]
    if isinstance(given, tuple):
        return [array for one in given for array in numbers_of(one)]
    return [given.copy()] if isinstance(given, np.ndarray) and given.dtype != object else []


def episode(env):
    """Arrays of a reset and of 18 steps with random actions, over a restored state and a copy."""
    random, found = np.random.default_rng(0), numbers_of(env.reset(seed=3))
    for step in range(18):
        if step == 6:
            state = env.get_state()
            env.step(np.zeros(env.action_space.shape, np.float32))
            env.set_state(state)
        elif step == 12:
            env = pickle.loads(pickle.dumps(copy.deepcopy(env)))
        actions = random.uniform(-1.0, 1.0, env.action_space.shape).astype(np.float32)
        found += numbers_of(env.step(actions))
    return found + numbers_of(env.get_state())


def observe_all(self, which, observations, shown):
    """``SafetyFilter.observe_again`` for all environments."""
    for one in self.observe_calls((0, len(which), 0), observations, shown):
        one()


def assert_alike(build, monkeypatch):
    """Assert that episodes are bitwise equal with and without kept sums and partial observations.

    Returns the number of uses of either.
    """
    uses, resets = [], []
    recall, again = SafetyFilter._sums_of, SafetyFilter.observe_again

    def watched(self, observations):
        sums = recall(self, observations)
        uses.append(sums.size > 0)
        return sums

    def observe_again(*given):
        resets.append(True)
        again(*given)

    monkeypatch.setattr(SafetyFilter, "_sums_of", watched)
    monkeypatch.setattr(SafetyFilter, "observe_again", observe_again)
    kept = episode(build())
    monkeypatch.setattr(SafetyFilter, "recall_sums", lambda self, observations: None)
    monkeypatch.setattr(SafetyFilter, "observe_again", observe_all)
    for one, other in zip(kept, episode(build()), strict=True):
        np.testing.assert_array_equal(one, other)
    return sum(uses), len(resets)


@pytest.mark.parametrize("which", FILTERS)
@pytest.mark.parametrize("name", SCENARIOS)
def test_kept_sums_and_partial_observations_change_no_bit(name, which, monkeypatch):
    wrap, options = FILTERS[which]
    mode = "NextStep" if options.get("frame") == "local" else "SameStep"

    def build():
        return wrap(rv.make_vec(rv.Scenario(**SCENARIOS[name]), NUM_ENVS, mode), **options)

    uses, resets = assert_alike(build, monkeypatch)
    turns_frames = name not in ("3-D", "unicycles") and options.get("frame") != "local"
    in_one_call = name != "directed"  # robots may have more neighbours than rows
    assert (uses > 6) == (turns_frames and in_one_call)
    assert resets > 0 or mode == "NextStep" or "time_limit" not in SCENARIOS[name]


def test_kept_sums_change_no_bit_of_training_environments(monkeypatch):
    def build():
        return training_env("clutter-8", NUM_ENVS, learning_preset=False, time_limit=0.4)

    assert min(assert_alike(build, monkeypatch)) > 0


def test_filters_alone_sum_the_rows_they_are_given():
    """An array that its owner has changed since ``observe``."""
    scenario = rv.Scenario(n_robots=LANES + 1, spawn_size=50.0)
    made, fresh = HeadingFilter(scenario, 1), HeadingFilter(scenario, 1)
    seen = rv.Simulator(scenario).reset(seed=0)
    choices = np.ones((1, scenario.n_robots, 2), np.float32)
    made.observe(seen)
    made.recall_sums(seen)
    made.hold(choices)
    seen[...] = -seen
    fresh.observe(-seen)
    fresh.hold(choices)
    np.testing.assert_array_equal(made.apply(seen), fresh.apply(seen.copy()))
