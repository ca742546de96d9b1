"""Former errors of certificates, injected again: ``verify --random-scenarios`` finds each of them.

The seeds below were found by a search over some thousand; they change with the sampled scenarios.
"""

from dataclasses import replace
from types import SimpleNamespace

import pytest

from rendezvous_env import Sensing, graphs
from rendezvous_env.safety.theorems import assumptions, certificate, constants, gains, links
from train.verify.falsification import climb
from train.verify.random_scenarios import trials_of


def exchange(monkeypatch, before, after):
    """Replace the bounds or an assumption of every theorem that has them."""
    changed = tuple(
        replace(
            theorem,
            bounds=after if theorem.bounds is before else theorem.bounds,
            assumptions=tuple(after if one is before else one for one in theorem.assumptions),
        )
        for theorem in certificate.THEOREMS
    )
    assert changed != certificate.THEOREMS
    monkeypatch.setattr(certificate, "THEOREMS", changed)


def merges_at_midpoints(monkeypatch):
    """Theorem R: as if merges inside obstacles were at the midpoint."""
    monkeypatch.setattr(
        links, "merge_growth", lambda team: (team.n_robots - 1) * team.merge_radius / 2
    )


def the_nearest_has_a_heavy_link(monkeypatch):
    """Theorem G with mutual occlusion: a* for the lightest link, and continuous inputs."""
    bounds = gains.bounds

    def followed(scenario, asked):
        found = bounds(scenario, asked)
        return replace(found, time=found.continuous_time)

    exchange(monkeypatch, bounds, followed)
    light = {"lightest_link": lambda scenario: scenario.bottleneck_weight}
    monkeypatch.setattr(gains, "known", SimpleNamespace(**{**vars(constants), **light}))


def a_speed_limit_bounds_gains(monkeypatch):
    """Theorem G of law (1): min(D̄, v_max) τ ≤ r in place of D̄ τ ≤ r."""
    within = assumptions.within_neighbours

    def slow(scenario, asked):
        fastest = min(scenario.max_degree, scenario.speed_limit)
        return "" if fastest * scenario.tau <= scenario.merge_radius else within(scenario, asked)

    exchange(monkeypatch, within, slow)


EVERYBODY_IS_SEEN = {"graph": graphs.complete(13.0), "sensing": Sensing()}
"""Scenario of a kind that other tests compile."""


@pytest.mark.parametrize(
    ("mistake", "by", "number", "changes", "broken"),
    [
        (merges_at_midpoints, "links", 80582, EVERYBODY_IS_SEEN, "link_growth"),
        (the_nearest_has_a_heavy_link, "law", 1001, {}, "time"),
        (a_speed_limit_bounds_gains, "law", 1101, {}, "nested"),
    ],
)
def test_planted_mistake_is_found(mistake, by, number, changes, broken, monkeypatch):
    drawn = next(one for one in trials_of(0, number) if one.by == by)
    scenario, *starts = (one.replace(**changes) for one in (drawn.scenario, *drawn.starts))
    trial = replace(drawn, scenario=scenario, starts=tuple(starts))
    assert climb(trial)[1].violation is None
    mistake(monkeypatch)
    found = climb(trial)[1].violation
    assert found.number == broken and found.found > found.promised
