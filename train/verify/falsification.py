"""Falsification of one certificate: adversarial episodes, checks of every bound, shrinking.

Only the public interface is used: certificates, the vector environment and its wrappers.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from heapq import nlargest
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rendezvous_env.baselines.laws.paper_laws import LAW_OF_MODEL

import rendezvous_env as rv
from rendezvous_env import baselines, vector
from rendezvous_env.safety.settings import MAX_TURN_RATE
from rendezvous_env.safety.theorems.certificate import answer, question
from rendezvous_env.safety.theorems.theorem import PROMISED
from rendezvous_env.trajectory import begin as begin_policy

from .. import policies
from .adversaries import Adversary, Misled
from .monitors import NUMBERS, REPEATED, SEARCHED, BatchMoment, Monitor
from .random_scenarios import Trial, other_starts

Array = NDArray[np.float64]
Policy = Callable[[Any, BatchMoment], Any]

TEAMS = 24
"""Number of environments per trial, divided evenly between initial conditions."""
MAX_STEPS = 400  # maximum number of steps to a time bound
MAX_MEAN_STEPS = 1000
"""Steps for which environments are simulated until they meet, if a mean time is bounded."""
PATIENT_STEPS = 1000
"""Steps of a trial of a policy, besides those that a deadlock has to last."""
FEW_STEPS = 8, 80
"""Minimum and maximum number of steps of trials whose time bound cannot be reached."""
_PARENTS = 3  # initial conditions from which the next generation is made
_LAWS = {**LAW_OF_MODEL, "mixed": "by-model"}
_HOW = ("by", "arguments", "frame", "period", "seed", "policy", "numbers")
"""Fields of a trial that are written in addition to its scenario."""


@dataclass(frozen=True)
class Violation:
    """A violated bound of a certificate."""

    number: str  # one of NUMBERS
    team: int
    step: int
    found: float
    promised: float
    words: str
    choices: Array = field(repr=False)  # of the environment, (steps, n, k)

    def __str__(self) -> str:
        return (
            f"{self.number} is {self.found:.6g}, bound {self.promised:.6g}, in step {self.step} "
            f"of environment {self.team}: {self.words}"
        )


@dataclass
class Tally:
    """Accumulated results of trials, for a claim or for all theorems."""

    trials: int = 0
    seconds: float = 0.0
    steps: int = 0
    margin: float = math.inf  # of a claim, the worst; negative is a violation, up to rounding
    violations: int = 0
    first: int | None = None  # the first batch of a claim with a violation
    counts: Counter[tuple[str, str]] = field(default_factory=Counter)
    """Counts by theorem: initial conditions with a certificate ("granted"), checks of each of
    NUMBERS ("time" only if the bound was reached or all met before), and "violations"."""
    ratio: dict[str, float] = field(default_factory=dict)  # the worst T/bound of each
    found: list[tuple[int, Trial, TrialResult]] = field(default_factory=list)
    """Violations: trial index, trial as sampled, and result."""

    def join(self, other: Tally) -> None:
        """Add the counts of another tally."""
        for name in ("trials", "seconds", "steps", "violations", "found"):
            setattr(self, name, getattr(self, name) + getattr(other, name))
        self.margin = min(self.margin, other.margin)
        self.first = min((k for k in (self.first, other.first) if k is not None), default=None)
        self.counts.update(other.counts)
        for name, ratio in other.ratio.items():
            self.ratio[name] = max(self.ratio.get(name, 0.0), ratio)


@dataclass
class TrialResult(Tally):
    """Result of a trial."""

    violation: Violation | None = None
    closeness: dict[str, Array] = field(default_factory=dict, repr=False)  # see ``Watch``, (B,)
    began: Array = field(default_factory=lambda: np.empty((0, 0, 0)), repr=False)  # (B, n, d), m


class Promised(NamedTuple):
    """Bounds of a certificate as numbers that can be violated."""

    limits: dict[str, float]  # by one of NUMBERS; 0 for properties of each step
    theorems: dict[str, tuple[str, ...]]  # numbers of each applicable theorem
    bearing_error: float  # rad
    words: str


def ask(scenario: rv.Scenario, by: str, arguments: Mapping[str, float]) -> Promised:
    """Bounds of the certificate; none if the arguments are refused."""
    given = dict(arguments)
    error = given.pop("bearing_error", 0.0)
    try:
        asked = question(scenario, by, given, error)
    except ValueError:
        return Promised({}, {}, 0.0, "")
    found, applies = answer(scenario, asked)
    theorems, limits = {}, found.promises
    for theorem, bounds in applies:
        own = [name for name in PROMISED if getattr(bounds, name) < math.inf and name in limits]
        if theorem.every_step:
            own.append(theorem.every_step)
            limits[own[-1]] = 0.0
        if own:
            where = ", in 3-D" * (scenario.dim == 3) + ", η > 0" * (asked.error > 0)
            where += ", obstacles" * (theorem.name == "R" and bool(scenario.obstacles))
            theorems[f"{by}: {theorem.name}{where}"] = tuple(own)
    return Promised(limits, theorems, asked.error, found.theorem)


def searched(scenario: rv.Scenario, numbers: tuple[str, ...]) -> Promised:
    """Properties to falsify without a certificate: V and hull never increase, no deadlock.

    A deadlock is a time without progress longer than ``patience_of(scenario)``.
    """
    limits = {name: 0.0 for name in numbers}
    if "deadlock" in limits:
        limits["deadlock"] = patience_of(scenario)
    words = "no certificate covers this policy"
    return Promised(limits, {"policy": numbers}, 0.0, words)


def patience_of(scenario: rv.Scenario) -> float:
    """Time without progress that counts as a deadlock, s.

    The largest of 200 steps, in which law (1) moves far; n r/a*, in which its slowest robot crosses
    half a merge radius; and two turns of the body.
    """
    n, least = scenario.n_robots, scenario.bottleneck_weight
    slow = n * scenario.merge_radius / least if least > 0.0 else 0.0
    turning = 4.0 * math.pi / scenario.min_turn_limit if scenario.model.nonholonomic else 0.0
    return max(200.0 * scenario.tau, slow, turning)


def start_of(teams: int, starts: int) -> NDArray[np.int64]:
    """Index of the initial condition of each environment, (B,)."""
    return np.arange(teams) * starts // teams


def begin(trial: Trial, bearing_error: float, count: int) -> tuple[Any, Any, Policy]:
    """Environments under the safety filter, first observations, and the acting policy."""
    scenario, arguments = trial.scenario, dict[str, Any](trial.arguments)
    env = _teams_of(scenario, count)
    error = arguments.pop("bearing_error", 0.0)
    arguments |= {"frame": trial.frame, "decision_period": trial.period}
    if trial.by not in ("gains", "policy"):
        arguments["bearing_error"] = bearing_error
    # errors beyond those of the sensor
    beyond = error > scenario.sensing.largest("error")
    seen = Misled(env, scenario, error, trial.seed) if beyond else env
    wrapped = guarded(seen, trial.by, arguments)
    options = None
    if trial.starts:
        places = np.array([one.start_positions for one in trial.starts])
        options = {"positions": places[start_of(count, len(places))]}
    start = wrapped.reset(seed=trial.seed, options=options)[0]
    if trial.by == "policy":
        own = policies.make(trial.policy, scenario)
        begin_policy(own, wrapped.unwrapped.simulator)
        return wrapped, start, partial(policies.called, trial.policy, own)
    if trial.by == "law":
        law = baselines.make(_LAWS.get(scenario.model.name, "bearing-only"), scenario)
        return wrapped, start, lambda seen, now: law(seen, now.time)
    random = np.random.default_rng([trial.seed, 1])
    turn_rate = arguments.get("max_turn_rate", MAX_TURN_RATE)
    adversary = Adversary(scenario, count, trial.by, random, turn_rate)
    if trial.frame == "local" or trial.by == "gains" or not wrapped.filter.along_net_bearing:
        return wrapped, start, adversary

    def as_seen(seen: Any, now: BatchMoment) -> Array:
        """Adversarial actions in the frames with x along f."""
        frames = wrapped.filter.get_state()["frames"]
        return np.einsum("bnij,bni->bnj", frames, np.asarray(adversary(seen, now)))

    return wrapped, start, as_seen


@lru_cache(maxsize=2)
def _teams_of(scenario: rv.Scenario, count: int) -> Any:
    """Simulated environments, reset for each filter and initial condition."""
    return rv.make_vec(scenario, num_envs=count, autoreset_mode="Disabled", num_threads=1)


def guarded(env: Any, by: str, arguments: Mapping[str, Any]) -> Any:
    """Vector environment under a safety filter; law (1) needs none."""
    return env if by in ("law", "policy") else vector.GuaranteeWrapper(env, by, **arguments)


def play(trial: Trial, *, teams: int = TEAMS, choices: Array | None = None) -> TrialResult:
    """Request the certificates, simulate a batch of environments and check every bound.

    It ends at a violation, or when every environment has met or reached its bound, if that is
    feasible. ``choices``, (steps, n, k), replace the adversaries for a single environment.
    """
    among = trial.starts or (trial.scenario,)
    if trial.by == "policy":
        promised = [searched(one, trial.numbers) for one in among]
    else:
        promised = [ask(one, trial.by, trial.arguments) for one in among]
    if not any(one.limits for one in promised):
        return TrialResult()
    if any("expected_time" in one.limits for one in promised) and teams == TEAMS:
        teams = REPEATED * len(among)
    try:
        wrapped, observations, policy = begin(trial, promised[0].bearing_error, teams)
    except (ValueError, RuntimeError):  # no initial condition, or a wrapper that rejects the robots
        return TrialResult()
    simulator, which = wrapped.unwrapped.simulator, start_of(teams, len(among))
    limits = {
        name: np.array([one.limits.get(name, math.inf) for one in promised])[which]
        for name in dict.fromkeys((*NUMBERS, *SEARCHED))
        if any(name in one.limits for one in promised)
    }
    last = _last_steps(trial, limits) if choices is None else np.full(teams, len(choices))
    simulator.set_max_steps(trial.period * int(last.max()) + 1)
    watch = Monitor(wrapped.unwrapped, limits, trial.period, trial.arguments.get("budget", 0.0))
    kept: list[Any] = []
    wrong, began = None, watch.now.positions
    while wrong is None and ((last > len(kept)) & ~simulator.ended).any():
        chosen = policy(observations, watch.now) if choices is None else choices[None, len(kept)]
        kept.append(np.asarray(chosen, dtype=np.float32))
        observations, *_, infos = wrapped.step(kept[-1])
        _, wrong = watch.look(infos)
    played = TrialResult(steps=len(kept), closeness=watch.closeness, began=began)
    for k, one in enumerate(promised):
        checked = {"granted", *watch.checked(which == k)}
        for name, own in one.theorems.items():
            played.counts.update((name, what) for what in checked.intersection(("granted", *own)))
    if not math.isnan(ratio := watch.time_over_bound):
        played.ratio = {name: ratio for name, what in played.counts if what == "time"}
    if wrong := wrong or watch.look_at_mean():
        number, team, found, limit = wrong
        words, own_choices = promised[which[team]].words, np.array(kept)[:, team]
        played.violations, broken = 1, [name for name, what in played.counts if what == number]
        played.violation = Violation(number, team, len(kept), found, limit, words, own_choices)
        played.counts.update((name, "violations") for name in broken)
    return played


def _last_steps(trial: Trial, limits: Mapping[str, Array]) -> Array:
    """Step of each environment's time bound, (B,), 0 if infeasible; random if all are."""
    if trial.by == "policy":
        patience = max(patience_of(one) for one in trial.starts or (trial.scenario,))
        steps = PATIENT_STEPS + math.ceil(patience / trial.scenario.tau)
        return np.full_like(next(iter(limits.values())), steps)
    few = np.exp(np.random.default_rng([trial.seed, 4]).uniform(*np.log(FEW_STEPS))).round()
    last = np.full_like(next(iter(limits.values())), math.inf)
    for name in {"time", "expected_time"} & set(limits):
        last = np.minimum(last, np.ceil(limits[name] / (trial.scenario.tau * trial.period)) + 1)
    late = last > MAX_STEPS
    means = limits.get("expected_time", np.full(len(last), math.inf))
    most = np.where(np.isfinite(means), np.minimum(last, MAX_MEAN_STEPS), few * late.all())
    return np.where(late, most, last)


