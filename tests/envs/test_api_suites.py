"""PettingZoo and Gymnasium API test suites on every kind of environment."""

import itertools
import warnings
from functools import partial
from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest
from conftest import MODELS, five
from guarantees import GUARANTEES, WHICH_AND_KIND, make, same
from gymnasium.utils.env_checker import check_env
from parameters import marked
from pettingzoo.utils.conversions import parallel_to_aec
from test_training_env import FORMS, SCENARIO

import rendezvous_env as rv
from rendezvous_env import rendezvous_v0

with warnings.catch_warnings():  # PettingZoo imports its own old modules here
    warnings.simplefilter("ignore", DeprecationWarning)
    from pettingzoo import test as suites
    from pettingzoo.test.state_test import state_test

# the two messages that a table of directions must provoke, by their exact text
pytestmark = pytest.mark.filterwarnings(
    "ignore:^The observation contains negative numbers and is in the shape of a graphical "
    r"observation\. This might be a bad thing\.$:UserWarning",
    r"ignore:^Observation numpy array is all zeros\.$:UserWarning",
)
SMALL = {"spawn_size": 4.0, "time_limit": 8.0}
HEAVY = five("single_integrator-2d", robot_model="double_integrator", **SMALL)
TEAMS = {
    "with inertia": HEAVY,
    **{
        f"{kind}, {on_merge}": five(kind, on_merge=on_merge, **SMALL)
        for kind, on_merge in itertools.product(MODELS, ("remove", "follow"))
    },
}
WRAPPED = {
    f"{which}, {kind}": partial(make, which, kind, decision_period=3, **GUARANTEES[which].options)
    for which, kind in WHICH_AND_KIND
}
PARALLEL = {
    **{name: partial(rv.parallel_env, scenario) for name, scenario in TEAMS.items()},
    **WRAPPED,
    **{f"training, {name}": partial(rv.training_env, SCENARIO, **FORMS[name]) for name in FORMS},
}

AEC = [*TEAMS, *WRAPPED]
FAST = {
    *(f"{kind}, remove" for kind in MODELS),
    *(f"{which}, single_integrator-2d" for which in GUARANTEES),
    *("unicycle, follow", "training, preset", "training, discrete"),
}
"""Environments in fast tests."""


@pytest.mark.parametrize("name", marked(PARALLEL, slow=PARALLEL.keys() - FAST))
def test_pettingzoo_parallel_api(name, capsys):
    build = PARALLEL[name]
    suites.parallel_api_test(build(), num_cycles=300)
    assert "Passed Parallel API test" in capsys.readouterr().out
    suites.parallel_seed_test(build, num_cycles=60)
    assert not same(*(build().reset(seed=seed)[0] for seed in (1, 2)))


@pytest.mark.parametrize("name", marked(AEC, slow={*AEC} - FAST))
def test_aec_api(name, capsys):
    build = PARALLEL[name]
    if name in TEAMS:
        forms = rendezvous_v0.env, rendezvous_v0.raw_env
        aec, raw = (partial(form, TEAMS[name]) for form in forms)
        suites.seed_test(aec, num_cycles=60)
    else:
        aec = raw = lambda: parallel_to_aec(build())
    suites.api_test(aec(), num_cycles=200, verbose_progress=False)
    assert "Passed API test" in capsys.readouterr().out
    env = raw()
    state_test(env, build(), num_cycles=20)
    assert env.state_space == build().unwrapped.state_space
    assert np.isfinite([env.state_space.low, env.state_space.high]).all()


def test_max_cycles_is_time_limit():
    forms = rendezvous_v0.parallel_env, rendezvous_v0.env
    parallel, aec = (lambda max_cycles, form=form: form("duo", None, max_cycles) for form in forms)
    suites.max_cycles_test(SimpleNamespace(parallel_env=parallel, env=aec))


@pytest.mark.parametrize(
    "scenario",
    ["fig4", "swarm-20", "unicycle-6", "uav-6", pytest.param(HEAVY, marks=pytest.mark.slow)],
)
def test_gymnasium_check_env(scenario):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gymnasium.make(
            "rendezvous_env:rendezvous/Rendezvous-v0", scenario=scenario, render_mode="rgb_array"
        )
        env.reset(seed=0)
        env.render()
        check_env(env.unwrapped)
    assert env.spec.max_episode_steps is None


@pytest.mark.filterwarnings("ignore::UserWarning")  # it prefers images and bounded boxes
def test_gymnasium_check_env_with_headings():
    env = gymnasium.make(
        "rendezvous_env:rendezvous/RendezvousHeading-v0", scenario=SCENARIO, min_alignment=0.3
    )
    check_env(env.unwrapped, skip_render_check=True)
    assert env.action_space.shape == (4, 2)
