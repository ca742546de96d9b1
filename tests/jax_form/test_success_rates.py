"""Success rates in float32 against those of the engine, over 1,000 seeds."""

import importlib

import numpy as np
import pytest
from parameters import marked

import rendezvous_env as rv

SEEDS = 1000
CASES = {
    "clutter-4": {"time_limit": 8.5},
    "ring-12": {"time_limit": 3.25},
    "cloud-8": {"dim": 2, "time_limit": 1.3},
    "unicycle-6": {"time_limit": 1.86},
}
"""Scenarios, with time limits within which about half of the environments meet."""


def actions_of(observations, scenario, xp):
    """Law (1), or v = f_x and ω = 4 f_y for unicycles."""
    f = observations[..., scenario.observation_layout.neighbours, :].sum(axis=-2)
    if scenario.model.nonholonomic:
        return xp.stack([f[..., 0], 4.0 * f[..., 1]], axis=-1)
    return f


def success_of_engine(name, changes):
    """Share of environments that meet."""
    env = rv.make_vec(name, num_envs=SEEDS, autoreset_mode="DISABLED", **changes)
    scenario, met = env.simulator.scenario, np.zeros(SEEDS, bool)
    seen, _ = env.reset(seed=0)
    for _ in range(scenario.max_steps):
        seen, _, terminated, _, _ = env.step(actions_of(seen, scenario, np))
        met |= terminated
    env.close()
    return met.mean()


def success_in_float32(name, changes):
    """The same share, of the JAX form."""
    import jax
    import jax.numpy as jnp

    with jax.enable_x64(False):
        env = importlib.import_module("rendezvous_env.jax").make(name, num_envs=SEEDS, **changes)
        seen, state = env.reset(0)
        assert state.positions.dtype == jnp.float32

        def advance(now, _):
            seen, state = now
            seen, state, *_ = env.step(None, state, actions_of(seen, env.scenario, jnp))
            return (seen, state), None

        steps = env.scenario.max_steps
        (_, state), _ = jax.jit(lambda now: jax.lax.scan(advance, now, None, steps))((seen, state))
        return float((state.status == 1).mean())


@pytest.mark.slow
@pytest.mark.parametrize("name", marked(CASES, nightly=CASES.keys() - {"cloud-8"}))
def test_success_rates_in_float32_agree_with_the_engine(name):
    pytest.importorskip("jax")
    p, q = (rate(name, CASES[name]) for rate in (success_of_engine, success_in_float32))
    assert 0.3 < p < 0.7, "the time limit decides too few episodes"
    # 95 % interval of the difference of two rates over different seeds; these are the same seeds
    assert abs(p - q) <= 1.96 * np.sqrt((p * (1 - p) + q * (1 - q)) / SEEDS)
    print(f"{name}: engine {p:.3f}, float32 {q:.3f}")
