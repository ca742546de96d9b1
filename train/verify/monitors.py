"""What a certificate promises, held against every step of the teams that are played."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

import rendezvous_env as rv
from rendezvous_env.compilation import kernel
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
"""Teams of a trial whose mean time is promised."""
_FLOAT32 = 2.0**-20
_CONFIDENCE = 5.0
"""Standard errors by which a mean may lie above its bound."""
_COUNT = 48
"""Directions in which hulls are measured."""
_NEARLY = 0.9
"""Share of the bound on L from which L is measured exactly in 3-D."""


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
        count, self.along = teams.num_envs, directions(scenario.dim)
        self.held = period * scenario.tau
        self.levels = np.full(count, scenario.n_robots * budget)
        speed = max(scenario.speed_limit, scenario.max_degree)
        self.length_error = _FLOAT32 * speed * self.held + 1e-11 * float(
            np.abs(now.positions).max()
        )
        self.lyapunov_error, self.growth_error = np.zeros(count), 0.0
        self.free, self.met = np.ones(count, dtype=bool), np.full(count, np.inf)
        self.scale = np.maximum(now.lyapunov, 1e-300)
        sight = math.inf if scenario.sensing.range is None else scenario.sensing.range
        self.ranges = sight, scenario.merge_radius
        start = np.linalg.norm(now.positions[:, None] - now.positions[:, :, None], axis=-1)
        growth = limits.get("link_growth", np.full(1, math.inf))[:, None, None]
        self.lasting = start, (start + growth <= sight) & (now.weights > 0)
        self.tops = extents(now.positions, now.active, self.along)
        self.measured = np.empty((count, 5))
        self.closeness = {name: np.full(count, -np.inf) for name in limits} if climbing else {}

    @property
    def time_over_bound(self) -> float:
        """The worst of the teams that have met."""
        met = np.isfinite(self.met)
        ratio = self.met[met] / np.broadcast_to(self.limits.get("time", np.inf), met.shape)[met]
        return float(ratio.max()) if ratio.any() else math.nan

    def checked(self) -> set[str]:
        """Names of what was; of times only what was waited for."""
        return {
            name
            for name, limit in self.limits.items()
            if name not in ("time", "expected_time")
            or (np.isfinite(self.met) | (self.teams.time >= limit)).all()
        }

    def look(self, infos: Mapping[str, Any]) -> Found | None:
        """What this step violates."""
        last, now, scenario, limits = self.now, Moment(self.teams), self.scenario, self.limits
        self.now = now
        met = np.isinf(self.met) & (now.active.sum(axis=-1) == 1)
        self.met[met] = now.time[met]
        touched = infos["contact"].any(axis=-1)
        calm = (last.active == now.active).all(axis=-1) & ~touched
        self.free &= ~touched
        degree, n = scenario.max_degree, scenario.n_robots
        rounding = 1e-12 * last.lyapunov + _FLOAT32 * n * degree**2 * self.held
        self.lyapunov_error += rounding
        self.growth_error += 2.0 * self.length_error
        before, after = (last.positions, last.active, last.weights), (now.positions, now.active)
        _measure(before, after, self.along, self.tops, self.lasting, self.ranges, self.measured)
        reach, spread, nearest, lengthened, grown = self.measured.T

        def hull() -> Array:
            around = 2.0 * np.pi * (scenario.dim - 1.0) * reach
            if scenario.dim == 2:  # that of the polygon around it with a side for each direction
                around *= _COUNT / np.pi * math.tan(np.pi / _COUNT)
            near = around > limits["hull"] * (1.0 if scenario.dim == 2 else _NEARLY)
            for team in np.flatnonzero(near).tolist():
                around[team] = size(now.positions[team][now.active[team]])
            return around

        def ledger() -> tuple[Array, Array]:
            latest, self.levels = self.levels, infos["tank"].sum(axis=-1)
            fast = max(1.0, scenario.speed_limit / degree) ** 2
            steep = max(1.0, 2.0 * degree * self.held / scenario.merge_radius)
            risen = now.lyapunov + self.levels - last.lyapunov - latest
            return np.where(calm, risen, -np.inf), rounding * fast * steep + 1e-12 * latest

        looks: dict[str, Callable[[], tuple[Array, Array | float]]] = {
            # the step in which a bound falls may be finished
            "time": lambda: (
                np.where(np.isfinite(self.met), self.met, now.time) - self.held,
                1e-9 * limits["time"],
            ),
            "lyapunov": lambda: (
                np.where(self.free, now.lyapunov, -np.inf),
                self.lyapunov_error + 1e-9 * limits["lyapunov"],
            ),
            "hull": lambda: (hull(), 8.0 * self.growth_error),
            "link_growth": lambda: (grown, self.growth_error),
            "descent": lambda: (np.where(calm, now.lyapunov - last.lyapunov, -np.inf), rounding),
            "ledger": ledger,
            "nested": lambda: (
                np.where(calm & (nearest >= scenario.merge_radius), spread, -np.inf),
                self.length_error,
            ),
            "links": lambda: (np.where(calm, lengthened, -np.inf), 2.0 * self.length_error),
        }
        for name, limit in limits.items():
            if name not in looks:
                continue
            found, error = looks[name]()
            if (wrong := found > limit + error).any():
                team = int(np.argmax(np.where(wrong, found, -np.inf)))
                return name, team, float(found[team]), float(limit[team])
            if name not in self.closeness:
                continue
            unit = limit if name in BOUNDS else self.scale
            near = np.divide(found, unit, out=np.zeros(found.shape), where=np.isfinite(limit))
            np.maximum(self.closeness[name], near, out=self.closeness[name])
        return None

    def look_at_mean(self) -> Found | None:
        """Whether the mean time is surely above its bound; who has not met counts as if now."""
        if "expected_time" not in self.limits or len(self.met) < REPEATED:
            return None
        limit, times = float(self.limits["expected_time"][0]), np.minimum(self.met, self.teams.time)
        mean = float(times.mean())
        sure = mean - _CONFIDENCE * float(times.std(ddof=1)) / math.sqrt(len(times))
        return ("expected_time", 0, mean, limit) if sure - self.held > limit else None


@kernel
def _measure(
    before: Any, after: Any, along: Any, tops: Any, lasting: Any, ranges: Any, found: Any
) -> None:
    """Of each team, m: its mean support; how far the hull has grown; the shortest link before the
    step; how much longer a link has become in it, and a lasting one since the start.

    Args:
        before: places (B, n, d), who is there (B, n), weights (B, n, n), before the step.
        after: places and who is there, after it.
        along: directions, (M, d).
        tops: supports before the step, (B, M); those after it are written there.
        lasting: lengths at the start and which links must last, (B, n, n).
        ranges: sight and r.
        found: (B, 5), written.
    """
    (was_at, was, weights), (places, there), (start, lasts) = before, after, lasting
    n, d = places.shape[1], places.shape[2]
    for b in range(len(places)):
        total, spread = 0.0, -np.inf
        for m in range(len(along)):
            top = -np.inf
            for i in range(n):
                if there[b, i]:
                    reach = 0.0
                    for k in range(d):
                        reach += places[b, i, k] * along[m, k]
                    top = max(top, reach)
            spread, total, tops[b, m] = max(spread, top - tops[b, m]), total + top, top
        nearest, lengthened, grown = np.inf, -np.inf, -np.inf
        for i in range(n):
            for j in range(n):
                linked = weights[b, i, j] > 0.0 and was[b, i] and was[b, j]
                if i == j or not (linked or lasts[b, i, j]):
                    continue
                old, new = 0.0, 0.0
                for k in range(d):
                    old += (was_at[b, i, k] - was_at[b, j, k]) ** 2
                    new += (places[b, i, k] - places[b, j, k]) ** 2
                old, new = math.sqrt(old), math.sqrt(new)
                if lasts[b, i, j]:
                    grown = max(grown, new - start[b, i, j])
                if linked and old <= ranges[0]:
                    nearest, lengthened = min(nearest, old), max(lengthened, new - old)
        found[b, 0], found[b, 1], found[b, 2] = total / len(along), spread, nearest
        found[b, 3], found[b, 4] = lengthened, grown


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
