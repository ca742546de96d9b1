"""Custom safety filters from outside the package, and wrappers beneath a guarantee."""

import copy
import gc
import pickle

import gymnasium
import numpy as np
import pytest
from guarantees import constant
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import RecordEpisodeStatistics

import rendezvous_env as rv
from rendezvous_env.safety.tank import EnergyTank


class HalfSpeed(rv.SafetyFilter):
    """Filter: law (1) at a fraction of its speed chosen by the policy, at least ``least``."""

    state_key = "half_speed"
    chooses_vectors = False
    lowest_choice = 0.0

    def __init__(self, scenario, num_envs, *, least=0.5, num_threads=None):
        super().__init__(scenario, num_envs, action_size=1, frame="local", num_threads=num_threads)
        self.least = least

    def compute(self, observations):
        f = self.scenario.observation_layout.net_bearing(observations)
        return (np.maximum(self.held, self.least) * f).astype(np.float32)


rv.register_filter("half_speed", HalfSpeed)


def test_custom_filter_works_in_every_environment():
    env = rv.GuaranteeWrapper(rv.parallel_env("fig3"), "half_speed", least=0.25)
    env.reset(seed=0)
    assert env.action_space("robot_0").shape == (1,) and env.filter.least == 0.25
    assert set(env.get_state()) == {"env", "half_speed", "observed"}
    while env.agents:
        *_, infos = env.step(constant(env, [0.0]))
    assert all(info["summary"]["success"] for info in infos.values())

    venv = rv.make_vec("fig3", num_envs=3, autoreset_mode="Disabled")
    env = rv.vector.GuaranteeWrapper(venv, HalfSpeed, least=0.5)
    env.reset(seed=0)
    while not venv.simulator.ended.all():
        *_, infos = env.step(np.zeros(env.action_space.shape))
    assert infos["success"].all()

    made = HalfSpeed(venv.scenario, 3)
    assert rv.vector.GuaranteeWrapper(venv, made).filter is made
    teams = rv.vector.training_env("fig3", 2, guarantee="half_speed", least=0.75)
    assert teams.env.filter.least == 0.75
    # choices are held as under the guarantees of the package
    assert teams.env.decision_period == round(0.6 / teams.scenario.tau)
    for own in ({"decision_period": 3}, {"learning_preset": False}):
        held = rv.vector.training_env("fig3", 2, guarantee="half_speed", **own)
        assert held.env.decision_period == own.get("decision_period", 1)
    teams.reset(seed=0)
    teams.step(np.zeros(teams.action_space.shape, np.float32))


@pytest.mark.slow
def test_filter_instance_serves_one_wrapper():
    scenario = rv.scenarios.get("duo")
    for home, make in (
        (rv, lambda: rv.parallel_env(scenario)),
        (rv.vector, lambda: rv.make_vec(scenario)),
    ):
        made = EnergyTank(scenario, 1, budget=1.0)
        env = home.GuaranteeWrapper(make(), made)
        with pytest.raises(ValueError, match="this EnergyTank is used by another"):
            home.GuaranteeWrapper(make(), made)
        for again in (copy.deepcopy(env), pickle.loads(pickle.dumps(env))):
            again.reset(seed=0)
            assert again.filter is not made
            with pytest.raises(ValueError, match="this EnergyTank is used by another"):
                home.GuaranteeWrapper(make(), again.filter)
        other = home.GuaranteeWrapper(make(), copy.deepcopy(made))
        other.reset(seed=0)
        del env
        gc.collect()
        assert home.GuaranteeWrapper(make(), made).filter is made  # nobody holds it any more


class CountingTank(EnergyTank):
    """Tank that counts how often its calls are made anew."""

    count = 0

    def apply_calls(self, *given):
        self.count += 1
        return super().apply_calls(*given)


class ReusingTank(CountingTank):
    reuses_calls = True


@pytest.mark.parametrize(("kind", "count"), [(CountingTank, 5), (ReusingTank, 2)])
def test_calls_are_reused_in_a_decision_only_if_a_filter_says_so(kind, count):
    made = lambda kind: rv.vector.GuaranteeWrapper(  # noqa: E731
        rv.make_vec("clutter-4", 3, num_threads=1), kind, decision_period=5, budget=1.0
    )
    plain, counting = made(EnergyTank), made(kind)
    plain.reset(seed=0), counting.reset(seed=0)
    assert EnergyTank.reuses_calls
    for step in range(1, 4):
        choices = np.random.default_rng(step).uniform(-1, 1, plain.action_space.shape)
        (seen, *rest), (own, *others) = plain.step(choices), counting.step(choices)
        np.testing.assert_array_equal(own, seen)
        np.testing.assert_array_equal(others[0], rest[0])
        assert counting.filter.count == count * step


