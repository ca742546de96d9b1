"""Restored states: all entries are validated before any is applied."""

import re

import numpy as np
import pytest
from conftest import MODELS, UNEQUAL, assert_same_state, five, law_of, refusing, started
from parameters import first_fast
from test_input_shapes import AMONG, TEAMS

import rendezvous_env as rv
from baselines.learned.policy_settings import PolicySettings
from baselines.learned.training_environment import FeatureVectorEnv
from rendezvous_env import Simulator, parallel_env
from rendezvous_env.adapters.sb3 import RobotVecEnv
from rendezvous_env.engine.memory import AWAITING_RESET, RENDEZVOUS, TIME_OUT
from rendezvous_env.obstacles.shape import CORNERS, DETAILS, KIND, RADIUS
from rendezvous_env.safety.heading import HeadingFilter
from rendezvous_env.vector import EnergyTankWrapper, HeadingVectorWrapper


def refused(target, state, message):
    with refusing(target, message):
        target.set_state(state)


def changed(state, name, place, value):
    array = state[name].copy()
    array[place] = value
    return {**state, name: array}


FAST = {"n_robots": 2, "robot_model": "double_integrator", "max_speed": 3.0}
SIMULATORS = {
    "team": (five("single_integrator-2d", **AMONG), TEAMS),
    "arcs": (rv.Scenario(n_robots=5, graph=rv.graphs.directed(UNEQUAL)), 1),
    "inertia": (rv.Scenario(**FAST, obstacles=[rv.Capsule(((90, 0), (91, 0)), 0.1)]), TEAMS),
    "late": (five("single_integrator-2d", sensing=rv.Sensing(delay=2)), 1),
    "ring": (rv.Scenario(n_robots=60, graph="cycle"), 2),
}
"""Scenarios, and numbers of environments."""
WRONG_ENTRIES = [
    ("positions", (1, 2, 0), np.nan, "positions[1, 2, 0] is nan; it must be finite"),
    ("weights", (0, 3), -1.0, "weights[0, 3] is -1.0; it must be 0 or more"),
    ("obstacles", (2, 0, KIND), 1e9, "obstacles[2, 0] is [1000000000.0, "),
    ("obstacles", (2, 0, KIND), 4.0, "it must be a row that begins with one of [0, 1, 2, 3]"),
    ("obstacles", (2, 0, KIND), 1.5, "it must be a row that begins with one of [0, 1, 2, 3]"),
    ("obstacles", (2, 0, CORNERS), 3.0, "it must be a row with 3 to 4 corners if it is a polygon"),
    ("obstacles", (2, 1, CORNERS), 5.0, "it must be a row with 3 to 4 corners if it is a polygon"),
    ("obstacles", (2, 1, CORNERS), 3.5, "it must be a row with 3 to 4 corners if it is a polygon"),
    ("obstacles", (5, 1, DETAILS), np.inf, "it must be at most 1e+09"),
    ("obstacles", (5, 1, DETAILS), np.nan, "it must be finite"),
    ("obstacles", (5, 0, RADIUS), 0.0, "it must be of radius 1e-05 m or more"),
    ("merged_into", (3, 1), -1, "merged_into[3, 1] is -1; it must be from 0 to the robot's own"),
    ("merged_into", (3, 1), 4, "merged_into[3, 1] is 4; it must be from 0 to the robot's own"),
    ("merged_into", (3, slice(2)), 0, "weights"),  # merged, and still linked
    ("seed", 4, 2**63, "seed[4] is 9223372036854775808; it must be below 2**63"),
    ("episode", 4, -2, "episode[4] is -2"),
    ("status", 4, -1, "status[4] is -1; it must be 0 to 3"),
    ("status", 4, 4, "status[4] is 4; it must be 0 to 3"),
    ("status", 4, RENDEZVOUS, "1 exactly in environments in which one robot is left"),
    ("steps", 4, -1, "steps[4] is -1; it must be 0 or more"),
    ("initial_lyapunov", 4, -1.0, "initial_lyapunov[4] is -1.0; it must be 0 or more"),
    ("min_clearance", 4, np.nan, "min_clearance[4] is nan; it must be a length"),
    ("frames", (1, 1, 0), 3.0, "it must be a rotation"),
    ("frames", (1, 1), [1.0, 0.0, 0.0, -1.0], "it must be a rotation"),
]
WRONG = [
    *[("team", *entry) for entry in WRONG_ENTRIES],
    ("arcs", "weights", (0, 1, 1), 1.0, "weights[0, 1, 1] is 1.0; it must be 0: no robot is its"),
    pytest.param("inertia", "memory", (0, 1), (0.0, 3.1), "at most 3 m/s", marks=pytest.mark.slow),
    ("late", "past", (0, 1, 2), np.nan, "past[0, 1, 2, 0, 0] is nan; it must be finite"),
    ("late", "past", (0, 1, 2), 1e20, "it must be at most 1e+13"),
    ("ring", "first", (0, 0), 60, "first[0, 0] is 60; it must be from 0 to 59"),
    ("ring", "second", (1, 5), -1, "second[1, 5] is -1; it must be from 0 to 59"),
    ("ring", "second", (0, 0), 0, "second[0, 0] is 0; it must be above the other robot"),
    ("ring", "first", (0, 3), 0, "in the order of the links, each once"),
    ("ring", "weights", (0, 3), 0.0, "it must be 0 after a 0"),
    ("ring", "merged_into", (0, 1), 0, "it must be 0 for pairs with a merged robot"),
]


