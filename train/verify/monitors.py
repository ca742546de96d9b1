"""What a certificate promises, held against every step of the teams that are played."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

import rendezvous_env as rv
from rendezvous_env.compilation import inner_kernel, kernel
from rendezvous_env.physics.hull_perimeter import size
from rendezvous_env.physics.vectors import ORIGIN, combine, dot, load, norm, split, subtract
from rendezvous_env.safety.theorems.theorem import PROMISED

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Found = tuple[str, int, float, float]
"""The number that is violated, the team, what was found and what was promised."""

NUMBERS = (*PROMISED, "descent", "ledger", "nested", "links")
"""All have met in time; V, L and how much longer links are than at the start stay below their
bounds; the mean time of many teams does. In every step without a merge or a contact V falls, by
Σ f_i·Δ_i of the displacements (theory 4) where choices are held for one step, and V does not rise
up to a merge; V + ΣA does not rise; the hull is nested while linked robots are r or more apart; no
link grows longer."""
REPEATED = 48  # teams for each start of a trial whose mean time is promised
ALL = (*NUMBERS, "lemma", "law_descent", "merge_rise", "pieces")
"""And those of claims: Σ‖f_i‖ ≥ 2 max a; V falls as under law (1), by τ Σ‖f_i‖ min(‖f_i‖, v_max);
it rises at a merge by no more than theory 5 allows; no fewer robots are left than the graph has
components."""
_TIME, _LYAPUNOV, _HULL, _LINK_GROWTH, _, _DESCENT, _LEDGER, _NESTED, _LINKS = range(len(NUMBERS))
_LEMMA, _LAW_DESCENT, _MERGE_RISE, _PIECES = range(len(NUMBERS), len(ALL))
_FLOAT32 = 2.0**-20
_CONFIDENCE = 5.0  # standard errors by which a mean may lie above its bound
_COUNT = 48  # directions in which hulls are measured
_NEARLY = 0.97
"""Share of the bound on L from which L is measured exactly in 3-D: so many directions miss no more
of it than 1.5 %."""


class Moment:
    """What is read of teams at one moment, each thing once and by its name in a simulator."""

    def __init__(self, teams: rv.Simulator) -> None:
        self._teams = teams

    def __getattr__(self, name: str) -> Any:
        """Read it."""
        found = getattr(self._teams, name)
        vars(self)[name] = found = found() if callable(found) else found
        return found


class Watch:
    """Looks at teams of ours, at their start, after every step.

    ``limits`` is the most that each of ALL may be, (B,); a step is ``period`` base steps; tanks
    begin with a ``budget``, m²/s.
    """

    def __init__(self, env: Any, limits: dict[str, Array], period: int, budget: float) -> None:
        self.env, self.limits, self.teams, self.scenario = env, limits, env.simulator, env.scenario
        self.now = now = Moment(self.teams)
        scenario, count = self.scenario, self.teams.num_envs
        n, r, degree = scenario.n_robots, scenario.merge_radius, scenario.max_degree
        self.held = period * scenario.tau
        fast = max(1.0, scenario.speed_limit / degree)
        self.length_error = _FLOAT32 * degree * fast * self.held
        self.length_error += 1e-11 * float(np.abs(now.positions).max())
        sight = math.inf if scenario.sensing.range is None else scenario.sensing.range
        rounding = _FLOAT32 * n * degree**2 * self.held
        spent = fast**2 * max(1.0, 2.0 * degree * self.held / r)
        pieces = len(scenario.sensing_graph.components(n))
        steps = self.held, period == 1, scenario.speed_limit, sight, r, pieces
        self.numbers = *steps, self.length_error, rounding, spent
        self.growth_error, self.no_tanks = 0.0, np.zeros((count, n))
        self.along, self.met = directions(scenario.dim), np.full(count, np.inf)
        free, levels = np.ones(count, dtype=bool), np.full(count, n * budget)
        tops, height_error = extents(now.positions, now.active, self.along), np.zeros(count)
        self.kept = self.met, free, levels, height_error, tops
        start = np.linalg.norm(now.positions[:, None] - now.positions[:, :, None], axis=-1)
        growth = limits.get("link_growth", np.full(1, math.inf))[:, None, None]
        self.lasting = start, (start + growth <= sight) & (now.weights > 0)
        self.most = np.array([limits.get(name, np.full(count, np.inf)) for name in ALL])
        self.most[[_TIME, _LYAPUNOV]] *= 1.0 + 1e-9
        self.unit = np.where(np.isfinite(self.most), self.most, 1.0)
        self.unit[len(PROMISED) :] = np.maximum(now.lyapunov, 1e-300)
        self.unit[[_LEMMA, _PIECES]] = 1.0
        self.nearest = np.full(self.most.shape, -np.inf)
        self.found, self.errors = np.full(self.most.shape, -np.inf), np.zeros(self.most.shape)

    @property
    def closeness(self) -> dict[str, Array]:
        """How near each team came to break each number, (B,)."""
        return {name: self.nearest[ALL.index(name)] for name in self.limits}

    @property
    def time_over_bound(self) -> float:
        """The worst of the teams that have met."""
        met = np.isfinite(self.met)
        ratio = self.met[met] / np.broadcast_to(self.limits.get("time", np.inf), met.shape)[met]
        return float(ratio.max()) if ratio.any() else math.nan

    def checked(self, of: Mask) -> set[str]:
        """The numbers that were, of these teams, (B,); times only if they were waited for."""
        met, now = np.isfinite(self.met), self.teams.time
        timed = ("time", "expected_time")
        return {
            name
            for name, limit in self.limits.items()
            if name not in timed or (met | (now >= limit))[of].all()
        }

    def look(self, infos: Mapping[str, Any]) -> Mask:
        """Which of ALL this step violates, of which teams, (13, B)."""
        last, self.now = self.now, Moment(self.teams)
        now, found, outcome = self.now, self.found, self.env.outcome
        self.growth_error += 2.0 * self.length_error
        levels = infos.get("tank", self.no_tanks)
        _measure(
            (last.positions, last.active, last.weights, last.lyapunov),
            (now.positions, now.active, now.lyapunov, now.time),
            (infos["contact"], levels, outcome.lyapunov_before_merge, outcome.merge_excess),
            (self.along, *self.lasting),
            (*self.numbers, self.growth_error),
            self.kept,
            found,
            self.errors,
        )
        if "hull" in self.limits:
            near = 1.0 if self.scenario.dim == 2 else _NEARLY
            for team in np.flatnonzero(found[_HULL] > near * self.most[_HULL]).tolist():
                found[_HULL, team] = size(now.positions[team][now.active[team]])
        near = np.divide(found, self.unit, out=np.zeros(found.shape), where=self.most < np.inf)
        np.maximum(self.nearest, near, out=self.nearest)
        return np.asarray(found > self.most + self.errors)

    def worst(self, wrong: Mask) -> Found:
        """The first number that is violated, and the team by which it is the most."""
        row = int(np.argmax(wrong.any(axis=1)))
        team = int(np.argmax(np.where(wrong[row], self.found[row], -np.inf)))
        return ALL[row], team, float(self.found[row, team]), float(self.most[row, team])

    def look_at_mean(self) -> Found | None:
        """A start from which the mean time is surely too long; who has not met counts as if now."""
        if "expected_time" not in self.limits or len(self.met) % REPEATED:
            return None
        times = np.minimum(self.met, self.teams.time).reshape(-1, REPEATED)
        limit, mean = self.limits["expected_time"][::REPEATED], times.mean(axis=1)
        sure = mean - _CONFIDENCE * times.std(axis=1, ddof=1) / math.sqrt(REPEATED)
        if not (wrong := sure - self.held > limit).any():
            return None
        start = int(np.argmax(wrong))
        return "expected_time", start * REPEATED, float(mean[start]), float(limit[start])


@kernel
def _measure(before, after, reported, where, numbers, kept, found, errors):
    """Write what each of ALL is of each team, and by how much rounding may raise it, (13, B);
    what is kept from step to step is brought up to date. Tuples as ``Watch.look`` gives them.
    """
    (places, was, weights, higher), (moved_to, there, height, time) = before, after
    contact, tanks, at_merge, excess = reported
    met, free, levels, of_height, tops = kept
    held, once, fastest, sight, r, last, of_length, rounding, spent, of_growth = numbers
    for b in range(len(there)):
        alone, touched, left, level = True, False, 0, 0.0
        for i in range(there.shape[1]):
            alone = alone and was[b, i] == there[b, i]
            touched = touched or contact[b, i]
            left += there[b, i]
            level += tanks[b, i]
        free[b] = free[b] and not touched
        calm = alone and not touched and met[b] == np.inf
        if left == last and met[b] == np.inf:
            met[b] = time[b]
        step = rounding + 1e-12 * higher[b]
        of_height[b] += step
        # the step in which a bound falls may be finished
        found[_TIME, b] = min(met[b], time[b]) - held
        found[_LYAPUNOV, b], errors[_LYAPUNOV, b] = height[b] if free[b] else -np.inf, of_height[b]
        spread = _spread(moved_to[b], there[b], where[0], tops[b], found[_HULL, b : b + 1])
        present = places[b], was[b], weights[b], moved_to[b]
        nearest, lengthened, grown = _stretch(present, where[1][b], where[2][b], sight)
        work, own, strength = _fall(present, fastest)
        risen = height[b] - higher[b]
        first = at_merge[b] - higher[b] if once and not alone and not touched else -np.inf
        found[_LINK_GROWTH, b] = grown
        found[_DESCENT, b] = risen + max(work, 0.0) * once if calm else first
        found[_LEDGER, b] = risen + level - levels[b] if calm else -np.inf
        found[_NESTED, b] = spread if calm and nearest >= r else -np.inf
        found[_LINKS, b] = lengthened if calm else -np.inf
        found[_LAW_DESCENT, b] = risen + held * own if calm else first
        found[_LEMMA, b], found[_MERGE_RISE, b] = -strength, excess[b]
        found[_PIECES, b] = last - left
        errors[_DESCENT, b], errors[_LAW_DESCENT, b] = step, step
        errors[_LEDGER, b] = step * spent + 1e-12 * levels[b]
        errors[_HULL, b], errors[_LINK_GROWTH, b] = 8.0 * of_growth, of_growth
        errors[_NESTED, b], errors[_LINKS, b] = of_length, 2.0 * of_length
        errors[_LEMMA, b], errors[_MERGE_RISE, b] = 1e-9, 1e-12 * (1.0 + higher[b])
        levels[b] = level


@inner_kernel
def _spread(places, there, along, tops, found):
    """Write L, in the plane that of the polygon around the hull; give the hull's growth, m."""
    total, spread, left, d = 0.0, -np.inf, there.sum(), places.shape[1]
    for m in range(len(along)):
        top, middle = -np.inf, 0.0
        for i in range(len(places)):
            if there[i]:
                reach = dot(load(places[i]), load(along[m]))
                top, middle = max(top, reach), middle + reach / left
        spread, total, tops[m] = max(spread, top - tops[m]), total + top - middle, top
    found[0] = 2.0 * math.pi * (d - 1.0) * total / len(along)
    if d == 2:
        found[0] *= _COUNT / math.pi * math.tan(math.pi / _COUNT)
    return spread


