"""Sensing graphs: their weights, their worst cases, and the families that episodes draw from."""

from __future__ import annotations

import time
import tracemalloc

import numpy as np
import pytest
from conftest import UNEQUAL, unequal_matrix
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from rendezvous_env import Scenario, Simulator, graphs
from rendezvous_env.graphs.weights import bottleneck_weight, components, max_degree


def drawn(graph: graphs.Graph, n: int, count: int) -> np.ndarray:
    """Weights of the first episodes of many seeds, (count, n, n)."""
    sim = Simulator(Scenario(n_robots=n, graph=graph), count)
    sim.reset(0)
    return sim.weights


@pytest.mark.parametrize(
    ("graph", "edges"),
    [
        (graphs.complete(), {(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)}),
        (graphs.path(), {(0, 1), (1, 2), (2, 3)}),
        (graphs.cycle(), {(0, 1), (1, 2), (2, 3), (0, 3)}),
        (graphs.star(), {(0, 1), (0, 2), (0, 3)}),
        (graphs.from_edges([(1, 0), (3, 2, 1.0), (1, 3)]), {(0, 1), (2, 3), (1, 3)}),
    ],
)
def test_edges_by_hand(graph, edges):
    weights = graph.base_weights(4)
    assert set(zip(*np.nonzero(np.triu(weights)), strict=True)) == edges
    np.testing.assert_array_equal(weights, weights.T)
    assert set(np.unique(weights)) <= {0.0, 1.0}
    np.testing.assert_array_equal(drawn(graph, 4, 2), np.tile(weights, (2, 1, 1)))


def test_a_matrix_is_taken_as_it_is():
    graph = graphs.from_matrix(UNEQUAL)
    np.testing.assert_array_equal(graph.base_weights(5), UNEQUAL)
    assert graph == graphs.from_edges(
        [(3, 4, 0.9), (0, 1, 2.0), (0, 3, 0.5), (2, 1, 1.3), (2, 3, 0.7), (4, 2, 1.1)]
    )


@pytest.mark.parametrize(
    "graph",
    [
        graphs.complete(),
        graphs.path((0.5, 1.0)),
        graphs.random_tree(2.0),
        graphs.erdos_renyi(0.125, (0.1, 0.7)),
        graphs.from_matrix(UNEQUAL),
        graphs.Graph("complete", probability=1.0),
    ],
)
def test_plain_data_gives_an_equal_graph(graph):
    assert graphs.parse(graph.to_plain()) == graph
    assert graphs.parse(graph) is graph


# ---- worst cases --------------------------------------------------------------------------------


def contractions(weights: np.ndarray):
    """Every matrix that merging can make of this one, by brute force."""
    yield weights
    n = len(weights)
    for i in range(n):
        for j in range(i + 1, n):
            if weights[i, j] > 0:
                merged = weights.copy()
                merged[i] = merged[:, i] = np.maximum(merged[i], merged[j])
                merged[i, i] = 0
                keep = np.arange(n) != j
                yield from contractions(merged[np.ix_(keep, keep)])


@settings(max_examples=40)
@given(st.integers(2, 6), st.integers(0, 10**6))
def test_no_sequence_of_merges_leaves_the_worst_cases(n, seed):
    weights = unequal_matrix(n, seed)
    degree, bottleneck = max_degree(weights), bottleneck_weight(weights)
    for contracted in contractions(weights):
        if len(contracted) > 1:
            assert contracted.sum(axis=1).max() <= degree * (1 + 1e-12)
            assert contracted.max() >= bottleneck * (1 - 1e-12)
            assert bottleneck_weight(contracted) >= bottleneck * (1 - 1e-12)
            assert len(components(contracted)) == 1


def test_the_heaviest_edge_can_vanish_but_not_the_bottleneck():
    path = np.array([[0, 2, 0], [2, 0, 0.5], [0, 0.5, 0]])
    assert bottleneck_weight(path) == 0.5
    assert max_degree(path) == 2.5
    assert components(path) == [[0, 1, 2]]
    assert components(np.zeros((2, 2))) == [[0], [1]] and max_degree(np.zeros((2, 2))) == 0


