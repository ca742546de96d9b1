"""A guarantee is not put upon another one, and begins with a reset of its own."""

from __future__ import annotations

import itertools

import gymnasium
import numpy as np
import pytest

import rendezvous_env as rv
from rendezvous_env.envs.gymnasium_env import make_env

NAMES = ["HeadingVectorWrapper", "EnergyTankWrapper", "GainWrapper", "LinkKeepingWrapper"]
PAIRS = list(itertools.product(NAMES, NAMES))


def one_team():
    return rv.parallel_env("ring-12")


def teams(**options):
    return rv.make_vec("ring-12", num_envs=2, **options)


@pytest.mark.parametrize(("upper", "lower"), PAIRS)
def test_a_guarantee_is_not_put_upon_another(upper, lower):
    with pytest.raises(TypeError, match=rf"{lower}.*{upper}"):
        getattr(rv, upper)(getattr(rv, lower)(one_team()))


@pytest.mark.parametrize(("upper", "lower"), PAIRS)
def test_nor_are_those_of_vector_environments(upper, lower):
    with pytest.raises(TypeError, match=rf"{lower}.*{upper}"):
        getattr(rv.vector, upper)(getattr(rv.vector, lower)(teams()))


@pytest.mark.parametrize("upper", NAMES)
def test_nor_upon_one_with_another_wrapper_in_between(upper):
    from pettingzoo.utils.wrappers import BaseParallelWrapper

    between = BaseParallelWrapper(rv.EnergyTankWrapper(one_team()))
    with pytest.raises(TypeError, match=rf"EnergyTankWrapper.*{upper}"):
        getattr(rv, upper)(between)
    getattr(rv, upper)(BaseParallelWrapper(one_team())).reset(seed=0)


@pytest.mark.parametrize("upper", NAMES)
def test_training_environments_have_their_guarantee(upper):
    with pytest.raises(TypeError):
        getattr(rv, upper)(rv.training_env("ring-12"))
    with pytest.raises(TypeError):
        getattr(rv.vector, upper)(rv.vector.training_env("ring-12", num_envs=2))


@pytest.mark.parametrize("upper", NAMES)
def test_a_team_as_one_agent_is_neither(upper):
    for wrapper in (getattr(rv, upper), getattr(rv.vector, upper)):
        with pytest.raises(TypeError, match="RendezvousEnv"):
            wrapper(make_env("ring-12"))


@pytest.mark.parametrize("name", NAMES)
def test_an_environment_that_was_reset_before_needs_a_new_reset(name):
    base = one_team()
    base.reset(seed=0)
    env = getattr(rv, name)(base)
    choices = {agent: env.action_space(agent).sample() for agent in env.agents}
    with pytest.raises(RuntimeError, match=rf"{name}.*new reset"):
        env.step(choices)
    env.reset(seed=0)
    env.step(choices)
    env = getattr(rv, name)(base)
    env.set_state(getattr(rv, name)(base).get_state())
    env.step(choices)

    venv = teams()
    venv.reset(seed=0)
    wrapped = getattr(rv.vector, name)(venv)
    with pytest.raises(RuntimeError, match=rf"{name}.*new reset"):
        wrapped.step(np.zeros(wrapped.action_space.shape, np.float32))
    wrapped.reset(seed=0)
    wrapped.step(np.zeros(wrapped.action_space.shape, np.float32))


@pytest.mark.parametrize("make", [rv.parallel_env, rv.training_env])
def test_a_step_before_the_reset_says_so(make):
    env = make("ring-12")
    actions = {name: env.action_space(name).sample() for name in env.possible_agents}
    for given in (actions, {}):
        with pytest.raises(RuntimeError, match="call reset"):
            env.step(given)


@pytest.mark.parametrize("spelling", ["SAME_STEP", "same_step", "SameStep", "same-step"])
def test_autoreset_modes_may_be_spelled_as_elsewhere(spelling):
    mode = gymnasium.vector.AutoresetMode.SAME_STEP
    if "-" in spelling:
        with pytest.raises(ValueError, match="autoreset_mode"):
            teams(autoreset_mode=spelling)
    else:
        assert teams(autoreset_mode=spelling).autoreset_mode is mode


@pytest.mark.parametrize("name", NAMES[:2])
@pytest.mark.parametrize("margin", [0.0, 5e-324, 1e-200, 9e-7])
def test_the_smallest_margin_is_a_millionth(name, margin):
    for wrapper, env in ((getattr(rv, name), one_team()), (getattr(rv.vector, name), teams())):
        with pytest.raises(ValueError, match=r"at least 1e-06"):
            wrapper(env, min_alignment=margin)
        wrapper(env, min_alignment=1e-6)
    with pytest.raises(ValueError, match="at least 1e-06"):
        rv.certified_heading([1, 0], [1, 0], [1, 0], min_alignment=margin, dead_zone=1, max_turn=1)
