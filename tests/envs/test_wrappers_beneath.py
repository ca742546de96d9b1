"""Foreign wrappers beneath a guarantee: rejected if they void it, otherwise correct."""

import numpy as np
import pytest
from guarantees import GUARANTEES
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorWrapper
from gymnasium.wrappers.vector import NormalizeReward, RecordEpisodeStatistics, TransformReward
from pettingzoo.utils.conversions import aec_to_parallel, parallel_to_aec
from pettingzoo.utils.wrappers import BaseParallelWrapper, BaseWrapper

import rendezvous_env as rv
from rendezvous_env import vector

SCENARIO = rv.scenarios.get("fig4").replace(obstacles=(), time_limit=20.0)
WHICH = pytest.mark.parametrize("which", GUARANTEES)
MODES = pytest.mark.parametrize("mode", AutoresetMode)


class Observing(BaseParallelWrapper):
    """Wrapper that changes observations."""

    def reset(self, seed=None, options=None):
        seen, infos = super().reset(seed=seed, options=options)
        return self._changed(seen), infos

    def step(self, actions):
        seen, *others = super().step(actions)
        return self._changed(seen), *others

    def _changed(self, seen):
        return {name: -rows for name, rows in seen.items()}


class WritingToObservations(Observing):
    """The same, in place."""

    def _changed(self, seen):
        for rows in seen.values():
            rows *= -1.0
        return seen


class ObservingLater(Observing):
    """Wrapper without effect at a reset."""

    def reset(self, seed=None, options=None):
        return self.env.reset(seed=seed, options=options)


class Acting(BaseParallelWrapper):
    """Wrapper that changes actions."""

    def step(self, actions):
        return super().step({name: -action for name, action in actions.items()})


class WritingToActions(BaseParallelWrapper):
    """The same, in place."""

    def step(self, actions):
        for action in actions.values():
            action *= -1.0
        return super().step(actions)


class ActingRarely(BaseParallelWrapper):
    """Wrapper that repeats an old action at random (sticky actions)."""

    count = 0

    def step(self, actions):
        self.count += 1
        if self.count == 7:
            actions = {name: 0.5 * action for name, action in actions.items()}
        return super().step(actions)


class Stacking(BaseParallelWrapper):
    """Wrapper with observations of another shape."""

    def observation_space(self, agent):
        space = super().observation_space(agent)
        return Box(-9.0, 9.0, (*space.shape, 4), np.float32)


class ActingInOtherUnits(BaseParallelWrapper):
    """Wrapper with actions of another range."""

    def action_space(self, agent):
        return Box(-1.0, 1.0, super().action_space(agent).shape, np.float32)


class Passing(BaseParallelWrapper):
    """Wrapper that changes rewards only."""

    def step(self, actions):
        seen, rewards, *others = super().step(actions)
        return seen, {name: reward + 1.0 for name, reward in rewards.items()}, *others


class Turns(BaseWrapper):
    """AEC wrapper with negated observations."""

    def observe(self, agent):
        return -super().observe(agent)


def turn_based(env):
    return aec_to_parallel(Turns(parallel_to_aec(env)))


def played(env, steps=40):
    """V under random choices."""
    env.reset(seed=0)
    random, simulator = np.random.default_rng(0), env.unwrapped.simulator
    found = [simulator.lyapunov()[0]]
    for _ in range(steps):
        if env.agents:
            shape = env.action_space(env.agents[0]).shape
            env.step({name: random.uniform(-1, 1, shape) for name in env.agents})
            found.append(simulator.lyapunov()[0])
    return np.array(found)


CHANGING = [
    Observing, WritingToObservations, ObservingLater, Acting, WritingToActions, ActingRarely,
    turn_based,
]  # fmt: skip


@WHICH
@pytest.mark.parametrize("between", CHANGING)
@pytest.mark.parametrize("twice", [False, True])
def test_guarantee_refuses_wrapper_that_changes_observations_or_actions(which, between, twice):
    beneath = between(rv.parallel_env(SCENARIO))
    env = GUARANTEES[which].around(Passing(beneath) if twice else beneath)
    name = "Turns" if between is turn_based else between.__name__
    what = "actions" if "Acting" in name or "Actions" in name else "observations"
    remedy = "apply it outside"
    with pytest.raises(RuntimeError, match=rf"{name}.*has changed {what}, .*{remedy}"):
        played(env)
    if what == "actions" or between is ObservingLater:
        with pytest.raises(RuntimeError, match=r"call reset\(\)"):
            env.step(dict.fromkeys(env.agents, np.zeros(env.action_space("robot_0").shape)))


