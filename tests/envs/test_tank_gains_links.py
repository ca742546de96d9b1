"""The tank's ledger; gains and desired velocities in either frame; graphs that change."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from guarantees import constant, draw, make, same

import rendezvous_env as rv
from rendezvous_env import vector

# ---- tanks ---------------------------------------------------------------------------------------


def test_the_ledger_is_told_and_seen(kind):
    env = make("tank", kind, budget=0.5, observe_level=True)
    scenario, random = env.unwrapped.scenario, np.random.default_rng(1)
    unit = scenario.merge_radius * scenario.max_degree
    seen, infos = env.reset(seed=2)
    carried_out = set()
    while env.agents:
        before = {name: info["tank"] for name, info in infos.items()}
        for name, rows in seen.items():
            expected = [before[name] / unit, *[0.0] * (scenario.dim - 1)]
            assert rows[-1] == pytest.approx(expected, rel=1e-6, abs=1e-6)
        seen, _, ends, _, infos = env.step(draw(env, random))
        for info in infos.values():
            assert type(info["carried_out"]) is bool and info["tank"] >= 0
            assert info["carried_out"] or any(ends.values()) or info["lyapunov_rate"] <= 1e-6
            carried_out.add(info["carried_out"])
        assert any(ends.values()) or any(infos[name]["tank"] != before[name] for name in infos)
    assert carried_out == {False, True}


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
    disc, starts = rv.Disc(centre=(0.0, 0.0), radius=1.99), ((-2.0, 0.0), (2.0, 0.0))
    scenario = rv.Scenario(n_robots=2, start_positions=starts, obstacles=(disc,))
    env = rv.EnergyTankWrapper(rv.parallel_env(scenario))
    env.reset(seed=0)
    for _ in range(5):
        *_, infos = env.step(constant(env, (1.0, 0.0)))  # along f
        assert all(info["contact"] and info["tank"] == 0.0 for info in infos.values())
    *_, infos = env.step(constant(env, (-1.0, 0.0)))
    assert not any(info["carried_out"] for info in infos.values())


# ---- gains and links -----------------------------------------------------------------------------


def test_weights_are_of_rows_in_either_frame():
    """They are numbers, not vectors: a frame turns what is seen and nothing else."""
    envs = [make("gains", frame=frame) for frame in ("net_bearing", "local")]
    for env in envs:
        env.reset(seed=4)
    random = np.random.default_rng(1)
    for _ in range(10):
        choice = draw(envs[0], random)
        assert same(*(env.step(choice)[4] for env in envs))
    first, second = (env.unwrapped.simulator.positions for env in envs)
    np.testing.assert_array_equal(first, second)


def test_desired_velocities_are_turned_with_the_frame():
    envs = [make("links", frame=frame) for frame in ("net_bearing", "local")]
    (turned, _), (local, _) = (env.reset(seed=4) for env in envs)
    layout = envs[0].unwrapped.scenario.observation_layout
    along = {}
    for name, rows in local.items():
        f = layout.net_bearing(rows)
        strength = np.linalg.norm(f)
        assert layout.net_bearing(turned[name]) == pytest.approx([strength, 0.0], abs=1e-6)
        along[name] = (f / strength).astype(np.float32)
    assert not same(turned, local)
    envs[0].step(constant(envs[0], (1.0, 0.0)))
    envs[1].step(along)
    first, second = (env.unwrapped.simulator.positions for env in envs)
    np.testing.assert_allclose(first, second, atol=1e-6)


# ---- directed, switching and proximity graphs, under random choices ------------------------------

CYCLE = rv.Scenario(n_robots=6, graph=rv.graphs.directed_cycle(), time_limit=300.0)
TANK = partial(vector.EnergyTankWrapper, budget=20.0)


@pytest.mark.parametrize(
    ("wrap", "scenario", "expected"),
    [
        (vector.GainWrapper, CYCLE, {"met": True, "grew": False}),
        (vector.GainWrapper, "switching-8", {"met": True, "grew": False}),
        (vector.LinkKeepingWrapper, "range-12", {"met": True, "grew": False, "lost links": False}),
        # the checks can fail
        (vector.HeadingVectorWrapper, "range-12", {"lost links": True}),
        (TANK, "switching-8", {"grew": True}),
    ],
)
def test_what_is_kept_while_graphs_change(wrap, scenario, expected):
    """Whether all meet, whether L grows, and whether links are lost while nobody merges."""
    venv = wrap(rv.make_vec(scenario, 12, autoreset_mode="Disabled"))
    venv.reset(seed=3)
    simulator, random = venv.unwrapped.simulator, np.random.default_rng(0)
    size, met = simulator.size(), np.zeros(12, dtype=bool)
    found = {"grew": False, "lost links": False}
    for _ in range(600):
        before = simulator.weights > 0, simulator.merged_into
        met |= venv.step(draw(venv, random))[2]
        found["grew"] |= (simulator.size() > size + 1e-6).any()
        alone = (simulator.merged_into == before[1]).all(axis=1)
        found["lost links"] |= (before[0] & ~(simulator.weights > 0))[alone].any()
        size = simulator.size()
        if met.all():
            break
    assert {"met": met.all(), **found}.items() >= expected.items()
