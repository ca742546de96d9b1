"""Graphs and files in the formats of other packages."""

import networkx as nx
import numpy as np
import pytest
from scipy import sparse

from rendezvous_env import Scenario, Simulator, graphs, scenarios
from rendezvous_env.graphs.weights import weighted_links

PATH = ((0, 1, 1.0), (1, 2, 1.0), (2, 3, 1.0))
CYCLE = ((0, 1, 1.0), (1, 2, 1.0), (2, 3, 1.0), (3, 0, 1.0))
LINE = nx.path_graph(4)
ONE_WAY = nx.DiGraph([(0, 1), (1, 2), (2, 3), (3, 0)])
MATRIX = nx.to_numpy_array(LINE)
KINDS = ("bsr", "coo", "csc", "csr", "dia", "dok", "lil")
SPARSE = [f"{kind}_{what}" for kind in KINDS for what in ("array", "matrix")]


def graph_of(value, n=4):
    """Graph of a scenario of n robots for a value."""
    return Scenario(n_robots=n, graph=value).sensing_graph


def letters(*edges):
    graph = nx.Graph()
    graph.add_nodes_from("abcd")
    graph.add_edges_from(edges)
    return graph


@pytest.mark.parametrize(
    "given",
    [
        LINE,
        nx.MultiGraph(LINE),
        nx.freeze(nx.path_graph(4)),
        nx.complete_graph(4).edge_subgraph(LINE.edges),
        LINE.edges,
        LINE.edges(data=True),
        LINE.edges(data="weight"),
        nx.MultiGraph(LINE).edges,
        nx.MultiGraph(LINE).edges(data=True),
        [(0, 1), (1, 2), (2, 3)],
        [[0, 1], [1, 2], [2, 3]],
        [(0, 1), (2, 1, 1.0), (2, 3)],
        [(0, 1, None), (1, 2, {}), (2, 3, {"weight": 1.0})],
        ((i, i + 1) for i in range(3)),
        {(0, 1), (1, 2), (2, 3)},
        np.array([(0, 1), (1, 2), (2, 3)]),
        np.array([(0, 1, 1.0), (1, 2, 1.0), (2, 3, 1.0)]),
        MATRIX.tolist(),
        nx.to_pandas_adjacency(LINE),
        nx.to_pandas_edgelist(LINE),
        *(getattr(sparse, made)(MATRIX) for made in SPARSE),
    ],
    ids=lambda given: type(given).__name__,
)
def test_a_scenario_reads_a_path_however_it_is_given(given):
    assert graph_of(given) == graphs.from_edges(PATH)


@pytest.mark.parametrize(
    "given",
    [ONE_WAY, nx.MultiDiGraph(ONE_WAY), ONE_WAY.edges, ONE_WAY.edges(data=True)],
    ids=lambda given: type(given).__name__,
)
def test_a_directed_networkx_graph_stays_directed(given):
    assert graph_of(given) == graphs.directed(CYCLE)
    assert graphs.directed(given) == graphs.directed(CYCLE)


@pytest.mark.parametrize("made", [sparse.csr_array, sparse.dok_array, nx.DiGraph])
def test_directed_reads_matrices_and_graphs(made):
    matrix = nx.to_numpy_array(ONE_WAY)
    assert graphs.directed(made(matrix)) == graphs.directed(matrix)
    both = graphs.directed(LINE)
    assert both == graphs.directed(MATRIX) and both.directed


def test_the_weight_of_an_edge_is_its_attribute_weight():
    graph = nx.Graph()
    graph.add_edge(0, 1, weight=0.5, length=7.0)
    graph.add_edge(1, 2)
    wanted = ((0, 1, 0.5), (1, 2, 1.0))
    assert graph_of(graph, 3).edges == wanted
    assert graph_of(graph.edges(data=True), 3).edges == wanted
    assert graph_of(graph.edges(data="weight"), 3).edges == wanted
    assert graphs.from_matrix(graph).edges == wanted


def test_nodes_of_other_names_are_numbered_in_their_order():
    graph = letters(("d", "a"), ("b", "c"), ("a", "b"))
    assert graph_of(graph).edges == ((0, 1, 1.0), (0, 3, 1.0), (1, 2, 1.0))
    np.testing.assert_array_equal(graph_of(graph).base_weights(4), nx.to_numpy_array(graph))
    shuffled = nx.Graph()
    shuffled.add_nodes_from([2, 0, 1])
    shuffled.add_edges_from([(0, 1), (1, 2)])
    assert graph_of(shuffled, 3).edges == ((0, 1, 1.0), (1, 2, 1.0))  # indices of robots


def test_a_graph_keeps_robots_that_have_no_edge():
    alone = nx.Graph([(0, 1)])
    alone.add_node(2)
    for given in (alone, [(0, 1)], nx.to_scipy_sparse_array(alone)):
        team = Scenario(n_robots=3, graph=given, require_connected=False)
        assert team.sensing_graph.components(3) == [[0, 1], [2]]


