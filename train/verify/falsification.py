"""One scenario, one certificate: adversaries play, and every number that it gives is checked.

Everything goes through what any user has: ``certificate``, the vector environment and its wrappers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

import baselines
import rendezvous_env as rv
from rendezvous_env import vector

from .wishes import Adversary

Array = NDArray[np.float64]

TEAMS = 12
"""Teams of one trial: one start or seeds side by side, adversaries of their own."""
MOST_STEPS = 400
"""Steps for which a time bound is waited for."""
FEW_STEPS = 60
"""Steps of trials whose time bound is out of reach."""
NUMBERS = ("time", "lyapunov", "hull", "link_growth", "descent", "nested", "links")
"""What is checked: all have met in time; V, L and how much longer links are than at the start stay
below their bounds; and in every step without a merge or a contact V falls, the hull is nested while
linked robots are r or more apart, and no link grows longer."""
_FLOAT32 = 2.0**-20
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

    theorem: str
    """Name of the theorem that was granted, empty if none was."""
    checked: tuple[str, ...] = ()
    """Which of NUMBERS were checked; "time" only if the bound was reached, or all met before."""
    steps: int = 0
    time_over_bound: float = math.nan
    violation: Violation | None = None


@dataclass(frozen=True)
class Promises:
    """What a certificate gives, as numbers that can fail; infinite or False: nothing."""

    time: float
    """s."""
    lyapunov: float
    """Of V, m²/s."""
    hull: float
    """Of L, m."""
    link_growth: float
    """m."""
    descent: bool
    """Whether V falls in every step without merge and contact."""
    nested: bool
    """Whether the hull is nested in them."""
    links: bool
    """Whether no link grows longer in them."""

    @property
    def any(self) -> bool:
        """Whether there is anything to check."""
        return any(self.given(name) for name in NUMBERS)

    def given(self, name: str) -> bool:
        """Whether one of NUMBERS is promised."""
        value = getattr(self, name)
        return value if isinstance(value, bool) else value < math.inf


def promises_of(found: rv.Certificate) -> Promises:
    """What of a certificate can be checked in the environment as it steps."""
    named, words = found.promises, found.theorem
    never_rises = "never rises between merges" in words
    return Promises(
        time=named.get("time", math.inf),
        lyapunov=named.get("lyapunov", math.inf),
        hull=named.get("hull", math.inf),
        link_growth=named.get("link_growth", math.inf),
        descent=found.by == "heading" and (found.guaranteed or never_rises),
        nested=found.by in ("law", "gains") and "the hull does not grow" in words,
        links=found.by == "links" and "no link grows longer" in words,
    )


def name_of(found: rv.Certificate) -> str:
    """Which theorem was granted, in short; empty for none."""
    if not found.guaranteed:
        return ""
    words = found.theorem.partition(":")[0].partition(" in continuous")[0]
    return f"{found.by}: {words.removeprefix('theorems ').removeprefix('theorem ')}"


def ask(scenario: rv.Scenario, by: str, arguments: dict[str, float]) -> rv.Certificate | None:
    """The certificate; None if the arguments are refused."""
    try:
        return rv.certificate(scenario, by=by, **arguments)
    except ValueError:
        return None


def play(trial: Trial, *, teams: int = TEAMS, choices: Array | None = None) -> Played:
    """Ask for the certificate, play, and hold every number against what happens.

    Args:
        trial: what is played.
        teams: how many teams, side by side.
        choices: (steps, n, k) of one team, instead of adversaries.

    Returns:
        What was granted and checked, and the first violation.
    """
    scenario = trial.scenario
    found = ask(scenario, trial.by, trial.arguments)
    if found is None or not (promises := promises_of(found)).any:
        return Played("")
    try:
        run = _Run(trial, found, promises, teams, choices)
    except (ValueError, RuntimeError):  # no room for a start, or a wrapper that refuses robots
        return Played(name_of(found))
    return run.to_end()


class _Run:
    """A trial that runs."""

    def __init__(
        self,
        trial: Trial,
        found: rv.Certificate,
        promises: Promises,
        teams: int,
        choices: Array | None,
    ) -> None:
        scenario = trial.scenario
        self.scenario, self.found, self.promises, self.given = scenario, found, promises, choices
        reach = math.ceil(min(promises.time / scenario.tau, 1e9)) + 1
        self.most = reach if reach <= MOST_STEPS else FEW_STEPS
        if choices is not None:
            self.most = max(len(choices), 1)
        self.env = rv.make_vec(
            scenario,
            num_envs=teams,
            autoreset_mode="Disabled",
            num_threads=1,
            max_cycles=trial.period * self.most + 1,
        )
        self.teams, self.by, self.period = self.env.simulator, trial.by, trial.period
        random = np.random.default_rng([trial.seed, 1])
        self.wrapped = _wrapped(self.env, trial, found)
        self.observations, _ = self.wrapped.reset(seed=trial.seed)
        self.policy: Callable[[], Any]
        if trial.by == "law":
            law = baselines.make(_LAWS.get(scenario.robot_model, "bearing-only"), scenario)
            self.policy = lambda: law(self.observations, self.teams.time)
        else:
            adversary = Adversary(scenario, teams, trial.by, random)
            self.policy = lambda: adversary(self.observations, self.teams)
        self.watch = _Watch(self)

    def to_end(self) -> Played:
        """Step until all have met, or the bound is reached, or something is violated."""
        kept: list[Any] = []
        steps = 0
        for steps in range(1, self.most + 1):
            if self.given is None:
                chosen = np.asarray(self.policy(), dtype=np.float32)
                kept.append(chosen)
            else:
                chosen = self.given[None, steps - 1].astype(np.float32)
            self.observations, *_, infos = self.wrapped.step(chosen)
            if wrong := self.watch.look(infos["contact"]):
                number, team, value, promised = wrong
                choices = self.given if self.given is not None else np.array(kept)[:, team]
                return self._played(
                    steps,
                    Violation(
                        number, team, steps, value, promised, self.found.theorem, np.array(choices)
                    ),
                )
            if self.watch.done:
                break
        return self._played(steps, None)

    def _played(self, steps: int, violation: Violation | None) -> Played:
        checked = self.watch.checked()
        return Played(name_of(self.found), checked, steps, self.watch.time_over_bound, violation)


def guarded(env: Any, by: str, arguments: Mapping[str, Any]) -> Any:
    """A vector environment under what keeps a guarantee; law (1) needs nothing."""
    return env if by == "law" else _WRAPPERS[by](env, **arguments)


def _wrapped(env: Any, trial: Trial, found: rv.Certificate) -> Any:
    """The environment under what keeps the guarantee, with the certificate's own numbers."""
    arguments: dict[str, Any] = dict(trial.arguments)
    if trial.by != "gains":
        arguments["bearing_error"] = found.bearing_error
    arguments |= {"frame": trial.frame, "decision_period": trial.period}
    return guarded(env, trial.by, arguments)


