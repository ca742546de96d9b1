"""Theorems of the paper and of theory.md section 3, over many random teams."""

import math
from itertools import pairwise

import numpy as np
import pytest
from conftest import MODELS, UNEQUAL, five, law_of, unequal_matrix
from hypothesis import given
from hypothesis import strategies as st
from parameters import slow
from scipy.spatial.distance import pdist

import baselines
from rendezvous_env import Scenario, Simulator, certificate, graphs
from rendezvous_env.engine.memory import RENDEZVOUS
from rendezvous_env.safety.lyapunov import lyapunov, lyapunov_rate, net_bearings
from rendezvous_env.safety.theorems.descent import time_bound
from rendezvous_env.trajectory import run
from research.time_bounds import rendezvous_time_lower_bound

FAMILIES = {
    "complete": lambda n: graphs.complete((0.5, 1.5)),
    "path": lambda n: graphs.path((0.5, 2.0)),
    "cycle": lambda n: graphs.cycle() if n > 2 else graphs.path(0.7),
    "star": lambda n: graphs.star((0.5, 2.0)),
    "random_tree": lambda n: graphs.random_tree((0.5, 2.0)),
    "erdos_renyi": lambda n: graphs.erdos_renyi(0.3, (0.5, 1.5)),
    "matrix": unequal_matrix,
}
TEAMS = 16


def run_to_end(scenario, num_envs, *, seed=0, policy=None, options=None):
    """Teams after a run of a law, rendezvous times, s, and the largest increase of V, m²/s.

    The increase is between merges; it is negative if V decreased in every step of every running
    team.
    """
    chosen = law_of(scenario) if policy is None else baselines.make(policy, scenario)
    simulator = Simulator(scenario, num_envs, num_threads=1)
    times, rise = np.full(num_envs, np.inf), -np.inf
    for step in run(simulator, chosen, simulator.reset(seed, options)):
        out, on = step.outcome, step.running
        rise = max(rise, (out.lyapunov_before_merge - step.lyapunov)[on].max())
        met = on & (out.status == RENDEZVOUS)
        times[met] = simulator.time[met]
    return simulator, times, rise


@st.composite
def teams(draw):
    """Positions (n, d) at least 5 cm apart, and symmetric weights, not all zero."""
    n, d = draw(st.integers(2, 7)), draw(st.integers(2, 3))
    random = np.random.default_rng(draw(st.integers(0, 2**32)))
    lattice = np.zeros((n, d))
    lattice[:, 0] = np.arange(n)
    positions = random.normal(size=(n, d)) * 10 ** draw(st.floats(0, 2))
    if draw(st.booleans()) or pdist(positions).min() < 0.05:  # all on one line
        positions = lattice[random.permutation(n)] * draw(st.floats(0.1, 9.0))
    links = np.triu(random.random((n, n)) < draw(st.floats(0.2, 1.0)), 1)
    links[0, draw(st.integers(1, n - 1))] = True
    weights = np.where(links, random.uniform(0.1, 3.0, (n, n)), 0.0)
    return positions, weights + weights.T


def check_law_1(scenario, num_envs, seed):
    """Theorems 1 and A: V decreases in every step, and all meet in time.

    ``verify`` checks the amount of the decrease, and increases at merges.
    """
    simulator, times, rise = run_to_end(scenario, num_envs, seed=seed)
    assert rise < 0
    assert (times <= time_bound(scenario, simulator.initial_lyapunov)).all()
    return simulator


