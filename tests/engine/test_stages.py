"""Stages depend on what they compute, and on nothing else."""

import numpy as np
import pytest

import rendezvous_env as rv
from rendezvous_env import kernel_cache
from rendezvous_env.compilation import compiled
from rendezvous_env.engine.stages.apply_noise import apply_noise
from rendezvous_env.engine.stages.collide import merge_robots
from rendezvous_env.engine.stages.conclude import conclude_step
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
    expected = {"propose_motion", "advance_free", "sense_pairs", "conclude_step"}
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
