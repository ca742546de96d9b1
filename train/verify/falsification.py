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

from .misled import Misled
from .wishes import Adversary

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

TEAMS = 12
"""Teams of one trial: one start or seeds side by side, adversaries of their own."""
_REPEATED = 48
"""Teams of a trial whose mean time is promised."""
MOST_STEPS = 400
"""Steps for which a time bound is waited for."""
FEW_STEPS = 60
"""Steps of trials whose time bound is out of reach."""
BOUNDS = ("time", "lyapunov", "hull", "link_growth", "expected_time")
"""All have met in time; V, L and how much longer links are than at the start stay below their
bounds; the mean time of many teams does."""
_STEPWISE = {
    "V": "descent",
    "D": "ledger",
    "D, the bound on V": "ledger",
    "G": "nested",
    "G, the hull": "nested",
    "R": "links",
}
"""What theorems promise of every step without a merge or a contact: V falls; V + ΣA does; the hull
is nested while linked robots are r or more apart; no link grows longer."""
_ON_ERRORS = ("N", "N1", "N1'", "D", "R")
"""Theorems that are counted apart where bearings err."""
NUMBERS = (*BOUNDS, "descent", "ledger", "nested", "links")
_FLOAT32 = 2.0**-20
_NEARLY = 0.9
"""Share of the bound on L from which L is measured exactly; a few directions are quicker."""
_CONFIDENCE = 5.0
"""Standard errors by which a mean may lie above its bound."""
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
        teams = _REPEATED
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
        self.watch = _Watch(self.teams, trial, limits)

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


