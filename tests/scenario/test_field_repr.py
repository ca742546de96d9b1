"""``repr`` of scenarios and their parts: an expression with the fields that are not defaults."""

import math

import pytest

import rendezvous_env as rv

CERTIFICATES = [
    rv.certificate("ring-12"),
    rv.certificate("clutter-8", by="heading", min_alignment=0.2),
]
GRAPHS = {
    "graphs.complete()": rv.graphs.complete(),
    "graphs.cycle(2.0)": rv.graphs.cycle(2.0),
    "graphs.random_tree((0.5, 2.0))": rv.graphs.random_tree((0.5, 2.0)),
    "graphs.erdos_renyi(0.5)": rv.graphs.erdos_renyi(0.5),
    "graphs.erdos_renyi(0.3, (1.0, 2.0))": rv.graphs.erdos_renyi(0.3, (1.0, 2.0)),
    "graphs.from_edges(((0, 1, 2.0),), n_robots=3)": rv.graphs.from_edges([(0, 1, 2.0)], 3),
    "graphs.directed(((1, 0, 1.0),), n_robots=2)": rv.graphs.directed([(1, 0)]),
    "graphs.switching([graphs.path(), graphs.star()], dwell=0.5, order='random')": (
        rv.graphs.switching(["path", "star"], 0.5, "random")
    ),
}


def evaluated(made):
    return eval(repr(made), dict(vars(rv)))


@pytest.mark.parametrize("name", rv.scenarios.names())
def test_repr_of_every_named_scenario_is_an_expression_for_it(name):
    scenario = rv.scenarios.get(name)
    assert evaluated(scenario) == scenario


def test_repr_shows_only_fields_that_differ_from_their_default():
    assert repr(rv.Scenario()) == "Scenario()"
    shown = rv.Scenario(n_robots=3, graph="cycle", sensing=rv.Sensing(noise=0.1), costs=("rise",))
    assert repr(shown) == (
        "Scenario(n_robots=3, graph=graphs.cycle(), sensing=Sensing(noise=0.1), costs=('rise',))"
    )
    assert repr(rv.ObstacleField(4)) == "ObstacleField(count=4)"
    assert repr(rv.RewardWeights(progress=2.0)) == "RewardWeights(progress=2.0)"
    assert repr(rv.Events(n_crashed=1)) == "Events(n_crashed=1)"
    moving = rv.Moving(rv.Disc((0, 0), 1.0), velocity=(1, 0))
    assert repr(moving) == (
        "Moving(shape=Disc(centre=(0.0, 0.0), radius=1.0), velocity=(1.0, 0.0))"
    )


@pytest.mark.parametrize(("text", "graph"), GRAPHS.items())
def test_repr_of_a_graph_is_the_call_that_creates_it(text, graph):
    assert repr(graph) == text
    assert evaluated(graph) == graph


def test_repr_of_listed_edges_with_random_weights_is_an_expression_for_them():
    plain = {"kind": "edges", "edges": [[0, 1, 1.0]], "n_nodes": 2, "weight_range": [0.5, 2.0]}
    graph = rv.graphs.parse(plain)
    assert evaluated(graph) == graph


@pytest.mark.parametrize("certificate", CERTIFICATES, ids=lambda one: one.scenario)
def test_repr_of_a_certificate_is_an_expression_for_it(certificate):
    assert evaluated(certificate) == certificate
    assert "link_growth_bound" not in repr(certificate)


def test_repr_of_infinite_required_fields_is_an_expression():
    assert math.isinf(CERTIFICATES[1].time_bound)
    assert "time_bound=float('inf')" in repr(CERTIFICATES[1])
