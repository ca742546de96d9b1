"""Theorems N, N1, N1', D and R by hand."""

import math

import numpy as np
import pytest
from conftest import UNEQUAL
from test_bounds import ALLOWANCE, close, started

from rendezvous_env import Scenario, Sensing, certificate, graphs
from rendezvous_env.safety.settings import bounded_error
from rendezvous_env.safety.theorems.constants import lyapunov_bound
from rendezvous_env.safety.theorems.gains import kappa, shrinking
from rendezvous_env.safety.theorems.noise import (
    equal_gain_bounds,
    gains_are_equal,
    law_bounds,
    tolerated_error,
)
from rendezvous_env.safety.theorems.theorem import LAW
from rendezvous_env.sensors.imperfections import in_sectors


def test_sampled_equal_gains_match_hand_computation():
    """T ≤ L0 sin(π/n)/(2cκ(n) sin((1 − β)π/n)) + (n − 1)τ at τ = (r/2c) sin(βπ/n)."""
    n, c, r, beta = 7, 2 * 0.7, 0.3, 0.6
    step = r / (2 * c) * math.sin(beta * math.pi / n)
    ring = Scenario(n_robots=n, graph=graphs.cycle(0.7), merge_radius=r, time_step=step)
    rate = 2 * c * n * math.sin(math.pi / n) ** 2
    rate *= math.sin((1 - beta) * math.pi / n) / math.sin(math.pi / n)
    ring, _, extent = started(ring)
    assert equal_gain_bounds(ring, LAW).time == close(extent / rate + 6 * step)
    space, eta = ring.replace(dim=3, start_positions=None), 0.6 * math.atan(1 / math.sqrt(n * 5))
    space = space.replace(time_step=r / (2 * c) * math.sin(eta))
    bracket = math.cos(eta) / n - math.sin(eta) * math.sqrt(1 - 2 / n)
    space, _, extent = started(space)
    expected = extent / (2 * math.pi) / (2 * c * bracket) + 6 * space.tau
    assert equal_gain_bounds(space, LAW).time == close(expected)
    pair, _, extent = started(Scenario(n_robots=2))  # both on one line: no bearing is ever wrong
    assert equal_gain_bounds(pair, LAW).time == close(extent / 4 + pair.tau)


def test_sampling_is_not_covered_elsewhere():
    short = Scenario(time_step=0.02 * Scenario().certified_step)
    assert np.isfinite(equal_gain_bounds(short, LAW).time)
    for changes in (
        *({"graph": graph} for graph in ("path", UNEQUAL, graphs.complete((1, 2)))),
        {"max_speed": 3.9},
    ):
        assert gains_are_equal(short.replace(**changes), LAW)
    assert not gains_are_equal(Scenario(), LAW)
    # the certified step: asin(1) is more than π/5
    assert equal_gain_bounds(Scenario(), LAW).time == np.inf
    for dim, sharp in ((2, math.pi / 5), (3, math.atan(1 / math.sqrt(15)))):
        assert shrinking(5, dim, 1.0, 0.99 * sharp) > 0 == shrinking(5, dim, 1.0, 1.01 * sharp)


def test_equal_gains_tolerate_errors_and_sampling():
    team = Scenario(n_robots=6, time_step=0.002, graph=graphs.complete((0.5, 2.0)))
    even, extent = {"by": "gains", "min_gain": 1.0, "max_gain": 1.0}, 40
    sine = math.sin(math.pi / 6)
    held = math.asin(2 * team.tau / team.merge_radius)
    found, kappa_6 = certificate(team, **even), float(kappa(6))
    assert found.tolerated_bearing_error == close(math.pi / 6 - held)
    rate = 2 * kappa_6 * math.sin(math.pi / 6 - held) / sine
    assert found.time_bound == close(extent / rate + 5 * team.tau)
    assert found.continuous_time_bound == close(extent / (2 * kappa_6))
    wrong = certificate(team, **even, bearing_error=0.3)
    rate = 2 * kappa_6 * math.sin(math.pi / 6 - 0.3 - held) / sine
    assert wrong.guaranteed and wrong.theorem.startswith("theorem N")
    strayed = 5 * 2 * math.pi * 2 * team.tau * math.sin(0.15)  # in merge steps
    assert wrong.time_bound == close((extent + strayed) / rate + 5 * team.tau)
    assert wrong.hull_bound == close(extent + strayed)
    for changes, words in (
        ({"bearing_error": 0.52}, "tolerate less than 0.50"),
        ({"max_gain": 2.0, "bearing_error": 0.1}, "equal sums of gains"),
    ):
        refused = certificate(team, **{**even, **changes})
        assert not refused.guaranteed and words in refused.theorem
        assert math.isinf(refused.time_bound)


