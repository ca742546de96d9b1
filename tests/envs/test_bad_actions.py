"""Invalid actions: errors name the robot, and the state is unchanged."""

import copy

import numpy as np
import pytest
from conftest import MODELS
from guarantees import GUARANTEES, constant, draw, make, same
from test_pettingzoo import merged, until_a_merge
from test_training_env import SCENARIO

import rendezvous_env as rv


def _with(name, value):
    return lambda actions, gone: {**actions, name: value(actions.get("robot_0"))}


BAD_ACTIONS = {
    "nan": (_with("robot_0", lambda a: a * np.nan), ValueError, r"action of robot_0 .*nan"),
    "short": (_with("robot_0", lambda a: a[1:]), ValueError, "action of robot_0 .* finite numbers"),
    "number": (_with("robot_0", lambda a: 1.0), ValueError, "action of robot_0 is 1.0"),
    "text": (_with("robot_0", lambda a: "left"), ValueError, "action of robot_0 is 'left'"),
    "no dict": (lambda a, gone: list(a.values()), ValueError, "it must be a dict with an action"),
    "missing": (lambda a, gone: {k: v for k, v in a.items() if k != "robot_0"}, KeyError,
        "robot_0 is alive but has no action"),
    "unknown": (_with("robot_9", lambda a: a), KeyError, "'robot_9' is no robot of this env"),
    "no name": (_with(5, lambda a: a), KeyError, "5 is no robot of this environment"),
    "merged away": (lambda a, gone: {**a, gone: a["robot_0"]}, KeyError, "GONE has merged into"),
}  # fmt: skip


@pytest.fixture(
    scope="module", params=[*((None, kind) for kind in MODELS), *((w, None) for w in GUARANTEES)]
)
def after_a_merge(request):
    """An environment with or without a guarantee, and a newly merged robot."""
    which, kind = request.param
    env = make(which, kind or "single_integrator-2d", changes={"spawn_size": 3.0})
    if which is None:
        infos = until_a_merge(env)[-1]
    else:
        infos, ahead = env.reset(seed=3)[-1], np.zeros(env.action_space("robot_0").shape)
        ahead[0] = 1.0
        while not merged(infos):
            infos = env.step(constant(env, ahead))[-1]
    return env, merged(infos)[0]


@pytest.mark.parametrize("name", BAD_ACTIONS)
def test_bad_actions_name_robot_and_change_nothing(after_a_merge, name):
    spoil, error, message = BAD_ACTIONS[name]
    env, gone = copy.deepcopy(after_a_merge[0]), after_a_merge[1]
    choices, before = draw(env, np.random.default_rng(0)), env.get_state()
    with pytest.raises(error, match=message.replace("GONE", gone)):
        env.step(spoil(choices, gone))
    assert same(env.get_state(), before)
    assert same(env.step(choices), copy.deepcopy(after_a_merge[0]).step(choices))


@pytest.mark.parametrize(
    ("form", "bad"),
    [({}, [0.0, np.nan]), ({"discrete": True}, 9), ({"discrete": True}, 0.5)],
)
def test_training_env_names_robot(form, bad):
    env = rv.training_env(SCENARIO, **form)
    env.reset(seed=0)
    actions, before = draw(env, np.random.default_rng(0)), env.get_state()
    with pytest.raises(ValueError, match="action of robot_2 is"):
        env.step(actions | {"robot_2": bad})
    with pytest.raises(KeyError, match="robot_3 is alive but has no action"):
        env.step({name: actions[name] for name in env.agents[:3]})
    assert same(env.get_state(), before)
    env.step(actions)


@pytest.mark.parametrize(
    ("form", "bad", "message"),
    [
        ({}, np.full((2, 4, 2), np.nan), "action of robot_0 in environment 0 is .*must be finite"),
        ({}, np.zeros((2, 4)), r"shape \(2, 4\); they must be \(B, n, 2\) = \(2, 4, 2\)"),
        ({"discrete": True}, np.full((2, 4), 9), "robot_0 in environment 0 is 9.*integer below 9"),
        ({"discrete": True}, np.full((2, 4), 1.5), "robot_0 in environment 0 is 1.5"),
        ({"discrete": True}, [[0, 0, 0, 0], [0, 0, -1, 0]], "robot_2 in environment 1 is -1"),
        ({"discrete": True}, np.zeros((2, 4, 2)), r"they must be \(B, n\) = \(2, 4\)"),
        ({"discrete": True}, np.full((2, 4), np.inf), "robot_0 in environment 0 is inf"),
        ({"discrete": True}, [[None] * 4] * 2, "actions is .* must be numbers"),
    ],
)
def test_vector_training_env_names_environment_and_robot(form, bad, message):
    teams = rv.vector.training_env(SCENARIO, 2, **form)
    teams.reset(seed=0)
    before = teams.get_state()["env"]["env"]
    with pytest.raises(ValueError, match=message):
        teams.step(bad)
    assert same(teams.get_state()["env"]["env"], before)
