"""``rendezvous verify --any``: random scenarios by the thousand, and violations made small."""

from __future__ import annotations

import dataclasses
import json
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import rendezvous_env as rv
from rendezvous_env.safety.theorems.theorem import CHOICES

from .falsification import TEAMS, Played, Tally, Task, Trial, climb, play
from .random_scenarios import STARTS, draw, draw_kind

DRAWS = 50
"""Of a task: they are of one kind and share compiled code. Each is of STARTS scenarios."""
_CLIMBING = 0.15
"""Share of trials whose starts are bettered."""
_HOW = ("by", "arguments", "frame", "period", "seed")
"""What of a trial is written besides its scenario."""
_KINDS = 10**9
"""Where the random streams of kinds begin, beyond those of trials."""


def tasks_of(trials: int, seed: int, kinds: int | None = None) -> list[Task]:
    """So many scenarios, or a few more, of so many kinds at most, cut into tasks."""
    draws = -(-trials // STARTS)
    blocks = range(-(-draws // DRAWS))
    most = kinds or len(blocks)
    numbers = [range(k * DRAWS, min((k + 1) * DRAWS, draws)) for k in blocks]
    looks = [partial(look_at, numbers[k], seed, k % most) for k in blocks]
    return [Task(f"any-{k:07d}", "scenarios", looks[k]) for k in blocks]


def look_at(numbers: range, seed: int, kind: int) -> Tally:
    """Play the trials of these numbers, all of one kind."""
    began, tally = time.perf_counter(), Tally(trials=len(numbers) * STARTS)
    for number in numbers:
        for drawn in trials_of(seed, number, kind):
            tally.add(number, *climb(drawn))
    tally.seconds = time.perf_counter() - began
    return tally


def trials_of(seed: int, number: int, kind_number: int | None = None) -> list[Trial]:
    """The scenarios of a number, played under each of CHOICES; of the kind of their task if of no
    other.
    """
    kind_number = number // DRAWS if kind_number is None else kind_number
    kind = draw_kind(np.random.default_rng([seed, _KINDS + kind_number]))
    random = np.random.default_rng([seed, number])
    drawn = draw(random, kind)
    return [
        Trial(
            scenario=drawn.scenario,
            by=by,
            arguments=drawn.arguments[by],
            frame="net_bearing" if random.random() < 0.3 else "local",
            period=3 if by != "law" and random.random() < 0.15 else 1,
            seed=int(random.integers(2**31)),
            generations=3 if random.random() < _CLIMBING else 0,
            starts=drawn.starts,
        )
        for by in CHOICES
    ]


def shrink(trial: Trial, played: Played) -> tuple[Trial, Played]:
    """A trial of fewer robots and plainer fields in which the same number is violated.

    One thing is made simpler at a time, and kept if adversaries still find a violation; until
    nothing is left to try.
    """
    assert played.violation is not None
    number, again = played.violation.number, True
    while again:
        again = False
        for simpler in _simpler(trial):
            found = play(simpler)
            if found.violation is not None and found.violation.number == number:
                trial, played, again = simpler, found, True
                break
    return trial, played


def _simpler(trial: Trial) -> Iterator[Trial]:
    """The trial with one thing less, the largest things first."""
    scenario, plain, exact = trial.scenario, rv.Scenario(), rv.Sensing()
    given = scenario.obstacles if isinstance(scenario.obstacles, tuple) else ()
    fields = ("max_speed", "time_step", "max_turn_rate", "obstacle_contact", "on_merge")
    flaws = [one.name for one in dataclasses.fields(exact)]
    changes: list[dict[str, Any]] = [
        {"obstacles": ()},
        *[{name: getattr(plain, name)} for name in fields],
        {"local_frames": "global"},
        *[{"sensing": replace(scenario.sensing, **{n: getattr(exact, n)})} for n in flaws],
        *[{"obstacles": given[:k] + given[k + 1 :]} for k in range(len(given))],
        *_fewer_robots(scenario),
    ]
    for change in changes:
        if any(getattr(scenario, name) != value for name, value in change.items()):
            with suppress(ValueError):
                yield replace(trial, scenario=scenario.replace(**change))
    if trial.period > 1 or trial.frame != "local":
        yield replace(trial, period=1, frame="local")


def _fewer_robots(scenario: rv.Scenario) -> Iterator[dict[str, Any]]:
    n, graph = scenario.n_robots, scenario.sensing_graph
    for robot in range(n if n > 2 else 0):
        left = [k for k in range(n) if k != robot]
        tables = {name: getattr(scenario, name) for name in ("start_positions", "start_headings")}
        change: dict[str, Any] = {
            name: tuple(table[k] for k in left) for name, table in tables.items() if table
        }
        with suppress(ValueError):  # nobody left to see
            if graph.kind in ("edges", "directed"):
                made = rv.graphs.directed if graph.kind == "directed" else rv.graphs.from_matrix
                change["graph"] = made(graph.base_weights(n)[np.ix_(left, left)])
            yield {"n_robots": n - 1, **change}


def write(folder: Path, name: str, trial: Trial, played: Played) -> Path:
    """A violation as a scenario in NAME.toml, and how it is played in NAME.json.

    Where one team alone repeats it, its choices are written too, and its start becomes the
    scenario's.
    """
    assert played.violation is not None
    violation = played.violation
    alone = replace(trial, seed=trial.seed + violation.team)
    repeated = play(alone, teams=1, choices=violation.choices).violation
    choices = None
    if repeated is not None and repeated.number == violation.number:
        trial, violation, choices = alone, repeated, violation.choices.tolist()
    folder.mkdir(parents=True, exist_ok=True)
    trial.scenario.replace(name=name).to_toml(folder / f"{name}.toml")
    how = {
        **{name: getattr(trial, name) for name in _HOW},
        "teams": TEAMS if choices is None else 1,
        **{name: getattr(violation, name) for name in ("number", "found", "promised", "step")},
        "certificate": violation.words,
        "choices": choices,
    }
    (folder / f"{name}.json").write_text(json.dumps(how), encoding="utf-8")
    return folder / f"{name}.toml"


def repeat(path: Path) -> Played:
    """Play a violation again from the files of ``write``."""
    how = json.loads(path.with_suffix(".json").read_text(encoding="utf-8"))
    trial = Trial(rv.Scenario.from_toml(path), **{name: how[name] for name in _HOW})
    choices = None if how["choices"] is None else np.array(how["choices"])
    return play(trial, teams=how["teams"], choices=choices)
