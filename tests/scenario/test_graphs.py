"""Sensing graphs: weights, worst cases and families; directed and changing graphs."""

import tracemalloc

import numpy as np
import pytest
from conftest import UNEQUAL, started, unequal_matrix
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from rendezvous_env import Scenario, Sensing, graphs
from rendezvous_env.graphs.weights import bottleneck_weight, closed_groups, components, max_degree
from rendezvous_env.scenario.start_options import parse_options

ARCS = [(0, 1, 0.5), (1, 2, 2.0), (2, 1, 1.5), (2, 0, 1.0)]
MATRIX = [[0, 0.5, 0], [0, 0, 2.0], [1.0, 1.5, 0]]
PLAIN = ["path", graphs.directed_cycle((0.5, 1.0)), graphs.from_edges([(0, 2)])]
ONE_WAY = [
    graphs.directed(ARCS),
    graphs.directed_cycle(),
    graphs.directed_cycle((0.5, 2.0)),
    graphs.switching(PLAIN, 0.5, "random"),
    graphs.proximity(),
    graphs.proximity((0.5, 1.0)),
]
MUTUAL = [
    graphs.complete(),
    graphs.complete((0.1, 0.7)),
    graphs.path((0.5, 1.0)),
    graphs.random_tree(2.0),
    graphs.erdos_renyi(0.125, (0.1, 0.7)),
    graphs.from_edges([(0, 1), (2, 1, 0.3)]),
]


def scenario(graph, **fields):
    sensing = Sensing(range=5.0) if graph.kind == "proximity" else Sensing()
    return Scenario(**({"n_robots": 3, "graph": graph, "sensing": sensing} | fields))


def drawn(graph: graphs.Graph, n: int, count: int) -> np.ndarray:
    """Weights of the first episodes of many seeds, (count, n, n)."""
    sim = started(Scenario(n_robots=n, graph=graph), count)
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
def test_edges_match_hand_computation(graph, edges):
    weights = graph.base_weights(4)
    assert set(zip(*np.nonzero(np.triu(weights)), strict=True)) == edges
    np.testing.assert_array_equal(weights, weights.T)
    assert set(np.unique(weights)) <= {0.0, 1.0}
    np.testing.assert_array_equal(drawn(graph, 4, 2), np.tile(weights, (2, 1, 1)))


def test_matrix_is_used_unchanged():
    graph = graphs.from_matrix(UNEQUAL)
    np.testing.assert_array_equal(graph.base_weights(5), UNEQUAL)
    assert graph == graphs.from_edges(
        [(3, 4, 0.9), (0, 1, 2.0), (0, 3, 0.5), (2, 1, 1.3), (2, 3, 0.7), (4, 2, 1.1)]
    )


def test_arcs_match_hand_computation():
    graph = graphs.directed(ARCS)
    np.testing.assert_array_equal(graph.base_weights(3), MATRIX)
    assert graph == graphs.directed(np.array(MATRIX)) == graphs.directed(MATRIX)
    assert graph == graphs.directed([list(arc) for arc in ARCS])
    # a square table of lists is a matrix, tuples are arcs
    assert graphs.directed([[0, 1], [1, 0]]).edges == ((0, 1, 1.0), (1, 0, 1.0))
    assert graphs.directed([(0, 1), (1, 0)]).edges == ((0, 1, 1.0), (1, 0, 1.0))
    cycle = graphs.directed_cycle(2.0)
    sees, seen, _ = cycle.links(4)
    assert list(zip(sees, seen, strict=True)) == [(0, 1), (1, 2), (2, 3), (3, 0)]
    assert cycle.bottleneck_weight(4) == cycle.max_degree(4) == 2.0
    assert cycle.most_neighbours(4) == 1 and cycle.weight_sum(4) == 4.0


@pytest.mark.parametrize("graph", ONE_WAY + MUTUAL)
def test_toml_and_plain_data_round_trip(graph, tmp_path):
    again = graphs.parse(graph.to_plain())
    assert again == graph and hash(again) == hash(graph) and graphs.parse(graph) is graph
    scenario(graph).to_toml(tmp_path / "one.toml")
    assert Scenario.from_toml(tmp_path / "one.toml") == scenario(graph).replace(name="custom")


