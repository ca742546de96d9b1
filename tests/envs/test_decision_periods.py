"""Choices that are held: a decision is so many base steps, whoever merges or ends on the way."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import five
from guarantees import GUARANTEES, constant, draw, make, same, which_and_kind

import rendezvous_env as rv


@which_and_kind
def test_a_period_is_that_many_base_steps_with_the_choice_held(which, kind):
    guarantee, scenario = GUARANTEES[which], five(kind, spawn_size=3.0, time_limit=5.0)
    options = guarantee.options | {"frame": "local"}
    env = guarantee.around(rv.parallel_env(scenario), decision_period=4, **options)
    single = guarantee.around(rv.parallel_env(scenario), **options)
    env.reset(seed=8)
    single.reset(seed=8)
    choice, steps = draw(env, np.random.default_rng(5)), 0
    while env.agents:
        alive = env.agents.copy()
        result = env.step({name: choice[name] for name in alive})
        told, rewards = [{} for _ in result], dict.fromkeys(alive, 0.0)
        for _ in range(4):
            if single.agents:
                part = single.step({name: choice[name] for name in single.agents})
                for known, new in zip(told, part, strict=True):
                    known |= new
                rewards = {name: rewards[name] + part[1].get(name, 0.0) for name in alive}
        assert result[1] == pytest.approx(rewards, abs=1e-12) and set(result[0]) == set(alive)
        assert all(same(result[k], told[k]) for k in (0, 2, 3, 4))
        assert same(env.get_state()["env"], single.get_state()["env"])
        assert which != "tank" or (env.tank.levels == single.tank.levels).all()
        steps += 1
    assert steps > 3 and not single.agents and env.step({}) == ({}, {}, {}, {}, {})


def test_the_certified_heading_follows_f_within_a_period():
    """Passing by a neighbour f swings round; a held heading would lose the margin, h does not."""
    env = make("heading", decision_period=40, min_alignment=0.5, max_turn_rate=1.0)
    margins, swings, base = [], [], env.unwrapped
    step = base.step

    def noting(actions):
        rows = base.simulator.observe()[0]
        f = base.scenario.observation_layout.net_bearing(rows)
        strong = np.linalg.norm(f, axis=-1) >= 2 * base.scenario.dead_zone
        margins.extend(env.steering.alignment[0][strong])
        swings.append(f)
        return step(actions)

    base.step = noting
    env.reset(seed=4)
    while env.agents:
        env.step(constant(env, (0.0, 1.0)))
    assert min(margins) >= 0.5 - 1e-9 and len(margins) > 50
    first, last = (swings[k][0] / np.linalg.norm(swings[k][0]) for k in (0, 30))
    assert first @ last < 0.999
