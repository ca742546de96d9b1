"""Supported and rejected wrappers of other libraries: a table, with a test for each row.

| library | over | fits |
|---|---|---|
| Gymnasium | one agent (``make_env``) | SINGLE |
| Gymnasium | ``rv.make_vec``, guarantees, ``vector.training_env`` | ABOVE |
| Gymnasium | beneath a guarantee | BENEATH; REFUSED are refused |
| PettingZoo | ``rv.parallel_env``, ``rv.training_env``, ``rendezvous_v0.env`` | PARALLEL, TURNS |
| SuperSuit | the same | SUPERSUIT; beneath a guarantee its third column |
| stable-baselines3 | ``RobotVecEnv`` | STOCK; the others in ``adapters.sb3_wrappers`` |
| skrl | ``rv.training_env``, vector forms, one agent | SKRL |
| TorchRL | ``rv.training_env``; ``rv.parallel_env`` to the first merge | ``PettingZooWrapper`` |
| Minari | one agent | ``DataCollector``, in ``test_specs`` |
"""

import numpy as np
import pytest
from gymnasium import wrappers
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import vector as vector_wrappers
from pettingzoo.utils import wrappers as pettingzoo_wrappers
from pettingzoo.utils.conversions import parallel_to_aec
from stable_baselines3.common.vec_env import VecCheckNan, VecNormalize

import rendezvous_env as rv
from rendezvous_env import vector
from rendezvous_env.adapters.sb3 import make_robots
from rendezvous_env.envs.gymnasium_env import make_env, make_heading_env

SHORT = {"time_limit": 2.0}


def with_arguments(kind, *arguments, **options):
    return lambda env: kind(env, *arguments, **options)


# Gymnasium, one agent

SINGLE = {
    "TimeLimit": with_arguments(wrappers.TimeLimit, 5),
    "OrderEnforcing": wrappers.OrderEnforcing,
    "Autoreset": wrappers.Autoreset,
    "RecordEpisodeStatistics": wrappers.RecordEpisodeStatistics,
    "ClipAction": wrappers.ClipAction,
    "RescaleAction": with_arguments(wrappers.RescaleAction, np.float32(-1.0), np.float32(1.0)),
    "StickyAction": with_arguments(wrappers.StickyAction, 0.3),
    "FlattenObservation": wrappers.FlattenObservation,
    "FrameStackObservation": with_arguments(wrappers.FrameStackObservation, 3),
    "DelayObservation": with_arguments(wrappers.DelayObservation, 2),
    "NormalizeObservation": wrappers.NormalizeObservation,
    "TimeAwareObservation": with_arguments(wrappers.TimeAwareObservation),
    "RescaleObservation": with_arguments(
        wrappers.RescaleObservation, np.float32(-1.0), np.float32(1.0)
    ),
    "TransformReward": with_arguments(wrappers.TransformReward, lambda reward: 2.0 * reward),
    "ClipReward": with_arguments(wrappers.ClipReward, -1.0, 1.0),
    "NormalizeReward": wrappers.NormalizeReward,
}


@pytest.mark.parametrize("name", SINGLE)
@pytest.mark.parametrize("make", [make_env, make_heading_env])
@pytest.mark.filterwarnings("ignore:.*TimeAware|.*time limit|.*max_episode_steps")
def test_wrappers_of_gymnasium_fit_one_agent(name, make):
    made = make("fig3", time_limit=2.0)
    if name == "TimeAwareObservation":  # which asks for a time limit of Gymnasium's own
        made = wrappers.TimeLimit(made, 100)
    env = SINGLE[name](made)
    env.reset(seed=0)
    env.action_space.seed(0)
    ends = 0
    for _ in range(70):
        seen, reward, met, late, _ = env.step(env.action_space.sample())
        assert env.observation_space.contains(seen) and np.isfinite(reward)
        if met or late:
            ends += 1
            if name != "Autoreset":
                env.reset()
    assert ends >= 1


# Gymnasium, vector