@pytest.mark.parametrize(("team", "name", "place", "value", "message"), WRONG)
def test_impossible_state_entry_is_rejected(team, name, place, value, message):
    sim = started(*SIMULATORS[team])
    refused(sim, changed(sim.get_state(), name, place, value), re.escape(message))


def test_state_entries_must_match_shape_and_type():
    sim = started(*SIMULATORS["late"])
    state = sim.get_state()
    for wrong, message in (
        ({k: v for k, v in state.items() if k != "past"}, "'past' is missing"),
        (state | {"speed": state["steps"]}, "'speed' is unknown; it must be one of positions"),
        (state | {"past": state["past"][:, :2]}, "past is float32 of shape"),
        (state | {"steps": state["steps"].astype(float)}, "steps is float64 .* must be int64"),
    ):
        refused(sim, wrong, message)


def test_survivors_must_be_their_own_representative():
    sim = started(five("single_integrator-2d"), 1)
    state = sim.get_state()
    state["weights"][:] = 0.0
    refused(sim, changed(state, "merged_into", (0, slice(1, 3)), [0, 1]), "itself not merged")
    sim.set_state(changed(state, "merged_into", (0, slice(1, 3)), [0, 0]))
    assert sim.active.tolist() == [[True, False, False, True, True]]


def test_edge_lists_are_accepted_or_rejected_as_whole():
    sim, ragged = started(*SIMULATORS["team"]), [[1.0], [2.0, 3.0]]
    sim.step(np.ones((TEAMS, 5, 2)))
    state = sim.get_state()
    for name in ("positions", "weights", "steps", "seed", "merged_into", "obstacles"):
        for wrong in (ragged, "words"):
            refused(sim, {**state, name: wrong}, f"{name} must be an array")
    listed = {**state, "positions": state["positions"].tolist(), "steps": state["steps"].tolist()}
    sim.step(np.ones((TEAMS, 5, 2)))
    sim.set_state(listed)
    assert_same_state(sim, state)


def test_non_state_is_rejected():
    filtered = HeadingFilter(five("unicycle"), 1)
    for target in (Simulator(five("unicycle")), parallel_env("fig3"), filtered):
        for wrong in (None, 3, [], "state"):
            refused(target, wrong, "must be a mapping")