def test_law_1_tolerates_errors_by_n1():
    team, n, a, degree = Scenario(graph=UNEQUAL), 5, 0.9, 6.5
    borne = 2 * math.asin(a / (n * degree))
    assert certificate(team).tolerated_bearing_error == close(borne)
    wrong = certificate(team, bearing_error=borne / 2)
    rho = n * degree * math.sin(borne / 4) / a
    above = 2 * 6.5 * 10 * math.sqrt(2) + ALLOWANCE
    above += 4 * team.tau * n * (2 * math.sin(borne / 4) * degree) ** 2
    bound = n * above / (4 * a**2 * (1 - rho**2)) + 4 * team.tau
    assert wrong.guaranteed and wrong.theorem.startswith("theorem N1")
    assert wrong.time_bound == close(bound) and math.isinf(wrong.lyapunov_bound)
    refused = certificate(team, bearing_error=borne * 1.01)
    assert not refused.guaranteed and f"less than {borne:.4g} rad" in refused.theorem


def test_headings_and_tanks_tolerate_errors():
    team, n, a, degree, margin = Scenario(graph=UNEQUAL), 5, 0.9, 6.5, 0.5
    start = 2 * 6.5 * 10 * math.sqrt(2)
    for by, share, above in (
        ("heading", 1.5, start + ALLOWANCE),
        ("tank", 2, start + 2 * ALLOWANCE),
    ):
        borne = 2 * math.asin(share * margin / (2 * 1.5) * a / (n * degree))
        found = certificate(team, margin, by=by)
        assert found.tolerated_bearing_error == close(borne)
        wrong = certificate(team, margin, by=by, bearing_error=borne / 2)
        q = margin * share - 2 * 1.5 * n * degree * math.sin(borne / 4) / a
        assert wrong.guaranteed and wrong.bearing_error == borne / 2
        assert wrong.time_bound == close(n * above / (a * q) ** 2 + 4 * team.tau)
        assert wrong.lyapunov_bound == close(above)
        refused = certificate(team, margin, by=by, bearing_error=borne * 1.01)
        assert not refused.guaranteed and refused.lyapunov_bound == close(above)
        assert "tolerate less than" in refused.theorem


def test_known_degrees_give_sharper_bounds():
    """2c_m in place of 2a*: (m − 1) a on complete graphs of weight a, 2a on cycles."""
    a, n, eta = 0.7, 6, 0.1
    team, ring = (Scenario(n_robots=n, graph=g) for g in (graphs.complete(a), graphs.cycle(a)))
    each = (started(team)[1] + n * 2.0) / (n - 1) + (n - 1) * 0.2 * a
    expected = each / (2 * 0.3**2 * a**2) + (n - 1) * team.tau
    assert tank(team, budget=2.0).time_bound == close(expected)
    for scenario in (team, ring):
        assert tolerated_error(scenario) == close(2 * math.asin(1 / n))
    assert tolerated_error(team, 0.3) == close(2 * math.asin(0.3 / (1.3 * n)))
    ring, initial, _ = started(ring)
    above = initial + 5 * 0.2 * n * a + 5 * ring.tau * n * (2 * math.sin(eta / 2) * 2 * a) ** 2
    rates = [4 * c**2 / m * (1 - (m * math.sin(eta / 2)) ** 2) for m, c in ((2, a), (6, 2 * a))]
    expected = above / min(rates) + 5 * ring.tau
    assert law_bounds(ring, LAW._replace(error=eta)).time == close(expected)