class TestTheorem1:
    """Law (1) achieves rendezvous if and only if the graph is connected."""

    @pytest.mark.parametrize("dim", [2, 3])
    @pytest.mark.parametrize("n", [2, slow(3), 5, slow(8), 12])
    @pytest.mark.parametrize("family", FAMILIES)
    def test_connected_graphs_meet_within_bound_and_v_decreases(self, family, n, dim):
        graph = FAMILIES[family](n)
        scenario = Scenario(
            n_robots=n, dim=dim, graph=graph, time_limit=1000.0, neighbour_slots=n - 1
        )
        simulator = check_law_1(scenario, TEAMS, seed=1000 * n + dim)
        assert (simulator.merged_into == 0).all()
        assert simulator.lyapunov() == pytest.approx(0)

    @pytest.mark.nightly
    @pytest.mark.parametrize("dim", [2, 3])
    @pytest.mark.parametrize("family", FAMILIES)
    def test_large_and_crowded_teams_meet(self, family, dim):
        crowd = Scenario(n_robots=20, dim=dim, spawn_size=4.0, merge_radius=0.15, time_limit=1000.0)
        check_law_1(crowd.replace(graph=FAMILIES[family](20)), 100, seed=dim)

    @pytest.mark.parametrize("dim", [2, 3])
    @pytest.mark.parametrize(
        ("pieces", "n"),
        [([[0, 3], [1, 2, 4]], 5), ([[0], [1, 5, 2], [3, 4]], 6), ([[0, 1, 2, 3, 4, 5], [6]], 7)],
    )
    def test_disconnected_graph_ends_with_one_robot_per_component(self, pieces, n, dim):
        edges = [
            (*pair, 0.6 + 0.2 * k) for piece in pieces for k, pair in enumerate(pairwise(piece))
        ]
        graph = graphs.from_edges(edges, n)
        scenario = Scenario(
            n_robots=n, dim=dim, graph=graph, require_connected=False, time_limit=60.0,
            neighbour_slots=n - 1,
        )  # fmt: skip
        simulator, times, _ = run_to_end(scenario, 50, seed=9)
        assert np.isinf(times).all()
        survivors = np.empty(n, dtype=int)
        for piece in pieces:
            survivors[piece] = min(piece)
        assert (simulator.merged_into == survivors).all()
        assert not certificate(scenario).guaranteed
        assert np.isinf(time_bound(scenario, simulator.initial_lyapunov)).all()

    def test_unlinked_robots_do_not_move(self):
        alone = Scenario(n_robots=3, graph=np.zeros((3, 3)), require_connected=False, time_step=0.1)
        simulator, *_ = run_to_end(alone.replace(time_limit=2.0), 4)
        assert simulator.active.all() and (simulator.path_length == 0).all()


class TestTheoremA:
    """T ≤ n V0⁺/(8 a*²), exact for two robots."""

    @pytest.mark.parametrize("dim", [2, 3])
    @pytest.mark.parametrize("weight", [0.4, 1.0, 2.5])
    def test_two_robots_meet_within_step_of_closed_form(self, weight, dim):
        pair = Scenario(n_robots=2, dim=dim, graph=graphs.path(weight), merge_radius=0.3)
        starts = np.random.default_rng(3).normal(size=(200, 2, dim)) * 4
        _, times, _ = run_to_end(pair, 200, options={"positions": starts})
        length = np.linalg.norm(starts[:, 1] - starts[:, 0], axis=-1)
        expected = np.maximum(length - pair.merge_radius, 0) / (2 * weight)
        assert (np.abs(times - expected) <= pair.tau * (1 + 1e-6)).all()

    def test_no_team_is_faster_than_lower_bound(self):
        for dim in (2, 3):
            scenario = five(f"single_integrator-{dim}d", max_speed=0.8)
            _, times, _ = run_to_end(scenario, 64, seed=4)
            resting, *_ = run_to_end(scenario, 64, seed=4, policy="zero")
            bounds = [rendezvous_time_lower_bound(scenario, p) for p in resting.positions]
            assert np.isfinite(times).any() and (times >= np.array(bounds) - scenario.tau).all()
            assert min(bounds) > 1

    @pytest.mark.parametrize("dim", [2, 3])
    def test_bounds_hold_under_speed_limit(self, dim):
        scenario = Scenario(n_robots=5, dim=dim, graph=UNEQUAL, max_speed=0.5, time_limit=2000.0)
        assert time_bound(scenario, 1.0) > 5 * time_bound(scenario.replace(max_speed=None), 1.0)
        check_law_1(scenario, 64, seed=5)