@inner_kernel
def _stretch(present, start, lasts, sight):
    """The shortest link in sight; how much longer one, and since the start a lasting one, is, m."""
    places, was, weights, moved_to = present
    nearest, lengthened, grown = np.inf, -np.inf, -np.inf
    for i in range(len(places)):
        for j in range(len(places)):
            linked = weights[i, j] > 0.0 and was[i] and was[j]
            if i == j or not (linked or lasts[i, j]):
                continue
            old = norm(subtract(load(places[j]), load(places[i])))
            new = norm(subtract(load(moved_to[j]), load(moved_to[i])))
            if lasts[i, j]:
                grown = max(grown, new - start[i, j])
            if linked and old <= sight:
                nearest, lengthened = min(nearest, old), max(lengthened, new - old)
    return nearest, lengthened, grown


@inner_kernel
def _fall(present, fastest):
    """Σ f_i·Δ_i of what the robots are displaced by, m²/s; Σ‖f_i‖ min(‖f_i‖, v_max), (m/s)²; and
    Σ‖f_i‖/(2 max a) − 1, without unit (lemma 1), infinite without links.
    """
    places, was, weights, moved_to = present
    work, own, strength, heaviest = 0.0, 0.0, 0.0, 0.0
    for i in range(len(places)):
        f = ORIGIN
        for j in range(len(places)):
            if weights[i, j] > 0.0 and was[i] and was[j]:
                _, bearing = split(subtract(load(places[j]), load(places[i])))
                f, heaviest = combine(1.0, f, weights[i, j], bearing), max(heaviest, weights[i, j])
        work += dot(f, subtract(load(moved_to[i]), load(places[i])))
        strength += norm(f)
        own += norm(f) * min(norm(f), fastest)
    return work, own, strength / (2.0 * heaviest) - 1.0 if heaviest > 0.0 else np.inf


def extents(places: Array, active: Mask, along: Array) -> Array:
    """Support max_i u·p_i of the robots that are there, for each direction u, (B, M), m."""
    reach = np.where(active[..., None], places @ along.T, -np.inf)
    return np.asarray(reach.max(axis=1))


def directions(dim: int, count: int = _COUNT) -> Array:
    """Unit vectors all round, (M, d); in 3-D on a spiral."""
    k = np.arange(count) + 0.5
    if dim == 2:
        return np.stack([np.cos(2 * np.pi * k / count), np.sin(2 * np.pi * k / count)], axis=-1)
    height, angle = 1.0 - 2.0 * k / count, np.pi * (1.0 + math.sqrt(5.0)) * k
    flat = np.sqrt(1.0 - height**2)
    return np.stack([flat * np.cos(angle), flat * np.sin(angle), height], axis=-1)
