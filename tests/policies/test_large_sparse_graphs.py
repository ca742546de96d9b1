"""The default step of large sparse graphs, and law (1) scaled to it (theory 4)."""

from __future__ import annotations

import numpy as np
import pytest

import baselines
import rendezvous_env as rv

MESH = rv.graphs.erdos_renyi(0.06)


def sparse(n=60, **fields):
    return rv.Scenario(n_robots=n, graph=fields.pop("graph", MESH), spawn_size=12.0, **fields)


def test_the_step_is_made_for_the_degrees_there_are():
    scenario = sparse()
    assert scenario.max_degree == 59.0
    assert scenario.step_degree == pytest.approx(2 * 0.06 * 59)
    assert scenario.tau == pytest.approx(scenario.merge_radius / (2 * scenario.step_degree))
    assert scenario.speed_limit == scenario.step_degree
    assert scenario.scales_velocity and scenario.tau > 8 * scenario.certified_step


def test_a_fixed_graph_counts_its_own_links():
    links = [(i, i + 1) for i in range(49)] + [(0, k) for k in range(5, 12)]
    scenario = sparse(50, graph=rv.graphs.from_edges(links))
    assert scenario.step_degree == 8.0 and scenario.max_degree == 49.0


@pytest.mark.parametrize(
    "scenario",
    [
        sparse(47),
        sparse(60, graph="cycle"),
        sparse(60, graph="complete"),
        sparse(60, time_step=0.001),
        sparse(60, robot_model="unicycle"),
    ],
    ids=["small", "a cycle stays one", "complete", "given step", "unicycles"],
)
def test_elsewhere_the_step_is_the_certified_one_or_given(scenario):
    assert not scenario.scales_velocity
    assert scenario.tau == scenario.time_step or scenario.tau == scenario.certified_step


def test_every_scenario_of_small_teams_keeps_its_step():
    for name in rv.scenarios.names():
        scenario = rv.scenarios.get(name)
        assert scenario.step_degree == scenario.max_degree and not scenario.scales_velocity


def test_law_1_goes_more_slowly_where_merges_have_made_a_hub():
    """A star of 59: the hub's D_i is eight times what the step is for, its neighbours' is not."""
    scenario = sparse()
    seen = np.zeros((60, *scenario.observation_layout.shape), np.float32)
    seen[0, :, 0] = 1.0
    seen[1, 0, 0] = 1.0
    velocity = baselines.make("bearing-only", scenario)(seen, 0.0)
    assert velocity[0, 0] == pytest.approx(59.0 * scenario.step_degree / 59.0)
    assert velocity[1, 0] == 1.0


def test_all_meet_and_v_never_rises_between_merges():
    scenario = sparse(time_limit=40.0)
    found = rv.rollout(scenario, baselines.make("bearing-only", scenario), seed=3, num_envs=6)
    assert found.success.all()
    assert (found.largest_rise_between_merges <= 0.0).all()


def test_a_hub_that_did_not_slow_down_would_raise_v():
    """It stands beside the middle of 59 neighbours; 2τ D_i/r times too fast it ends far beyond."""
    scenario = sparse(graph=rv.graphs.erdos_renyi(0.03), local_frames="global")
    star = np.zeros((60, 60))
    star[0, 1:] = star[1:, 0] = 1.0
    around = 2 * np.pi * np.arange(59) / 59
    ring = 1.3 * scenario.merge_radius * np.stack([np.cos(around), np.sin(around)], axis=-1)
    places = np.vstack([[0.02, 0.0], ring])
    rows, policy = scenario.observation_layout.neighbours, baselines.make("bearing-only", scenario)
    change = []
    for law in (policy, lambda seen, time: seen[..., rows, :].sum(-2)):
        simulator = rv.Simulator(scenario)
        seen = simulator.reset(0, {"positions": places, "weights": star})
        before = simulator.lyapunov()[0]
        actions = np.zeros((1, 60, 2), np.float32)
        actions[0, 0] = law(seen, 0.0)[0, 0]
        simulator.step(actions)
        change.append(simulator.lyapunov()[0] - before)
    assert change[0] < 0.0 < change[1]


def test_the_certificate_covers_it_and_says_how():
    certificate = rv.certificate(sparse())
    assert certificate.guaranteed and "scaled" in certificate.theorem
    assert np.isfinite(certificate.time_bound)
    given = rv.certificate(sparse(time_step=sparse().tau, allow_long_step=True))
    assert not given.guaranteed
