"""A wrapper that changes the rewards of teams changes what TorchRL and BenchMARL pay."""

import numpy as np
import pytest

pytest.importorskip("torchrl.envs")
from gymnasium.wrappers.vector import TransformReward

from rendezvous_env.adapters.torchrl import GROUP, RendezvousEnv


def more(teams):
    return TransformReward(teams, lambda rewards: rewards + 5.0)


@pytest.mark.parametrize("return_state", [False, True])
def test_a_wrapper_of_the_teams_changes_the_rewards_of_robots(return_state):
    found = []
    for options in ({}, {"wrap": more}):
        env = RendezvousEnv("clutter-4", 3, seed=0, return_state=return_state, **options)
        env.set_seed(0)
        data = env.reset()
        data[GROUP, "action"] = env.action_spec[GROUP, "action"].zero()
        found.append(env.step(data)["next", GROUP, "reward"].numpy())
    np.testing.assert_allclose(found[1] - found[0], 5.0, rtol=1e-5)
    assert found[0].shape == (3, 4, 1)


def test_a_task_of_benchmarl_hands_the_wrapper_on():
    pytest.importorskip("benchmarl")
    from rendezvous_env.adapters.benchmarl import RendezvousTask

    env = RendezvousTask("clutter-4", {"wrap": more}).get_env_fun(2, True, 0, "cpu")()
    data = env.reset()
    data[GROUP, "action"] = env.action_spec[GROUP, "action"].zero()
    assert (env.step(data)["next", GROUP, "reward"] > 3.0).all()
