"""Search for counterexamples of one policy over initial conditions, graphs and weights.

A counterexample is an increase of V, a growth of the hull, or a deadlock.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

import rendezvous_env as rv

from . import random_initial_conditions as places_of
from .falsification import Tally, TrialResult, Violation, climb
from .monitors import SEARCHED
from .random_scenarios import GRAPHS, STARTS, Trial, other_starts, random_graph, reach_of

_STREAM = 5  # of random numbers
_TRIES = 40
_OWN_GRAPH = 0.25  # fraction of trials with the scenario's graph
_OWN_SIZE = 0.4  # fraction of trials with the scenario's number of robots
_DRAWN = 0.15  # fraction of trials with initial conditions sampled as in episodes
_CLIMBING = 0.3  # fraction of trials whose initial conditions are optimised
_SIZES = (2, 3, 3, 4, 4, 5, 6)


class Counterexample(NamedTuple):
    """A counterexample."""

    number: str  # one of SEARCHED
    trial: Trial
    played: TrialResult


def search(
    policy: str, scenario: rv.Scenario, seed: int, number: int, numbers: Sequence[str]
) -> Tally:
    """Run a policy from the initial conditions of a sampled scenario.

    Stops when each quantity has been violated, or no further one is.
    """
    began, tally = time.perf_counter(), Tally(trials=STARTS)
    trial = replace(draw(policy, scenario, seed, number), numbers=tuple(numbers))
    for _ in numbers:
        if not trial.numbers:
            break
        one, played = climb(trial)
        tally.join(played)
        if played.violation is None:
            break
        tally.found.append((number, one, played))
        left = tuple(name for name in trial.numbers if name != played.violation.number)
        trial = replace(trial, numbers=left)
    tally.seconds = time.perf_counter() - began
    return tally


def draw(policy: str, scenario: rv.Scenario, seed: int, number: int) -> Trial:
    """Sample a variant of a scenario in size, graph, weights and initial conditions.

    The first sample is the scenario itself, as are those without a valid variant.
    """
    random = np.random.default_rng([seed, _STREAM, number])
    chosen, starts = scenario, tuple[rv.Scenario, ...]()
    for _ in range(_TRIES if number else 0):
        with suppress(ValueError):
            chosen = _varied(random, scenario)
            break
    if chosen.start_positions is not None:
        places = np.array(chosen.start_positions)
        anew = 0.0 if chosen.obstacles else 0.5
        starts = (chosen, *other_starts(random, chosen, places[None], anew)[1:])
    return Trial(
        scenario=chosen,
        by="policy",
        arguments={},
        seed=int(random.integers(2**31)),
        generations=3 if starts and random.random() < _CLIMBING else 0,
        starts=starts,
        policy=policy,
        numbers=tuple(SEARCHED),
    )


def _varied(random: np.random.Generator, scenario: rv.Scenario) -> rv.Scenario:
    """Sample size, graph, weights and initial condition; a ValueError if they are inconsistent."""
    n, r, dim = scenario.n_robots, scenario.merge_radius, scenario.dim
    graph, fields = scenario.sensing_graph, dict[str, Any](allow_long_step=True)
    resizable = graph.kind not in ("edges", "directed", "switching")
    if resizable and random.random() > _OWN_SIZE:
        n = int(places_of.pick(random, *_SIZES))
    if graph.fixed and graph.undirected and random.random() > _OWN_GRAPH:
        fields["graph"] = random_graph(random, places_of.pick(random, *GRAPHS["fixed"]), n, r)
    if n != scenario.n_robots:
        fields |= {"start_positions": None, "start_headings": None, "neighbour_slots": None}
    varied = scenario.replace(n_robots=n, **fields)
    if random.random() < _DRAWN:
        return varied.replace(start_positions=None)
    reach = reach_of(scenario.sensing.smallest("range"), n, r)
    return varied.replace(start_positions=places_of.random_positions(random, n, dim, r, reach))


def first_of_each(tally: Tally) -> Iterator[Counterexample]:
    """Counterexample of each quantity with the fewest robots, the first of equals."""
    for number in SEARCHED:
        found = [one for one in tally.found if one[2].violation.number == number]  # type: ignore[union-attr]
        if found:
            _, trial, played = min(found, key=lambda one: (one[1].scenario.n_robots, one[0]))
            yield Counterexample(number, trial, played)


_WORDS = {
    "rise": "V rises by {:.3g} m²/s in step {}",
    "growth": "the convex hull grows by {:.3g} m in step {}",
    "deadlock": "no progress for {:.4g} s up to step {}",
}


def words_of(violation: Violation | None) -> str:
    """Description of a counterexample: the violation and its step."""
    assert violation is not None
    return _WORDS[violation.number].format(violation.found, violation.step)


def rows_of(tally: Tally, numbers: Sequence[str]) -> list[dict[str, Any]]:
    """Rows of searched violations, with the number of initial conditions for each."""
    draws = {
        name: sum(one[2].violation.number == name for one in tally.found)  # type: ignore[union-attr]
        for name in SEARCHED
    }
    return [
        {
            "searched": name,
            "violation": words,
            "draws": tally.trials // STARTS,
            "violations": draws[name],
        }
        for name, words in SEARCHED.items()
        if name in numbers
    ]