def test_graph_properties_are_reported():
    found = {graph.kind: (graph.directed, graph.changes, graph.undirected) for graph in ONE_WAY}
    assert found == {
        "directed": (True, False, False),
        "directed_cycle": (True, False, False),
        "switching": (True, True, False),
        "proximity": (False, True, False),
    }
    both_ways = graphs.switching(["path", "star"])
    assert (both_ways.directed, both_ways.undirected) == (False, False)
    assert both_ways.most_links(4) == 5  # 0 and 1 are linked in both
    for graph in MUTUAL:
        assert graph.undirected and not graph.directed and not graph.changes


def test_jointly_connected_graphs_are_accepted():
    halves = [graphs.from_edges([(0, 1)], 3), graphs.directed([(2, 1)], 3)]
    assert scenario(graphs.switching(halves)).max_degree == 1.0
    for graph in (graphs.directed([(0, 1), (0, 2)]), graphs.switching(halves[:1])):
        assert not scenario(graph, require_connected=False).require_connected
    near = scenario(graphs.proximity(), sensing=Sensing(range=0.6), require_connected=False)
    assert near.start_reach == np.inf
    assert scenario(graphs.proximity()).start_reach == pytest.approx(5.0 - 2 * 0.1)


@pytest.mark.parametrize(
    ("graph", "weights", "said"),
    [
        (graphs.switching(["path"]), np.zeros((3, 3)), "where the graph changes"),
        (graphs.proximity(), np.zeros((3, 3)), "where the graph changes"),
        (graphs.directed(ARCS), np.eye(3), "no robot is its own neighbour"),
        (graphs.directed(ARCS), [[0, 0.5, 0.5], [0, 0, 0], [0, 0, 0]], "weights are not connected"),
        (graphs.directed(ARCS), 9 * np.array(MATRIX), r"weights reach D = .*at most 4"),
        (graphs.directed(ARCS), 0.5 * np.array(MATRIX), r"a\* = 0\.25 m/s; .*at least 0\.5"),
    ],
)
def test_impossible_start_weights_are_rejected(graph, weights, said):
    with pytest.raises(ValueError, match=said):
        parse_options(scenario(graph), 1, {"weights": np.array(weights, dtype=float)})


def contractions(weights: np.ndarray):
    """All matrices that merges along edges can produce from this one, by brute force."""
    yield weights
    for i, j in zip(*np.nonzero(np.triu(weights + weights.T)), strict=True):
        merged = weights.copy()
        merged[i] = np.maximum(merged[i], merged[j])
        merged[:, i] = np.maximum(merged[:, i], merged[:, j])
        merged[i, i] = 0
        keep = np.arange(len(weights)) != j
        yield from contractions(merged[np.ix_(keep, keep)])


@pytest.mark.slow
@settings(max_examples=40)
@given(st.integers(2, 6), st.integers(0, 10**6))
def test_merges_never_exceed_worst_case(n, seed):
    weights = unequal_matrix(n, seed)
    degree, bottleneck = max_degree(weights), bottleneck_weight(weights)
    for contracted in contractions(weights):
        if len(contracted) > 1:
            assert contracted.sum(axis=1).max() <= degree * (1 + 1e-12)
            assert contracted.max() >= bottleneck * (1 - 1e-12)
            assert bottleneck_weight(contracted) >= bottleneck * (1 - 1e-12)
            assert len(components(contracted)) == 1


