"""One scenario, one certificate: adversaries play, and every number that it gives is checked.

Everything goes through what any user has: ``certificate``, the vector environment and its wrappers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import baselines
import rendezvous_env as rv
from rendezvous_env import vector
from rendezvous_env.safety.theorems.certificate import THEOREMS
from rendezvous_env.safety.theorems.theorem import Asked

from .adversarial_actions import Adversary
from .adversarial_bearings import Misled
from .monitors import BOUNDS, NUMBERS, REPEATED, Watch

Array = NDArray[np.float64]

TEAMS = 12
"""Teams of one trial: one start or seeds side by side, adversaries of their own."""
MOST_STEPS = 400
"""Steps for which a time bound is waited for."""
FEW_STEPS = 60
"""Steps of trials whose time bound is out of reach."""
_STEPWISE = {
    "V": "descent",
    "D": "ledger",
    "D, the bound on V": "ledger",
    "G": "nested",
    "G, the hull": "nested",
    "R": "links",
}
"""What theorems promise of every step, by one of NUMBERS."""
_ON_ERRORS = ("N", "N1", "N1'", "D", "R")
"""Theorems that are counted apart where bearings err."""
_LAWS = {"unicycle": "unicycle", "nonholonomic_3d": "nonholonomic-3d"}
_WRAPPERS: dict[str, Callable[..., Any]] = {
    "heading": vector.HeadingVectorWrapper,
    "tank": vector.EnergyTankWrapper,
    "gains": vector.GainWrapper,
    "links": vector.LinkKeepingWrapper,
}


@dataclass(frozen=True)
class Trial:
    """A scenario, what keeps the guarantee, and how it is played."""

    scenario: rv.Scenario
    by: str
    arguments: dict[str, float]
    """Of the certificate, and of the wrapper."""
    frame: str
    period: int
    """Base steps for which a choice is held."""
    seed: int
    """Team b has this seed + b; adversaries are drawn from it."""
    generations: int = 0
    """How often starts are bettered, see ``climb``."""


@dataclass(frozen=True)
class Violation:
    """A number of a certificate that does not hold."""

    number: str
    """One of NUMBERS."""
    team: int
    step: int
    found: float
    promised: float
    words: str
    choices: Array = field(repr=False)
    """Of the team, (steps, n, k)."""

    def __str__(self) -> str:
        """In one line."""
        return (
            f"{self.number} is {self.found:.6g}, promised {self.promised:.6g}, in step {self.step} "
            f"of team {self.team}: {self.words}"
        )


@dataclass(frozen=True)
class Played:
    """What came of a trial."""

    granted: dict[str, tuple[str, ...]] = field(default_factory=dict)
    """The theorems that applied, and which of their NUMBERS were checked; "time" only if the bound
    was reached, or all met before."""
    steps: int = 0
    time_over_bound: float = math.nan
    violation: Violation | None = None
    closeness: dict[str, Array] = field(default_factory=dict, repr=False)
    """How near each team came to break each number, (B,)."""


class Promised(NamedTuple):
    """What a certificate gives, as numbers that can fail."""

    limits: dict[str, float]
    """By one of NUMBERS; 0 for what each step keeps."""
    theorems: dict[str, tuple[str, ...]]
    """What each theorem that applies has a part in."""
    bearing_error: float
    """rad."""
    words: str


def ask(scenario: rv.Scenario, by: str, arguments: Mapping[str, float]) -> Promised:
    """What is promised; nothing if the arguments are refused."""
    try:
        found = rv.certificate(scenario, by=by, **arguments)
    except ValueError:
        return Promised({}, {}, 0.0, "")
    asked = Asked(
        by,
        found.min_alignment,
        arguments.get("budget", 0.0),
        arguments.get("min_gain"),
        arguments.get("max_gain"),
        arguments.get("share", 0.5),
        found.bearing_error,
    )
    theorems, limits = {}, dict(found.promises)
    for theorem in THEOREMS:
        if by not in theorem.by or theorem.unmet(scenario, asked)[1]:
            continue
        bounds = theorem.bounds(scenario, asked)
        own = [name for name in BOUNDS if getattr(bounds, name) < math.inf and name in limits]
        if theorem.name in _STEPWISE:
            own.append(_STEPWISE[theorem.name])
            limits[own[-1]] = 0.0
        if own:
            wrong = ", η > 0" * (found.bearing_error > 0 and theorem.name in _ON_ERRORS)
            beside = ", obstacles" * (theorem.name == "R" and bool(scenario.obstacles))
            theorems[f"{by}: {theorem.name}{wrong}{beside}"] = tuple(own)
    return Promised(limits, theorems, found.bearing_error, found.theorem)


def play(
    trial: Trial,
    *,
    teams: int = TEAMS,
    choices: Array | None = None,
    starts: Sequence[Array] | None = None,
) -> Played:
    """Ask for the certificate, play, and hold every number against what happens.

    Args:
        trial: what is played.
        teams: how many teams, side by side.
        choices: (steps, n, k) of one team, instead of adversaries.
        starts: (n, d) of each team, m, instead of the scenario's, with certificates of their own.

    Returns:
        What was granted and checked, and the first violation.
    """
    scenarios = [trial.scenario]
    if starts is not None:
        scenarios = [trial.scenario.replace(start_positions=start) for start in starts]
    promised = [ask(scenario, trial.by, trial.arguments) for scenario in scenarios]
    if not any(one.limits for one in promised):
        return Played()
    if "expected_time" in promised[0].limits and teams == TEAMS and starts is None:
        teams = REPEATED
    try:
        run = _Run(trial, promised, teams if starts is None else len(starts), choices, starts)
    except (ValueError, RuntimeError):  # no room for a start, or a wrapper that refuses robots
        return Played()
    return run.to_end()


class _Run:
    """A trial that runs."""

    def __init__(
        self,
        trial: Trial,
        promised: Sequence[Promised],
        teams: int,
        choices: Array | None,
        starts: Sequence[Array] | None,
    ) -> None:
        scenario = trial.scenario
        self.promised, self.given = promised, choices
        limits = {
            name: np.array([one.limits.get(name, math.inf) for one in promised])
            for name in NUMBERS
            if any(name in one.limits for one in promised)
        }
        times = [limits[name].min() for name in ("time", "expected_time") if name in limits]
        reach = math.ceil(min([*times, 1e9]) / (scenario.tau * trial.period)) + 1
        self.most = reach if reach <= MOST_STEPS else FEW_STEPS
        if choices is not None:
            self.most = max(len(choices), 1)
        env = rv.make_vec(
            scenario,
            num_envs=teams,
            autoreset_mode="Disabled",
            num_threads=1,
            max_cycles=trial.period * self.most + 1,
        )
        arguments: dict[str, Any] = dict(trial.arguments)
        error = arguments.pop("bearing_error", 0.0)
        arguments |= {"frame": trial.frame, "decision_period": trial.period}
        if trial.by != "gains":
            arguments["bearing_error"] = promised[0].bearing_error
        random = np.random.default_rng([trial.seed, 1])
        # what the sensor itself does not do
        seen = Misled(env, scenario, error, random) if error > scenario.sensing.error else env
        self.wrapped = guarded(seen, trial.by, arguments)
        options = None if starts is None else {"positions": np.array(starts)}
        self.observations, _ = self.wrapped.reset(seed=trial.seed, options=options)
        self.teams = env.simulator
        self.policy: Callable[[], Any]
        if trial.by == "law":
            law = baselines.make(_LAWS.get(scenario.robot_model, "bearing-only"), scenario)
            self.policy = lambda: law(self.observations, self.teams.time)
        else:
            adversary = Adversary(scenario, teams, trial.by, random)
            self.policy = lambda: adversary(self.observations, self.teams)
        self.watch = Watch(self.teams, limits, trial.period, trial.arguments.get("budget", 0.0))

    def to_end(self) -> Played:
        """Step until all have met, or the bound is reached, or something is violated."""
        kept: list[Any] = []
        watch, wrong = self.watch, None
        while wrong is None and len(kept) < self.most and not self.teams.ended.all():
            if self.given is None:
                chosen = np.asarray(self.policy(), dtype=np.float32)
            else:
                chosen = self.given[None, len(kept)].astype(np.float32)
            kept.append(chosen)
            self.observations, *_, infos = self.wrapped.step(chosen)
            wrong = watch.look(infos)
        wrong = wrong or watch.look_at_mean()
        checked = watch.checked()
        theorems = {name: own for one in self.promised for name, own in one.theorems.items()}
        violation = None
        if wrong is not None:
            number, team, found, limit = wrong
            words = self.promised[team % len(self.promised)].words
            own = np.array(kept)[:, team]
            violation = Violation(number, team, len(kept), found, limit, words, own)
        return Played(
            {name: tuple(n for n in own if n in checked) for name, own in theorems.items()},
            len(kept),
            watch.time_over_bound,
            violation,
            watch.closeness,
        )


def guarded(env: Any, by: str, arguments: Mapping[str, Any]) -> Any:
    """A vector environment under what keeps a guarantee; law (1) needs nothing."""
    return env if by == "law" else _WRAPPERS[by](env, **arguments)


# ---- an optimiser over starts --------------------------------------------------------------------

_PARENTS = 3
_STRIDES = (1e-3, 3.0)
"""By how much a start is changed, in units of r."""


def climb(trial: Trial) -> tuple[Trial, Played]:
    """Look for a start from which something is violated: play the trial from its own start, and
    ``trial.generations`` times from changes of those that came nearest to break one of its numbers.

    Returns:
        The trial, with the start of what was found; and what came of it, of all generations.
    """
    played = play(trial)
    if played.violation is not None or not played.granted or not trial.generations:
        return trial, played
    random, radius = np.random.default_rng([trial.seed, 2]), trial.scenario.merge_radius
    number = str(random.choice(list(played.closeness)))
    parents = [(-math.inf, start) for start in _own_starts(trial)]
    for _ in range(trial.generations):
        starts: list[Array] = []
        for k in range(4 * TEAMS):
            stride = radius * math.exp(random.uniform(*np.log(_STRIDES)))
            place = parents[k % len(parents)][1]
            moved = np.arange(len(place)) == random.integers(len(place))  # one robot, or all
            moved |= random.random() < 0.5
            start = place + stride * random.normal(size=place.shape) * moved[:, None]
            if _possible(trial.scenario, start) and len(starts) < TEAMS:
                starts.append(start)
        if not starts:
            break
        found = play(trial, starts=starts)
        if found.violation is not None:
            own = trial.scenario.replace(start_positions=starts[found.violation.team])
            return replace(trial, scenario=own), found
        if number in found.closeness:
            parents += zip(found.closeness[number].tolist(), starts, strict=True)
            parents = sorted(parents, key=lambda one: -one[0])[:_PARENTS]
    return trial, played


def _own_starts(trial: Trial) -> list[Array]:
    """The scenario's start, or some that it draws."""
    if trial.scenario.start_positions is not None:
        return [np.array(trial.scenario.start_positions)]
    drawn = rv.Simulator(trial.scenario, _PARENTS, num_threads=1)
    drawn.reset(trial.seed)
    return list(drawn.positions)


def _possible(scenario: rv.Scenario, start: Array) -> bool:
    try:
        scenario.replace(start_positions=start)
    except ValueError:
        return False
    return True