# ---- families -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "graph", [graphs.random_tree((0.5, 2.0)), graphs.erdos_renyi(0.25, (0.5, 2.0))]
)
def test_families_draw_connected_graphs_within_their_worst_cases(graph):
    weights = drawn(graph, 7, 300)
    np.testing.assert_array_equal(weights, weights.transpose(0, 2, 1))
    assert all(len(components(matrix)) == 1 for matrix in weights)
    positive = weights[weights > 0]
    assert positive.min() >= 0.5 and positive.max() <= 2.0
    assert stats.kstest(np.unique(positive), stats.uniform(0.5, 1.5).cdf).pvalue > 1e-3
    assert max(max_degree(matrix) for matrix in weights) <= graph.max_degree(7)
    assert min(bottleneck_weight(matrix) for matrix in weights) >= graph.bottleneck_weight(7)
    assert np.triu(weights).sum(axis=(1, 2)).max() <= graph.weight_sum(7)
    assert len(np.unique(weights > 0, axis=0)) > 100


def test_trees_are_uniform():
    """Cayley: 16 labelled trees of four robots, each as likely."""
    weights = drawn(graphs.random_tree(), 4, 4800)
    kinds, counts = np.unique(weights.reshape(4800, -1), axis=0, return_counts=True)
    assert len(kinds) == 16 and (kinds.sum(axis=1) == 6).all()
    assert stats.chisquare(counts).pvalue > 1e-3


def test_erdos_renyi_has_the_probability_it_says_where_all_are_connected():
    weights = drawn(graphs.erdos_renyi(0.8), 9, 2000)
    share = np.triu(weights).sum() / (2000 * 36)
    assert share == pytest.approx(0.8, abs=0.01)


def test_hardly_any_edges_become_a_tree():
    weights = drawn(graphs.erdos_renyi(1e-9), 6, 50)
    assert (np.triu(weights).sum(axis=(1, 2)) == 5).all()
    assert len(np.unique(weights, axis=0)) > 20


def test_a_range_of_weights_on_a_fixed_graph_is_drawn_for_every_episode():
    sim = Simulator(Scenario(n_robots=5, graph=graphs.path((0.5, 2.0))), 3)
    sim.reset(0)
    first = sim.weights
    sim.reset()
    assert (first > 0).tolist() == (sim.weights > 0).tolist()
    assert not np.any((first == sim.weights) & (first > 0))


@pytest.mark.parametrize("weight", [1e-9, 1e-8, 3e-8, 1e9])
def test_the_bottleneck_of_weak_links_is_not_lost(weight):
    assert graphs.bottleneck_weight(weight * UNEQUAL) == weight * 0.9


# ---- large teams --------------------------------------------------------------------------------


@pytest.mark.parametrize("graph", ["complete", "cycle", "star", "random_tree", "directed_cycle"])
def test_a_large_team_takes_no_memory_of_pairs(graph):
    Scenario(n_robots=9, graph=graph)  # imports what it needs
    tracemalloc.start()
    scenario = Scenario(n_robots=10_000, graph=graph)
    assert scenario.certified_step > 0.0 and scenario.bottleneck_weight == 1.0
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 20e6  # a matrix of 10,000 robots has 800 MB


def test_a_matrix_of_a_million_edges_is_read_at_once():
    weights = np.random.default_rng(0).uniform(0.5, 1.0, (1000, 1000))
    np.fill_diagonal(weights, 0.0)
    start = time.process_time()
    graph = graphs.directed(weights)
    assert len(graph.edges) == 999_000 and hash(graph) == hash(graphs.directed(weights))
    assert graph.max_degree(1000) == pytest.approx(999 * weights.max())
    np.testing.assert_array_equal(graph.base_weights(1000), weights)
    assert time.process_time() - start < 3.0  # 9 s when each edge was read by itself


@pytest.mark.parametrize(
    "graph", ["complete", "path", "cycle", "star", graphs.from_matrix(UNEQUAL)]
)
def test_closed_forms_are_what_the_matrix_says(graph):
    graph, n = graphs.parse(graph), 5
    matrix = graph.base_weights(n)
    first, second, weight = graph.links(n)
    np.testing.assert_array_equal(matrix[first, second], weight)
    assert graph.most_links(n) == len(first) and graph.components(n) == components(matrix)
    assert graph.max_degree(n) == pytest.approx(max_degree(matrix))
    assert graph.bottleneck_weight(n) == bottleneck_weight(matrix)
    assert graph.weight_sum(n) == pytest.approx(np.triu(matrix).sum())
    assert graph.extreme_weights(n) == (weight.min(), weight.max())
    assert graph.step_degree(60 if graph.kind != "edges" else n) > 0.0