@pytest.mark.parametrize(
    ("rows", "n", "edges"),
    [
        ([(0, 1, 0.5), (1, 2, 1.0), (2, 0, 2.0)], 3, ((0, 1, 0.5), (0, 2, 2.0), (1, 2, 1.0))),
        ([(0, 1, 0.5), (1, 2, 1.0), (2, 3, 2.0)], 4, ((0, 1, 0.5), (1, 2, 1.0), (2, 3, 2.0))),
        ([(0, 1), (2, 0)], 3, ((0, 1, 1.0), (0, 2, 1.0))),
        ([(0, 2), (2, 0)], 2, ((0, 1, 2.0),)),
        ([[0, 2, 1], [2, 0, 1], [1, 1, 0]], 3, ((0, 1, 2.0), (0, 2, 1.0), (1, 2, 1.0))),
        (((0, 2, 1), (2, 0, 1), (1, 1, 0)), 3, ((0, 1, 2.0), (0, 2, 1.0), (1, 2, 1.0))),
    ],
)
def test_a_square_table_is_a_matrix_where_it_can_be_one(rows, n, edges):
    assert graph_of(rows, n).edges == edges


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_rounding_does_not_make_a_matrix_asymmetric(dtype):
    random = np.random.default_rng(0)
    for _ in range(50):
        weights = random.uniform(0.1, 9.0, (6, 6)).astype(dtype)
        weights = np.triu(weights, 1) + np.triu(weights, 1).T
        rounded = weights.copy()
        rounded[0, 1] = np.nextafter(rounded[0, 1], dtype(np.inf))
        rounded[5, 2] = np.nextafter(rounded[5, 2], dtype(0.0))
        for given in (rounded, sparse.csr_array(rounded)):
            found = graph_of(given, 6).base_weights(6)
            np.testing.assert_array_equal(found, found.T)
            np.testing.assert_allclose(found, weights, rtol=1e-6)
        exact = graph_of(weights, 6).base_weights(6)
        np.testing.assert_array_equal(exact, weights.astype(np.float64))


def test_weights_of_a_reset_come_as_those_of_a_scenario_do():
    simulator = Simulator(Scenario(n_robots=4))
    rounded = 1.0 - np.eye(4)
    rounded[0, 1] = np.nextafter(1.0, 0.0)
    for given in (sparse.csr_array(1.0 - np.eye(4)), nx.complete_graph(4), rounded):
        simulator.reset(0, options={"weights": given})
        weights = simulator.weights[0]
        np.testing.assert_array_equal(weights, weights.T)
        np.testing.assert_allclose(weights, 1.0 - np.eye(4), rtol=1e-12)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({0: [1], 1: [2]}, r"graph is \{0: .* a networkx graph; graphs\.from_edges takes lists"),
        (LINE.adj, r"a networkx graph; graphs\.from_edges takes lists of \(i, j\)"),
        (object(), r"numbers, .*; graphs\.from_edges takes lists of \(i, j\)"),
        (np.ones((2, 5)), r"shape \(2, 5\); .* graphs\.from_edges takes lists"),
        (nx.path_graph(5), r"its matrix or edge list is for 5 robots, not for 4"),
        (nx.Graph([(0, 1), (1, 1), (2, 3)]), r"edge \(1, 1\) must join two different robots"),
        (nx.MultiGraph([(0, 1), (1, 0), (1, 2), (2, 3)]), r"edge \(0, 1\) must join .* once"),
        (letters(("a", "b"), ("c", "d")), r"components \[0, 1\] and \[2, 3\]"),
        ([(0, 1), (1, 2), (2, 9)], r"edge \(2, 9\) must join two different robots of 0\.\.3"),
        ([(0, 1), (1, 2), (2, 3, -1.0)], r"edge \(2, 3\) has weight -1\.0; it must be positive"),
        ([[1, 1, 0], [1, 1, 1], [0, 1, 1]], r"edge \(1, 1\)|a\[0, 0\] = 1\.0 must be 0"),
        (sparse.csr_array(np.triu(MATRIX)), r"a\[0, 1\] = 1\.0 must equal its mirror image"),
        (sparse.csr_array(-MATRIX), r"a\[0, 1\] = -1\.0 must not be negative"),
        (sparse.csr_array(1j * MATRIX), r"it must be a matrix of real numbers"),
        (sparse.csr_array(np.nan * MATRIX[:3]), r"shape \(3, 4\); they must be"),
    ],
)
def test_a_graph_that_cannot_be_is_refused_in_its_own_words(given, message):
    with pytest.raises(ValueError, match=message):
        graph_of(given)


def test_a_directed_graph_is_no_undirected_one():
    for made in (graphs.from_edges, graphs.from_matrix):
        with pytest.raises(ValueError, match=r"undirected; graphs\.directed takes directed graphs"):
            made(ONE_WAY)


def test_a_large_sparse_matrix_is_read_without_a_dense_one():
    n = 10_000
    steps = np.arange(n - 1)
    upper = sparse.coo_array((np.ones(n - 1), (steps, steps + 1)), shape=(n, n))
    first, second, weights = weighted_links(upper + upper.T)
    assert len(weights) == n - 1 and (second - first == 1).all()


@pytest.mark.parametrize("name", ["team.toml", "team.TOML", "Team.Toml"])
@pytest.mark.parametrize("mark", [b"", b"\xef\xbb\xbf"])
def test_a_file_is_read_whatever_wrote_it(tmp_path, name, mark):
    path = tmp_path / name
    path.write_bytes(mark + b"n_robots = 3\r\ngraph = [[0, 1], [1, 2]]\r\n")
    for given in (path, str(path)):
        team = scenarios.resolve(given)
        assert team.n_robots == 3 and team.name == path.stem
        assert team.sensing_graph.edges == ((0, 1, 1.0), (1, 2, 1.0))


def test_a_file_in_another_encoding_has_a_remedy(tmp_path):
    path = tmp_path / "team.toml"
    path.write_bytes("n_robots = 3".encode("utf-16"))
    with pytest.raises(ValueError, match=r"team\.toml: not a TOML file: .*; save it as UTF-8"):
        Scenario.from_toml(path)