ANY_MODE = {
    "RecordEpisodeStatistics": vector_wrappers.RecordEpisodeStatistics,
    "NormalizeReward": vector_wrappers.NormalizeReward,
    "ClipReward": with_arguments(vector_wrappers.ClipReward, -1.0, 1.0),
    "TransformReward": with_arguments(vector_wrappers.TransformReward, lambda r: 2.0 * r),
    "ClipAction": vector_wrappers.ClipAction,
    "TransformAction": with_arguments(vector_wrappers.TransformAction, lambda action: action),
    "DictInfoToList": vector_wrappers.DictInfoToList,
}
OF_OBSERVATIONS = {  # Gymnasium's own refuse SAME_STEP
    "FlattenObservation": vector_wrappers.FlattenObservation,
    "TransformObservation": with_arguments(vector_wrappers.TransformObservation, np.negative),
}
ABOVE = ANY_MODE | OF_OBSERVATIONS
FORMS = {
    "teams": rv.make_vec,
    "guarantee": lambda *given, **options: vector.HeadingVectorWrapper(
        rv.make_vec(*given, **options)
    ),
    "training": vector.training_env,
}


@pytest.mark.parametrize("name", ABOVE)
@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("mode", AutoresetMode)
def test_wrappers_of_gymnasium_fit_vector_environments(name, form, mode):
    made = FORMS[form]("fig3", 3, autoreset_mode=mode, **SHORT)
    if name in OF_OBSERVATIONS and mode is AutoresetMode.SAME_STEP:
        with pytest.raises(ValueError, match="Expected autoreset_mode"):
            ABOVE[name](made)
        return
    env = ABOVE[name](made)
    env.reset(seed=0)
    env.action_space.seed(0)
    for _ in range(70):
        seen, rewards, *_ = env.step(env.action_space.sample())
        assert seen.shape == env.observation_space.shape and np.isfinite(rewards).all()


BENEATH = ["RecordEpisodeStatistics", "NormalizeReward", "ClipReward", "TransformReward"]
REFUSED = {name: TypeError for name in (*OF_OBSERVATIONS, "ClipAction", "TransformAction")}
REFUSED |= {"DictInfoToList": RuntimeError}


@pytest.mark.parametrize("name", ABOVE)
@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.DISABLED])
def test_wrappers_of_gymnasium_beneath_guarantees_fit_or_are_refused(name, mode):
    def played():
        beneath = ABOVE[name](rv.make_vec("fig3", 3, autoreset_mode=mode, **SHORT))
        env = vector.EnergyTankWrapper(beneath, decision_period=3)
        env.reset(seed=0)
        for _ in range(30):
            env.step(env.action_space.sample())

    if name in BENEATH:
        return played()
    with pytest.raises(REFUSED[name], match="EnergyTankWrapper"):
        played()


# PettingZoo

PARALLEL = {
    "BaseParallelWrapper": pettingzoo_wrappers.BaseParallelWrapper,
    "MultiEpisodeParallelEnv": with_arguments(pettingzoo_wrappers.MultiEpisodeParallelEnv, 3),
}
TURNS = {
    "BaseWrapper": pettingzoo_wrappers.BaseWrapper,
    "AssertOutOfBoundsWrapper": None,  # for discrete actions, as PettingZoo has it
    "ClipOutOfBoundsWrapper": pettingzoo_wrappers.ClipOutOfBoundsWrapper,
    "OrderEnforcingWrapper": pettingzoo_wrappers.OrderEnforcingWrapper,
    "MultiEpisodeEnv": with_arguments(pettingzoo_wrappers.MultiEpisodeEnv, 3),
}
TEAMS = {
    "parallel": lambda: rv.parallel_env("fig3", **SHORT),
    "guarantee": lambda: rv.HeadingVectorWrapper(rv.parallel_env("fig3", **SHORT)),
    "training": lambda: rv.training_env("fig3", **SHORT),
    "discrete": lambda: rv.training_env("fig3", discrete=True, **SHORT),
}