def climb(trial: Trial) -> tuple[Trial, TrialResult]:
    """Search for initial conditions that violate a bound.

    Simulate the trial from its initial conditions, then ``trial.generations`` times from variations
    of those closest to a violation.

    Returns:
        The trial (with the violating initial condition if found) and its result.
    """
    drawn, played = trial, play(trial)
    first, random = played, np.random.default_rng([trial.seed, 2])
    number = str(random.choice(list(played.closeness))) if played.closeness else ""
    nearest: list[tuple[float, Array]] = []
    for _ in range(trial.generations if number else 0):
        if played.violation is not None:
            break
        if number in played.closeness:
            found = [*nearest, *zip(played.closeness[number], played.began, strict=True)]
            found.sort(key=itemgetter(0))
            best = {place.tobytes(): (near, place) for near, place in found}
            nearest = nlargest(_PARENTS, best.values(), key=itemgetter(0))
        places = np.array([place for _, place in nearest])
        if starts := other_starts(random, trial.scenario, places):
            trial = replace(trial, starts=starts)
            played = play(trial)
    if played.violation is None:
        return drawn, first
    if trial.starts or trial.by == "policy":
        start = played.began[played.violation.team]
        trial = replace(trial, scenario=trial.scenario.replace(start_positions=start), starts=())
    return trial, played


