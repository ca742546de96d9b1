"""Stages depend on what they compute, and on nothing else."""

import numpy as np
import pytest

import rendezvous_env as rv
from rendezvous_env import kernel_cache
from rendezvous_env.compilation import compiled
from rendezvous_env.engine.stages.apply_noise import apply_noise
from rendezvous_env.engine.stages.collide import merge_robots
from rendezvous_env.engine.stages.conclude import add_step, conclude_step
from rendezvous_env.engine.stages.propose import propose_motion
from rendezvous_env.engine.stages.sense_neighbours import sense_pairs
from rendezvous_env.rewards import terms
from rendezvous_env.sensors import chance
from rendezvous_env.simulator import Simulator

STAGES = propose_motion, merge_robots, sense_pairs, apply_noise, conclude_step


def changed_stages(monkeypatch, module, name, value):
    """Names of the stages that an edit of a constant of a module makes anew."""

    def contents():
        return ["".join(kernel_cache.content(stage)) for stage in STAGES]

    before = contents()
    monkeypatch.setattr(module, name, value)
    pairs = zip(STAGES, before, contents(), strict=True)
    return {stage.__name__ for stage, old, new in pairs if old != new}


def test_reward_edit_compiles_the_last_stage_only(monkeypatch):
    assert changed_stages(monkeypatch, terms, "CLEARANCE_PENALTY", 3) == {"conclude_step"}


def test_sensor_edit_compiles_the_noise_stage_only(monkeypatch):
    assert changed_stages(monkeypatch, chance, "_STEP", np.uint64(1)) == {"apply_noise"}


def called(simulator):
    """Names of the stages that have been called for."""
    return {kernel.__name__ for kernel in simulator._runner._stages._entries}


@pytest.mark.skipif(not compiled(), reason="plain Python compiles nothing")
def test_stages_that_a_scenario_lacks_are_not_called():
    simulator = Simulator(rv.Scenario(n_robots=2, spawn_size=50.0))
    simulator.reset(seed=0)
    simulator.step(np.zeros((1, 2, 2), np.float32))
    expected = {"propose_motion", "sense_pairs", "conclude_step"}
    assert called(simulator) == expected
    simulator.compile()
    assert called(simulator) == {*expected, "merge_robots"}


def test_merges_are_called_for_when_robots_are_near():
    start = {"start_positions": ((0.0, 0.0), (1.0, 0.0)), "merge_radius": 0.1}
    simulator = Simulator(rv.Scenario(n_robots=2, **start))
    observations = simulator.reset(seed=0)
    assert "merge_robots" not in called(simulator)
    for _ in range(simulator.max_steps):
        output = simulator.step(
            observations[:, :, 0] if simulator.all_running else np.zeros((1, 2, 2))
        )
        observations = output.observations
        if not output.active.all():
            break
    assert not output.active.all() and "merge_robots" in called(simulator)


def test_merges_are_called_for_after_a_change_of_state():
    """The last step before a merge, from a state of another simulator."""
    start = {"start_positions": ((0.0, 0.0), (1.0, 0.0)), "merge_radius": 0.1}
    simulator, other = (Simulator(rv.Scenario(n_robots=2, **start)) for _ in range(2))
    observations, output = simulator.reset(seed=0), None
    while output is None or output.active.all():
        before, actions = simulator.get_state(), observations[:, :, 0]
        output = simulator.step(actions)
        observations = output.observations
    other.reset(seed=0)
    other.step(np.zeros_like(actions))
    assert "merge_robots" not in called(other)
    other.set_state(before)
    after = other.step(actions)
    np.testing.assert_array_equal(after.active, output.active)
    np.testing.assert_array_equal(after.scores, output.scores)
    assert not after.active.all()


def test_initial_lyapunov_of_an_awaiting_environment_follows_its_step():
    scenario = rv.Scenario(n_robots=3)
    simulator, other = Simulator(scenario, 2), Simulator(scenario, 2)
    for one in (simulator, other):
        one.reset(seed=0)
    mask = np.array([True, False])
    other.reset(mask=mask)
    simulator.restart(mask)
    state = simulator.get_state()
    simulator.set_state(state)
    simulator.step(np.zeros((2, 3, 2), np.float32))
    np.testing.assert_array_equal(simulator.initial_lyapunov, other.initial_lyapunov)
    assert (simulator.initial_lyapunov > 0.0).all()


@pytest.mark.kernels
def test_rewards_and_contacts_of_steps_add_up():
    """Environment 1 of 3 ends in the first of two steps; the slice leaves out environment 2."""
    status, resting = np.array([0, 1, 1]), np.zeros(3, np.bool_)
    rewards, robot_rewards = np.array([1.0, 2.0, 4.0]), np.array([[0.5, 1.0]] * 3)
    contact = np.array([[True, False], [False, True], [True, True]])
    step = rewards, robot_rewards, contact
    totals = np.zeros(3), np.zeros((3, 2)), np.zeros((3, 2), np.bool_)
    add_step(status, resting, step, totals, 0, 2, False)
    assert resting.tolist() == [False, True, False]
    assert contact.tolist() == [[False, False], [False, False], [True, True]]
    contact[0, 1] = True
    add_step(status, resting, step, totals, 0, 2, True)
    assert contact[0].tolist() == [False, True]  # those of the last step are kept
    assert totals[0].tolist() == [2.0, 4.0, 0.0]
    assert totals[1].tolist() == [[1.0, 2.0], [1.0, 2.0], [0.0, 0.0]]
    assert totals[2].tolist() == [[True, True], [False, True], [False, False]]