def test_too_long_step_raises_v():
    """r/(2D̄) is safe, much longer steps are not (theory 4)."""
    scenario = Scenario(n_robots=8, graph=graphs.path(), allow_long_step=True, time_limit=60.0)
    long = scenario.replace(time_step=20 * scenario.certified_step)
    assert run_to_end(long, 64)[2] > 1
    assert not certificate(long).guaranteed


class TestTheorems3And4:
    """Unicycles meet under (7) with ω of (8), and with ω = cos t; 3-D nonholonomic robots meet
    under (12) and (17).
    """

    @pytest.mark.parametrize(
        ("theorem", "model", "policy"),
        [
            (3, "unicycle", "unicycle"),
            (3, "unicycle", "unicycle-cosine"),
            (4, "nonholonomic_3d", "nonholonomic-3d"),
        ],
    )
    @pytest.mark.parametrize("n", [2, slow(3), 5, slow(8)])
    @pytest.mark.parametrize("family", FAMILIES)
    def test_all_nonholonomic_teams_meet(self, theorem, model, policy, family, n):
        scenario = Scenario(
            **MODELS[model], n_robots=n, graph=FAMILIES[family](n), time_limit=600.0,
            neighbour_slots=n - 1,  # all families are one kind to the compiler
        )  # fmt: skip
        assert np.isfinite(run_to_end(scenario, 36, seed=n, policy=policy)[1]).all()
        assert certificate(scenario).theorem.startswith(f"theorem {theorem}")

    def test_teams_meet_from_singular_attitudes(self):
        scenario = five("nonholonomic_3d", time_limit=200.0)
        headings = np.stack([np.linspace(-3, 3, 5), np.full(5, math.pi / 2)], axis=-1)
        assert np.isfinite(run_to_end(scenario, 64, options={"headings": headings})[1]).all()


@given(teams())
def test_lemma_1_bounds_total_net_bearing(team):
    """Lemma 1: Σ‖f_i‖ ≥ 2 max a_ij while no two neighbours coincide."""
    positions, weights = team
    total = np.linalg.norm(net_bearings(positions, weights), axis=-1).sum()
    assert total >= 2 * weights.max() * (1 - 1e-12)


def test_lemma_1_is_attained_by_three_collinear_robots():
    f = net_bearings([[0.0, 0], [1, 0], [3, 0]], [[0, 0.7, 0], [0.7, 0, 0.7], [0, 0.7, 0]])
    assert np.linalg.norm(f, axis=-1).tolist() == [0.7, 0.0, 0.7]


@given(teams(), st.integers(0, 2**32))
def test_rate_of_v_matches_central_differences(team, seed):
    """V̇ = −2 Σ‖f_i‖² under law (1) and −2 Σ (h_iᵀf_i)² under law (4), against differences of V."""
    positions, weights = team
    f = net_bearings(positions, weights)
    h = np.random.default_rng(seed).normal(size=f.shape)
    h /= np.linalg.norm(h, axis=-1, keepdims=True)
    along = np.sum(h * f, axis=-1, keepdims=True)
    scale = weights.sum() ** 2
    for velocities, rate in ((f, -2 * np.sum(f**2)), (h * along, -2 * np.sum(along**2))):
        assert lyapunov_rate(velocities, f) == pytest.approx(rate, abs=1e-12 * scale)
        assert rate <= 0
        dt = 1e-5 / weights.sum()
        ahead = lyapunov(positions + dt * velocities, weights)
        behind = lyapunov(positions - dt * velocities, weights)
        assert (ahead - behind) / (2 * dt) == pytest.approx(rate, abs=1e-5 * scale)
