"""Fuzzing of policies, wrappers, batches, headings and rollouts, see ``fuzzing``."""

from __future__ import annotations

import inspect
from typing import Any

import numpy as np
import pytest
import soup
from fuzzing import EFFORTS, TEAMS, Refused, assert_finite, attempt, explore, start_and_play, teams
from hypothesis import strategies as st
from soup import absurd, any_table, nearly

import baselines
import rendezvous_env as rv
from rendezvous_env import vector

# ---- policies -----------------------------------------------------------------------------------


@st.composite
def policies(draw: st.DrawFn) -> tuple[Any, str, dict[str, Any]]:
    """A name, the team that it is for, and options."""
    team = draw(teams)
    name = draw(nearly(st.sampled_from(baselines.names()), "bearing", "learn"))
    values = {
        "clearance": nearly(st.floats(0, 3)),
        "persistence": nearly(st.floats(0, 3)),
        "min_alignment": nearly(st.floats(0.01, 0.99)),
        "max_turn_rate": nearly(soup.lengths),
        "seed": nearly(st.integers(0, 5)),
        "clearence": absurd,
    }
    keys = draw(st.lists(st.sampled_from(sorted(values)), max_size=2, unique=True))
    return name, team, {key: draw(values[key]) for key in keys}


@pytest.mark.parametrize("effort", EFFORTS)
def test_policies(effort):
    def check(made, data):
        name, team, options = made
        scenario = TEAMS[team]
        policy = attempt(lambda: baselines.make(name, scenario, **options))
        if isinstance(policy, Refused) or hasattr(policy, "watch"):  # sees more than observations
            return
        shape = (2, scenario.n_robots, *scenario.observation_layout.shape)
        seen = data.draw(any_table(*shape) | any_table(*shape[1:]))
        usual = np.random.default_rng(0).uniform(-1, 1, shape).astype(np.float32)
        assert_finite(policy(usual, 0.0))
        time = data.draw(nearly(st.floats(0, 9), [0.0, 1.0]))
        with np.errstate(all="ignore"):  # such observations no simulator gives out
            attempt(lambda: policy(seen, time))
        attempt(lambda: policy.reset(data.draw(absurd | st.lists(st.booleans()))))
        policy.reset()
        assert_finite(policy(usual, np.zeros(2)))

    explore(check, 30 * effort, policies(), st.data())


# ---- settings -----------------------------------------------------------------------------------

margins = st.floats(0.01, 0.99)
WRAPPER = {
    "min_alignment": nearly(margins, 0, 1),
    "max_turn_rate": nearly(soup.lengths, 0),
    "frame": nearly(st.sampled_from(["net_bearing", "local"]), "body"),
    "decision_period": nearly(st.sampled_from([1, 3]), 0, 2.0),
    "certified": nearly(st.booleans(), 1),
    "budget": nearly(soup.lengths, -1e-9),
    "observe_level": nearly(st.booleans(), 1),
    "min_gain": nearly(st.none() | soup.lengths, 0.0, np.nan),
    "max_gain": nearly(st.none() | soup.lengths, -1.0),
    "share": nearly(st.floats(0.01, 1.0), 0.0, 1.1),
    "bearing_error": nearly(st.floats(0.0, 1.5), -0.1, 2.0),
}
"""Settings of guarantees; each takes those that it has an argument for."""
WRAPPERS = ("HeadingVectorWrapper", "EnergyTankWrapper", "GainWrapper", "LinkKeepingWrapper")
BATCH = {
    "num_envs": nearly(st.integers(1, 4), 0, 2.0),
    "num_threads": nearly(st.sampled_from([None, 1, 2]), 0),
    "max_cycles": nearly(st.sampled_from([None, 1, 5, 10**15]), 0),
    "autoreset_mode": nearly(st.sampled_from(["NextStep", "SameStep", "Disabled"]), "Next"),
    "render_mode": nearly(st.none(), "window"),
    "merge_radius": nearly(soup.lengths),
    "merge_radios": absurd,
}


def some_of(values: dict[str, st.SearchStrategy]) -> st.SearchStrategy:
    """A few keywords."""
    keys = st.lists(st.sampled_from(sorted(values)), max_size=3, unique=True)
    return keys.flatmap(lambda chosen: st.fixed_dictionaries({key: values[key] for key in chosen}))


@pytest.mark.parametrize("effort", EFFORTS)
def test_arguments_of_wrappers(effort):
    def check(team, alone, name, data):
        scenario = TEAMS[team]
        base = rv.parallel_env(scenario) if alone else rv.make_vec(scenario, 2, max_cycles=3)
        wrap = getattr(rv if alone else vector, name)
        own = inspect.signature(wrap).parameters.keys() & WRAPPER.keys()
        arguments = data.draw(some_of({key: WRAPPER[key] for key in own}))
        if data.draw(st.integers(0, 9)) == 0:
            base = data.draw(absurd)
        env = attempt(lambda: wrap(base, **arguments), ValueError, TypeError)
        if isinstance(env, Refused):
            return
        env.reset(seed=0)
        size, simulator = env.filter.action_size, env.unwrapped.simulator
        for k in range(3):
            raw = np.full(size, (1.0, -3e38, 1e-40)[k])
            if alone:
                env.step({name: raw for name in env.agents})
            else:
                env.step(np.tile(raw, (2, scenario.n_robots, 1)))
            assert_finite(simulator.positions, simulator.lyapunov(), simulator.observe())

    explore(check, 60 * effort, teams, st.booleans(), st.sampled_from(WRAPPERS), st.data())


@pytest.mark.parametrize("effort", EFFORTS)
def test_arguments_of_batches(effort):
    def check(team, arguments):
        env = attempt(lambda: rv.make_vec(TEAMS[team], **arguments))
        if isinstance(env, Refused):
            return
        start_and_play(env.simulator, 3)

    explore(check, 30 * effort, teams, some_of(BATCH))


@pytest.mark.parametrize("effort", EFFORTS)
def test_headings_and_certificates(effort):
    constants = {
        "min_alignment": nearly(margins),
        "dead_zone": nearly(soup.lengths),
        "max_turn": nearly(soup.lengths, np.inf),
    }

    def check(vectors, given, margin, scenario):
        heading = attempt(lambda: rv.certified_heading(*vectors, **given))
        if not isinstance(heading, Refused):
            assert np.allclose(np.linalg.norm(heading, axis=-1), 1.0)
        certificate = attempt(lambda: rv.certificate(scenario, margin))
        if not isinstance(certificate, Refused):
            assert not np.isnan(certificate.time_bound)

    explore(
        check, 30 * effort, st.tuples(*[any_table(2) | any_table(3)] * 3),
        st.fixed_dictionaries(constants), nearly(margins),
        st.sampled_from(list(TEAMS.values())) | absurd,
    )  # fmt: skip


@pytest.mark.parametrize("effort", EFFORTS)
def test_rollouts(effort):
    def check(policy, answer, seed, num_envs):
        scenario = TEAMS["plane"].replace(time_limit=0.1, time_step=0.02, allow_long_step=True)
        act = (lambda observations, time: answer) if policy is None else policy
        call = lambda: rv.rollout(scenario, act, seed, num_envs, record="all")  # noqa: E731
        trajectory = attempt(call, ValueError, TypeError)
        if not isinstance(trajectory, Refused):
            assert_finite(trajectory.positions, trajectory.lyapunov, trajectory.observations)

    answers = any_table(1, 3, 2) | absurd
    explore(check, 15 * effort, st.none() | st.none() | soup.uncallable,
            answers, nearly(st.integers(0, 9), -1), nearly(st.integers(1, 2), 0))  # fmt: skip