def test_invalid_filter_is_rejected():
    base = rv.parallel_env("fig3")
    with pytest.raises(TypeError, match="HalfSpeed has no setting 'leats'; did you mean 'least'"):
        rv.GuaranteeWrapper(base, "half_speed", leats=1)
    made = type("Made", (HalfSpeed,), {"__init__": lambda self, scenario: None})
    with pytest.raises(TypeError, match=r"constructor of Made: .*; it must take \(scenario, num_e"):
        rv.GuaranteeWrapper(base, made)
    for safety_filter in ("half_speed", HalfSpeed(base.scenario, 1)):
        with pytest.raises(TypeError, match="has no setting 'decision_periods'; did you mean"):
            rv.GuaranteeWrapper(base, safety_filter, decision_periods=2)
    for call, arguments, message in (
        (rv.GuaranteeWrapper, (base, "half_sped"), "safety_filter is 'half_sped'"),
        (rv.GuaranteeWrapper, (base, 5), "safety_filter is 5; it must be one of"),
        (rv.GuaranteeWrapper, (base, dict), "safety_filter is <class 'dict'>; .* a subclass of it"),
        (
            rv.GuaranteeWrapper,
            (base, HalfSpeed(base.scenario, 2)),
            "this scenario and 1 environment",
        ),
        (rv.register_filter, ("heading", HalfSpeed), "which are taken"),
        (rv.register_filter, ("other", dict), "subclass of SafetyFilter"),
        (rv.register_filter, ("no word", HalfSpeed), "a word"),
    ):
        with pytest.raises(ValueError, match=message):
            call(*arguments)


@pytest.mark.parametrize("wrapper", [rv.GuaranteeWrapper, rv.vector.GuaranteeWrapper])
def test_filter_names_must_not_clash_with_environment(wrapper):
    """The name would replace a method, or an entry of states or infos."""
    base = rv.parallel_env("fig3") if wrapper is rv.GuaranteeWrapper else rv.make_vec("fig3", 2)
    for key in ("env", "observed", "step", "simulator", "reset", "_seen", "no word", 3):
        named = type("Named", (HalfSpeed,), {"state_key": key})
        with pytest.raises(ValueError, match=f"state_key of Named is {key!r}; it must be"):
            wrapper(base, named)
    named = type("Named", (HalfSpeed,), {"state_key": "shown"})  # as only a learner's teams have it
    assert set(wrapper(base, named).get_state()) == {"env", "observed", "shown"}
    for key in ("contact", "lyapunov", "robot_rewards"):
        kind = type("Reports", (HalfSpeed,), {"diagnostics": property(lambda _, k=key: {k: None})})
        with pytest.raises(ValueError, match=f"Reports reports '{key}', which is already a key"):
            wrapper(base, kind)


@pytest.mark.parametrize("mode", list(AutoresetMode))
@pytest.mark.parametrize("period", [1, 3])
def test_gymnasium_wrappers_work_beneath_guarantee(mode, period):
    """Rewards pass through them in each step; everything else is unchanged."""

    def make(between):
        venv = rv.make_vec("fig3", num_envs=3, autoreset_mode=mode, time_limit=2.0)
        env = between(venv)
        return rv.vector.EnergyTankWrapper(env, budget=1.0, decision_period=period)

    plain = make(lambda env: env)
    doubled = make(lambda env: gymnasium.wrappers.vector.TransformReward(env, lambda r: 2 * r))
    random, ended = np.random.default_rng(0), 0
    seen, _ = plain.reset(seed=4)
    np.testing.assert_array_equal(seen, doubled.reset(seed=4)[0])
    for _ in range(60):
        choices = random.uniform(-1, 1, plain.action_space.shape)
        one, two = plain.step(choices), doubled.step(choices)
        np.testing.assert_array_equal(one[0], two[0])
        np.testing.assert_array_equal(2 * one[1], two[1])
        ended += (one[2] | one[3]).sum()
        for key in ("tank", "merged_into", "time", "contact"):
            np.testing.assert_array_equal(one[4][key], two[4][key])
    assert ended >= 3


