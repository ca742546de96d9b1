"""Error messages for values of the wrong kind: field, value and remedy."""

import math
import re
from contextlib import suppress

import gymnasium
import numpy as np
import pytest
from conftest import started
from fuzzing import DOORS
from strategies import DEEP, HUGE, UNWRITABLE, refusal

import baselines
import rendezvous_env as rv
from rendezvous_env import Scenario
from rendezvous_env.checks import counted, short_repr
from rendezvous_env.limits import MAX_STEPS
from rendezvous_env.simulator import Simulator

PAIR = Scenario(n_robots=2)


def test_counted_gives_the_plural_unless_the_count_is_one():
    assert [counted(n, "step") for n in (0, 1, 2)] == ["0 steps", "1 step", "2 steps"]
    assert [counted(n, "policy") for n in (1, 3)] == ["1 policy", "3 policies"]


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (UNWRITABLE, "an integer of about 5001 digits"),
        (-UNWRITABLE, "an integer of about 5001 digits"),
        (10**59, repr(10**59)),
        ([1.5, "a"], "[1.5, 'a']"),
        (True, "True"),
        (DEEP, "[[[[[[...]]]]]]"),
    ],
    ids=lambda value: short_repr(value)[:30],
)
def test_short_repr_shows_value_with_limited_length(value, text):
    assert short_repr(value) == text
    assert len(short_repr("x" * 10**6)) < 100 and len(short_repr(list(range(10**6)))) < 100
    assert len(short_repr(np.zeros((40, 40)))) < 250


WRONG_ACTIONS = [
    None, "ab", b"ab", ["1", "2"], [HUGE, 0], [1e300, 0], [math.nan, 0.0], [None, 1.0], 5, [], {},
    [[1.0], [2.0, 3.0]], np.array([1.0, 2.0], dtype=object), [1j, 0], DEEP, np.array("a"),
    {"x": 1.0}, np.ones((2, 3)), np.array([0, "NaT"], "m8[s]"),
]  # fmt: skip


def test_pettingzoo_step_without_agents_rejects_array():
    env = rv.parallel_env(PAIR, max_cycles=1)
    env.reset(seed=0)
    env.step({name: np.zeros(2, np.float32) for name in env.agents})
    assert env.step({}) == ({}, {}, {}, {}, {})
    for wrong in (None, [], np.zeros((2, 2))):
        assert "actions is" in refusal(env.step, wrong)


@pytest.mark.parametrize("make", [rv.rendezvous_v0.env, rv.rendezvous_v0.raw_env])
def test_aec_step_rejects_wrong_action_immediately(make):
    env = make(PAIR, max_cycles=1)
    env.reset(seed=0)
    base = env.unwrapped
    before = base.get_state()
    for wrong in WRONG_ACTIONS:
        assert "action of robot_0 is" in refusal(env.step, wrong)
    assert env.agent_selection == "robot_0"
    env.step([0.0, 0.0])
    assert "action of robot_1 is None" in refusal(env.step, None)
    np.testing.assert_equal(base.get_state(), before)
    env.step(np.zeros(2, np.float32))
    assert env.truncations["robot_0"]
    assert "which has ended, is [0.0, 0.0]; it must be None" in refusal(env.step, [0.0, 0.0])
    env.step(None)
    env.step(None)
    assert env.agents == []


@pytest.mark.parametrize(
    "name",
    ["gymnasium", "simulator", "vector", "vector heading", "vector tank", "vector links"],
)
def test_invalid_action_arrays_are_rejected(name):
    env = DOORS[name][1](PAIR, 1)
    env.reset(seed=0)
    before = env.get_state()
    single = isinstance(env, gymnasium.Env)
    for wrong in WRONG_ACTIONS:
        for team in (wrong, [wrong, wrong]):
            message = refusal(env.step, team if single else [team])
            assert re.match(
                r"actions? (is|have shape|of robot_\d in environment 0 is) .* must be", message
            )
    np.testing.assert_equal(env.get_state(), before)
    message = refusal(env.step, [[0, 0], [1e300, 0]] if single else [[[0, 0], [1e300, 0]]])
    assert "finite, in float32" in message


WRONG_SEEDS = [5.0, True, "5", b"5", -1, -HUGE, [], [1, 2, 3], {}, [0.5], [True],
               np.array(5.0), np.array([[1]]), np.nan, {1}, [[1]], DEEP, 1j, ["a"]]  # fmt: skip


def state_of(env):
    """Running episode of any environment."""
    return (env if hasattr(env, "get_state") else env.unwrapped).get_state()


@pytest.fixture(params=DOORS)
def door(request):
    """Each kind of environment, freshly reset."""
    _, make = DOORS[request.param]
    env = make(PAIR, 1)
    env.reset(seed=3)
    return env


