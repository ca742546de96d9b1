"""Monitors that compare every step of simulated environments with the bounds of a certificate."""

import math
from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

import rendezvous_env as rv
from rendezvous_env.physics.hull_perimeter import size
from rendezvous_env.safety.theorems.theorem import PROMISED

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Found = tuple[str, int, float, float]
"""Violated quantity, environment, measured value, bound."""

NUMBERS = (*PROMISED, "descent", "ledger", "nested", "links")
"""Monitored quantities.

Bounds: rendezvous time; V; hull perimeter L; growth of links; mean rendezvous time. Per step:

* "descent": without merge or contact V decreases by Σ f_i·Δ_i of the displacements (theory 4) if
  actions are held for one step, and V does not increase up to a merge.
* "ledger": V + ΣA does not increase.
* "nested": hulls are nested while linked robots are at least r apart.
* "links": no link grows, and with actions held for one step no robot leaves its balls of radius r/4
  (docs/proofs.md, R).

Claims also use Σ‖f_i‖ ≥ 2 max a ("lemma"); the decrease τ Σ‖f_i‖ min(‖f_i‖, v_max) of V under law
(1) ("law_descent"); the bound of theory 5 at merges ("merge_rise"); at least as many robots as
graph components ("pieces")."""
SEARCHED = {
    "rise": "V rises in a step without merge or contact (m²/s)",
    "growth": "the convex hull grows in such a step, linked robots r or more apart (m)",
    "deadlock": "neither a merge nor a fall of V for a long time (s)",
}
"""Objectives of the search for counterexamples of a policy, by quantity."""
_PROGRESS = (
    1e-4  # of a* r, m²/s: a decrease of V that ends a deadlock, 1 % of the slowest for ε = 0.1
)
REPEATED = 48  # environments per initial condition of a trial with a bounded mean time
_FLOAT32 = 2.0**-20
_CONFIDENCE = 5.0  # standard errors by which a mean may lie above its bound
_COUNT = 48  # directions in which hulls are measured
_NEARLY = 0.97
"""Fraction of the bound on L above which L is computed exactly in 3-D; the sampled directions
underestimate it by at most 1.5 %."""


class BatchMoment:
    """State of a batch at one time: lazily read simulator attributes and pairwise geometry."""

    def __init__(self, teams: rv.Simulator) -> None:
        self._teams = teams
        _ = self.positions, self.active, self.weights, self.lyapunov  # before the next step

    def __getattr__(self, name: str) -> Any:
        """Read an attribute of the simulator."""
        found = getattr(self._teams, name)
        vars(self)[name] = found = found() if callable(found) else found
        return found

    @cached_property
    def both(self) -> Mask:
        """True if robots i and j are active, (B, n, n)."""
        return np.asarray(self.active[:, :, None] & self.active[:, None])

    @cached_property
    def linked(self) -> Mask:
        """True if they are linked, (B, n, n)."""
        return np.asarray(self.both & (self.weights > 0.0))

    @cached_property
    def offsets(self) -> Array:
        """p_j − p_i, (B, n, n, d), m."""
        return np.asarray(self.positions[:, None] - self.positions[:, :, None])

    @cached_property
    def distances(self) -> Array:
        """‖p_j − p_i‖, (B, n, n), m."""
        return lengths(self.offsets)[..., 0]

    @cached_property
    def tops(self) -> Array:
        """Support function of the team in M directions, (B, M), m, see ``extents``."""
        return extents(self.positions, self.active, directions(self.positions.shape[-1]))

    @cached_property
    def gains(self) -> Array:
        """a_ij of active robots, (B, n, n), m/s."""
        return np.where(self.linked, self.weights, 0.0)

    @cached_property
    def net_bearings(self) -> Array:
        """f_i = Σ_j a_ij g_ij, (B, n, d), m/s."""
        return np.asarray((self.gains[..., None] * unit(self.offsets)).sum(axis=2))


def lengths(vectors: Array) -> Array:
    """Norms (..., 1) of vectors (..., d)."""
    return np.asarray(np.sqrt((vectors**2).sum(axis=-1, keepdims=True)))


def unit(vectors: Array) -> Array:
    """Unit vectors (..., d); zero stays zero."""
    sizes = lengths(vectors)
    return np.divide(vectors, sizes, out=np.zeros_like(vectors), where=sizes > 1e-12)


def _most(values: Array, where: Mask) -> Array:
    """Maximum per environment, (B,)."""
    return np.asarray(np.where(where, values, -np.inf).max(axis=(1, 2)))


def across(ahead: Array, axis: Array) -> Array:
    """Perpendicular vectors, (..., d): rotated by 90° in the plane, ahead × axis in 3-D."""
    if ahead.shape[-1] == 2:
        return np.stack([-ahead[..., 1], ahead[..., 0]], axis=-1)
    return np.cross(ahead, axis)


