"""Nonholonomic teams: no robot stays across its net bearing, for any desired turn rates."""

import itertools
import math

import numpy as np
import pytest

import baselines
import rendezvous_env as rv
from rendezvous_env import Scenario, graphs
from rendezvous_env.compilation import kernel
from rendezvous_env.physics.vectors import add, dot, load, norm, scaled, split
from rendezvous_env.robots.nonholonomic_3d import body_frame_3d
from rendezvous_env.safety.theorems.turning import gated_window, turning_window
from rendezvous_env.safety.turning import (
    Gate,
    desired_rates,
    gated_rates,
    mean_axis,
    pitch_of,
    robot_of,
)

MODELS = ("nonholonomic_3d", "unicycle")
MIXED = ("mixed in 3-D", "mixed in 2-D")
KINDS = ("zero", "random", "greedy")
MARGIN = 0.3


def team(model, graph, radius, turn_rate):
    """Four robots; in mixed teams the first and the third are single integrators."""
    dim = 3 if "3" in model else 2
    if model in MIXED:
        model = ["single_integrator", MODELS[3 - dim]] * 2
    return Scenario(
        n_robots=4, dim=dim, robot_model=model, graph=graph,
        neighbour_slots=3,  # rows as most tests have them: no other kernels
        merge_radius=radius, spawn_size=8.0 * radius + 6.0, max_turn_rate=turn_rate, time_limit=1e6,
    )  # fmt: skip


@kernel
def greedy(net_bearings, observations, shares, gate, chosen):
    """Turn rates with the smallest speed after the gate."""
    for team in range(len(chosen)):
        for i in range(chosen.shape[1]):
            f, slowest = load(net_bearings[team, i]), np.inf
            pitch = pitch_of(observations[team, i], observations.shape[2] - 1, gate)
            for k in range(len(shares)):
                rates = gated_rates(desired_rates(shares[k], gate), f, pitch, gate)
                speed = abs(dot(mean_axis(rates, pitch, gate), f))
                if speed < slowest:
                    slowest = speed
                    for angle in range(shares.shape[1]):
                        chosen[team, i, angle] = shares[k, angle]


def under_the_gate(scenario, kind, teams, steps, seed=0, side=4, margin=MARGIN):
    """Teams initially and after each step, or until all have met."""
    venv = rv.make_vec(scenario, num_envs=teams, autoreset_mode="Disabled", num_threads=1)
    env = rv.vector.HeadingVectorWrapper(venv, min_alignment=margin, max_turn_rate=1e6)
    observations, _ = env.reset(seed=seed)
    random = np.random.default_rng(seed)
    gate = robot_of(scenario, margin).gate
    shares = np.linspace(-1, 1, side * side)[:, None]  # of the limits
    if scenario.dim == 3:
        shares = np.array(list(itertools.product(np.linspace(-1, 1, side), repeat=2)))
    desired = np.zeros((teams, scenario.n_robots, shares.shape[1]))
    turning = scenario.nonholonomic_robots
    yield venv.simulator
    for _ in range(steps):
        if kind == "random":
            desired = random.uniform(-1, 1, desired.shape)
        elif kind == "greedy":
            f = scenario.observation_layout.net_bearing(observations)
            greedy(f, observations, shares, gate, desired)
        choices = desired
        if not turning.all():  # single integrators choose vectors: turned to one side, or random
            f = scenario.observation_layout.net_bearing(observations)
            aside = random.normal(size=f.shape) if kind == "random" else np.roll(f, 1, axis=-1)
            padded = np.concatenate([desired, desired], axis=-1)[..., : scenario.dim]
            choices = np.where(turning[:, None], padded, aside - f)
        observations, *_ = env.step(choices)
        yield venv.simulator
        if not (venv.simulator.status == 0).any():
            break


def test_saturated_law_deadlock_is_resolved():
    """Slowest turns on a path of four, r = 4 m, ω_max = 0.2 rad/s, ε = 0.3: V was constant."""
    scenario = team("nonholonomic_3d", graphs.path(), 4.0, 0.2)
    *_, teams = under_the_gate(scenario, "greedy", 16, 2500, side=8)
    assert (teams.status != 0).all()