class _Watch:
    """What certificates promise, held against every step."""

    def __init__(self, teams: rv.Simulator, trial: Trial, limits: dict[str, Array]) -> None:
        self.teams, self.limits = teams, limits
        self.scenario = scenario = trial.scenario
        self.latest = teams.positions, teams.active, teams.lyapunov(), teams.weights
        self.along, self.held = directions(scenario.dim), trial.period * scenario.tau
        self.levels = np.full(
            teams.num_envs, scenario.n_robots * trial.arguments.get("budget", 0.0)
        )
        places = self.latest[0]
        speed = max(scenario.speed_limit, scenario.max_degree)
        self.length_error = _FLOAT32 * speed * self.held + 1e-11 * float(np.abs(places).max())
        self.lyapunov_error, self.growth_error = np.zeros(teams.num_envs), 0.0
        self.free = np.ones(teams.num_envs, dtype=bool)
        self.met = np.full(teams.num_envs, np.inf)
        self.start, self.scale = _distances(places), np.maximum(self.latest[2], 1e-300)
        sensing = scenario.sensing
        self.sight = math.inf if sensing.range is None else sensing.range
        growth = limits.get("link_growth", np.full(1, math.inf))[:, None, None]
        self.lasting = (self.start + growth <= self.sight) & (self.latest[3] > 0)
        self.closeness = {name: np.full(teams.num_envs, -np.inf) for name in limits}

    @property
    def time_over_bound(self) -> float:
        """The worst of the teams that have met."""
        met = np.isfinite(self.met)
        limit = np.broadcast_to(self.limits.get("time", np.inf), met.shape)
        ratio = self.met[met] / limit[met]
        return float(ratio.max()) if ratio.any() else math.nan

    def checked(self) -> tuple[str, ...]:
        """Names of what was."""
        names = []
        for name, limit in self.limits.items():
            waited = np.isfinite(self.met) | (self.teams.time >= limit)
            if name not in ("time", "expected_time") or waited.all():
                names.append(name)
        return tuple(names)

    def look(self, infos: Mapping[str, Any]) -> tuple[str, int, float, float] | None:
        """The number that this step violates, the team, what was found and what was promised."""
        teams, scenario = self.teams, self.scenario
        places, active, before, weights = self.latest
        self.latest = teams.positions, teams.active, teams.lyapunov(), teams.weights
        now_at, left, now, _ = self.latest
        met = ~np.isfinite(self.met) & (left.sum(axis=-1) == 1)
        self.met[met] = teams.time[met]
        touched = infos["contact"].any(axis=-1)
        calm = (active == left).all(axis=-1) & ~touched
        self.free &= ~touched
        degree, n = scenario.max_degree, scenario.n_robots
        rounding = 1e-12 * before + _FLOAT32 * n * degree**2 * self.held
        self.lyapunov_error += rounding
        self.growth_error += 2.0 * self.length_error
        # the step in which a bound falls may be finished
        late = np.where(np.isfinite(self.met), self.met, teams.time) - self.held
        was, apart = _distances(places), _distances(now_at)
        linked = (weights > 0) & (was <= self.sight) & active[:, None] & active[:, :, None]

        def hull() -> tuple[Array, Array | float]:
            reach = extents(now_at, left, self.along).mean(axis=-1)
            around = 2.0 * np.pi * (scenario.dim - 1.0) * reach
            if (around > _NEARLY * self.limits["hull"]).any():
                around = teams.size()
            return around, 8.0 * self.growth_error

        def ledger() -> tuple[Array, Array]:
            latest, self.levels = self.levels, infos["tank"].sum(axis=-1)
            fast = max(1.0, scenario.speed_limit / degree) ** 2
            steep = max(1.0, 2.0 * degree * self.held / scenario.merge_radius)
            risen = now + self.levels - before - latest
            return np.where(calm, risen, -np.inf), rounding * fast * steep + 1e-12 * latest

        def nested() -> tuple[Array, Array | float]:
            wide = (np.where(linked, was, np.inf) >= scenario.merge_radius).all(axis=(1, 2))
            grown = extents(now_at, left, self.along) - extents(places, active, self.along)
            return np.where(calm & wide, grown.max(axis=-1), -np.inf), self.length_error

        def longer() -> tuple[Array, Array | float]:
            grown = np.max(apart - was, axis=(1, 2), where=linked, initial=-np.inf)
            return np.where(calm, grown, -np.inf), 2.0 * self.length_error

        looks: dict[str, Callable[[], tuple[Array, Array | float]]] = {
            "time": lambda: (late, 1e-9 * self.limits["time"]),
            "lyapunov": lambda: (
                np.where(self.free, now, -np.inf),
                self.lyapunov_error + 1e-9 * self.limits["lyapunov"],
            ),
            "hull": hull,
            "link_growth": lambda: (
                np.max(apart - self.start, axis=(1, 2), where=self.lasting, initial=-np.inf),
                self.growth_error,
            ),
            "descent": lambda: (np.where(calm, now - before, -np.inf), rounding),
            "ledger": ledger,
            "nested": nested,
            "links": longer,
        }
        for name, look in looks.items():
            if name not in self.limits:
                continue
            found, error = look()
            limit = np.broadcast_to(self.limits[name], found.shape)
            if (wrong := found > limit + error).any():
                team = int(np.argmax(np.where(wrong, found, -np.inf)))
                return name, team, float(found[team]), float(limit[team])
            unit = limit if name in BOUNDS else self.scale
            near = np.divide(found, unit, out=np.zeros(found.shape), where=np.isfinite(limit))
            np.maximum(self.closeness[name], near, out=self.closeness[name])
        return None

    def look_at_mean(self) -> tuple[str, int, float, float] | None:
        """Whether the mean time is surely above its bound; who has not met counts as if now."""
        if "expected_time" not in self.limits or len(self.met) < _REPEATED:
            return None
        limit, times = float(self.limits["expected_time"][0]), np.minimum(self.met, self.teams.time)
        mean = float(times.mean())
        sure = mean - _CONFIDENCE * float(times.std(ddof=1)) / math.sqrt(len(times))
        return ("expected_time", 0, mean, limit) if sure - self.held > limit else None


def _distances(places: Array) -> Array:
    """(B, n, n), m."""
    return np.asarray(np.linalg.norm(places[:, None] - places[:, :, None], axis=-1))


def extents(places: Array, active: Mask, along: Array) -> Array:
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
            team = found.violation.team
            own = trial.scenario.replace(start_positions=starts[team])
            return replace(trial, scenario=own, seed=trial.seed + team), found
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
