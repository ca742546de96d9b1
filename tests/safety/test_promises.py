"""Certified numbers under adversaries, step by step and filter by filter.

Filters with injected faults must violate them.
"""

import math

import numpy as np
import pytest
from conftest import MODELS, five
from faulty_filters import mistaken

import baselines
from rendezvous_env import Scenario, Sensing, certificate, graphs, rollout
from rendezvous_env.safety.gains import Gains
from rendezvous_env.safety.heading import HeadingFilter
from rendezvous_env.safety.links import LinkKeeping
from rendezvous_env.safety.tank import EnergyTank
from train.verify.falsification import play
from train.verify.random_scenarios import Trial

ANYWHERE = ("single_integrator-2d", "single_integrator-3d")
FIVE = {kind: five(kind, spawn_size=3.0) for kind in MODELS}
EVEN = Scenario(n_robots=6, graph=graphs.complete(0.7), spawn_size=3.0)
SIX = Scenario(n_robots=6, spawn_size=3.0)
LONGEST = SIX.replace(max_speed=SIX.merge_radius / SIX.tau)
MOST = {"min_gain": LONGEST.max_speed, "max_gain": LONGEST.max_speed}
"""Gains for which a robot may move by r in a step."""
ANY = (
    graphs.directed_cycle(),
    graphs.directed([(i, i - 1, 0.5 + i) for i in range(1, 6)], 6),  # led by one
    graphs.switching(["path", "cycle", graphs.directed_cycle()], dwell=1.0),
    graphs.from_edges([*((i, (i + 1) % 6, 1.0 + i) for i in range(6)), (0, 3, 0.3)], 6),
)
RARELY = Sensing(range=2.5, field_of_view=2.0, dropout=0.3, occlusion="robots")
NEAR = SIX.replace(spawn_size=2.0, sensing=Sensing(range=4.0))
ERRING = NEAR.replace(sensing=Sensing(range=4.0, error=0.2))


def played(scenario, by, *, frame="local", **arguments):
    return play(Trial(scenario, by, arguments, frame))


def longer(scenario, factor, **changes):
    """A step of a multiple of the certified one."""
    step = factor * scenario.certified_step
    return scenario.replace(time_step=step, allow_long_step=True, **changes)


def checked(found):
    """Checked numbers."""
    return {what for _, what in found.counts} - {"granted"}


@pytest.mark.parametrize("kind", MODELS)
@pytest.mark.parametrize("error", [0.0, 0.1, 0.6])
@pytest.mark.parametrize("factor", [1.0, 10.0])
@pytest.mark.parametrize(("by", "step"), [("heading", "descent"), ("tank", "ledger")])
def test_v_or_ledger_decreases_in_every_step(by, step, kind, error, factor):
    """With bearing errors, too long steps, and nonholonomic robots."""
    given = {"min_alignment": 0.3 if by == "heading" else 0.6, "bearing_error": error}
    scenario = FIVE[kind] if factor == 1.0 else longer(FIVE[kind], factor)
    for options in ({}, {"budget": 2.0}) if by == "tank" else ({},):
        found = played(scenario, by, **given, **options)
        assert found.violation is None and {step, "lyapunov"} <= checked(found) and found.steps > 5


CASES = [
    *[(FIVE[kind], "gains", {}, "nested") for kind in ANYWHERE],
    *[(FIVE[kind], "links", {"bearing_error": e}, "links") for kind in ANYWHERE for e in (0, 0.2)],
    *[(LONGEST.replace(dim=dim), "gains", MOST, "nested") for dim in (2, 3)],
    (SIX.replace(sensing=RARELY), "gains", {}, "nested"),
    (NEAR, "links", {"share": 0.1}, "links"),
    pytest.param(NEAR.replace(dim=3), "links", {"share": 0.1}, "links", marks=pytest.mark.slow),
    (ERRING, "links", {"bearing_error": 0.2 + 1e-6}, "links"),
    (FIVE[ANYWHERE[0]], "links", {"bearing_error": 0.2, "share": 0.01}, "links"),
    (longer(SIX, 4.0), "links", {}, "links"),
    (longer(SIX, 2.0, max_speed=1.3), "tank", {"min_alignment": 0.05, "budget": 1.0}, "ledger"),
    (FIVE[ANYWHERE[0]], "tank", {"min_alignment": 0.6, "frame": "net_bearing"}, "ledger"),
    *[(EVEN, by, {"min_alignment": 0.9}, "time") for by in ("heading", "tank")],
    (EVEN, "law", {"bearing_error": 0.25}, "time"),
    *[(EVEN.replace(graph=graphs.cycle(0.7)), by, {"min_alignment": 0.9, "bearing_error": 0.1},
        "time") for by in ("heading", "tank")],
]  # fmt: skip


@pytest.mark.parametrize(("scenario", "by", "arguments", "number"), CASES)
def test_certificate_bounds_hold(scenario, by, arguments, number):
    found = played(scenario, by, **arguments)
    assert found.violation is None and number in checked(found)


@pytest.mark.parametrize("graph", ANY)
def test_law_1_meets_within_bound(graph):
    """Theorem D1 with nearly twice the certified step; the continuous bound is smaller."""
    team = longer(SIX.replace(graph=graph, spawn_size=4.0, time_limit=400.0), 1.9)
    found = certificate(team)
    assert found.guaranteed and found.continuous_time_bound < found.time_bound < math.inf
    law = rollout(team, baselines.make("bearing-only", team), 0, num_envs=6)
    assert (law.rendezvous_time <= found.time_bound).all()


MISTAKES = {
    "Δ² does not matter": (
        EnergyTank,
        lambda known: {"merge_radius": 1e9},
        (longer(FIVE[ANYWHERE[0]], 2.0), "tank", {"min_alignment": 0.1, "budget": 1.0}),
    ),
    "errors do not matter": (
        HeadingFilter,
        lambda known: {"robot": known.robot._replace(error_chord=0.0)},
        (FIVE[ANYWHERE[0]], "heading", {"min_alignment": 0.1, "bearing_error": 0.6}),
    ),
    "nobody goes beyond its neighbour": (
        Gains,
        lambda known: {
            "min_gains": np.full_like(known.min_gains, 40.0),
            "max_gains": np.full_like(known.max_gains, 40.0),
            "speed_limit": 40.0,
        },
        (SIX.replace(graph="path", max_speed=1e3), "gains", {}),
    ),
    "balls may be three times as large": (
        LinkKeeping,
        lambda known: {"radius": 3.0 * known.radius},
        (FIVE[ANYWHERE[0]], "links", {}),
    ),
    "any velocity of the dual cone will do": (
        LinkKeeping,
        lambda known: {"radius": 1e6, "share": 0.0},
        (FIVE[ANYWHERE[0]], "links", {}),
    ),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_planted_filter_mistake_is_detected(mistake, monkeypatch):
    made, changes, (scenario, by, arguments) = MISTAKES[mistake]
    assert played(scenario, by, **arguments).violation is None
    mistaken(monkeypatch, made, changes)
    assert played(scenario, by, **arguments).violation is not None