def test_reset_accepts_integers_of_any_type_as_seed(door):
    before = state_of(door)
    for wrong in WRONG_SEEDS:
        assert re.match("seed .*must be", refusal(door.reset, seed=wrong)), wrong
    np.testing.assert_equal(state_of(door), before)
    door.reset(seed=5)
    wanted = state_of(door)
    for seed in (np.array(5), np.int32(5), np.uint64(5), [5], np.array([5])):
        door.reset(seed=seed)
        np.testing.assert_equal(state_of(door), wanted)
    door.reset(seed=2**63 - 1)


LARGE_SEEDS = [2**63, 2**63 + 1, 2**64 - 1, 2**64, 2**130, HUGE, UNWRITABLE]


@pytest.mark.parametrize("seed", LARGE_SEEDS, ids=range(7))
def test_every_reset_folds_large_seeds_as_seed_sequence_does(door, seed):
    """Bitwise equal to the episode of the folded seed, which is in use."""
    used = int(np.random.SeedSequence(seed).generate_state(1, np.uint64)[0]) >> 1
    door.reset(seed=used)
    wanted = state_of(door)
    door.reset(seed=seed)
    np.testing.assert_equal(state_of(door), wanted)
    if (told := getattr(getattr(door, "unwrapped", None), "np_random_seed", None)) is not None:
        assert told in (used, (used,))


def test_seeds_in_use_are_those_of_np_random():
    """Given, random, and restored seeds, in every form with random numbers."""
    from rendezvous_env.envs.gymnasium_env import make_env

    for env in (rv.parallel_env("duo"), make_env("duo"), rv.training_env("duo")):
        for seed in (7, 2**64 + 1, None, 7):
            env.reset(seed=seed)
            assert env.np_random_seed == int(env.simulator.seeds[0])
            fresh = np.random.Generator(np.random.PCG64(env.np_random_seed))
            if seed is not None:
                assert env.np_random.random() == fresh.random()
        state = env.get_state()
        env.reset(seed=8)
        env.set_state(state)
        assert env.np_random_seed == 7
    fresh = make_env("duo")
    fresh.reset()
    assert fresh.np_random_seed == int(fresh.simulator.seeds[0])
    teams = rv.make_vec("duo", 3)
    teams.reset(seed=2**63 - 2)
    assert teams.np_random_seed == tuple(teams.simulator.seeds.tolist())
    assert teams.np_random_seed[:2] == (2**63 - 2, 2**63 - 1)
    assert teams.np_random.random() == np.random.Generator(np.random.PCG64(2**63 - 2)).random()


def test_seeds_of_a_batch_follow_one_another_or_are_one_each():
    simulator = started(PAIR, 3, seed=2**63 - 3)
    assert simulator.seeds.tolist() == [2**63 - 3, 2**63 - 2, 2**63 - 1]
    simulator.reset(2**63 - 1)
    large = simulator.seeds.tolist()
    assert large[0] == 2**63 - 1 and len(set(large)) == 3 and max(large) < 2**63
    simulator.reset([2**63 - 1, 2**63, 2**63 + 1])
    assert simulator.seeds.tolist() == large
    for wrong, said in (([1, 2], "seed has 2 entries; it must be one number, or 3"),
                        ([1, 2, "x"], "seed is 'x'; it must be an integer")):  # fmt: skip
        assert said in refusal(simulator.reset, wrong)


WRONG_OPTIONS = [
    (5, "options is 5; it must be None or a dict"),
    ([("positions", 1)], "options is .* None or a dict"),
    ({"position": 1}, "options: 'position' is not an option; did you mean 'positions'"),
    (
        {"start_positions": 1},
        "options: 'start_positions' is not an option; did you mean 'positions'",
    ),
    ({"adjacency": 1}, "options: 'adjacency' is not an option; did you mean 'weights'"),
    (
        {"speed_limit": 1},
        "options: 'speed_limit' is a field of the scenario.* environment with max_speed=…",
    ),
    ({"n_robot": 3}, "options: 'n_robot' is a field of the scenario.* environment with n_robots=…"),
    ({"positions": [[HUGE, 0], [0, 0]]}, "positions is .* numbers"),
    ({"positions": DEEP}, "positions is"),
    ({"frames": np.full((2, 2, 2), 1e300)}, "frames of robot_0 is"),
    ({"weights": [[0, None], [None, 0]]}, "weights is .* numbers"),
    ({"obstacles": [{"radius": 1}]}, "obstacles: a disc needs centre"),
]


def test_reset_rejects_invalid_options_and_ignores_unknown(door):
    before = state_of(door)
    for options, message in WRONG_OPTIONS:
        said = refusal(door.reset, seed=1, options=options)
        assert re.match(message, said), said
    np.testing.assert_equal(state_of(door), before)
    door.reset(seed=1)
    wanted = state_of(door)
    door.reset(seed=1, options={5: 1, UNWRITABLE: 2, ("a",): 3, "x" * 300: 4, None: 5})
    np.testing.assert_equal(state_of(door), wanted)