def shrink(trial: Trial, played: TrialResult) -> tuple[Trial, TrialResult]:
    """Shrink a violation: simplify one property at a time while the same bound is violated."""
    assert played.violation is not None
    number, simpler = played.violation.number, _simpler(trial)
    while (smaller := next(simpler, None)) is not None:
        found = play(smaller)
        if found.violation is not None and found.violation.number == number:
            trial, played, simpler = smaller, found, _simpler(smaller)
    return trial, played


def _simpler(trial: Trial) -> Iterator[Trial]:
    """Simplifications of a trial, largest first."""
    scenario, plain, exact = trial.scenario, rv.Scenario(), rv.Sensing()
    given = scenario.obstacles if isinstance(scenario.obstacles, tuple) else ()
    fields = ("max_speed", "time_step", "max_turn_rate", "obstacle_contact", "on_merge")
    area = {"start_region": None}, {"start_region": None, "spawn_size": max(scenario.spawn_edges)}
    flaws = [one.name for one in dataclasses.fields(exact)]
    changes: list[dict[str, Any]] = [
        {"obstacles": ()},
        *[{name: getattr(plain, name)} for name in fields],
        {"local_frames": "global"},
        {"activation": rv.Activation()},
        {"events": rv.Events()},
        *area,
        *[{"sensing": replace(scenario.sensing, **{n: getattr(exact, n)})} for n in flaws],
        *[{"obstacles": given[:k] + given[k + 1 :]} for k in range(len(given))],
        *_fewer_robots(scenario),
        *_rounder(scenario),
    ]
    own_limits = {name: one for name, one in trial.arguments.items() if isinstance(one, list)}
    if own_limits:  # of each robot
        of_all = {"min_gain": min, "max_gain": max}
        alike = {name: of_all[name](own) for name, own in own_limits.items()}
        yield replace(trial, arguments=trial.arguments | alike)
    for change in changes:
        if own_limits and "n_robots" in change:
            continue
        if any(getattr(scenario, name) != value for name, value in change.items()):
            with suppress(ValueError):
                yield replace(trial, scenario=scenario.replace(**change))
    if trial.period > 1 or trial.frame != "local":
        yield replace(trial, period=1, frame="local")