@kernel
def unproductive(starts, turns, gate, waited):
    """Number of steps until |mᵀf| ≥ ‖f‖/2 under rates of the gate.

    ``starts`` (N, 5) are yaw, pitch and f; ``turns`` (N, K, 3) is what f is turned by.
    """
    for i in range(len(starts)):
        yaw, pitch, world = starts[i, 0], starts[i, 1], load(starts[i, 2:5])
        for k in range(turns.shape[1]):
            r = body_frame_3d(yaw, pitch)
            x, y, z = (r[0], r[3], r[6]), (r[1], r[4], r[7]), (r[2], r[5], r[8])
            f = (dot(x, world), dot(y, world), dot(z, world))
            rates = gated_rates((0.0, 0.0), f, pitch, gate)
            if abs(dot(mean_axis(rates, pitch, gate), f)) >= 0.5 * norm(f):
                break
            waited[i] = k + 1
            yaw, pitch = yaw + gate.duration * rates[0], pitch + gate.duration * rates[1]
            world = scaled(split(add(world, norm(f), load(turns[i, k])))[1], norm(f))


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("turned", [0.02, 0.1, 0.3, 0.7, 0.9, 1.5])
def test_one_of_k_steps_is_productive(dim, turned):
    """Theorem T: f rotates by less than θ in total, adversarially, from the worst direction."""
    random, count = np.random.default_rng(0), 4000
    turned = min(turned, math.pi / 3) if dim == 2 else turned
    window, drift = turning_window(dim, turned)
    # in the plane law (8) turns by τ‖f‖ sin φ, of which 0.8 · 10/11 > 0.7 is sure
    strength = 2.0 if dim == 3 else turned / 0.7 * 10 / 11
    gate = Gate(dim == 2, 0.999, 1e-6, 1.0, turned, turned)
    f = random.normal(size=(count, 3))
    f[: count // 2, :2] *= random.choice([1e-6, 0.1 * turned, turned / 3, 0.4], (count // 2, 1))
    starts = np.zeros((count, 5))
    starts[:, 1] = random.uniform(-math.pi, math.pi, count)
    starts[::2, 1] = random.choice([0.0, math.pi / 2, math.pi], count // 2)
    starts[::2, 1] += turned * random.uniform(-1, 1, count // 2)
    if dim == 2:
        f[:, 2], starts[:, 1] = 0.0, 0.0
    starts[:, 2:] = strength * f / np.linalg.norm(f, axis=-1, keepdims=True)
    turns = random.normal(size=(count, window, 3))
    turns[::3] = turns[::3, :1] * (-1.0) ** np.arange(window)[:, None]  # there and back
    turns[..., 2] *= dim - 2
    shares = np.linalg.norm(turns, axis=-1).sum(axis=-1)[:, None, None]
    waited = np.zeros(count, np.int64)
    unproductive(starts, 0.98 * drift * turns / shares, gate, waited)
    assert 0 < waited.max() < window


@pytest.mark.parametrize("turn_rate", [0.2, 10.0])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("model", MODELS + MIXED)
def test_v_decreases_in_every_window(model, kind, turn_rate):
    """K and q of theorem T, in the environment, for any desired turn rates."""
    scenario = team(model, graphs.path(), 4.0, turn_rate)
    window, least = gated_window(scenario, MARGIN)
    seen = [
        (teams.lyapunov(), teams.active.sum(axis=-1))
        for teams in under_the_gate(scenario, kind, 16, 400)
    ]
    v, left = (np.array(each) for each in zip(*seen, strict=True))
    calm = (left[window:] == left[:-window]) & (left[window:] > 1)
    assert calm.sum() > 100 and 3 <= window <= 10
    assert (v[:-window] - v[window:])[calm].min() >= least > 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("model", MODELS)
def test_no_team_is_stuck(model):
    name = "unicycle" if model == "unicycle" else "nonholonomic-3d"
    kinds = graphs.path(), graphs.complete(), graphs.cycle()
    radii, turn_rates = (0.2, 1.0, 4.0), (0.2, 1.0, 10.0)
    for i, j in np.ndindex(3, 3):  # all pairs of two of the three values
        graph, radius, rate = kinds[i], radii[j], turn_rates[(i + j) % 3]
        scenario = team(model, graph, radius, rate)
        for kind in KINDS:
            *_, teams = under_the_gate(scenario, kind, 8, 20000)
            assert (teams.status != 0).all(), (graph, radius, rate, kind)
        scenario = scenario.replace(time_limit=20000 * scenario.tau)
        found = rv.rollout(scenario, baselines.make(name, scenario), 0, num_envs=8, record=())
        assert found.success.all(), (graph, radius, rate, name)
