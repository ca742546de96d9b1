"""State of environments of every kind: in states, pickles, copies, and over resets."""

import copy
import pickle
from functools import partial

import numpy as np
import pytest
from conftest import MODELS
from guarantees import GUARANTEES, WHICH_AND_KIND, draw, make, same
from parameters import marked
from test_custom_filter import HalfSpeed
from test_gymnasium_env import SCENARIOS, small
from test_training_env import FORMS, SCENARIO

import rendezvous_env as rv


def teams(which, mode="NextStep", num_envs=6, **options):
    scenario = "clutter-8" if GUARANTEES[which].anywhere else rv.Scenario(n_robots=3)
    venv = rv.make_vec(scenario, num_envs, autoreset_mode=mode)
    return GUARANTEES[which].around_teams(venv, **options)


def made_with(make, which, *arguments):
    return partial(make, which, *arguments, decision_period=2, **GUARANTEES[which].options)


ENVIRONMENTS = {
    **{f"bare, {kind}": partial(make, None, kind) for kind in MODELS},
    **{f"{which}, {kind}": made_with(make, which, kind) for which, kind in WHICH_AND_KIND},
    **{f"teams, {which}": made_with(teams, which) for which in GUARANTEES},
    **{f"teams, {which}, local": partial(teams, which, frame="local") for which in GUARANTEES},
    **{f"teams, {name}": partial(rv.make_vec, small(name), 21) for name in SCENARIOS},
    **{f"training, {name}": partial(rv.training_env, SCENARIO, **FORMS[name]) for name in FORMS},
    "teams, same step": partial(rv.make_vec, small("2-D"), 21, "SameStep"),
    "filter of one's own": lambda: rv.GuaranteeWrapper(rv.parallel_env("fig3"), HalfSpeed),
}


def spoil(given):
    """Overwrite every array that an environment returned or received."""
    if isinstance(given, np.ndarray) and given.dtype != object:
        given[...] = ~given if given.dtype.kind == "b" else -7 - given
    elif isinstance(given, dict):
        spoil(tuple(given.values()))
    elif isinstance(given, (tuple, np.ndarray)):
        for part in given:
            spoil(part)


@pytest.mark.parametrize("name", marked(ENVIRONMENTS, slow=[*ENVIRONMENTS][1::2]))
def test_state_pickle_and_deepcopy_continue_alike(name):
    """Independent of later changes to arrays returned or received by the copies."""
    build, random = ENVIRONMENTS[name], np.random.default_rng(0)
    env, fresh = build(), build()
    env.reset(seed=3)
    for _ in range(3):
        env.step(draw(env, random))
    state = env.get_state()
    fresh.set_state(state)
    copies = [fresh, copy.deepcopy(env), pickle.loads(pickle.dumps(env))]
    given = [(state, copy.deepcopy(state))]
    while getattr(env, "agents", True) and len(given) < 13:
        choices = draw(env, random)
        result = env.step(choices)
        given.append((result, copy.deepcopy(result)))
        for other in copies:
            own = copy.deepcopy(choices)
            told = other.step(own)
            assert same(result, told) and same(env.get_state(), other.get_state())
            spoil((own, told, other.state()))
    assert len(given) > 5 and all(same(*pair) for pair in given)
    new = build()
    assert same(env.reset(seed=9), new.reset(seed=9)) and same(env.get_state(), new.get_state())