class Monitor:
    """Monitor of a batch after reset and after every step.

    ``limits`` are the bounds (B,) by quantity; a step is ``period`` base steps; energy tanks start
    with ``budget``, m²/s.
    """

    def __init__(self, env: Any, limits: dict[str, Array], period: int, budget: float) -> None:
        self.env, self.limits, self.teams, self.scenario = env, limits, env.simulator, env.scenario
        self.now = now = BatchMoment(self.teams)
        scenario, count = self.scenario, self.teams.num_envs
        n, r, degree = scenario.n_robots, scenario.merge_radius, scenario.max_degree
        self.once, self.held = period == 1, period * scenario.tau
        fast = max(1.0, scenario.speed_limit / degree)
        self.length_error = _FLOAT32 * degree * fast * self.held
        self.length_error += 1e-11 * float(np.abs(now.positions).max())
        self.rounding = _FLOAT32 * n * degree**2 * self.held
        self.spent = fast**2 * max(1.0, 2.0 * degree * self.held / r)
        self.growth_error, self.height_error = 0.0, np.zeros(count)
        self.met, self.free = np.full(count, np.inf), np.ones(count, dtype=bool)
        self.levels = np.full(count, n * budget)
        self.sight = scenario.sensing.smallest("range")
        self.pieces = len(scenario.sensing_graph.components(n))
        growth = limits.get("link_growth", np.full(1, np.inf))[:, None, None]
        self.lasting = now.linked & (now.distances + growth <= self.sight)
        self.start = now.distances
        self.lowest, self.fell = now.lyapunov, np.zeros(count)
        self.closeness = {name: np.full(count, -np.inf) for name in limits}
        """Distance of each environment from violating each bound, (B,)."""
        self.units = dict.fromkeys(limits, np.maximum(now.lyapunov, 1e-300))
        self.units |= {"lemma": np.ones(count), "pieces": np.ones(count)}
        timed = (*PROMISED, "deadlock")
        self.units |= {name: limits[name] for name in timed if name in limits}

    @property
    def time_over_bound(self) -> float:
        """Largest ratio of rendezvous time to bound."""
        met = np.isfinite(self.met)
        ratio = self.met[met] / np.broadcast_to(self.limits.get("time", np.inf), met.shape)[met]
        return float(ratio.max()) if ratio.any() else math.nan

    def checked(self, of: Mask) -> set[str]:
        """Quantities that were checked in the given environments, (B,)."""
        met, now = np.isfinite(self.met), self.teams.time
        timed = ("time", "expected_time")
        return {
            name
            for name, limit in self.limits.items()
            if name not in timed or (met | (now >= limit))[of].all()
        }

    def look(self, infos: Mapping[str, Any]) -> tuple[Mask, Found | None]:
        """Mask of violating environments in this step, (B,), and the first, largest violation."""
        measured, wrong, worst = self._measure(infos), np.zeros(len(self.met), dtype=bool), None
        for name, limit in self.limits.items():
            if name not in measured:  # over many steps, as a mean
                continue
            found, error = measured[name]
            most = limit * (1.0 + 1e-9 * (name in ("time", "lyapunov")))
            near = np.zeros(len(found))
            np.divide(found, self.units[name], out=near, where=limit < np.inf)
            np.maximum(self.closeness[name], near, out=self.closeness[name])
            broken = found > most + error
            if worst is None and broken.any():
                team = int(np.argmax(np.where(broken, found, -np.inf)))
                worst = name, team, float(found[team]), float(most[team])
            wrong |= broken
        return wrong, worst

    def _measure(self, infos: Mapping[str, Any]) -> dict[str, tuple[Array, Any]]:
        """Monitored values, (B,) each, and their rounding allowances."""
        last, self.now = self.now, BatchMoment(self.teams)
        now, outcome, touched = self.now, self.env.outcome, infos["contact"].any(axis=1)
        alone, left = (last.active == now.active).all(axis=1), now.active.sum(axis=1)
        calm = alone & ~touched & np.isinf(self.met)
        self.free &= ~touched
        self.met = np.where((left == self.pieces) & np.isinf(self.met), now.time, self.met)
        before = self.levels
        self.levels = levels = infos["tank"].sum(axis=1) if "tank" in infos else before
        step = self.rounding + 1e-12 * last.lyapunov
        self.height_error += step
        self.growth_error += 2.0 * self.length_error
        risen, rises = now.lyapunov - last.lyapunov, outcome.lyapunov_before_merge - last.lyapunov
        first = np.where(~alone & ~touched & self.once, rises, -np.inf)
        seen = last.linked & (last.distances <= self.sight)
        found: dict[str, tuple[Array, Any]] = {
            # the step that contains a bound may be finished
            "time": (np.minimum(self.met, now.time) - self.held, 0.0),
            "lyapunov": (np.where(self.free, now.lyapunov, -np.inf), self.height_error),
            "merge_rise": (outcome.merge_excess, 1e-12 * (1.0 + last.lyapunov)),
            "pieces": (self.pieces - left, 0.0),
        }
        if "ledger" in self.limits:
            paid = np.where(calm, risen + levels - before, -np.inf)
            found["ledger"] = paid, step * self.spent + 1e-12 * before
        if "rise" in self.limits:
            found["rise"] = np.where(calm, risen, first), step
        if "deadlock" in self.limits:
            found["deadlock"] = self._time_without_progress(alone), 0.0
        if "hull" in self.limits:
            found["hull"] = self._size(), 8.0 * self.growth_error
        if "link_growth" in self.limits:
            longer = _most(now.distances - self.start, self.lasting)
            found["link_growth"] = longer, self.growth_error
        if "descent" in self.limits:
            moved = now.positions - last.positions
            work = (last.net_bearings * moved).sum(axis=(1, 2))
            fall = risen + np.maximum(work, 0.0) * self.once
            found["descent"] = np.where(calm, fall, first), step
        for name in {"nested", "growth"} & self.limits.keys():
            apart = -_most(-last.distances, seen) >= self.scenario.merge_radius
            grown = (now.tops - last.tops).max(axis=1)
            found[name] = np.where(calm & apart, grown, -np.inf), self.length_error
        if "links" in self.limits:
            lengthened = _most(now.distances - last.distances, seen)
            if self.once:
                ball = 0.25 * self.scenario.merge_radius
                moved = (now.positions - last.positions)[:, :, None]
                beyond = lengths(moved - ball * unit(last.offsets))[..., 0] - ball
                lengthened = np.maximum(lengthened, _most(beyond, seen))
            found["links"] = np.where(calm, lengthened, -np.inf), 2.0 * self.length_error
        if {"lemma", "law_descent"} & self.limits.keys():
            pull, twice = lengths(last.net_bearings)[..., 0], 2.0 * last.gains.max(axis=(1, 2))
            share = np.full(len(left), np.inf)
            np.divide(pull.sum(axis=1), twice, out=share, where=twice > 0.0)
            own = (pull * np.minimum(pull, self.scenario.speed_limits)).sum(axis=1)
            found["lemma"] = 1.0 - share, 1e-9
            found["law_descent"] = np.where(calm, risen + self.held * own, first), step
        return found

    def _time_without_progress(self, alone: Mask) -> Array:
        """Time since the last merge or new minimum of V, (B,), s; −∞ after rendezvous."""
        now, scenario = self.now, self.scenario
        least = _PROGRESS * scenario.bottleneck_weight * scenario.merge_radius
        progress = ~alone | (now.lyapunov < self.lowest - least)
        self.lowest = np.where(progress, now.lyapunov, self.lowest)
        self.fell = np.where(progress, now.time, self.fell)
        return np.where(np.isinf(self.met), now.time - self.fell, -np.inf)

    def _size(self) -> Array:
        """Hull perimeter L, (B,), m: in the plane of a circumscribed polygon, exact if large."""
        now, plane, most = self.now, self.scenario.dim == 2, self.limits["hull"]
        there = now.active[..., None]
        centre = (now.positions * there).sum(axis=1) / there.sum(axis=1)
        sizes = 2.0 * (now.tops - centre @ directions(self.scenario.dim).T).mean(axis=1)
        sizes *= _COUNT * math.tan(math.pi / _COUNT) if plane else 2.0 * math.pi
        for team in np.flatnonzero(sizes > (1.0 if plane else _NEARLY) * most).tolist():
            sizes[team] = size(now.positions[team][now.active[team]])
        return np.asarray(sizes)

    def look_at_mean(self) -> Found | None:
        """Initial condition whose mean time significantly exceeds the bound, if any."""
        if "expected_time" not in self.limits or len(self.met) % REPEATED:
            return None
        times = np.minimum(self.met, self.teams.time).reshape(-1, REPEATED)
        limit, mean = self.limits["expected_time"][::REPEATED], times.mean(axis=1)
        sure = mean - _CONFIDENCE * times.std(axis=1, ddof=1) / math.sqrt(REPEATED)
        if not (wrong := sure - self.held > limit).any():
            return None
        start = int(np.argmax(wrong))
        return "expected_time", start * REPEATED, float(mean[start]), float(limit[start])


def extents(places: Array, active: Mask, along: Array) -> Array:
    """Support max_i u·p_i of active robots for each direction u, (B, M), m."""
    reach = np.where(active[..., None], places @ along.T, -np.inf)
    return np.asarray(reach.max(axis=1))


def directions(dim: int, count: int = _COUNT) -> Array:
    """Evenly distributed unit vectors, (M, d); in 3-D on a spiral."""
    k = np.arange(count) + 0.5
    if dim == 2:
        return np.stack([np.cos(2 * np.pi * k / count), np.sin(2 * np.pi * k / count)], axis=-1)
    height, angle = 1.0 - 2.0 * k / count, np.pi * (1.0 + math.sqrt(5.0)) * k
    flat = np.sqrt(1.0 - height**2)
    return np.stack([flat * np.cos(angle), flat * np.sin(angle), height], axis=-1)
