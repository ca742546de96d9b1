"""Partial resets, restored states, and finished environments, which rest."""

import copy
import pickle

import numpy as np
import pytest
import test_changing_graphs as changing
from conftest import MODELS, UNEQUAL, assert_same_state, five, started
from parameters import marked
from test_batch_equals_singles import towards_neighbours
from test_double_integrator import FAR
from test_sensing_engine import PLANE, WORST
from test_sparse import RING, WEB

from rendezvous_env import ObstacleField, Scenario, Sensing, Simulator, scenarios
from rendezvous_env.engine.memory import AWAITING_RESET, RUNNING, TIME_OUT

# obstacles as in ``test_double_integrator``: nothing else is compiled
INERT = {d: {"robot_model": "double_integrator", "dim": d, "obstacles": (FAR[d],)} for d in (2, 3)}
INERTIA = {f"double_integrator-{d}d": INERT[d] for d in (2, 3)}
KINDS = MODELS | INERTIA
CHANGING = {
    "sensing": {"sensing": WORST},
    "proximity": {"graph": "proximity", "sensing": Sensing(range=4.0, field_of_view=5.0)},
}
TEAMS = 7
SOME = np.array([False, True, False, False, True, True, False])


@pytest.fixture(params=marked(KINDS, own_path=INERTIA))
def scenario(request) -> Scenario:
    team = {"n_robots": 5, "graph": UNEQUAL, "spawn_size": 6.0, "merge_radius": 0.4}
    return Scenario(**team | (KINDS | CHANGING)[request.param])


def halfway(scenario: Scenario, merges: bool = True) -> tuple[Simulator, np.ndarray]:
    """Moving environments, some of them with merged robots."""
    sim = Simulator(scenario, TEAMS)
    observations = sim.reset(0)
    while sim.steps.max() < 10 or (merges and sim.active.all()):
        observations = sim.step(towards_neighbours(scenario, observations)).observations
    return sim, observations


@pytest.mark.parametrize(
    "scenario",
    marked([*KINDS, *CHANGING], own_path=INERTIA, kernels=["proximity"]),
    indirect=True,
)
def test_partial_resets_agree_and_keep_other_environments(scenario):
    """Immediately in the last step's outputs, in a step of rest, or by a reset."""
    (sim, seen), (other, _), (alone, _), (anew, _) = (halfway(scenario) for _ in range(4))
    actions = towards_neighbours(scenario, seen)
    for simulator in (sim, other, alone, anew):
        outcome = simulator.step(actions)
        if simulator is sim:
            sim.restart(SOME, outcome)
            at_once = outcome.observations.copy()
    before = anew.get_state()
    np.testing.assert_array_equal(anew.reset(mask=SOME), at_once)
    np.testing.assert_array_equal(anew.observe(), at_once)
    assert_same_state(anew, sim)
    for name, array in anew.get_state().items():
        np.testing.assert_array_equal(array[~SOME], before[name][~SOME], err_msg=name)
    other.restart(SOME)
    assert (other.status[SOME] == AWAITING_RESET).all()
    begun = other.positions[SOME]
    resting = other.step(actions)
    np.testing.assert_array_equal(resting.observations[SOME], at_once[SOME])
    np.testing.assert_array_equal(resting.rewards[SOME], 0.0)
    np.testing.assert_array_equal(other.positions[SOME], begun)
    np.testing.assert_array_equal(other.path_length[SOME], 0.0)
    assert (other.steps[SOME] == 0).all() and (other.status[SOME] == RUNNING).all()
    went_on = alone.step(actions)
    np.testing.assert_array_equal(resting.observations[~SOME], went_on.observations[~SOME])
    np.testing.assert_array_equal(other.positions[~SOME], alone.positions[~SOME])
    fresh = started(scenario, TEAMS)
    np.testing.assert_array_equal(fresh.reset()[SOME], at_once[SOME])
    for name in ("frames", "weights", "initial_lyapunov"):
        np.testing.assert_array_equal(getattr(fresh, name)[SOME], getattr(other, name)[SOME])
    for _ in range(4):  # nothing is left of what was seen before
        seen, expected = (each.step(actions).observations[SOME] for each in (other, fresh))
        np.testing.assert_array_equal(seen, expected)


@pytest.mark.parametrize("count", [0, 1, 3, 40, 300])
def test_restart_observes_any_number_of_environments_in_blocks(count):
    """In single blocks of 32 environments, or all blocks at once where many are restarted."""
    sim = Simulator(Scenario(n_robots=3, sensing=Sensing(noise=0.1)), 300)
    outcome = sim.step(towards_neighbours(sim.scenario, sim.reset(0)))
    before, mask = outcome.observations.copy(), np.zeros(300, np.bool_)
    mask[np.random.default_rng(0).permutation(300)[:count]] = True
    sim.restart(mask, outcome)
    np.testing.assert_array_equal(outcome.observations[~mask], before[~mask])
    assert (outcome.observations[mask] != before[mask]).any(axis=(1, 2, 3)).all()
    np.testing.assert_array_equal(sim.observe(), outcome.observations)