@settings(max_examples=40, deadline=None)
@given(st.integers(2, 5), st.integers(0, 10**6), st.sampled_from([1, 2, 4]))
def test_merges_of_arcs_never_exceed_worst_case(n, seed, most):
    random = np.random.default_rng(seed)
    weights = random.uniform(0.5, 2.0, (n, n)) * (
        random.permuted(np.tile(np.arange(n) < min(most, n - 1), (n, 1)), axis=1)
    )
    np.fill_diagonal(weights, 0.0)
    degree, least = max_degree(weights, directed=True), weights[weights > 0].min(initial=np.inf)
    for contracted in contractions(weights):
        degrees = contracted.sum(axis=1)
        assert degrees.max() <= degree * (1 + 1e-12)
        assert degrees[degrees > 0].min(initial=np.inf) >= least
        assert (contracted > 0).sum(axis=1).max() <= graphs.directed(weights).most_neighbours(n)


def test_switching_list_has_worst_case_of_graphs():
    graph = graphs.switching(["path", graphs.directed_cycle(1.5), graphs.from_edges([(0, 3)], 4)])
    # robots 0 and 3 may merge in one graph, and then have all edges of the path
    assert graph.max_degree(4) == max(3 * 1.0, 3 * 1.5)
    assert graph.bottleneck_weight(4) == 1.0 and graph.most_neighbours(4) == 3
    assert graph.weight_sum(4) == 3.0 and graph.step_degree(4) == graph.max_degree(4)
    union = graph.base_weights(4)
    assert union[0, 1] == 1.5 and union[1, 0] == 1.0 and union[0, 3] == 1.0 and union[0, 2] == 0
    # a graph without edges makes nobody's D_i small: nobody sees anyone in it
    assert graphs.switching([np.zeros((4, 4)), "cycle"]).bottleneck_weight(4) == 1.0


def test_closed_groups_match_hand_computation():
    chain = graphs.directed([(0, 1), (1, 2)]).base_weights(3)
    assert closed_groups(chain) == [[2]]
    assert closed_groups(graphs.directed_cycle().base_weights(3)) == [[0, 1, 2]]
    apart = graphs.directed([(0, 1), (0, 2), (2, 3), (3, 2)]).base_weights(4)
    assert sorted(closed_groups(apart)) == [[1], [2, 3]]


@pytest.mark.parametrize("weight", [1e-9, 1e-8, 3e-8, 1e9])
def test_bottleneck_of_weak_links_is_kept(weight):
    assert graphs.bottleneck_weight(weight * UNEQUAL) == weight * 0.9


@pytest.mark.parametrize(
    "graph", [graphs.random_tree((0.5, 2.0)), graphs.erdos_renyi(0.25, (0.5, 2.0))]
)
def test_families_are_connected_within_worst_case(graph):
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


def test_random_trees_are_uniform():
    """Cayley: 16 labelled trees of four robots with equal probability."""
    weights = drawn(graphs.random_tree(), 4, 4800)
    kinds, counts = np.unique(weights.reshape(4800, -1), axis=0, return_counts=True)
    assert len(kinds) == 16 and (kinds.sum(axis=1) == 6).all()
    assert stats.chisquare(counts).pvalue > 1e-3


def test_erdos_renyi_has_stated_probability():
    weights = drawn(graphs.erdos_renyi(0.8), 9, 2000)
    share = np.triu(weights).sum() / (2000 * 36)
    assert share == pytest.approx(0.8, abs=0.01)


def test_sparse_erdos_renyi_becomes_tree():
    weights = drawn(graphs.erdos_renyi(1e-9), 6, 50)
    assert (np.triu(weights).sum(axis=(1, 2)) == 5).all()
    assert len(np.unique(weights, axis=0)) > 20


@pytest.mark.parametrize("graph", ["complete", "cycle", "star", "random_tree", "directed_cycle"])
def test_large_graph_uses_little_memory(graph):
    Scenario(n_robots=9, graph=graph)  # imports what it needs
    tracemalloc.start()
    made = Scenario(n_robots=10_000, graph=graph)
    assert made.certified_step > 0.0 and made.bottleneck_weight == 1.0
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 20e6  # a matrix of 10,000 robots has 800 MB


@pytest.mark.parametrize(
    "graph", ["complete", "path", "cycle", "star", graphs.from_matrix(UNEQUAL)]
)
def test_closed_forms_equal_matrix(graph):
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