CLUTTER = Scenario(n_robots=2, obstacle_slots=2)


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        *[
            (name, {field: value}, rf"{field} is .*; it must")
            for value in (math.nan, math.inf, -1, "1", None, [1], HUGE, True, np.ones(2))
            for name, field in (
                ("tangent-merged", "clearance"),
                ("tangent-merged-tuned", "clearance"),
                ("tangent-merged-tuned", "persistence"),
                ("tank-merged", "budget"),
                ("tank-merged", "patience"),
                ("tangent-certified", "min_alignment"),
                ("tangent-blocking-certified", "max_turn_rate"),
                ("random", "seed"),
            )
            if not (field == "seed" and value is HUGE)
            if not (field in ("persistence", "budget", "patience") and value is None)
        ],
        ("tangent-merged-tuned", {"min_alignment": 1e-9}, "min_alignment is 1e-09; .*least 1e-06"),
        (["zero"], {}, r"policy \['zero'\] is unknown; those that fit are"),
        (5, {}, "policy 5 is unknown"),
        (None, {}, "policy None is unknown"),
        ("x" * 10**5, {}, "policy 'x.* is unknown"),
    ],
)
def test_policy_options_are_validated_on_construction(name, options, message):
    assert re.search(message, refusal(baselines.make, name, CLUTTER, **options))


@pytest.mark.parametrize(
    "name", [name for name in baselines.names(CLUTTER) if not name.startswith("privileged")]
)
def test_policies_reject_observations_of_other_shape(name):
    policy = baselines.make(name, CLUTTER)
    rows, d = CLUTTER.observation_layout.shape
    for wrong in (
        np.zeros(()), np.zeros(d), np.zeros((2, rows + 1, d)), np.zeros((2, rows, 3)), None, "a",
        np.zeros((2, rows, d), dtype=object), [[1], [2, 3]], DEEP,
    ):  # fmt: skip
        assert re.match("observations (is|have shape)", refusal(policy, wrong, 0.0))
    for kind in ("<f8", ">f4", np.longdouble, np.float16, np.int8):
        assert policy(np.zeros((2, rows, d), kind), 0.0).shape == (2, d)
    assert policy(np.zeros((2, rows, d)).tolist(), 0.0).shape == (2, d)
    with np.errstate(all="ignore"), suppress(ValueError):  # taken or not, a reset forgets it
        policy(np.full((2, rows, d), np.nan), 0.0)
    policy.reset()
    assert np.isfinite(policy(np.zeros((2, rows, d)), np.zeros(()))).all()


def test_policies_reject_invalid_masks_and_times():
    policy = baselines.make("tangent-certified", CLUTTER)
    policy(np.zeros((3, 2, *CLUTTER.observation_layout.shape)), 0.0)
    for wrong in ([True], "abc", [[True, False, True]], [1, 0, 1], 5):
        assert "one for each of 3 environments" in refusal(policy.reset, wrong)
    policy.reset([True, False, True])
    scenario = Scenario(n_robots=2, robot_model="unicycle")
    policy = baselines.make("unicycle-cosine", scenario)
    for time in ("a", None, math.nan, [0.0, 1.0], [[0.0]], HUGE, {}):
        rows = np.zeros((3, 2, *scenario.observation_layout.shape))
        assert re.match("time is", refusal(policy, rows, time))


@pytest.mark.parametrize("value", [0, -1, True, 2.0, "2", math.nan, math.inf, HUGE, [1]])
def test_invalid_counts_are_rejected(value):
    assert f"max_cycles is {short_repr(value)}" in refusal(Simulator(PAIR).set_max_steps, value)
    assert "num_envs is" in refusal(Simulator, PAIR, value)
    assert "num_threads is" in refusal(Simulator, PAIR, 1, num_threads=value)
    env = rv.parallel_env(PAIR, max_cycles=MAX_STEPS)
    with pytest.raises(ValueError, match="max_cycles is"):
        env.max_cycles = value
    assert env.max_cycles == MAX_STEPS
    assert "num_envs is" in refusal(rv.rollout, PAIR, lambda o, t: o, num_envs=value)


def test_invalid_modes_and_policies_are_rejected():
    assert "max_cycles is None" in refusal(Simulator(PAIR).set_max_steps, None)
    for mode in ("Next", 5, None, ["NextStep"]):
        said = refusal(rv.make_vec, PAIR, autoreset_mode=mode)
        assert re.match(r"autoreset_mode is .* one of 'NextStep', 'SameStep', 'Disabled'", said)
    for policy in (5, None, "zero"):
        assert "it must be callable" in refusal(rv.rollout, PAIR, policy, kind=TypeError)
    for answer in (None, "a", [HUGE], np.zeros(3)):
        assert re.match("actions", refusal(rv.rollout, PAIR, lambda o, t, a=answer: a))
    for mode in (5, ["human"], np.array(["human"])):
        assert "render_mode is" in refusal(rv.parallel_env, PAIR, render_mode=mode)