def test_finished_environment_is_frozen(scenario):
    """For any actions and any final velocity."""
    sim, _ = halfway(scenario)
    sim.set_max_steps(int(sim.steps.max()) + 1)
    actions = np.ones((TEAMS, 5, scenario.action_size))
    last = sim.step(actions)
    assert set(sim.status.tolist()) <= {1, TIME_OUT} and (sim.status == TIME_OUT).any()
    before = sim.get_state()
    for _ in range(3):
        outcome = sim.step(-actions)
        np.testing.assert_array_equal(outcome.observations, last.observations)
        assert not outcome.rewards.any() and not outcome.contact.any()
    assert_same_state(sim, before)


def test_path_length_counts_active_robots(scenario):
    """A merged robot adds nothing, even if it was moving."""
    sim, observations = halfway(scenario)
    assert not sim.active.all()
    for _ in range(20):
        before, length, there = sim.positions, sim.path_length, sim.active
        observations = sim.step(towards_neighbours(scenario, observations)).observations
        chords = np.linalg.norm(sim.positions - before, axis=-1)
        unmerged = (sim.active == there).all(axis=1)
        way = sim.path_length - length
        straight = np.where(there, chords, 0.0).sum(axis=1)[unmerged]
        assert (way[unmerged] >= straight - 1e-12).all()
        assert (way[unmerged] <= straight * 1.02 + 1e-9).all()


def test_obstacles_belong_to_episode():
    """After a partial reset, and after restoring a state."""
    field = ObstacleField((1, 3), (0.2, 0.5), 6.0, 0.05, True)
    team = Scenario(n_robots=3, obstacles=field)
    sim, other = started(team, TEAMS), started(team, TEAMS, seed=100)
    still = np.zeros((TEAMS, 3, 2))
    sim.restart(SOME)  # these pass the step by, and are looked at there alone
    seen = sim.step(still)
    state = sim.get_state()
    np.testing.assert_array_equal(seen.observations, sim.observe())
    other.set_state(state)
    np.testing.assert_array_equal(other.step(still).observations, seen.observations)
    touched = np.zeros((2, TEAMS, 3), bool)
    for _ in range(60):  # into what stands at +y of it, which only who is near is moved around
        ahead = np.einsum("bnij,i->bnj", sim.frames, [0.0, 1.0])
        for k, teams in enumerate((sim, other)):
            touched[k] |= teams.step(ahead).contact
        assert (sim.clearance > -1e-9).all()
    np.testing.assert_array_equal(*touched)
    assert touched.any() and not touched.all()
    places, table = state["positions"][:, :, None], state["obstacles"][:, None]
    gaps = np.linalg.norm(places - table[..., 3:5], axis=-1) - table[..., 2]
    nearest = np.where(table[..., 0] == 0, np.inf, gaps).min(axis=2)
    np.testing.assert_allclose(seen.clearance, nearest, rtol=1e-12)


CASES = {
    **{kind: five(kind) for kind in MODELS},
    **{kind: changing.scenario(**fields) for kind, fields in changing.KINDS.items()},
    "sensing": PLANE.replace(sensing=WORST),
    "packing": scenarios.get("robotarium-4"),
    "ring": RING,
    "web": WEB,
}


def onwards(sim: Simulator, steps: int = 30) -> list[np.ndarray]:
    """All outputs of some steps, and the initial state of the next episodes."""
    found = [sim.observe()]
    for _ in range(steps):
        outcome = sim.step(towards_neighbours(sim.scenario, found[-1]))
        found += [outcome.rewards, outcome.contact, sim.positions, sim.weights]
        found.append(outcome.observations)
    return [*found, sim.reset()]


@pytest.mark.parametrize("name", CASES)
def test_episode_continues_from_copied_state(name):
    sim, _ = halfway(CASES[name], merges=name not in ("packing", "nonholonomic_3d"))
    state, restored = sim.get_state(), started(sim.scenario, TEAMS, seed=99)
    restored.set_state(state)
    copies = [copy.copy(sim), pickle.loads(pickle.dumps(sim)), restored]
    np.testing.assert_array_equal(copies[0].lyapunov(), sim.lyapunov())
    future = onwards(sim)
    for twin in copies:
        assert_same_state(twin, state)  # independent of the original
        for own, other in zip(onwards(twin), future, strict=True):
            np.testing.assert_array_equal(own, other)
        assert_same_state(sim, twin)
