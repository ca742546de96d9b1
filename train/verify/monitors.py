"""What a certificate promises, held against every step of the teams that are played."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

import rendezvous_env as rv

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

BOUNDS = ("time", "lyapunov", "hull", "link_growth", "expected_time")
"""All have met in time; V, L and how much longer links are than at the start stay below their
bounds; the mean time of many teams does."""
NUMBERS = (*BOUNDS, "descent", "ledger", "nested", "links")
"""And in every step without a merge or a contact V falls; V + ΣA does; the hull is nested while
linked robots are r or more apart; no link grows longer."""
_FLOAT32 = 2.0**-20
_NEARLY = 0.9
"""Share of the bound on L from which L is measured exactly; a few directions are quicker."""
_CONFIDENCE = 5.0
"""Standard errors by which a mean may lie above its bound."""
REPEATED = 48
"""Teams of a trial whose mean time is promised."""


class Watch:
    """Looks at teams after every step.

    Args:
        teams: at their start.
        limits: the most that each of NUMBERS may be, (B,) or the same for all.
        period: base steps of a step.
        budget: B_i that each robot's tank begins with, m²/s.
    """

    def __init__(
        self, teams: rv.Simulator, limits: dict[str, Array], period: int, budget: float
    ) -> None:
        self.teams, self.limits = teams, limits
        self.scenario = scenario = teams.scenario
        self.latest = teams.positions, teams.active, teams.lyapunov(), teams.weights
        self.along, self.held = directions(scenario.dim), period * scenario.tau
        self.levels = np.full(teams.num_envs, scenario.n_robots * budget)
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
        if "expected_time" not in self.limits or len(self.met) < REPEATED:
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
    """Unit vectors all round, (M, d); in 3-D on a spiral."""
    k = np.arange(count) + 0.5
    if dim == 2:
        return np.stack([np.cos(2 * np.pi * k / count), np.sin(2 * np.pi * k / count)], axis=-1)
    height, angle = 1.0 - 2.0 * k / count, np.pi * (1.0 + math.sqrt(5.0)) * k
    flat = np.sqrt(1.0 - height**2)
    return np.stack([flat * np.cos(angle), flat * np.sin(angle), height], axis=-1)
