"""Search and pursuit from bearings alone, for unicycles whose cameras see part of the plane."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.checks import positive
from rendezvous_env.scenario.observation_layout import ObservedRows
from rendezvous_env.scenario.scenario import Scenario

from ..policy import Float32, Mask, StatefulPolicy, of_model, register, within_limits

Array = NDArray[np.float64]
_PERIODS = 20.0  # minimum of ``remember``, time steps
_SMOOTHING = 10.0  # time constant of the memory of bearings, time steps
_ALIGNED = 0.5  # rad; a robot drives within this angle of the desired direction
_CLEARANCE = 0.25  # rad, of the desired direction from obstacle edges
_GRAZING = 0.05  # rad, of the axis of a driving robot from obstacle edges
_VARIATION = 40.0  # cycles of the leg length per rad of the last bearing
_COMMITMENT = 0.5  # weight of the angle from the axis in the choice of an edge
_UNKNOWN = math.inf  # distance driven since an obstacle was seen, if none was


def turned(vectors: Array, angles: Array) -> Array:
    """Vectors (..., 2) rotated counter-clockwise by angles (...), rad."""
    c, s = np.cos(angles), np.sin(angles)
    x, y = vectors[..., 0], vectors[..., 1]
    return np.stack([c * x - s * y, s * x + c * y], axis=-1)


def wrapped(angles: Array) -> Array:
    """Angles in [−π, π), rad."""
    return (angles + np.pi) % (2.0 * np.pi) - np.pi


def intervals_of(edges: Array) -> tuple[Array, Array]:
    """Middles and half-widths, rad, of obstacles with edges (..., 2, 2), counter-clockwise first.

    The half-width is −π for an obstacle with zero edges.
    """
    angles = np.arctan2(edges[..., 1], edges[..., 0])
    half = 0.5 * ((angles[..., 0] - angles[..., 1]) % (2.0 * np.pi))
    middle = wrapped(angles[..., 1] + half)
    return middle, np.where(np.any(edges, axis=(-1, -2)), half, -np.pi)


def are_blocked(angles: Array, middles: Array, halves: Array, clearance: float) -> NDArray[Any]:
    """True for angles (...) nearer than a clearance, rad, to an interval of (..., M)."""
    apart = np.abs(wrapped(middles - angles[..., np.newaxis]))
    blocked: NDArray[Any] = np.any(apart < halves + clearance, axis=-1)
    return blocked


def clear_angles(wanted: Array, middles: Array, halves: Array) -> Array:
    """Angle of the best clear direction of each robot, (N,), rad, from the robot's axis.

    Candidates are the ends of the M intervals, widened by the clearance. The best one has the
    smallest angle from the desired direction plus ``_COMMITMENT`` times its angle from the axis. It
    is π/2 if no candidate is clear.
    """
    reach = halves + _CLEARANCE
    candidates = np.concatenate([middles + reach, middles - reach], axis=-1)
    inside = np.abs(wrapped(candidates[:, :, np.newaxis] - middles[:, np.newaxis]))
    valid = np.concatenate([halves, halves], axis=-1) > -np.pi
    valid &= ~np.any(inside < reach[:, np.newaxis] - 1e-6, axis=-1)
    cost = np.abs(wrapped(candidates - wanted[:, np.newaxis]))
    cost += _COMMITMENT * np.abs(wrapped(candidates))
    cost[~valid] = np.inf
    best, robots = cost.argmin(axis=-1), np.arange(len(cost))
    chosen = wrapped(candidates[robots, best])
    return np.where(np.isfinite(cost[robots, best]), chosen, 0.5 * np.pi)


@register("search-and-pursue", fits=of_model("unicycle"), kind="rule")
@dataclass
class SearchAndPursue(StatefulPolicy):
    """Pursues the net bearing, remembers it out of view, then searches in scans and straight legs.

        m ← R(−ωτ) e^(−τ/T) m + f,   ω = m's angle/τ,   v = v_max where |angle| < 0.5 rad

    Memories turn with the robot's own commands. A robot without a bearing for ``remember`` scans a
    full turn, drives a leg, and repeats both. It scans on the spot, or on a circle once it has seen
    a robot and the scenario has no obstacles: the circle sweeps a blind zone. The last bearing seen
    scales the leg by 0.5 to 1.5, so that adjacent robots do not search in parallel.

    Obstacle edges are remembered until the robot has driven ``leg``/2. It takes the clear direction
    next to the desired one, and drives only if its axis is clear.

    Args:
        scenario: scenario of unicycles.
        remember: time for which a bearing is pursued out of view, s; None is r/v_max, or 20 time
            steps if longer.
        leg: mean length of a straight leg, m; None is 2r.
    """

    scenario: Scenario
    remember: Any = None
    leg: Any = None

    def __post_init__(self) -> None:
        scenario = self.scenario
        r, speed, tau = scenario.merge_radius, scenario.speed_limit, scenario.tau
        usual = max(r / speed, _PERIODS * tau)
        self.remember = usual if self.remember is None else positive("remember", self.remember, "s")
        self.leg = 2.0 * r if self.leg is None else positive("leg", self.leg, "m")
        self._turn_limit = float(scenario.action_bounds[1])
        self._scan_time, self._leg_time = 2.0 * math.pi / self._turn_limit, self.leg / speed

    def _start(self, teams: int) -> None:
        robots = teams, self.scenario.n_robots
        slots = self.scenario.observation_layout.obstacle_slots
        self._bearing = np.zeros((*robots, 2))
        self._unseen = np.full(robots, self.remember)  # time since a robot was seen, s
        self._searched = np.zeros(robots)  # duration of the search, s
        self._has_seen = np.zeros(robots, dtype=np.bool_)
        self._leg_scale = np.ones(robots)
        self._edges = np.zeros((*robots, slots, 2, 2))
        self._driven = np.full((*robots, slots), _UNKNOWN)  # m since an obstacle was seen
        self._inputs = np.zeros((*robots, 2))  # of the previous call

    def _forget(self, which: Mask) -> None:
        self._unseen[which], self._driven[which] = self.remember, _UNKNOWN
        self._leg_scale[which] = 1.0
        for memory in (self._bearing, self._searched, self._has_seen, self._edges, self._inputs):
            memory[which] = 0

    def act(self, observations: NDArray[Any], time: ArrayLike) -> Float32:
        """Actions (..., n, 2): v, m/s, and ω, rad/s; see ``Policy``."""
        return self.after(self.scenario.tau, observations, time)

    def after(self, elapsed: float, observations: NDArray[Any], time: ArrayLike) -> Float32:
        """Actions ``elapsed`` s after the previous call; see ``RealTimePolicy``."""
        rows = self.scenario.observation_layout.split(self._teams_of(observations))
        self._dead_reckon(elapsed)
        self._see(rows)
        pursues = self._unseen < self.remember
        phase = self._searched % (self._scan_time + self._leg_time * self._leg_scale)
        scans = ~pursues & (phase < self._scan_time)
        towards = np.arctan2(self._bearing[..., 1], self._bearing[..., 0])
        self._inputs = self._drive(np.where(pursues, towards, 0.0), scans)
        return self._as_given(within_limits(self._inputs, self.scenario))

    def _dead_reckon(self, elapsed: float) -> None:
        """Turn and age the memories by the inputs of the previous call."""
        angles = -self._inputs[..., 1] * elapsed
        fading = math.exp(-elapsed / (_SMOOTHING * self.scenario.tau))
        self._bearing = fading * turned(self._bearing, angles)
        self._unseen += elapsed
        self._searched += elapsed
        if self._driven.size:
            self._edges = turned(self._edges, angles[..., np.newaxis, np.newaxis])
            self._driven += (self._inputs[..., 0] * elapsed)[..., np.newaxis]

    def _see(self, rows: ObservedRows) -> None:
        """Update the memories by the rows that are present."""
        f, sees = rows.neighbours.sum(axis=-2, dtype=np.float64), np.any(rows.neighbours, (-1, -2))
        self._bearing += f
        varied = 0.5 + _VARIATION * np.arctan2(f[..., 1], f[..., 0]) % 1.0
        self._leg_scale = np.where(sees, varied, self._leg_scale)
        self._has_seen |= sees
        self._unseen[sees] = 0.0
        self._searched[self._unseen < self.remember] = 0.0
        seen = np.any(rows.obstacles, axis=(-1, -2))
        self._edges[seen], self._driven[seen] = rows.obstacles[seen], 0.0
        self._edges[self._driven >= 0.5 * self.leg] = 0.0

    def _drive(self, towards: Array, scans: NDArray[Any]) -> Array:
        """Speeds and turn rates, (B, n, 2), for desired directions (B, n), rad from the axis."""
        clear: Any = True
        if self._driven.size:
            middles, halves = intervals_of(self._edges)
            blocked = are_blocked(towards, middles, halves, _CLEARANCE)
            towards[blocked] = clear_angles(towards[blocked], middles[blocked], halves[blocked])
            clear = ~are_blocked(np.zeros_like(towards), middles, halves, _GRAZING)
        limit, fastest = self._turn_limit, self.scenario.speed_limit
        rates = np.clip(towards / self.scenario.tau, -limit, limit)
        speeds = np.where(clear & (np.abs(towards) < _ALIGNED), fastest * np.cos(towards), 0.0)
        circling = fastest if self._driven.size == 0 else 0.0
        speeds = np.where(scans, circling * self._has_seen, speeds)
        return np.stack([speeds, np.where(scans, limit, rates)], axis=-1)