@pytest.mark.parametrize("sectors", [2, 3, 5, 8, 13, 90])
@pytest.mark.parametrize("dim", [2, 3])
def test_bearing_rounding_is_bounded(sectors, dim):
    random, worst = np.random.default_rng(sectors), 0.0
    for _ in range(3000):
        g = random.normal(size=dim) * ([1.0] * (dim - 1) + [random.choice([1.0, 30.0])])
        g /= np.linalg.norm(g)
        rounded = np.array(in_sectors(tuple(g), sectors))
        worst = max(worst, math.acos(np.clip(g @ rounded, -1, 1)))
    bound = bounded_error(Sensing(sectors=sectors), dim)
    assert worst <= bound + 1e-9 and worst > 0.5 * min(bound, 1.5)


def tank(scenario, **given):
    """Certificate with ε = 0.3 for the initial positions of ``started``."""
    return certificate(started(scenario)[0], 0.3, by="tank", **given)


def test_tank_bounds_match_hand_computation():
    team = Scenario(n_robots=5, graph=UNEQUAL, merge_radius=0.2)
    _, initial, _ = started(team)
    assert lyapunov_bound(team, initial) == close(initial + ALLOWANCE)
    most = initial + 2 * ALLOWANCE + 5 * 20.0
    bound = 5 * most / (4 * 0.3**2 * 0.9**2)
    found = tank(team, budget=20.0)
    assert found.lyapunov_bound == close(most)
    long = team.replace(time_step=3 * team.certified_step, allow_long_step=True)
    # of two scales the smaller one counts, not their product
    for changed, factor in (
        *((team, 1), (team.replace(max_speed=1.3), 5), (long, 3)),
        (long.replace(max_speed=1.3), 5),
    ):
        expected = factor * bound + 4 * changed.tau
        assert tank(changed, budget=20.0).time_bound == close(expected)


def test_links_are_certified_by_theorem_r():
    team, late = Scenario(graph=UNEQUAL), 4 * Scenario(graph=UNEQUAL).tau
    most = 2 * 6.5 * 10 * math.sqrt(2) + ALLOWANCE
    found = certificate(team, by="links", share=0.25)
    assert found.guaranteed and found.theorem.startswith("theorem R")
    assert found.time_bound == close(5 * most / (4 * 0.25 * 0.9**2) + late)
    assert math.isinf(found.continuous_time_bound) and not found.continuous_time_only
    assert found.lyapunov_bound == close(most)
    assert found.tolerated_bearing_error == close(math.pi / 10)
    wrong = certificate(team, by="links", share=0.25, bearing_error=math.pi / 20)
    assert wrong.time_bound - late == close(4 * (found.time_bound - late))
    refused = certificate(team, by="links", bearing_error=math.pi / 10)
    assert not refused.guaranteed and "grows between merges even so" in refused.theorem
    assert [*refused.promises] == ["lyapunov", "link_growth"]


def test_limited_range_links_match_hand_computation():
    start = ((0.0, 0.0), (4.5, 0.0), (4.5, 4.5), (0.0, 4.5))
    seen, graph = Sensing(range=5.0), graphs.complete(2.0)
    team = Scenario(n_robots=4, start_positions=start, sensing=seen, graph=graph)
    most = 2 * 2 * 5 * (6 + 9) + 3 * 0.2 * 2 * 6
    found = certificate(team, by="links")
    assert found.time_bound == close(4 * most / (4 * 0.5 * 4) + 3 * team.tau)
    assert math.isinf(found.lyapunov_bound)  # V counts those who are out of sight too
    far = certificate(team.replace(sensing=Sensing(range=4.6)), by="links")  # 4.5 > 4.6 − 0.3
    assert not far.guaranteed and "range − (n − 1) r/2" in far.theorem
    drawn = team.replace(start_positions=None)
    assert not certificate(drawn, by="links").guaranteed
    assert certificate(drawn.replace(spawn_size=3.0), by="links").guaranteed
    near = Scenario(n_robots=4, graph=graphs.proximity(), sensing=Sensing(range=6.0))
    found, most = certificate(near, by="links"), 2 * 6 * (6 + 9) + 3 * 0.2 * 6
    assert found.guaranteed and found.lyapunov_bound == close(most)
    assert found.time_bound == close(4 * most / (4 * 0.5) + 3 * near.tau)
