"""What certificates once promised and the environment does not keep: each is played here."""

from __future__ import annotations

import math

import numpy as np
import pytest

import baselines
from rendezvous_env import Disc, Scenario, Sensing, Simulator, certificate, graphs, rollout
from rendezvous_env.safety.gains import Gains
from rendezvous_env.safety.links import LinkKeeping


def unit(degrees):
    return np.array([math.cos(math.radians(degrees)), math.sin(math.radians(degrees))])


def behind_discs(longest):
    """Two merges in discs, at the lower index's place, take robot 2 some 2 r from robot 3."""
    start = [(-0.402, 0.0), (-0.201, 0.0), (0.0, 0.0), tuple(longest * unit(30))]
    return Scenario(
        n_robots=4, graph=graphs.proximity(), sensing=Sensing(range=3.0), local_frames="global",
        obstacles=(Disc((-0.3015, 0.0), 0.06), Disc((-0.1005, 0.0), 0.06)),
        obstacle_contact="ignore", start_positions=start,
    )  # fmt: skip


def links_played(scenario, steps=20):
    """How many robots are left under velocities that pull links apart, and their links."""
    links = LinkKeeping(scenario, 1, frame="local", share=0.001)
    simulator = Simulator(scenario, 1)
    observations, desired = simulator.reset(0), np.zeros((1, 4, 2))
    desired[0, 2] = -0.1, 0.3
    for step in range(steps):
        desired[0, 0] = (0.5, 0.0) if step > 3 else (0.0, 0.0)
        links.hold(desired)
        observations = simulator.step(links.act(observations)).observations
    return int(simulator.active.sum()), simulator.weights[0]


@pytest.mark.slow
def test_beside_obstacles_links_must_be_shorter_by_r_per_merge():
    far, near = behind_discs(2.699999), behind_discs(2.399999)
    left, weights = links_played(far)
    assert left == 2 and weights.max() == 0.0  # two robots that see nobody, for ever
    found = certificate(far, by="links", share=0.001)
    assert not found.guaranteed and "range − (n − 1) r with obstacles" in found.theorem
    assert certificate(near, by="links", share=0.001).guaranteed
    assert links_played(near)[1].max() > 0.0
    drawn = near.replace(start_positions=None, obstacles=(Disc((0.0, 0.0), 0.5),))
    assert not certificate(drawn, by="links").guaranteed
    assert certificate(drawn.replace(obstacles=()), by="links").guaranteed


@pytest.mark.parametrize(
    ("places", "heavy", "old"),
    [
        ((0.0, 2.0, 4.0, 6.0), [(0, 2), (0, 3), (1, 3)], 0.343),
        ((0.0, 4.0, 8.0), [(0, 2), (0, 1)], 0.40),
    ],
)
def test_the_link_to_the_nearest_may_be_the_lightest(places, heavy, old):
    n = len(places)
    weights = np.full((n, n), 0.1) - 0.1 * np.eye(n)
    for i, j in heavy:
        weights[i, j] = weights[j, i] = 10.0
    team = Scenario(
        n_robots=n, graph=weights, start_positions=tuple((x, 0.0) for x in places),
        sensing=Sensing(occlusion="robots"), time_limit=300.0,
    )  # fmt: skip
    taken = rollout(team, baselines.make("bearing-only", team), 0).rendezvous_time[0]
    found = certificate(team)
    assert found.guaranteed and old < taken <= found.time_bound


@pytest.mark.parametrize("model", ["unicycle", "nonholonomic_3d"])
def test_robots_that_turn_are_certified_under_the_gate_only(model):
    """Of the paper's laws nothing is said for held inputs; the gate cannot overshoot."""
    scenario = Scenario(robot_model=model, dim=2 if model == "unicycle" else 3)
    law = certificate(scenario)
    assert law.continuous_time_only and "in continuous time" in law.theorem and not law.promises
    gated = certificate(scenario, 0.3)
    assert gated.guaranteed and gated.theorem.startswith("theorem T")
    assert set(gated.promises) == {"time", "lyapunov"}
    assert not certificate(scenario, 0.3, bearing_error=0.01).guaranteed
    small = scenario.replace(n_robots=2, spawn_size=1.0)
    slow = certificate(small.replace(max_turn_rate=0.1), 0.3).time_bound
    assert certificate(small, 0.3).time_bound < slow < math.inf


EIGHT = {
    "cycle": graphs.directed_cycle(),
    "led": graphs.directed([(i, i - 1, 0.5 + i) for i in range(1, 8)], 8),
    "switching": graphs.switching(["path", "cycle", graphs.directed_cycle()], dwell=1.0),
    "weights": graphs.from_edges([(i, (i + 1) % 8, 1.0 + i) for i in range(8)] + [(0, 4, 0.3)], 8),
}


@pytest.mark.parametrize(
    ("kind", "dim"), [("cycle", 2), ("led", 2), ("switching", 2), ("weights", 2), ("cycle", 3)]
)
def test_law_1_meets_as_it_steps_within_the_bound(kind, dim):
    """Continuous time was exceeded 5.8 times at 2 × the certified step; D1 holds for τ D̄ < r."""
    team = Scenario(n_robots=8, dim=dim, graph=EIGHT[kind], spawn_size=4.0, time_limit=400.0)
    team = team.replace(time_step=1.9 * team.certified_step, allow_long_step=True)
    found = certificate(team)
    assert found.guaranteed and found.continuous_time_bound < found.time_bound < math.inf
    law = rollout(team, baselines.make("bearing-only", team), 0, num_envs=6)
    assert (law.rendezvous_time <= found.time_bound).all()


def test_a_speed_limit_does_not_keep_law_1_within_the_hull():
    """Bearings of weight 2 that nearly cancel: ‖f‖ < v_max cuts nothing off Σ_j c_ij = 4."""
    gains = np.array([[0.0, 2.0, 2.0], [0.01, 0.0, 0.01], [0.01, 0.01, 0.0]])
    side = 0.3 * np.array([math.cos(0.2), math.sin(0.2)])
    team = Scenario(
        n_robots=3, graph=graphs.directed(gains), max_speed=1.0, time_step=0.2,
        start_positions=((0.0, 0.0), (-side[0], -side[1]), (side[0], -side[1])),
        allow_long_step=True, local_frames="global",
    )  # fmt: skip
    simulator, law = Simulator(team, 1), baselines.make("bearing-only", team)
    observations, lowest = simulator.reset(0), []
    for _ in range(31):
        observations = simulator.step(law(observations, 0.0)).observations
        lowest.append(simulator.positions[0, :, 1].min())
    assert min(lowest) < -side[1] - 0.09
    found = certificate(team)
    assert not found.guaranteed and "beyond its neighbours" in found.theorem
    assert certificate(team.replace(time_step=0.02)).guaranteed


def test_the_hull_may_grow_by_r_where_robots_start_within_r():
    """Two of three merge at once and rest, the third walks on past them."""
    near = [(0.0, 0.0), (0.0, 0.002), (0.002, 0.001)]
    start = (*near, *((2.0 - x, y) for x, y in near))
    team = Scenario(n_robots=6, graph="complete", start_positions=start, local_frames="global")
    gains = Gains(team, 1, frame="local", min_gain=5.0)
    simulator = Simulator(team, 1)
    observations = simulator.reset(0)
    near_mates = [[float(j // 3 == i // 3) for j in range(6) if j != i] for i in range(6)]
    gains.hold([near_mates])
    before = simulator.size()[0]
    simulator.step(gains.act(observations))
    grown = simulator.size()[0] - before
    assert 0.05 < grown <= 2 * math.pi * team.merge_radius