@pytest.mark.parametrize("mode", list(AutoresetMode))
@pytest.mark.parametrize("period", [1, 3])
def test_statistics_recorder_counts_each_end_once(mode, period):
    """Including ends within a decision; the team rests for the remaining steps."""
    if gymnasium.__version__ < "1.3" and mode is AutoresetMode.SAME_STEP:
        pytest.skip("the recorder of Gymnasium 1.2 leaves out the first step of such episodes")

    def episodes(beneath, above):
        venv = beneath(rv.make_vec("fig3", num_envs=3, autoreset_mode=mode, max_cycles=11))
        env = above(rv.vector.HeadingVectorWrapper(venv, decision_period=period))
        env.reset(seed=4)
        random, found = np.random.default_rng(0), []
        for _ in range(40):
            *_, met, late, infos = env.step(random.uniform(-1, 1, env.action_space.shape))
            if "episode" in infos:
                found.append(infos["episode"]["r"])
            if mode is AutoresetMode.DISABLED and (met | late).any():
                env.reset(options={"reset_mask": met | late})
        return np.array(found)

    above = episodes(lambda env: env, RecordEpisodeStatistics)
    assert len(above) >= 3 and above.all()
    np.testing.assert_allclose(episodes(RecordEpisodeStatistics, lambda env: env), above)


def test_inner_wrapper_may_end_episode_within_decision():
    class Stops(gymnasium.vector.VectorWrapper):
        def step(self, actions):
            *told, late, infos = super().step(actions)
            return *told, late | (np.rint(infos["time"] / self.env.scenario.tau) == 4), infos

    base = rv.make_vec("fig3", num_envs=3, autoreset_mode="SameStep")
    env = rv.vector.HeadingVectorWrapper(Stops(base), decision_period=3)
    env.reset(seed=4)
    ended = [env.step(np.ones(env.action_space.shape))[3].tolist() for _ in range(4)]
    assert ended == [[False] * 3, [True] * 3] * 2 and not base.simulator.time.any()


def test_statistics_recorder_keeps_tanks_of_others():
    """The recorder removes the mask of environments from the given options."""
    venv = RecordEpisodeStatistics(rv.make_vec("fig3", num_envs=2, autoreset_mode="Disabled"))
    env = rv.vector.EnergyTankWrapper(venv, budget=1.0)
    env.reset(seed=4)
    away = np.broadcast_to(np.float32([-1.0, 0.0]), env.action_space.shape)
    env.step(away)
    before, options = env.tank.levels, {"reset_mask": np.array([True, False])}
    _, infos = env.reset(options=options)
    assert (env.tank.levels[0] == 1.0).all() and (before < 1.0).all()
    np.testing.assert_array_equal(env.tank.levels[1], before[1])
    assert infos["_tank"].tolist() == [True, False] and "reset_mask" in options
    whole = rv.vector.EnergyTankWrapper(rv.make_vec("fig3", num_envs=2), budget=1.0)
    whole.reset(seed=4), whole.reset()
    np.testing.assert_array_equal(env.step(away)[0][0], whole.step(away)[0][0])


def test_training_env_logs_no_missing_guarantee_before_it_refuses(caplog):
    fields = {"n_robots": 12, "neighbour_slots": 7, "neighbour_overflow": "nearest"}
    with pytest.raises(ValueError, match="neighbour"):
        rv.vector.training_env("clutter-4", 2, **fields)
    assert not caplog.messages


def test_training_env_logs_missing_guarantee_once(caplog):
    """Including errors that are unknown to its wrapper."""
    erring = rv.Scenario(n_robots=2, sensing=rv.Sensing(error=0.01))
    for scenario, given, words in (
        ("noisy-8", {}, ["no rendezvous is certified in"]),
        ("ring-12", {}, []),
        (erring, {}, ["in 'custom': pass bearing_error=0.01, the maximum"]),
        (erring, {"bearing_error": 0.01}, []),
    ):
        caplog.clear()
        for number in range(2):
            fields = {"time_limit": 7.25, "reward": {"time_penalty": float(number)}} | given
            rv.vector.training_env(scenario, learning_preset=False, **fields)
        assert len(caplog.messages) == len(words) and all(word in caplog.text for word in words)