def _fewer_robots(scenario: rv.Scenario) -> Iterator[dict[str, Any]]:
    n, graph = scenario.n_robots, scenario.sensing_graph
    for robot in range(n if n > 2 else 0):
        left = [k for k in range(n) if k != robot]
        listed = "start_positions", "start_headings", *scenario.per_robot
        tables = {name: getattr(scenario, name) for name in listed}
        change: dict[str, Any] = {
            name: tuple(table[k] for k in left) for name, table in tables.items() if table
        }
        own = {name: getattr(scenario.sensing, name) for name in scenario.sensing.per_robot}
        of_left: dict[str, Any] = {name: [row[k] for k in left] for name, row in own.items()}
        change["sensing"] = replace(scenario.sensing, **of_left)
        with suppress(ValueError):  # no neighbour left
            if graph.kind in ("edges", "directed"):
                made = rv.graphs.directed if graph.kind == "directed" else rv.graphs.from_matrix
                change["graph"] = made(graph.base_weights(n)[np.ix_(left, left)])
            yield {"n_robots": n - 1, **change}


def _rounder(scenario: rv.Scenario) -> Iterator[dict[str, Any]]:
    """Links of equal weights, and positions with few digits."""
    graph, n = scenario.sensing_graph, scenario.n_robots
    if graph.kind != "complete":
        yield {"graph": rv.graphs.complete()}
    if graph.kind == "edges":
        weights = graph.base_weights(n)
        yield {"graph": rv.graphs.from_matrix(1.0 * (weights > 0.0))}
        yield {
            "graph": rv.graphs.from_matrix(np.array([[_one_digit(a) for a in r] for r in weights]))
        }
    for digits in (0, 1, 2) if scenario.start_positions else ():
        places = np.array(scenario.start_positions)
        yield {"start_positions": tuple(map(tuple, (places.round(digits) + 0.0).tolist()))}


def _one_digit(value: float) -> float:
    return float(f"{value:.1g}")


def write(folder: Path, name: str, trial: Trial, played: TrialResult) -> Path:
    """Write a violation: scenario in NAME.toml, settings in NAME.json.

    If a single environment repeats it, its actions and initial condition are included.
    """
    assert played.violation is not None
    violation, choices = played.violation, None
    alone = replace(trial, seed=trial.seed + violation.team)
    repeated = play(alone, teams=1, choices=violation.choices).violation
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


def repeat(path: Path) -> TrialResult:
    """Repeat a violation from the files of ``write``."""
    how = json.loads(path.with_suffix(".json").read_text(encoding="utf-8"))
    given = {name: how[name] for name in _HOW if name in how}
    given["numbers"] = tuple(given.get("numbers", ()))
    trial = Trial(rv.Scenario.from_toml(path), **given)
    choices = None if how["choices"] is None else np.array(how["choices"])
    return play(trial, teams=how["teams"], choices=choices)