@WHICH
@pytest.mark.parametrize("between", [Stacking, ActingInOtherUnits])
def test_guarantee_refuses_wrapper_that_changes_spaces(which, between):
    with pytest.raises(TypeError, match=rf"in {between.__name__}, which changes the spaces"):
        GUARANTEES[which].around(Passing(between(rv.parallel_env(SCENARIO))))


@WHICH
def test_guarantee_stands_on_wrapper_that_passes_on(which):
    guarantee, base = GUARANTEES[which], rv.parallel_env(SCENARIO)
    plain = played(guarantee.around(rv.parallel_env(SCENARIO), decision_period=2))
    for env in (Passing(base), aec_to_parallel(parallel_to_aec(rv.parallel_env(SCENARIO)))):
        np.testing.assert_array_equal(played(guarantee.around(env, decision_period=2)), plain)


def test_wrapper_that_stands_for_sensors_is_accepted():
    class Sensor(Observing):
        part_of_world = True

        def _changed(self, seen):
            return {name: np.roll(rows, 1, axis=0) for name, rows in seen.items()}

    assert (np.diff(played(rv.HeadingVectorWrapper(Sensor(rv.parallel_env("duo"))))) <= 0.0).all()


class Teams(VectorWrapper):
    """Wrapper that changes its inputs and outputs."""

    def __init__(self, env, *, observed=lambda seen: seen, acted=lambda actions: actions):
        super().__init__(env)
        self.observed, self.acted = observed, acted

    def reset(self, **asked):
        seen, infos = super().reset(**asked)
        return self.observed(seen), infos

    def step(self, actions):
        seen, *others = super().step(self.acted(actions))
        return self.observed(seen), *others


def negated(array):
    array *= -1.0
    return array


TEAM_CHANGES = [
    ({"observed": np.negative}, "observations"), ({"observed": negated}, "observations"),
    ({"acted": np.negative}, "actions"), ({"acted": negated}, "actions"),
]  # fmt: skip


@WHICH
@MODES
@pytest.mark.parametrize(("change", "what"), TEAM_CHANGES)
def test_vector_guarantee_refuses_wrapper_that_changes_what_passes(which, mode, change, what):
    beneath = Teams(rv.make_vec(SCENARIO, 2, autoreset_mode=mode), **change)
    env = GUARANTEES[which].around_teams(RecordEpisodeStatistics(beneath))
    random = np.random.default_rng(0)
    with pytest.raises(RuntimeError, match=rf"Teams.*has changed {what}"):
        env.reset(seed=0)
        for _ in range(5):
            env.step(random.uniform(0.0, 1.0, env.action_space.shape))


def test_vector_guarantee_refuses_wrapper_that_changes_spaces():
    class Units(VectorWrapper):
        def __init__(self, env):
            super().__init__(env)
            space = env.single_action_space
            self.single_action_space = Box(-1.0, 1.0, space.shape, space.dtype)

    with pytest.raises(TypeError, match="in Units, which changes the spaces"):
        vector.HeadingVectorWrapper(Units(rv.make_vec("fig3", 2)))


