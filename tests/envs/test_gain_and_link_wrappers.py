"""GainWrapper and LinkKeepingWrapper: choices in either frame, rates, and graphs that change."""

from __future__ import annotations

import numpy as np
import pytest
from guarantees import draw, make, same

import rendezvous_env as rv
from rendezvous_env import vector

TEAMS = 12
CYCLE = rv.Scenario(n_robots=6, graph=rv.graphs.directed_cycle(), time_limit=300.0)
SWITCHING, RANGE = rv.scenarios.get("switching-8"), rv.scenarios.get("range-12")


def test_weights_are_of_rows_in_either_frame():
    """They are numbers, not vectors: a frame turns what is seen and nothing else."""
    envs = [make("gains", frame=frame) for frame in ("net_bearing", "local")]
    for env in envs:
        env.reset(seed=4)
    random = np.random.default_rng(1)
    for _ in range(10):
        choice = {a: random.random(4).astype(np.float32) for a in envs[0].agents}
        infos = [env.step(choice)[4] for env in envs]
        assert same(*infos)
    first, second = (env.unwrapped.simulator.positions for env in envs)
    np.testing.assert_array_equal(first, second)


def test_desired_velocities_are_turned_with_the_frame():
    envs = [make("links", frame=frame) for frame in ("net_bearing", "local")]
    (turned, _), (local, _) = (env.reset(seed=4) for env in envs)
    layout = envs[0].unwrapped.scenario.observation_layout
    assert not same(turned, local)
    for name in envs[0].agents:
        f = layout.net_bearing(local[name])
        strength = np.linalg.norm(f)
        assert layout.net_bearing(turned[name]) == pytest.approx([strength, 0.0], abs=1e-6)
    ahead = {name: np.array([1.0, 0.0], np.float32) for name in envs[0].agents}
    along = {}
    for name in envs[1].agents:
        f = layout.net_bearing(local[name])
        along[name] = (f / np.linalg.norm(f)).astype(np.float32)
    envs[0].step(ahead)
    envs[1].step(along)
    first, second = (env.unwrapped.simulator.positions for env in envs)
    np.testing.assert_allclose(first, second, atol=1e-6)


@pytest.mark.parametrize("which", ["gains", "links"])
def test_rates_are_those_of_the_motion(which):
    env, random = make(which, frame="local"), np.random.default_rng(1)
    before, _ = env.reset(seed=2)
    layout, tau = env.unwrapped.scenario.observation_layout, env.unwrapped.scenario.tau
    compared = 0
    while env.agents:
        places, frames = env.unwrapped.simulator.positions, env.unwrapped.simulator.frames
        choice = draw(env, random)
        after, _, ends, _, infos = env.step({name: abs(choice[name]) for name in env.agents})
        moved = np.einsum("nji,nj->ni", frames[0], (env.unwrapped.simulator.positions - places)[0])
        for name, info in infos.items() if not any(ends.values()) else ():
            rate = -2 * layout.net_bearing(before[name]) @ moved[env.unwrapped.index(name)] / tau
            assert info["lyapunov_rate"] == pytest.approx(rate, abs=1e-5)
            compared += 1
        before = after
    assert compared > 20


# ---- directed, switching and proximity graphs, under random choices ------------------------------


def played(wrap, scenario, steps=600):
    """Whether teams met, the largest change of L in a step, m, and how many links were lost while
    nobody merged."""
    venv = wrap(rv.make_vec(scenario, TEAMS, autoreset_mode="Disabled"))
    venv.reset(seed=3)
    simulator, random = venv.unwrapped.simulator, np.random.default_rng(0)
    space, size = venv.single_action_space, simulator.size()
    met, rise, lost = np.zeros(TEAMS, dtype=bool), -np.inf, 0
    for _ in range(steps):
        before = simulator.weights > 0, simulator.merged_into
        choices = random.uniform(space.low, space.high, (TEAMS, *space.shape))
        met |= venv.step(choices.astype(np.float32))[2]
        now = simulator.size()
        rise, size = max(rise, float((now - size).max())), now
        alone = (simulator.merged_into == before[1]).all(axis=1)
        lost += int((before[0] & ~(simulator.weights > 0))[alone].sum())
        if met.all():
            break
    return met, rise, lost


@pytest.mark.parametrize("scenario", [CYCLE, SWITCHING], ids=["directed cycle", "switching"])
def test_under_gains_the_hull_never_grows_and_all_meet(scenario):
    met, rise, _ = played(vector.GainWrapper, scenario)
    assert met.all() and rise <= 1e-6


def test_links_of_limited_range_are_kept_and_all_meet():
    met, rise, lost = played(vector.LinkKeepingWrapper, RANGE)
    assert met.all() and lost == 0 and rise <= 1e-6


def test_other_guarantees_lose_links_and_let_the_hull_grow():
    """The checks above can fail."""
    _, _, lost = played(vector.HeadingVectorWrapper, RANGE)
    assert lost > 0
    _, rise, _ = played(lambda env: vector.EnergyTankWrapper(env, budget=20.0), SWITCHING)
    assert rise > 0.01
