"""Certificates of gains, links and wrong bearings: which theorem, its number, or why none."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from conftest import UNEQUAL

from rendezvous_env import Disc, Scenario, Sensing, certificate, graphs
from rendezvous_env.safety.settings import bounded_error
from rendezvous_env.safety.theorems.constants import least_degrees
from rendezvous_env.safety.theorems.gains import kappa, shrinking_to_leader
from rendezvous_env.safety.theorems.theorem import CHOICES
from rendezvous_env.sensors.sensor_equations import in_sectors

WALL = (Disc((0.0, 0.0), 1.0),)
SQUARE = ((0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (0.0, 4.0))
EVEN = Scenario(n_robots=6, graph="cycle")


def short(scenario, share=0.2):
    """A step so short that a held bearing is wrong by a share of π/n."""
    gain = float(least_degrees(scenario).max())
    step = scenario.merge_radius / (2 * gain) * math.sin(share * math.pi / scenario.n_robots)
    return scenario.replace(time_step=step)


# ---- gains ---------------------------------------------------------------------------------------


def test_gains_are_certified_by_g():
    """Four at the corners of a square: L0 = 16 m, κ(4) = 1 + 3 sin²(π/6) = 1.75."""
    team = Scenario(n_robots=4, graph="path", start_positions=SQUARE)
    found = certificate(team, by="gains", min_gain=0.5)
    assert found.guaranteed and found.by == "gains" and not found.continuous_time_only
    assert found.theorem.startswith("theorem G: every policy that weighs neighbours")
    assert found.continuous_time_bound == pytest.approx(16 / (2 * 0.5 * 1.75))
    # C = D̄ = 2 m/s, τ C = r/2: k = ½/(½ + 2 · ½ · 0.5/2), ψ = π/4
    rate = 0.5 * math.sin(math.pi / 8) * math.pi / 4 * 0.5 / (0.5 + 2 * 0.125)
    assert found.time_bound == pytest.approx(16 / rate + 3 * team.tau)
    assert math.isinf(found.lyapunov_bound) and found.hull_bound == pytest.approx(16)
    assert found.tolerated_bearing_error == 0.0  # gains that differ bear nothing
    slow = certificate(team.replace(max_speed=0.25), by="gains", min_gain=0.5)
    assert slow.continuous_time_bound == pytest.approx(2 * found.continuous_time_bound)
    standard = certificate(team, by="gains").continuous_time_bound
    assert standard == pytest.approx(found.continuous_time_bound / 2)


def test_equal_gains_bear_errors_and_held_inputs():
    team = Scenario(n_robots=6, time_step=0.002, graph=graphs.complete((0.5, 2.0)))
    gain, sine = 1.0, math.sin(math.pi / 6)
    held = math.asin(2 * gain * team.tau / team.merge_radius)
    found = certificate(team, by="gains", min_gain=gain, max_gain=gain)
    assert found.tolerated_bearing_error == pytest.approx(math.pi / 6 - held)
    size = 40.0
    rate = 2 * gain * float(kappa(6)) * math.sin(math.pi / 6 - held) / sine
    assert found.time_bound == pytest.approx(size / rate + 5 * team.tau)
    assert found.continuous_time_bound == pytest.approx(size / (2 * gain * float(kappa(6))))
    wrong = certificate(team, by="gains", min_gain=gain, max_gain=gain, bearing_error=0.3)
    rate = 2 * gain * float(kappa(6)) * math.sin(math.pi / 6 - 0.3 - held) / sine
    assert wrong.guaranteed and wrong.theorem.startswith("theorem N")
    strayed = 5 * 2 * math.pi * 2 * gain * team.tau * math.sin(0.15)  # in merge steps
    assert wrong.time_bound == pytest.approx((size + strayed) / rate + 5 * team.tau)
    assert wrong.hull_bound == pytest.approx(size + strayed)
    for options, words in (
        ({"max_gain": gain, "bearing_error": 0.52}, "tolerate less than 0.50"),
        ({"max_gain": 2.0, "bearing_error": 0.1}, "gains that add up to the same"),
    ):
        refused = certificate(team, by="gains", min_gain=gain, **options)
        assert not refused.guaranteed and words in refused.theorem
        assert math.isinf(refused.time_bound)


def test_who_hides_behind_others_is_not_missed():
    """The nearest is always seen: law (1) has gains of a* or more, gains theirs."""
    sensing = Sensing(occlusion="robots")
    team = Scenario(n_robots=4, start_positions=SQUARE, sensing=sensing)
    for by in ("law", "gains"):
        found = certificate(team, by=by)
        assert found.guaranteed and "theorem G" in found.theorem
        assert found.continuous_time_bound == pytest.approx(16 / (2 * 1.0 * 1.75))
    for by, margin in (("heading", 0.5), ("tank", 0.5), ("links", 1.0)):
        assert not certificate(team, margin, by=by).guaranteed
    path = team.replace(graph="path")
    assert not certificate(path, by="gains").guaranteed


# ---- links ---------------------------------------------------------------------------------------


def test_links_are_certified_by_r():
    team = Scenario(graph=UNEQUAL)
    most = 2 * 6.5 * 10 * math.sqrt(2) + 4 * 0.2 * 6.5
    found = certificate(team, by="links", share=0.25)
    assert found.guaranteed and found.theorem.startswith("theorem R")
    late = 4 * team.tau
    assert found.time_bound == pytest.approx(5 * most / (4 * 0.25 * 0.9**2) + late)
    assert math.isinf(found.continuous_time_bound) and not found.continuous_time_only
    assert found.lyapunov_bound == pytest.approx(most)
    assert found.tolerated_bearing_error == pytest.approx(math.pi / 10)
    wrong = certificate(team, by="links", share=0.25, bearing_error=math.pi / 20)
    assert wrong.time_bound - late == pytest.approx(4 * (found.time_bound - late))
    refused = certificate(team, by="links", bearing_error=math.pi / 10)
    assert not refused.guaranteed and "longer between merges even so" in refused.theorem


def test_links_of_limited_range():
    sensing = Sensing(range=5.0)
    start = ((0.0, 0.0), (4.5, 0.0), (4.5, 4.5), (0.0, 4.5))
    team = Scenario(n_robots=4, start_positions=start, sensing=sensing, graph=graphs.complete(2.0))
    most = 2 * 2 * 5 * (6 + 9) + 3 * 0.2 * 2 * 6
    found = certificate(team, by="links")
    assert found.time_bound == pytest.approx(4 * most / (4 * 0.5 * 4) + 3 * team.tau)
    assert math.isinf(found.lyapunov_bound)  # V counts those who are out of sight too
    far = certificate(team.replace(sensing=Sensing(range=4.6)), by="links")  # 4.5 > 4.6 − 0.3
    assert not far.guaranteed and "range − (n − 1) r/2" in far.theorem
    drawn = team.replace(start_positions=None)
    assert not certificate(drawn, by="links").guaranteed
    assert certificate(drawn.replace(spawn_size=3.0), by="links").guaranteed


# ---- what is not certified -----------------------------------------------------------------------

NEITHER = (
    ({"robot_model": "unicycle"}, "whose action is their velocity"),
    ({"robot_model": "double_integrator"}, "no theorem covers double_integrator"),
    ({"sensing": Sensing(delay=2)}, "late"),
    ({"sensing": Sensing(noise=0.1)}, "noise = 0.1"),
)


@pytest.mark.parametrize(
    ("by", "changes", "words"),
    [
        *[(by, *refused) for by in ("gains", "links") for refused in NEITHER],
        ("gains", {"obstacles": WALL}, "obstacles can hold a robot back"),
        ("gains", {"sensing": Sensing(range=3.0)}, "out of sight"),
        ("gains", {"sensing": Sensing(dropout=0.1)}, "out of sight"),
        ("links", {"sensing": Sensing(field_of_view=3.0)}, "field_of_view is 3 rad"),
        ("links", {"sensing": Sensing(occlusion="robots")}, "occlusion is 'robots'"),
        ("links", {"sensing": Sensing(dropout=0.2)}, "dropout is 0.2"),
        ("links", {"obstacles": WALL}, "obstacles turn robots aside"),
    ],
)
def test_gains_and_links_that_are_not_certified(by, changes, words):
    found = certificate(Scenario(**changes), by=by)
    assert not found.guaranteed and math.isinf(found.time_bound)
    assert re.match(f"none.*{words}", found.theorem)


# ---- wrong bearings ------------------------------------------------------------------------------


def test_law_1_bears_errors_by_n1():
    team = Scenario(graph=UNEQUAL)
    found = certificate(team)
    n, a, degree = 5, team.bottleneck_weight, team.max_degree
    borne = 2 * math.asin(a / (n * degree))
    assert found.tolerated_bearing_error == pytest.approx(borne)
    wrong = certificate(team, bearing_error=borne / 2)
    rho = n * degree * math.sin(borne / 4) / a
    above = 2 * 6.5 * 10 * math.sqrt(2) + 4 * 0.2 * 6.5
    above += 4 * team.tau * n * (2 * math.sin(borne / 4) * degree) ** 2
    bound = n * above / (4 * a**2 * (1 - rho**2)) + 4 * team.tau
    assert wrong.guaranteed and wrong.theorem.startswith("theorem N1")
    assert wrong.time_bound == pytest.approx(bound)
    assert math.isinf(wrong.lyapunov_bound)
    refused = certificate(team, bearing_error=borne * 1.01)
    assert not refused.guaranteed and f"less than {borne:.4g} rad" in refused.theorem


def test_law_1_bears_more_by_n_where_degrees_are_equal():
    team = short(EVEN)
    found = certificate(team)
    assert found.tolerated_bearing_error == pytest.approx(0.8 * math.pi / 6)
    wrong = certificate(team, bearing_error=0.7 * math.pi / 6)
    assert wrong.guaranteed and wrong.theorem.startswith("theorem N:")
    assert not certificate(team, bearing_error=0.81 * math.pi / 6).guaranteed


def test_headings_and_tanks_bear_errors():
    team = Scenario(graph=UNEQUAL)
    n, a, degree, margin = 5, team.bottleneck_weight, team.max_degree, 0.5
    start, rises = 2 * 6.5 * 10 * math.sqrt(2), 4 * 0.2 * 6.5
    for by, share, above in (("heading", 1.5, start + rises), ("tank", 2.0, start + 2 * rises)):
        borne = 2 * math.asin(share * margin / (2 * 1.5) * a / (n * degree))
        found = certificate(team, margin, by=by)
        assert found.tolerated_bearing_error == pytest.approx(borne)
        wrong = certificate(team, margin, by=by, bearing_error=borne / 2)
        rho = n * degree * math.sin(borne / 4) / a
        q = margin * share - 2 * 1.5 * rho
        assert wrong.guaranteed and wrong.bearing_error == borne / 2
        assert wrong.time_bound == pytest.approx(n * above / (a * q) ** 2 + 4 * team.tau)
        assert wrong.lyapunov_bound == pytest.approx(above)
        refused = certificate(team, margin, by=by, bearing_error=borne * 1.01)
        assert not refused.guaranteed and refused.lyapunov_bound == pytest.approx(above)
        assert "tolerate less than" in refused.theorem


def test_bounded_errors_of_the_sensor_count():
    sensing = Sensing(error=0.01, sectors=400)
    team = Scenario(sensing=sensing)
    eta = 0.01 + math.pi / 400
    assert bounded_error(sensing, 2) == pytest.approx(eta)
    for by, margin in (("law", 1.0), ("heading", 0.9), ("tank", 0.9), ("links", 1.0)):
        found = certificate(team, margin, by=by)
        assert found.bearing_error == pytest.approx(eta) and found.guaranteed
        given = certificate(team.replace(sensing=Sensing()), margin, by=by, bearing_error=eta)
        assert given.time_bound == pytest.approx(found.time_bound)
        more = certificate(team, margin, by=by, bearing_error=0.03)
        assert more.bearing_error == 0.03 and more.time_bound > found.time_bound


@pytest.mark.parametrize("sectors", [2, 3, 5, 8, 13, 90])
@pytest.mark.parametrize("dim", [2, 3])
def test_no_bearing_is_rounded_by_more(sectors, dim):
    random, worst = np.random.default_rng(sectors), 0.0
    for _ in range(3000):
        g = random.normal(size=dim) * ([1.0] * (dim - 1) + [random.choice([1.0, 30.0])])
        g /= np.linalg.norm(g)
        rounded = np.array(in_sectors(tuple(g), sectors))
        worst = max(worst, math.acos(np.clip(g @ rounded, -1, 1)))
    bound = bounded_error(Sensing(sectors=sectors), dim)
    assert worst <= bound + 1e-9 and worst > 0.5 * min(bound, 1.5)


@pytest.mark.parametrize("by", ["heading", "tank"])
def test_no_rendezvous_of_bodies_with_wrong_bearings(by):
    found = certificate(Scenario(robot_model="unicycle"), 0.5, by=by, bearing_error=0.1)
    assert not found.guaranteed and found.theorem.startswith("none")
    assert math.isfinite(found.lyapunov_bound)


def test_noise_has_no_bound_but_a_mean():
    """θ = 2D̄τ/r = 1 for the certified step of a pair."""
    pair = Scenario(
        n_robots=2, sensing=Sensing(noise=0.3), start_positions=((0.0, 0.0), (5.0, 0.0))
    )
    found = certificate(pair)
    assert not found.guaranteed and math.isinf(found.time_bound)
    assert "noise = 0.3" in found.theorem and "expected_time_bound" in found.theorem
    gamma = math.exp(-0.045)
    nu = 2 * (1 - gamma**2) * 2 / 4
    rate = gamma * (2 - gamma) - nu
    above = 10 + 0.2 + 2 * 0.2
    assert found.expected_time_bound == pytest.approx(2 * above / (4 * rate))
    for changes in ({"bias": 0.1}, {"dropout": 0.1}, {"error": 0.01}, {"noise": 2.0}):
        sensing = Sensing(**{"noise": 0.3, **changes})
        assert math.isinf(certificate(pair.replace(sensing=sensing)).expected_time_bound)
    for by in ("heading", "tank", "gains", "links"):
        margin = 0.5 if by in ("heading", "tank") else 1.0
        other = certificate(pair, margin, by=by)
        assert not other.guaranteed and math.isinf(other.expected_time_bound)


# ---- a leader ------------------------------------------------------------------------------------


def test_the_rate_with_a_leader():
    """κ₁: 1 for a pair; π c/(n − 1) in space."""
    assert shrinking_to_leader(2, 2, 3.0) == pytest.approx(6.0)
    assert shrinking_to_leader(4, 2, 1.0) == pytest.approx(2 * 3 * math.sin(math.pi / 6) ** 2)
    assert shrinking_to_leader(3, 3, 1.0) == pytest.approx(math.pi / 2)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("by", CHOICES)
@pytest.mark.parametrize(
    ("sensing", "error"), [(Sensing(error=1.8), 1.8), (Sensing(sectors=2, error=3.0), math.pi)]
)
def test_sensors_that_err_by_more_than_a_right_angle(sensing, error, by, dim):
    """No angle is above π, although errors and sectors add up to more."""
    team = Scenario(n_robots=4, dim=dim, sensing=sensing)
    found = certificate(team, 0.3 if by in ("heading", "tank") else 1.0, by=by)
    assert not found.guaranteed and math.isinf(found.time_bound)
    assert found.bearing_error == pytest.approx(error)