def counted(mode, period, steps=200, teams=6, above=False, **options):
    """Episodes under random choices: (length, return) as recorded, by environment, and actual."""
    made = rv.make_vec("duo", teams, autoreset_mode=mode, time_limit=5.0)
    if above:
        env = RecordEpisodeStatistics(made)
    else:
        below = RecordEpisodeStatistics(made)
        env = vector.HeadingVectorWrapper(below, decision_period=period, **options)
    env.reset(seed=0)
    simulator, random = made.simulator, np.random.default_rng(0)
    found, expected = ([[] for _ in range(teams)] for _ in range(2))
    total, running = np.zeros(teams), ~simulator.ended
    for _ in range(steps):
        _, rewards, met, late, infos = env.step(
            random.uniform(-1.0, 1.0, env.action_space.shape).astype(np.float32)
        )
        over, total = met | late, total + rewards
        for team in np.flatnonzero(infos.get("_episode", [])):
            own = {key: values[team] for key, values in infos["episode"].items()}
            found[team].append((own["l"], own["r"]))
        for team in np.flatnonzero(over):
            told = infos["final_info"] if mode is AutoresetMode.SAME_STEP else infos
            length = round(told["time"][team] / made.scenario.tau)
            expected[team].append((length, total[team]))
        total[over] = 0.0
        if mode is AutoresetMode.DISABLED and running.any() and simulator.ended.all():
            env.step(np.zeros(env.action_space.shape, np.float32))  # all stand still
            env.reset(options={"reset_mask": simulator.ended})
    return found, expected


@MODES
@pytest.mark.parametrize("period", [1, 5, 7])
def test_recorder_beneath_guarantee_counts_each_episode_once(mode, period):
    found, expected = counted(mode, period)
    assert sum(map(len, expected)) >= 20
    ends = {length % period for own in expected for length, _ in own}
    assert period == 1 or len(ends) > 1  # some end within a decision
    for mine, right in zip(found, expected, strict=True):
        np.testing.assert_allclose(mine, right, rtol=1e-6, atol=1e-9)


