"""One scenario, one certificate: adversaries play, and every number that it gives is checked.

Everything goes through what any user has: certificates, the vector environment and its wrappers.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import baselines
import rendezvous_env as rv
from rendezvous_env import vector
from rendezvous_env.safety.theorems.certificate import answer, question
from rendezvous_env.safety.theorems.certificate import ask as theorems_of

from .adversarial_actions import Adversary
from .adversarial_bearings import Misled
from .monitors import BOUNDS, NUMBERS, REPEATED, Moment, Watch

Array = NDArray[np.float64]
Policy = Callable[[Any, Moment], Any]

TEAMS = 12
"""Teams of one trial: one start or seeds side by side, adversaries of their own."""
MOST_STEPS = 400
"""Steps for which a time bound is waited for."""
FEW_STEPS = 8, 80
"""Least and most steps of trials whose time bound is out of reach, most of them short."""
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
    given = dict(arguments)
    error = given.pop("bearing_error", 0.0)
    try:
        asked = question(scenario, by, given, error)
    except ValueError:
        return Promised({}, {}, 0.0, "")
    applies, words = theorems_of(scenario, asked)
    theorems, limits = {}, answer(scenario, asked, applies, words).promises
    for theorem, bounds in applies:
        own = [name for name in BOUNDS if getattr(bounds, name) < math.inf and name in limits]
        if theorem.every_step:
            own.append(theorem.every_step)
            limits[own[-1]] = 0.0
        if own:
            where = ", in 3-D" * (scenario.dim == 3) + ", η > 0" * (asked.error > 0)
            where += ", obstacles" * (theorem.name == "R" and bool(scenario.obstacles))
            theorems[f"{by}: {theorem.name}{where}"] = tuple(own)
    return Promised(limits, theorems, asked.error, words)


def play(
    trial: Trial,
    *,
    teams: int = TEAMS,
    choices: Array | None = None,
    among: Sequence[rv.Scenario] = (),
) -> Played:
    """Ask for the certificate, play, and hold every number against what happens.

    Args:
        trial: what is played.
        teams: how many teams, side by side.
        choices: (steps, n, k) of one team, instead of adversaries.
        among: the scenario from other starts, which take turns among the teams, with
            certificates of their own.

    Returns:
        What was granted and checked, and the first violation.
    """
    promised = [ask(one, trial.by, trial.arguments) for one in among or (trial.scenario,)]
    if not any(one.limits for one in promised):
        return Played()
    if "expected_time" in promised[0].limits and teams == TEAMS and not among:
        teams = REPEATED
    try:
        wrapped, start, policy = _begin(trial, promised[0].bearing_error, teams, among)
    except (ValueError, RuntimeError):  # no room for a start, or a wrapper that refuses robots
        return Played()
    return _to_end(trial, promised, wrapped, start, policy, choices)


def _begin(
    trial: Trial, bearing_error: float, count: int, among: Sequence[rv.Scenario]
) -> tuple[Any, Any, Policy]:
    """So many teams under what keeps the guarantee, what they see first, and who chooses."""
    scenario, arguments = trial.scenario, dict[str, Any](trial.arguments)
    env = _teams_of(scenario, count)
    error = arguments.pop("bearing_error", 0.0)
    arguments |= {"frame": trial.frame, "decision_period": trial.period}
    if trial.by != "gains":
        arguments["bearing_error"] = bearing_error
    # what the sensor itself does not do
    seen = Misled(env, scenario, error, trial.seed) if error > scenario.sensing.error else env
    wrapped = guarded(seen, trial.by, arguments)
    options = None
    if among:
        places = np.array([one.start_positions for one in among])
        options = {"positions": places[np.arange(count) % len(among)]}
    start = wrapped.reset(seed=trial.seed, options=options)[0]
    if trial.by != "law":
        return (
            wrapped,
            start,
            Adversary(scenario, count, trial.by, np.random.default_rng([trial.seed, 1])),
        )
    law = baselines.make(_LAWS.get(scenario.robot_model, "bearing-only"), scenario)
    return wrapped, start, lambda seen, now: law(seen, now.time)


@lru_cache(maxsize=2)
def _teams_of(scenario: rv.Scenario, count: int) -> Any:
    """Teams that are reset for each choice and start."""
    return rv.make_vec(scenario, num_envs=count, autoreset_mode="Disabled", num_threads=1)


def _to_end(
    trial: Trial,
    promised: Sequence[Promised],
    wrapped: Any,
    observations: Any,
    policy: Policy,
    choices: Array | None,
) -> Played:
    """Step until all have met, or the bound is reached, or something is violated."""
    teams, per_step = wrapped.unwrapped.simulator, trial.scenario.tau * trial.period
    limits = {
        name: np.resize([one.limits.get(name, math.inf) for one in promised], teams.num_envs)
        for name in NUMBERS
        if any(name in one.limits for one in promised)
    }
    times = [limits[name].min() for name in ("time", "expected_time") if name in limits]
    reach = math.ceil(min([*times, 1e9]) / per_step) + 1
    most = reach
    if reach > MOST_STEPS:
        random = np.random.default_rng([trial.seed, 4])
        most = round(math.exp(random.uniform(*np.log(FEW_STEPS))))
    if choices is not None:
        most = max(len(choices), 1)
    teams.set_max_steps(trial.period * most + 1)
    budget, climbing = trial.arguments.get("budget", 0.0), trial.generations > 0
    watch = Watch(teams, limits, trial.period, budget, climbing)
    kept: list[Any] = []
    wrong = None
    while wrong is None and len(kept) < most and not teams.ended.all():
        chosen = policy(observations, watch.now) if choices is None else choices[None, len(kept)]
        kept.append(np.asarray(chosen, dtype=np.float32))
        observations, *_, infos = wrapped.step(kept[-1])
        wrong = watch.look(infos)
    checked, violation = watch.checked(), None
    if wrong := wrong or watch.look_at_mean():
        number, team, found, limit = wrong
        words, own = promised[team % len(promised)].words, np.array(kept)[:, team]
        violation = Violation(number, team, len(kept), found, limit, words, own)
    granted = {
        name: tuple(number for number in own if number in checked)
        for one in promised
        for name, own in one.theorems.items()
    }
    return Played(granted, len(kept), watch.time_over_bound, violation, watch.closeness)


def guarded(env: Any, by: str, arguments: Mapping[str, Any]) -> Any:
    """A vector environment under what keeps a guarantee; law (1) needs nothing."""
    return env if by == "law" else _WRAPPERS[by](env, **arguments)


# ---- an optimiser over starts --------------------------------------------------------------------

_STARTS, _PARENTS = 6, 3
"""Starts of a generation, and those that it is made from."""
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
    random = np.random.default_rng([trial.seed, 2])
    number = str(random.choice(list(played.closeness)))
    parents = [(-math.inf, start) for start in _own_starts(trial)]
    for _ in range(trial.generations):
        starts: list[Array] = []
        among: list[rv.Scenario] = []
        for k in range(4 * _STARTS):
            start = _moved(random, parents[k % len(parents)][1], trial.scenario.merge_radius)
            with suppress(ValueError):  # not a start
                among.append(trial.scenario.replace(start_positions=start))
                starts.append(start)
            if len(among) == _STARTS:
                break
        if not among:
            break
        found = play(trial, among=among)
        if found.violation is not None:
            return replace(trial, scenario=among[found.violation.team % len(among)]), found
        if number in found.closeness:
            near = found.closeness[number].tolist()
            parents += zip(near, itertools.cycle(starts), strict=False)
            parents = sorted(parents, key=lambda one: -one[0])[:_PARENTS]
    return trial, played


def _moved(random: np.random.Generator, place: Array, radius: float) -> Array:
    """A start from which one robot has been moved, or all."""
    stride = radius * math.exp(random.uniform(*np.log(_STRIDES)))
    which = np.arange(len(place)) == random.integers(len(place))
    which |= random.random() < 0.5
    return np.asarray(place + stride * random.normal(size=place.shape) * which[:, None])


def _own_starts(trial: Trial) -> list[Array]:
    """The scenario's start, or some of those that have just been played."""
    if trial.scenario.start_positions is not None:
        return [np.array(trial.scenario.start_positions)]
    drawn = _teams_of(trial.scenario, TEAMS).simulator
    drawn.reset(trial.seed)
    return list(drawn.positions[:_PARENTS])