@pytest.mark.parametrize("kind", first_fast(MODELS))
def test_states_of_all_phases_are_accepted(kind):
    """Before the first reset, partially reset, resting, running, merged, met, timed out."""
    scenario = five(kind, time_limit=1.0, spawn_size=3.0)
    sim, other = Simulator(scenario, TEAMS), Simulator(scenario, TEAMS)
    seen, law = set(), law_of(scenario)

    def taken():
        other.set_state(sim.get_state())
        assert_same_state(other, sim)
        seen.update(sim.status.tolist(), ["merged"] * (not sim.active.all()))

    taken()
    with pytest.raises(RuntimeError, match="call reset"):
        other.step(np.zeros((TEAMS, 5, scenario.action_size)))
    first = np.arange(TEAMS) < 4
    for mask in (first, ~first):
        sim.reset(0, mask=mask)
        taken()
    for step in range(400):
        taken()
        np.testing.assert_array_equal(other.observe(), sim.observe())
        if step % 50 == 40:
            sim.restart(sim.ended)
            taken()
        sim.step(law(sim.observe(), sim.time))
    assert {TIME_OUT, AWAITING_RESET, "merged"} <= seen
    anew = Simulator(scenario, TEAMS)  # of teams never reset the seed is drawn later
    anew.set_state(Simulator(scenario, TEAMS).get_state())
    anew.reset()
    assert anew.seeds.min() > 1


def test_parallel_env_state_is_set_atomically():
    env = parallel_env("fig3")
    env.reset(seed=0)
    state = env.get_state()
    agents, actions = env.agents, {name: env.action_space(name).high for name in env.agents}
    env.max_cycles = 1
    env.step(actions)
    assert not env.agents
    refused(env, {"positions": state["positions"]}, "is missing")
    refused(env, changed(state, "positions", 0, np.nan), "positions")
    assert not env.agents
    env.set_state(state)
    assert_same_state(env, state)
    assert env.agents == agents


def begun(venv):
    venv.reset(seed=0)
    return venv


def perceiving():
    scenario = rv.scenarios.get("clutter-16")
    teams = rv.make_vec(scenario, 2, autoreset_mode="SameStep")
    settings = PolicySettings(8, (16,), 0.1, 0.5, 0.1, 3.0, scenario.tau)
    return begun(FeatureVectorEnv(teams, settings))


def robots():
    vec_env = RobotVecEnv(perceiving())
    vec_env.seed(0)
    vec_env.reset()
    return vec_env


NESTED = {
    "heading": lambda: begun(HeadingVectorWrapper(rv.make_vec("clutter-16", 2))),
    "tank": lambda: begun(EnergyTankWrapper(rv.make_vec("clutter-16", 2), budget=1.0)),
    "features": perceiving,
    "training": lambda: begun(rv.vector.training_env("clutter-16", 2, guarantee="tank")),
    "robots": robots,
}


def leaves(state, path=()):
    for key, value in state.items():
        yield from leaves(value, (*path, key)) if isinstance(value, dict) else [(*path, key)]


@pytest.mark.parametrize("make", NESTED.values(), ids=NESTED)
def test_nested_state_is_validated_before_use(make):
    """Entries of another time, one of them invalid: none may be applied."""
    target, other = make(), make()
    other.reset()  # the next episode: every entry that can differs
    paths = list(leaves(target.get_state()))
    assert len(paths) > 10
    for path in paths:
        left_out = () if path[-1] == "shown" else (lambda at, key: at.pop(key),)  # as 0.2 did
        for spoil in (
            *left_out,
            lambda at, key: at.update({key: "words"}),
            lambda at, key: at.update({f"{key}, more": at[key]}),
        ):
            state = other.get_state()
            at = state
            for key in path[:-1]:
                at = at[key]
            spoil(at, path[-1])
            refused(target, state, path[-1])


def test_robot_slots_reject_impossible_counts():
    target = robots()
    for name, value, what in (("returns", np.nan, "finite"), ("lengths", -1, "0 or more")):
        message = re.escape(f"{name}[1] is {value}; it must be {what}")
        refused(target, changed(target.get_state(), name, 1, value), message)
