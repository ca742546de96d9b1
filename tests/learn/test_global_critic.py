"""Critic with the global state, and absence of that state elsewhere."""

from dataclasses import replace

import numpy as np
import pytest
import torch

import rendezvous_env as rv
from rendezvous_env.adapters.slots import of_one_robot
from train.learn.environments import make_environments
from train.learn.networks import FAR, GlobalStateLayout
from train.learn.recurrent import Sequences, learner_of
from train.learn.settings import Config

CONFIG = Config(
    scenario="clutter-12", set=("time_limit=3",), guarantee="tank", budget=2.0, critic="global",
    set_width=8, hidden=(16,), memory_units=8, num_envs=5, decision_period=1,
)  # fmt: skip


def test_global_state_matches_hand_computation():
    """Robot 1 is 5 m from robot 0, the disc's centre 2 m to the left of it and 1 m ahead."""
    disc = rv.Disc((-1.0, 2.5), 0.5)
    scenario = rv.Scenario(n_robots=2, obstacles=(disc,), time_limit=10.0, max_speed=2.0)
    simulator = rv.Simulator(scenario, 1)
    observations = simulator.reset(0, {"positions": [[0.0, 0.0], [3.0, 4.0]]})
    f = scenario.observation_layout.net_bearing(observations)
    layout = GlobalStateLayout(2, 3)
    states = layout.states(simulator, f, np.array([[0.0, np.e - 1.0]]))
    assert states.shape == (1, 2, layout.size) and states.dtype == np.float32
    seen = layout.split(states)
    np.testing.assert_allclose(
        seen.robots[0], [[[0, 0, 0, 1], [1, 0, 1, 1]], [[1, 0, 0, 1], [0, 0, 1, 1]]], atol=1e-6
    )
    centre, x, y = np.array([-1.0, 2.5]), np.array([0.6, 0.8]), np.array([-0.8, 0.6])
    expected = [centre @ x / FAR, centre @ y / FAR, 0.5 / FAR]
    np.testing.assert_allclose(seen.obstacles[0, 0, 0], expected, atol=1e-6)
    assert not seen.obstacles[0, :, 1:].any()
    np.testing.assert_allclose(seen.context[0], [[1, 0], [1, 0]], atol=1e-6)
    for _ in range(20):
        observations = simulator.step(observations[..., 0, :]).observations
    f = scenario.observation_layout.net_bearing(observations)
    later = layout.split(layout.states(simulator, f, np.zeros((1, 2))))
    left = float(simulator.lyapunov()[0] / simulator.initial_lyapunov[0])
    assert left < 0.99
    share = 20 * scenario.tau / 10.0
    np.testing.assert_allclose(later.context[0, 0], [left, share], atol=1e-6)


def test_global_state_exists_without_visible_neighbours():
    """V(0) is 0, and V may be positive later."""
    scenario = rv.Scenario(
        n_robots=2, graph=rv.graphs.proximity(), require_connected=False, max_speed=4.0,
        sensing=rv.Sensing(range=1.0), local_frames="global", time_step=0.1,
    )  # fmt: skip
    simulator, layout = rv.Simulator(scenario, 1), GlobalStateLayout(2, 0)
    seen = simulator.reset(0, {"positions": [[0.0, 0.0], [1.2, 0.0]]})
    for _ in range(2):
        f = scenario.observation_layout.net_bearing(seen)
        states = layout.states(simulator, f, np.zeros((1, 2)))
        assert (layout.split(states).context[0, :, 0] == 0.0).all()
        seen = simulator.step(np.array([[[4.0, 0.0], [0.0, 0.0]]], np.float32)).observations
    assert simulator.initial_lyapunov[0] == 0.0 < simulator.lyapunov()[0]


@pytest.mark.slow
def test_merged_robots_are_absent_and_final_state_is_of_ended_episode():
    env = make_environments(CONFIG, 0)
    env.reset(seed=3)
    for _ in range(59):
        shown, *_ = env.step(np.zeros((5, 4), dtype=np.int64))
    active = env.env.simulator.active
    assert 0 < (~active).sum() < active.size
    states = shown[..., env.layout.size :]
    np.testing.assert_array_equal(states.any(axis=-1), active)
    there = active[:, :, None] & active[:, None, :]
    np.testing.assert_array_equal(env.global_state.split(states).robots[..., 3] == 1.0, there)
    shown, _, _, cuts, infos = env.step(np.zeros((5, 4), dtype=np.int64))
    assert cuts.any()
    last, split = np.stack(infos["final_obs"][cuts].tolist()), env.global_state.split
    np.testing.assert_array_equal(split(last[:, 0, env.layout.size :]).context[:, 1], 1.0)
    np.testing.assert_array_equal(split(shown[cuts][..., env.layout.size :]).context[..., 1], 0.0)


def judged(made, seen):
    """Preferences and values, without an optional hidden state."""
    if made.units:
        starts, kept = torch.ones(1, len(seen)), torch.ones(1, len(seen), dtype=torch.bool)
        seen = Sequences(seen[None], starts, torch.zeros(len(seen), made.units), kept)
    return made.judged(seen)


@pytest.mark.parametrize("memory", ["none", "features", "recurrent"])
def test_only_critic_reads_global_state(memory):
    config = replace(CONFIG, memory=memory)
    env = make_environments(config, 0)
    shown, _ = env.reset(seed=3)
    assert make_environments(replace(config, critic="local"), 0).layout == env.layout
    torch.manual_seed(1)
    spaces = map(of_one_robot, (env.single_observation_space, env.single_action_space))
    _, network, arguments = learner_of(config, env)
    made = network(*spaces, lambda _: 0.0, **arguments)
    seen = torch.as_tensor(shown.reshape(-1, shown.shape[-1]))
    other = seen.clone()
    other[:, env.layout.size :] += 1.0
    with torch.no_grad():
        torch.nn.init.normal_(made.action_net.weight, std=0.5)
        (before, own), (after, others) = judged(made, seen), judged(made, other)
    assert torch.equal(before, after) and (before[0] != before[1]).any()
    assert ((own - others).abs() > 1e-4).all()
    if memory == "recurrent":
        kept = []
        for each in (seen, other):
            made.begin(len(seen))
            made(each)
            kept.append(made.hidden)
        assert torch.equal(*kept) and kept[0].any()
