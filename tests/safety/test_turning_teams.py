"""Teams of robots that turn: none stays across its net bearing, whatever is wished for.

``python tests/safety/test_turning_teams.py 10000`` asks as many teams, and says how many are stuck.
"""

from __future__ import annotations

import itertools
import sys
import time

import numpy as np
import pytest

import baselines
import rendezvous_env as rv
from rendezvous_env import Scenario, graphs
from rendezvous_env.safety.turning import gated_turn_rate, mean_body_axis_2d, mean_body_axis_3d

MODELS = ("nonholonomic_3d", "unicycle")
WISHES = ("zero", "random", "greedy")
RADII = (0.2, 1.0, 4.0)
TURN_RATES = (0.2, 1.0, 10.0)
MARGIN = 0.3


def team(model, graph, radius, turn_rate, n=4):
    return Scenario(
        n_robots=n,
        dim=3 if model == "nonholonomic_3d" else 2,
        robot_model=model,
        graph=graph,
        merge_radius=radius,
        spawn_size=8.0 * radius + 6.0,
        max_turn_rate=turn_rate,
        time_limit=1e6,
    )


def candidates(model, side):
    """Turn rates to choose from, in units of the limits, (side², k)."""
    if model == "unicycle":
        return np.linspace(-1, 1, side * side)[:, None]
    return np.array(list(itertools.product(np.linspace(-1, 1, side), repeat=2)))


def greedy(scenario, observations, limits, margin, side):
    """Of side² turn rates the one with which the robot is slowest once the gate has seen it."""
    layout, shares = scenario.observation_layout, candidates(scenario.robot_model, side)
    f = layout.net_bearing(observations).astype(float)[..., None, :]
    f = np.ascontiguousarray(np.broadcast_to(f, (*f.shape[:2], len(shares), f.shape[-1])))
    asked = np.broadcast_to(shares * limits, (*f.shape[:-1], shares.shape[1])).copy()
    options = dict(
        min_alignment=margin,
        dead_zone=scenario.dead_zone,
        duration=scenario.tau,
        max_rate=limits,
    )
    if scenario.dim == 2:
        rates = gated_turn_rate(asked, f, **options)
        mean = mean_body_axis_2d(rates[..., 0], scenario.tau)
    else:
        gravity = layout.split(observations).gravity
        pitch = np.arctan2(-gravity[..., 0], -gravity[..., 2]).astype(float)
        pitch = np.broadcast_to(pitch[..., None], f.shape[:-1]).copy()
        rates = gated_turn_rate(asked, f, pitch, **options)
        mean = mean_body_axis_3d(rates[..., 0], rates[..., 1], pitch, scenario.tau)
    slowest = np.argmin(np.sum(mean * f, axis=-1) ** 2, axis=-1)
    return shares[slowest]


def stuck_under_the_gate(scenario, wish, teams, steps, seed=0, side=4, margin=MARGIN):
    """How many teams have not met after so many steps."""
    venv = rv.make_vec(scenario, num_envs=teams, autoreset_mode="Disabled", num_threads=1)
    env = rv.vector.HeadingVectorWrapper(venv, min_alignment=margin, max_turn_rate=1e6)
    observations, _ = env.reset(seed=seed)
    random = np.random.default_rng(seed)
    limits = scenario.action_bounds[1:]
    shape = (teams, scenario.n_robots, len(limits))
    for _ in range(steps):
        if wish == "zero":
            wishes = np.zeros(shape)
        elif wish == "random":
            wishes = random.uniform(-1, 1, shape)
        else:
            wishes = greedy(scenario, observations, limits, margin, side)
        observations, *_ = env.step(wishes)
        if not (venv.simulator.status == 0).any():
            break
    return int(np.sum(venv.simulator.status == 0))


def stuck_under_the_law(scenario, teams, steps, seed=0):
    """How many teams have not met under laws (7)(8) or (12)(17)."""
    name = "unicycle" if scenario.robot_model == "unicycle" else "nonholonomic-3d"
    policy = baselines.make(name, scenario)
    env = rv.make_vec(scenario, num_envs=teams, autoreset_mode="Disabled", num_threads=1)
    observations, _ = env.reset(seed=seed)
    for _ in range(steps):
        actions = policy(observations, env.simulator.time)
        observations, *_ = env.step(actions)
        if not (env.simulator.status == 0).any():
            break
    return int(np.sum(env.simulator.status == 0))


def scenarios(model):
    graph = {"path": graphs.path(), "complete": graphs.complete(), "cycle": graphs.cycle()}
    for (name, made), radius, rate in itertools.product(graph.items(), RADII, TURN_RATES):
        yield f"{model} {name} r={radius} ω={rate}", team(model, made, radius, rate)


def test_the_deadlock_of_the_saturated_law_is_gone():
    """Slowest wishes on a path of four, r = 4 m, ω_max = 0.2 rad/s, ε = 0.3: V stood still."""
    scenario = team("nonholonomic_3d", graphs.path(), 4.0, 0.2)
    assert stuck_under_the_gate(scenario, "greedy", 16, 2500, side=8) == 0


@pytest.mark.slow
@pytest.mark.parametrize("model", MODELS)
def test_no_team_is_stuck(model):
    for k, (name, scenario) in enumerate(scenarios(model)):
        for wish in WISHES:
            assert stuck_under_the_gate(scenario, wish, 8, 20000, seed=k) == 0, (name, wish)
        assert stuck_under_the_law(scenario, 8, 20000, seed=k) == 0, name


def main(total):
    each = -(-total // (len(RADII) * len(TURN_RATES) * 3 * len(MODELS) * 4))
    counts: dict[str, list[int]] = {}
    for model in MODELS:
        for k, (name, scenario) in enumerate(scenarios(model)):
            began = time.perf_counter()
            for wish in (*WISHES, "law"):
                if wish == "law":
                    stuck = stuck_under_the_law(scenario, each, 20000, seed=1000 * k)
                else:
                    stuck = stuck_under_the_gate(scenario, wish, each, 20000, seed=1000 * k)
                count = counts.setdefault(f"{model} {wish}", [0, 0])
                count[0] += stuck
                count[1] += each
                if stuck:
                    print(name, wish, stuck, "of", each, flush=True)
            print(f"{name}: {time.perf_counter() - began:.1f} s", flush=True)
    for what, (stuck, asked) in counts.items():
        print(f"{what}: {stuck} of {asked} stuck")


if __name__ == "__main__":
    main(int(sys.argv[1]))