@MODES
def test_recorder_above_teams_counts_each_episode_once(mode):
    found, expected = counted(mode, 1, above=True)
    for mine, right in zip(found, expected, strict=True):
        assert len(right) >= 3
        np.testing.assert_allclose(mine, right, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("make", [rv.make_vec, vector.training_env])
def test_disabled_teams_report_an_end_once(make):
    env = RecordEpisodeStatistics(make("duo", 4, autoreset_mode="Disabled", max_cycles=9))
    env.reset(seed=0)
    ends = np.zeros(4, int)
    while not env.unwrapped.simulator.ended.all():
        *_, met, late, _ = env.step(np.zeros(env.action_space.shape, np.float32))
        ends += met | late
    for _ in range(3):
        *_, met, late, infos = env.step(np.zeros(env.action_space.shape, np.float32))
        ends += met | late
        np.testing.assert_array_equal(infos["success"], env.unwrapped.simulator.status == 1)
    assert env.episode_count == 4 == len(env.return_queue) and (ends == 1).all()


@MODES
def test_infos_of_wrappers_are_joined_by_their_masks(mode):
    class Marking(VectorWrapper):
        """Wrapper that marks one environment per step."""

        count = 0

        def step(self, actions):
            *others, infos = super().step(actions)
            mask = np.arange(3) == self.count
            nested = {"a": np.where(mask, 10.0 + self.count, 0.0), "_a": mask}
            infos |= {"mark": np.where(mask, self.count, -1), "_mark": mask, "last": self.count}
            infos |= {"deep": nested, "_deep": mask.copy()}
            self.count += 1
            return *others, infos

    made = rv.make_vec("fig3", 3, autoreset_mode=mode)
    env = vector.HeadingVectorWrapper(Marking(made), decision_period=2)
    env.reset(seed=0)
    infos = env.step(np.ones(env.action_space.shape))[4]
    np.testing.assert_array_equal(infos["mark"], [0, 1, -1])
    np.testing.assert_array_equal(infos["_mark"], [True, True, False])
    np.testing.assert_array_equal(infos["deep"]["a"], [10.0, 11.0, 0.0])
    np.testing.assert_array_equal(infos["deep"]["_a"], infos["_deep"])
    assert infos["last"] == 1 and infos["_merged_into"].all()


@MODES
def test_rewards_that_wrappers_add_to_standing_environments_are_not_summed(mode):
    made = TransformReward(rv.make_vec("duo", 3, autoreset_mode=mode), lambda r: 0.0 * r + 1.0)
    env = vector.HeadingVectorWrapper(made, decision_period=5)
    env.reset(seed=0)
    for _ in range(30):
        before = env.unwrapped.simulator.steps.copy()
        _, rewards, met, late, infos = env.step(np.ones(env.action_space.shape))
        over = met | late
        if over.any():
            told = infos["final_info"] if mode is AutoresetMode.SAME_STEP else infos
            lasted = np.round(told["time"] / made.unwrapped.scenario.tau) - before
            np.testing.assert_allclose(rewards[over], lasted[over])
            assert (lasted[over] < 5).any()
            return
    raise AssertionError("none has ended")


def test_normalised_rewards_beneath_guarantee_are_those_of_bare_steps():
    """Statistics of a decision of five steps equal those of five steps without an end."""
    scenario = SCENARIO.replace(time_limit=100.0)
    under = NormalizeReward(rv.make_vec(scenario, 3))
    env = vector.HeadingVectorWrapper(under, decision_period=5)
    bare = NormalizeReward(rv.make_vec(scenario, 3))
    bare_env = vector.HeadingVectorWrapper(bare, decision_period=1)
    env.reset(seed=0), bare_env.reset(seed=0)
    up = np.ones(env.action_space.shape)
    rewards = env.step(up)[1]
    assert rewards.shape == (3,) and under.return_rms.count == pytest.approx(15.0, abs=1e-3)


@WHICH
@pytest.mark.parametrize("period", [1, 4, 5])
def test_films_of_guarantees_play_in_real_time(which, period):
    guarantee, tau = GUARANTEES[which], SCENARIO.tau
    for env in (
        guarantee.around(rv.parallel_env(SCENARIO), decision_period=period),
        guarantee.around_teams(rv.make_vec(SCENARIO, 2), decision_period=period),
        parallel_to_aec(guarantee.around(rv.parallel_env(SCENARIO), decision_period=period)),
    ):
        assert env.metadata["render_fps"] == pytest.approx(1.0 / (period * tau), rel=1e-12)
        assert env.metadata["render_modes"] == ["human", "rgb_array"]
    assert rv.parallel_env("robotarium-4").metadata["render_fps"] == pytest.approx(1.0 / 0.033)


@pytest.mark.parametrize("wrapped", [False, True])
def test_infos_have_the_same_keys_from_reset_on(wrapped):
    env = rv.parallel_env(SCENARIO.replace(time_limit=1.0))
    _, infos = (env := rv.HeadingVectorWrapper(env) if wrapped else env).reset(seed=0)
    keys = infos["robot_0"].keys()
    while env.agents:
        assert all(info.keys() == keys for info in infos.values())
        summary = infos["robot_0"]["summary"]
        assert "summary" not in infos["robot_0"]
        assert summary.items() <= infos["robot_0"].items() and len(summary) == 5
        shape = env.action_space("robot_0").shape
        *_, infos = env.step({name: np.ones(shape, np.float32) for name in env.agents})
    assert all(info.keys() == keys and "summary" in info for info in infos.values())
    with pytest.raises(KeyError, match="other"):
        infos["robot_0"]["other"]


@MODES
@pytest.mark.parametrize("wrapped", [False, True])
def test_vector_infos_have_the_same_keys_from_reset_on(mode, wrapped):
    env = rv.make_vec(SCENARIO.replace(time_limit=1.0), 3, autoreset_mode=mode)
    _, infos = (env := vector.HeadingVectorWrapper(env) if wrapped else env).reset(seed=0)
    keys, ended = infos.keys(), 0
    for _ in range(45):
        *_, met, late, infos = env.step(np.ones(env.action_space.shape, np.float32))
        assert infos.keys() - {"final_obs", "_final_obs", "final_info", "_final_info"} == keys
        assert infos["_summary"].all()
        for key, values in infos["summary"].items():
            np.testing.assert_array_equal(values, infos[key])
        ended += (met | late).sum()
    assert ended >= 3


def test_films_of_training_forms_play_in_real_time():
    from rendezvous_env.envs.gymnasium_env import make_heading_env

    for env in (
        rv.training_env("duo"),
        vector.training_env("duo", 2),
        rv.training_env("duo", guarantee="links", decision_period=3),
        make_heading_env("duo", decision_period=7),
    ):
        period = env.vector_env.env if hasattr(env, "agents") else getattr(env, "vector_env", env)
        period = getattr(period, "decision_period", None) or env.env.decision_period
        expected = 1.0 / (period * env.unwrapped.simulator.scenario.tau)
        assert env.metadata["render_fps"] == pytest.approx(expected, rel=1e-12)