class _Watch:
    """What the certificate promises, held against every step."""

    def __init__(self, run: _Run) -> None:
        self.promises, self.teams, self.scenario = run.promises, run.teams, run.scenario
        scenario, teams = run.scenario, run.teams
        self.latest = teams.positions, teams.active, teams.lyapunov(), teams.weights
        self.along, self.held = directions(scenario.dim), run.period * scenario.tau
        places = self.latest[0]
        speed = max(scenario.speed_limit, scenario.max_degree)
        self.length_error = _FLOAT32 * speed * self.held + 1e-11 * float(np.abs(places).max())
        self.lyapunov_error, self.growth_error = np.zeros(teams.num_envs), 0.0
        self.free = np.ones(teams.num_envs, dtype=bool)
        self.met = np.full(teams.num_envs, np.inf)
        self.start = _distances(places)
        self.sight = math.inf if scenario.sensing.range is None else scenario.sensing.range
        self.lasting = (self.start <= self.sight - self.promises.link_growth) & (self.latest[3] > 0)

    @property
    def done(self) -> bool:
        """Whether there is nothing left to wait for."""
        return bool(self.teams.ended.all())

    @property
    def time_over_bound(self) -> float:
        """The worst of the teams that have met."""
        met = self.met[np.isfinite(self.met)]
        timed = len(met) and self.promises.time < math.inf
        return float(met.max() / self.promises.time) if timed else math.nan

    def checked(self) -> tuple[str, ...]:
        """Names of what was."""
        waited = np.isfinite(self.met) | (self.teams.time >= self.promises.time)
        names = [name for name in NUMBERS if self.promises.given(name)]
        return tuple(name for name in names if name != "time" or waited.all())

    def look(self, contact: NDArray[np.bool_]) -> tuple[str, int, float, float] | None:
        """The number that this step violates, the team, what was found and what was promised."""
        teams, promised, scenario = self.teams, self.promises, self.scenario
        places, active, before, weights = self.latest
        self.latest = teams.positions, teams.active, teams.lyapunov(), teams.weights
        now_at, left, now, _ = self.latest
        met = ~np.isfinite(self.met) & (left.sum(axis=-1) == 1)
        self.met[met] = teams.time[met]
        calm = (active == left).all(axis=-1) & ~contact.any(axis=-1)
        self.free &= ~contact.any(axis=-1)
        rounding = 1e-12 * before + (
            _FLOAT32 * scenario.n_robots * scenario.max_degree**2 * self.held
        )
        self.lyapunov_error += rounding
        self.growth_error += 2.0 * self.length_error
        # the step in which a bound falls may be finished
        late = np.where(np.isfinite(self.met), self.met, teams.time) - self.held
        was, apart = _distances(places), _distances(now_at)
        linked = (weights > 0) & (was <= self.sight) & active[:, None] & active[:, :, None]
        looks: dict[str, Callable[[], tuple[NDArray[Any], Array, Any]]] = {
            "time": lambda: (late >= 0, late, 1e-9 * promised.time),
            "lyapunov": lambda: (self.free, now, self.lyapunov_error + 1e-9 * promised.lyapunov),
            "hull": lambda: (late >= -np.inf, teams.size(), 8.0 * self.growth_error),
            "link_growth": lambda: (
                late >= -np.inf,
                np.max(apart - self.start, axis=(1, 2), where=self.lasting, initial=-np.inf),
                self.growth_error,
            ),
            "descent": lambda: (calm, now - before, rounding),
            "nested": lambda: (
                calm & (np.where(linked, was, np.inf) >= scenario.merge_radius).all(axis=(1, 2)),
                self._outgrown(places, active),
                self.length_error,
            ),
            "links": lambda: (
                calm,
                np.max(apart - was, axis=(1, 2), where=linked, initial=-np.inf),
                2.0 * self.length_error,
            ),
        }
        for name, look in looks.items():
            if promised.given(name):
                counts, found, error = look()
                most = 0.0 if name in ("descent", "nested", "links") else getattr(promised, name)
                if (wrong := counts & (found > most + error)).any():
                    team = int(np.argmax(np.where(wrong, found, -np.inf)))
                    return name, team, float(found[team]), most
        return None

    def _outgrown(self, places: Array, active: NDArray[np.bool_]) -> Array:
        """How far the hull reaches beyond what it was, (B,), m."""
        before = extents(places, active, self.along)
        after = extents(self.latest[0], self.latest[1], self.along)
        return np.asarray(np.max(after - before, axis=-1))


def _distances(places: Array) -> Array:
    """(B, n, n), m."""
    return np.asarray(np.linalg.norm(places[:, None] - places[:, :, None], axis=-1))


def extents(places: Array, active: NDArray[np.bool_], along: Array) -> Array:
    """Support max_i u·p_i of the robots that are there, for each direction u, (B, M), m."""
    reach = np.where(active[..., None], places @ along.T, -np.inf)
    return np.asarray(reach.max(axis=1))


def directions(dim: int, count: int = 48) -> Array:
    """Unit vectors all round, (M, d); in space on a spiral."""
    k = np.arange(count) + 0.5
    if dim == 2:
        return np.stack([np.cos(2 * np.pi * k / count), np.sin(2 * np.pi * k / count)], axis=-1)
    height, angle = 1.0 - 2.0 * k / count, np.pi * (1.0 + math.sqrt(5.0)) * k
    flat = np.sqrt(1.0 - height**2)
    return np.stack([flat * np.cos(angle), flat * np.sin(angle), height], axis=-1)