def play_together(env, steps=60):
    env.reset(seed=0)
    for name in env.possible_agents:
        env.action_space(name).seed(0)
    ends = 0
    for _ in range(steps):
        given = env.step({name: env.action_space(name).sample() for name in env.agents})
        for name, seen in given[0].items():
            assert seen.shape == env.observation_space(name).shape
        if not env.agents:
            ends += 1
            env.reset()
    assert ends >= 1


def play_in_turn(env, steps=300):
    env.reset(seed=0)
    for name in env.possible_agents:
        env.action_space(name).seed(0)
    for name in env.agent_iter(steps):
        *_, met, late, _ = env.last()
        env.step(None if met or late else env.action_space(name).sample())


@pytest.mark.parametrize("name", PARALLEL)
@pytest.mark.parametrize("form", TEAMS)
def test_wrappers_of_pettingzoo_fit(name, form):
    play_together(PARALLEL[name](TEAMS[form]()), 200)


@pytest.mark.parametrize("name", TURNS)
@pytest.mark.parametrize("form", TEAMS)
def test_wrappers_of_pettingzoo_fit_robots_one_after_another(name, form):
    discrete = name == "AssertOutOfBoundsWrapper"
    if discrete != (form == "discrete"):
        pytest.skip("this wrapper is for the other kind of actions")
    wrap = pettingzoo_wrappers.AssertOutOfBoundsWrapper if discrete else TURNS[name]
    play_in_turn(wrap(parallel_to_aec(TEAMS[form]())))


def test_episodes_that_a_wrapper_begins_beneath_a_guarantee_are_refused():
    beneath = pettingzoo_wrappers.MultiEpisodeParallelEnv(TEAMS["parallel"](), 3)
    with pytest.raises(RuntimeError, match="beneath HeadingVectorWrapper has stepped or reset"):
        play_together(rv.HeadingVectorWrapper(beneath), 200)


# SuperSuit: how it wraps; whether it fits beneath a guarantee, or what refuses it

SUPERSUIT = {
    "clip_actions_v0": ((), True),
    "clip_reward_v0": ((), True),
    "delay_observations_v0": ((2,), RuntimeError),
    "dtype_v0": ((np.float64,), TypeError),
    "flatten_v0": ((), TypeError),
    "frame_skip_v0": ((3,), RuntimeError),
    "frame_stack_v1": ((3,), TypeError),
    "max_observation_v0": ((2,), RuntimeError),
    "sticky_actions_v0": ((0.3,), RuntimeError),
    "observation_lambda_v0": ((lambda seen, space: 0.5 * seen,), (TypeError, RuntimeError)),
    "reward_lambda_v0": ((lambda reward: 2.0 * reward,), True),
    "black_death_v3": ((), RuntimeError),  # it steps a team that has ended
    "agent_indicator_v0": ((), TypeError),
    "pad_observations_v0": ((), True),
    "pad_action_space_v0": ((), True),
    "nan_zeros_v0": ((), True),
}


@pytest.mark.parametrize("name", SUPERSUIT)
@pytest.mark.parametrize("form", ["parallel", "guarantee", "training"])
def test_wrappers_of_supersuit_fit(name, form):
    supersuit = pytest.importorskip("supersuit")
    play_together(getattr(supersuit, name)(TEAMS[form](), *SUPERSUIT[name][0]))
    turns = parallel_to_aec(TEAMS[form]())
    play_in_turn(getattr(supersuit, name)(turns, *SUPERSUIT[name][0]))


@pytest.mark.parametrize("name", SUPERSUIT)
def test_wrappers_of_supersuit_beneath_guarantees_fit_or_are_refused(name):
    supersuit = pytest.importorskip("supersuit")
    arguments, fits = SUPERSUIT[name]

    def played():
        beneath = getattr(supersuit, name)(TEAMS["parallel"](), *arguments)
        play_together(rv.HeadingVectorWrapper(beneath))

    if fits is True:
        return played()
    with pytest.raises(fits, match="HeadingVectorWrapper"):
        played()


