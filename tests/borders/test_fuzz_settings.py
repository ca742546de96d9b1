"""Fuzzing of wrappers, headings and certificates, see ``fuzzing``."""

from __future__ import annotations

import inspect

import numpy as np
import pytest
import soup
from fuzzing import EFFORTS, TEAMS, Refused, assert_finite, attempt, explore, teams
from hypothesis import strategies as st
from soup import absurd, any_table, nearly

import rendezvous_env as rv
from rendezvous_env import vector

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
