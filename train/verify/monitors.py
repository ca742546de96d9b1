"""What a certificate promises, held against every step of the teams that are played."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

import rendezvous_env as rv
from rendezvous_env.compilation import inner_kernel, kernel
from rendezvous_env.physics.hull_perimeter import size

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Found = tuple[str, int, float, float]
"""The number that is violated, the team, what was found and what was promised."""

BOUNDS = ("time", "lyapunov", "hull", "link_growth", "expected_time")
"""All have met in time; V, L and how much longer links are than at the start stay below their
bounds; the mean time of many teams does."""
NUMBERS = (*BOUNDS, "descent", "ledger", "nested", "links")
"""And in every step without a merge or a contact V falls; V + ΣA does; the hull is nested while
linked robots are r or more apart; no link grows longer."""
REPEATED = 48
"""Teams for each start of a trial whose mean time is promised."""
_TIME, _LYAPUNOV, _HULL, _LINK_GROWTH, _, _DESCENT, _LEDGER, _NESTED, _LINKS = range(len(NUMBERS))
_FLOAT32 = 2.0**-20
_CONFIDENCE = 5.0
"""Standard errors by which a mean may lie above its bound."""
_COUNT = 48
"""Directions in which hulls are measured."""
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
        setattr(self, name, found := found() if callable(found) else found)
        return found


class Watch:
    """Looks at teams after every step.

    Args:
        teams: at their start.
        limits: the most that each of NUMBERS may be, (B,).
        period: base steps of a step.
        budget: B_i that each robot's tank begins with, m²/s.
        climbing: whether to keep how near each team comes to break each number.
    """

    def __init__(
        self,
        teams: rv.Simulator,
        limits: dict[str, Array],
        period: int,
        budget: float,
        climbing: bool,
    ) -> None:
        self.teams, self.limits = teams, limits
        self.scenario = scenario = teams.scenario
        self.now = now = Moment(teams)
        count, n, r = teams.num_envs, scenario.n_robots, scenario.merge_radius
        self.held, degree = period * scenario.tau, scenario.max_degree
        fast = max(1.0, scenario.speed_limit / degree)
        self.length_error = _FLOAT32 * degree * fast * self.held
        self.length_error += 1e-11 * float(np.abs(now.positions).max())
        sight = math.inf if scenario.sensing.range is None else scenario.sensing.range
        rounding = _FLOAT32 * n * degree**2 * self.held
        spent = fast**2 * max(1.0, 2.0 * degree * self.held / r)
        self.numbers = self.held, sight, r, self.length_error, rounding, spent
        self.growth_error, self.no_tanks = 0.0, np.zeros((count, n))
        self.along = directions(scenario.dim)
        self.met, levels = np.full(count, np.inf), np.full(count, n * budget)
        tops = extents(now.positions, now.active, self.along)
        self.kept = self.met, np.ones(count, dtype=bool), levels, np.zeros(count), tops
        start = np.linalg.norm(now.positions[:, None] - now.positions[:, :, None], axis=-1)
        growth = limits.get("link_growth", np.full(1, math.inf))[:, None, None]
        self.lasting = start, (start + growth <= sight) & (now.weights > 0)
        self.most = np.array([limits.get(name, np.full(count, np.inf)) for name in NUMBERS])
        self.most[[_TIME, _LYAPUNOV]] *= 1.0 + 1e-9
        unit = np.maximum(now.lyapunov, 1e-300)
        self.unit = np.where(np.arange(len(NUMBERS))[:, None] < len(BOUNDS), self.most, unit)
        self.nearest = np.full(self.most.shape, -np.inf) if climbing else None
        self.found, self.errors = np.full(self.most.shape, -np.inf), np.zeros(self.most.shape)

    @property
    def closeness(self) -> dict[str, Array]:
        """How near each team came to break each number, (B,); nothing unless climbing."""
        if self.nearest is None:
            return {}
        return {name: self.nearest[NUMBERS.index(name)] for name in self.limits}

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

    def look(self, infos: Mapping[str, Any]) -> Found | None:
        """What this step violates."""
        last, self.now = self.now, Moment(self.teams)
        now, found = self.now, self.found
        self.growth_error += 2.0 * self.length_error
        _measure(
            (last.positions, last.active, last.weights, last.lyapunov),
            (now.positions, now.active, now.lyapunov, now.time),
            (infos["contact"], infos.get("tank", self.no_tanks)),
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
        if (wrong := found > self.most + self.errors).any():
            row = int(np.argmax(wrong.any(axis=1)))
            team = int(np.argmax(np.where(wrong[row], found[row], -np.inf)))
            return NUMBERS[row], team, float(found[row, team]), float(self.most[row, team])
        if self.nearest is not None:
            promised = np.isfinite(self.most)
            near = np.divide(found, self.unit, out=np.zeros(found.shape), where=promised)
            np.maximum(self.nearest, near, out=self.nearest)
        return None

    def look_at_mean(self) -> Found | None:
        """Whether the mean time from a start is surely above its bound; who has not met counts as
        if now.
        """
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
def _measure(
    before: Any,
    after: Any,
    told: Any,
    where: Any,
    numbers: Any,
    kept: Any,
    found: Any,
    errors: Any,
) -> None:
    """Write what each of NUMBERS is of each team, and by how much rounding may raise it.

    Args:
        before: places (B, n, d), who is there (B, n), weights (B, n, n), V (B,), before the step.
        after: places, who is there, V and the time (B,), after it.
        told: who touched an obstacle, and levels of tanks, (B, n).
        where: directions (M, d); lengths at the start and which links must last, (B, n, n).
        numbers: how long a step is held; sight; r; the errors of a length, of V and of V + ΣA in a
            step; that of a link's growth since the start.
        kept: when teams met, whether they have touched nothing yet, ΣA, the error of V since the
            start, (B,), and supports, (B, M); they are brought up to date.
        found: (9, B), written.
        errors: (9, B), written.
    """
    (_, was, _, higher), (_, there, height, time), (contact, tanks) = before, after, told
    met, free, levels, of_height, tops = kept
    held, sight, r, of_length, rounding, spent, of_growth = numbers
    for b in range(len(there)):
        calm, left, level = True, 0, 0.0
        for i in range(there.shape[1]):
            calm = calm and was[b, i] == there[b, i] and not contact[b, i]
            free[b] = free[b] and not contact[b, i]
            left += there[b, i]
            level += tanks[b, i]
        if left == 1 and met[b] == np.inf:
            met[b] = time[b]
        step = rounding + 1e-12 * higher[b]
        of_height[b] += step
        # the step in which a bound falls may be finished
        found[_TIME, b] = min(met[b], time[b]) - held
        found[_LYAPUNOV, b], errors[_LYAPUNOV, b] = height[b] if free[b] else -np.inf, of_height[b]
        spread = _spread(after, b, where[0], tops[b], found)
        nearest, lengthened = _stretch(before, after, b, where, sight, found)
        risen = height[b] - higher[b]
        found[_DESCENT, b], errors[_DESCENT, b] = risen if calm else -np.inf, step
        found[_LEDGER, b] = risen + level - levels[b] if calm else -np.inf
        errors[_LEDGER, b] = step * spent + 1e-12 * levels[b]
        found[_NESTED, b] = spread if calm and nearest >= r else -np.inf
        found[_LINKS, b] = lengthened if calm else -np.inf
        errors[_HULL, b], errors[_LINK_GROWTH, b] = 8.0 * of_growth, of_growth
        errors[_NESTED, b], errors[_LINKS, b] = of_length, 2.0 * of_length
        levels[b] = level


@inner_kernel
def _spread(after: Any, b: int, along: Any, tops: Any, found: Any) -> float:
    """Write L, in the plane that of the polygon around the hull with a side for each direction;
    give by how much the hull has grown, m.
    """
    places, there = after[0][b], after[1][b]
    n, d = places.shape
    total, spread, left = 0.0, -np.inf, 0
    for i in range(n):
        left += there[i]
    for m in range(len(along)):
        top, middle = -np.inf, 0.0
        for i in range(n):
            if there[i]:
                reach = 0.0
                for k in range(d):
                    reach += places[i, k] * along[m, k]
                top, middle = max(top, reach), middle + reach / left
        spread, total, tops[m] = max(spread, top - tops[m]), total + top - middle, top
    found[_HULL, b] = 2.0 * math.pi * (d - 1.0) * total / len(along)
    if d == 2:
        found[_HULL, b] *= _COUNT / math.pi * math.tan(math.pi / _COUNT)
    return spread


@inner_kernel
def _stretch(
    before: Any, after: Any, b: int, where: Any, sight: float, found: Any
) -> tuple[float, float]:
    """Write how much longer a lasting link has become since the start; give the shortest link
    before the step, and how much longer one has become in it, m.
    """
    was_at, was, weights = before[0][b], before[1][b], before[2][b]
    places, start, lasts = after[0][b], where[1][b], where[2][b]
    nearest, lengthened, grown = np.inf, -np.inf, -np.inf
    for i in range(len(places)):
        for j in range(len(places)):
            linked = weights[i, j] > 0.0 and was[i] and was[j]
            if i == j or not (linked or lasts[i, j]):
                continue
            old, new = 0.0, 0.0
            for k in range(places.shape[1]):
                old += (was_at[i, k] - was_at[j, k]) ** 2
                new += (places[i, k] - places[j, k]) ** 2
            old, new = math.sqrt(old), math.sqrt(new)
            if lasts[i, j]:
                grown = max(grown, new - start[i, j])
            if linked and old <= sight:
                nearest, lengthened = min(nearest, old), max(lengthened, new - old)
    found[_LINK_GROWTH, b] = grown
    return nearest, lengthened


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