def test_vector_environments_of_supersuit_fit_training_environments():
    supersuit = pytest.importorskip("supersuit")
    env = supersuit.pettingzoo_env_to_vec_env_v1(TEAMS["training"]())
    env.reset(seed=0)
    for _ in range(50):
        env.step(np.stack([env.action_space.sample() for _ in range(env.num_envs)]))


def test_frame_skip_draws_from_the_seed():
    """SuperSuit's requirement, without SuperSuit."""
    for make in (rv.parallel_env, rv.training_env):
        env = make("duo")
        env.reset(seed=3)
        drawn = env.unwrapped.np_random.integers(2, 9, 5).tolist()
        env.reset(seed=3)
        assert env.unwrapped.np_random.integers(2, 9, 5).tolist() == drawn
        env.np_random = np.random.default_rng(0)
        assert env.np_random_seed == -1


# stable-baselines3

STOCK = {"VecNormalize": with_arguments(VecNormalize, norm_obs=False), "VecCheckNan": VecCheckNan}


@pytest.mark.parametrize("name", STOCK)
def test_wrappers_of_stable_baselines3_fit(name):
    env = STOCK[name](make_robots("fig3", 3, **SHORT))
    env.reset()
    for _ in range(60):
        env.step(np.ones((env.num_envs, *env.action_space.shape), np.float32))


# skrl

SKRL = {
    "one team to train": lambda: rv.training_env("duo"),
    "choices": lambda: rv.training_env("duo", discrete=True),
    "robots that stay": lambda: rv.parallel_env("duo", on_merge="follow"),
    "guarantee": lambda: rv.HeadingVectorWrapper(rv.parallel_env("duo", on_merge="follow")),
    "one agent": lambda: make_env("duo"),
    "teams": lambda: rv.make_vec("duo", 3),
    "teams to train": lambda: vector.training_env("duo", 3),
    "vector guarantee": lambda: vector.HeadingVectorWrapper(rv.make_vec("duo", 3)),
}


@pytest.mark.parametrize("form", SKRL)
@pytest.mark.filterwarnings("ignore")
def test_skrl_recognises_environments(form):
    pytest.importorskip("skrl")
    torch = pytest.importorskip("torch")
    from skrl.envs.wrappers.torch import wrap_env

    made = SKRL[form]()
    env = wrap_env(made, verbose=False)
    env.reset()
    if hasattr(env, "possible_agents"):
        for _ in range(4):
            chosen = {name: np.asarray(env.action_space(name).sample()) for name in env.agents}
            env.step({name: torch.as_tensor(each).reshape(1, -1) for name, each in chosen.items()})
        assert env.state()["robot_0"].shape[-1] == made.state_space.shape[0]
        return
    rewards = env.step(torch.as_tensor(made.action_space.sample()).reshape(env.num_envs, -1))[1]
    assert rewards.shape == (env.num_envs, 1)


@pytest.mark.parametrize("make", [rv.training_env, rv.parallel_env])
def test_environments_name_pettingzoo_among_their_direct_bases(make):
    bases = [f"{base.__module__}.{base.__qualname__}" for base in type(make("duo")).__bases__]
    assert "pettingzoo.utils.env.ParallelEnv" in bases


# TorchRL


@pytest.mark.filterwarnings("ignore")
def test_torchrl_wraps_training_environments_to_the_end_and_others_to_the_first_merge():
    wrapping = pytest.importorskip("torchrl.envs.libs.pettingzoo")
    PettingZooWrapper = wrapping.PettingZooWrapper  # noqa: N806 - a class

    env = PettingZooWrapper(rv.training_env("fig3"), return_state=True)
    env.rollout(400)
    simulator = env._env.unwrapped.simulator
    assert simulator.ended[0]
    env = PettingZooWrapper(rv.HeadingVectorWrapper(rv.parallel_env("fig3")))
    env.rollout(2000)
    simulator = env._env.unwrapped.simulator
    assert not simulator.ended[0] and not simulator.active.all()
