"""EnergyTankWrapper: its ledger, told and seen, and where tanks go at merges, walls and resets."""

from __future__ import annotations

import numpy as np
import pytest
from guarantees import GUARANTEES, constant, draw, tape
from guarantees import make as make_under

import rendezvous_env as rv
from rendezvous_env import vector

KEYS = GUARANTEES["tank"].told


def make(kind="single_integrator-2d", **options):
    return make_under("tank", kind, **options)


def test_infos_are_those_of_the_ledger(kind):
    env, random = make(kind, budget=0.5, frame="local"), np.random.default_rng(1)
    before, _ = env.reset(seed=2)
    layout, tau = env.unwrapped.scenario.observation_layout, env.unwrapped.scenario.tau
    levels, both = dict.fromkeys(env.agents, 0.5), set()
    while env.agents:
        places, frames = env.unwrapped.simulator.positions, env.unwrapped.simulator.frames
        after, _, ends, _, infos = env.step(draw(env, random))
        moved = np.einsum("nji,nj->ni", frames[0], (env.unwrapped.simulator.positions - places)[0])
        whole = not any(ends.values())
        for name, info in infos.items():
            i = env.unwrapped.index(name)
            assert set(info) >= KEYS and type(info["carried_out"]) is bool
            if whole:
                rate = -2 * layout.net_bearing(before[name]) @ moved[i] / tau
                assert info["lyapunov_rate"] == pytest.approx(rate, abs=1e-5)
                assert info["tank"] >= 0 and (info["carried_out"] or rate <= 1e-6)
            both.add(info["carried_out"])
        if whole:
            assert any(infos[name]["tank"] != levels[name] for name in infos)
        levels, before = {name: info["tank"] for name, info in infos.items()}, after
    assert both == {False, True}


@pytest.mark.parametrize("on_merge", ["remove", "follow"])
def test_a_survivor_has_the_tanks_of_both(on_merge):
    scenario = rv.Scenario(n_robots=3, graph="path", merge_radius=0.2, on_merge=on_merge)
    env = rv.EnergyTankWrapper(rv.parallel_env(scenario), budget=3.0)
    env.reset(seed=0, options={"positions": [[0.0, 0.0], [0.22, 0.0], [6.0, 0.0]]})
    desired = constant(env, (0.0, 0.0)) | {"robot_0": np.array([0.5, 0.0], np.float32)}  # along f
    *_, infos = env.step(desired)
    assert infos["robot_1"]["merged_into"] == 0 and infos["robot_1"]["tank"] == 0.0
    assert infos["robot_0"]["tank"] > 5.5 and 2.9 < infos["robot_2"]["tank"] < 3.5
    assert len(env.agents) == (2 if on_merge == "remove" else 3)
    *_, infos = env.step(constant(env, (0.0, 0.0)))
    assert infos["robot_0"]["tank"] > 5.5
    if on_merge == "follow":
        assert infos["robot_1"]["tank"] == 0.0 and not infos["robot_1"]["carried_out"]


def test_a_wall_along_f_fills_no_tank():
    scenario = rv.Scenario(
        n_robots=2,
        start_positions=((-2.0, 0.0), (2.0, 0.0)),
        obstacles=(rv.Disc(centre=(0.0, 0.0), radius=1.99),),
    )
    env = rv.EnergyTankWrapper(rv.parallel_env(scenario))
    env.reset(seed=0)
    for _ in range(5):
        *_, infos = env.step(constant(env, (1.0, 0.0)))  # along f
        assert all(info["contact"] and info["tank"] == 0.0 for info in infos.values())
    *_, infos = env.step(constant(env, (-1.0, 0.0)))
    assert not any(info["carried_out"] for info in infos.values())


def test_the_level_seen_is_the_level_told():
    env, random = make(budget=0.3, observe_level=True), np.random.default_rng(0)
    scenario = env.unwrapped.scenario
    unit = scenario.merge_radius * scenario.max_degree
    observations, _ = env.reset(seed=1)
    assert observations["robot_3"][-1] == pytest.approx([0.3 / unit, 0.0])
    for _ in range(10):
        observations, *_, infos = env.step(draw(env, random))
        for name, rows in observations.items():
            assert rows[-1] == pytest.approx([infos[name]["tank"] / unit, 0.0], rel=1e-6)


def test_a_refused_state_leaves_the_tanks_alone():
    for env in (make(budget=1.0), vector.EnergyTankWrapper(rv.make_vec("duo", 2), budget=1.0)):
        env.reset(seed=0)
        state, levels = env.get_state(), env.tank.levels
        foreign = {**state["tank"], "levels": levels + 1}
        with pytest.raises(ValueError, match="observed"):
            env.set_state({**state, "tank": foreign, "observed": np.zeros(3)})
        with pytest.raises(ValueError, match="levels"):
            env.set_state({**state, "tank": {**state["tank"], "levels": -levels}})
        np.testing.assert_array_equal(env.tank.levels, levels)
        env.set_state({**state, "tank": foreign})
        np.testing.assert_array_equal(env.tank.levels, levels + 1)


def test_teams_of_a_mask_begin_anew_alone():
    venv = vector.EnergyTankWrapper(rv.make_vec("fig3", 3), budget=0.5)
    venv.reset(seed=0)
    for desired in tape(venv, 5):
        venv.step(desired)
    before = venv.tank.levels
    venv.reset(options={"reset_mask": np.array([False, True, False])})
    assert (venv.tank.levels[1] == 0.5).all() and (before != 0.5).all()
    np.testing.assert_array_equal(venv.tank.levels[[0, 2]], before[[0, 2]])
