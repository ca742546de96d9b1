"""Certificates and filters on directed, switching and proximity graphs."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rendezvous_env import Scenario, Sensing, certificate, graphs
from rendezvous_env.safety.links import LinkKeeping
from rendezvous_env.safety.theorems.constants import kind_of_links, leaders
from rendezvous_env.safety.theorems.descent import time_bound
from rendezvous_env.safety.theorems.gains import kappa

SQUARE = ((0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (0.0, 4.0))
PURSUIT = Scenario(n_robots=4, graph=graphs.directed_cycle(), start_positions=SQUARE)
LED = Scenario(graph=graphs.directed([(1, 0), (2, 1), (3, 1, 2.0)]), n_robots=4)
SWITCHING = Scenario(
    n_robots=4, graph=graphs.switching(["path", "star"], dwell=1.0), start_positions=SQUARE
)
NEAR = Scenario(n_robots=4, graph=graphs.proximity(), sensing=Sensing(range=6.0))


def test_kinds_and_leaders():
    kinds = {
        "undirected": Scenario(),
        "directed": PURSUIT,
        "switching": SWITCHING,
        "proximity": NEAR,
    }
    for kind, scenario in kinds.items():
        assert kind_of_links(scenario.sensing_graph) == kind
        whole = [list(range(scenario.n_robots))]
        assert leaders(scenario) == whole
    assert kind_of_links(LED.sensing_graph) == "directed" and leaders(LED) == [[0]]
    turns = graphs.switching(["path", LED.sensing_graph])
    assert leaders(Scenario(n_robots=4, graph=turns)) == [[0]]


@pytest.mark.parametrize("scenario", [PURSUIT, SWITCHING, NEAR])
@pytest.mark.parametrize("by", ["heading", "tank"])
def test_no_law_4_and_no_tank(scenario, by):
    found = certificate(scenario, 0.5, by=by)
    assert not found.guaranteed and found.theorem.startswith(f'none: by="{by}" has no theorem')
    assert math.isinf(found.time_bound) and math.isinf(found.lyapunov_bound)
    instead = "links" if scenario is NEAR else "gains"
    assert found.theorem.endswith(f'by="{instead}" has one')
    assert certificate(scenario, by=instead).guaranteed
    if scenario is SWITCHING:
        assert "grow without end" in found.theorem
    assert np.isinf(time_bound(scenario, 10.0, min_alignment=0.5))


def test_cyclic_pursuit_has_g_and_n():
    found = certificate(PURSUIT)
    assert found.guaranteed and found.theorem.startswith("theorem G: law (1)")
    assert found.continuous_time_bound == pytest.approx(16 / (2 * float(kappa(4))))
    held = math.asin(2 * PURSUIT.tau / PURSUIT.merge_radius)
    assert found.tolerated_bearing_error == pytest.approx(max(0.0, math.pi / 4 - held))
    short = PURSUIT.replace(time_step=0.01)
    wrong = certificate(short, bearing_error=0.5)
    assert wrong.guaranteed and wrong.theorem.startswith("theorem N: law (1)")
    gains = certificate(PURSUIT, by="gains")
    assert gains.continuous_time_bound == pytest.approx(found.continuous_time_bound)


def test_a_leader_may_rest():
    rate = 2 * 3 * math.sin(math.pi / 6) ** 2
    for by in ("law", "gains"):
        found = certificate(LED.replace(start_positions=SQUARE), by=by)
        assert found.guaranteed and found.continuous_time_bound == pytest.approx(16 / rate)
        assert found.tolerated_bearing_error == 0.0
    assert not certificate(LED, by="gains", bearing_error=0.01).guaranteed


def test_graphs_that_take_turns():
    for by in ("law", "gains"):
        found = certificate(SWITCHING, by=by)
        assert found.guaranteed and "theorem G" in found.theorem
        assert found.continuous_time_bound == pytest.approx(16 / (2 * float(kappa(4))))
        assert found.hull_bound == pytest.approx(16 + 3 * 2 * math.pi * 0.2)
    pieces = graphs.switching([graphs.from_edges([(0, 1), (2, 3)]), "path"])
    found = certificate(SWITCHING.replace(graph=pieces), by="gains")
    assert not found.guaranteed and "[0, 1] and [2, 3] see nobody outside" in found.theorem
    assert "at some time" in found.theorem and found.hull_bound > 16


def test_links_by_sight():
    found = certificate(NEAR, by="links")
    most = 2 * 6 * (6 + 9) + 3 * 0.2 * 6
    assert found.guaranteed and found.lyapunov_bound == pytest.approx(most)
    assert found.time_bound == pytest.approx(4 * most / (4 * 0.5) + 3 * NEAR.tau)
    for by in ("law", "gains"):
        refused = certificate(NEAR, by=by)
        assert not refused.guaranteed and "lose sight of each other" in refused.theorem
    loose = certificate(NEAR.replace(require_connected=False), by="links")
    assert not loose.guaranteed and "others are given or may be drawn" in loose.theorem
    cone = Sensing(range=6.0, field_of_view=3.0)
    assert "field_of_view" in certificate(NEAR.replace(sensing=cone), by="links").theorem


@pytest.mark.parametrize(("scenario", "kind"), [(PURSUIT, "directed"), (SWITCHING, "switching")])
def test_one_way_links_cannot_be_kept(scenario, kind):
    with pytest.raises(ValueError, match=f"scenario: graph is a {kind} one; theorem R needs"):
        LinkKeeping(scenario, 1)
    assert not certificate(scenario, by="links").guaranteed
    LinkKeeping(NEAR, 1)
