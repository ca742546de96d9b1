"""Oracle planner with the map and all positions: an upper bound for bearing-only policies."""

from typing import NamedTuple

import numpy as np

from rendezvous_env.obstacles.moving import moves
from rendezvous_env.scenario.scenario import Scenario
from rendezvous_env.simulator import Simulator

from ..policy import Mask, register
from ..steering import can_steer
from .privileged_laws import PrivilegedPolicy, without_overshoot
from .roadmap import Array, PathsTo, Roadmap

NAME = "privileged-planner"
_CLEARANCES = tuple(0.5**k for k in range(1, 9))
"""Candidate clearances, in merge radii; the largest feasible one is used."""
_GRID = {2: 13, 3: 7}  # points along each side of a grid
_ARRIVED = 1e-5  # of a full step; tolerance at waypoints, for float32


class Meeting(NamedTuple):
    """Meeting point of a team."""

    place: Array  # (d,), m
    left_out: int  # robots that cannot reach it


def meeting_place(roadmap: Roadmap, positions: Array) -> Meeting:
    """Point that minimises the latest arrival, then the total path length.

    Candidates are the robots' positions, (n, d), m, the corners of obstacles and a grid over the
    team. A finer grid around the best of these follows.
    """
    to_corners, _ = roadmap.to_corners(positions)
    low, high = positions.min(axis=0), positions.max(axis=0)
    places = np.concatenate([_grid(low, high), positions])
    ways = roadmap.distances(positions, to_corners, places)
    best = _best(np.concatenate([places, roadmap.corners]), np.hstack([ways, to_corners]))
    reach = (high - low).max() / (_GRID[positions.shape[1]] - 1)
    finer = np.concatenate([best.place[None], _grid(best.place - reach, best.place + reach)])
    return _best(finer, roadmap.distances(positions, to_corners, finer))


def _grid(low: Array, high: Array) -> Array:
    axes = np.linspace(low, high, _GRID[len(low)]).T
    return np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, len(low))


def _best(places: Array, ways: Array) -> Meeting:
    """Best of K candidate points, (K, d), with path lengths (n, K), m."""
    left_out = np.isinf(ways).sum(axis=0)
    ways = np.where(np.isinf(ways), 0.0, ways)
    chosen = np.lexsort((ways.sum(axis=0), ways.max(axis=0), left_out))[0]
    return Meeting(places[chosen], int(left_out[chosen]))


def plan(table: Array, positions: Array, merge_radius: float) -> PathsTo:
    """Paths for the earliest meeting of robots at (n, d), m, with merge radius r, m.

    ``table`` holds the obstacles. Robots without a path stay in place.
    """
    found: list[tuple[Roadmap, Meeting]] = []
    for clearance in _CLEARANCES:
        roadmap = Roadmap(table, clearance * merge_radius, positions.shape[1])
        found.append((roadmap, meeting_place(roadmap, positions)))
        if found[-1][1].left_out == 0:
            break
    roadmap, meeting = min(found, key=lambda pair: pair[1].left_out)
    return PathsTo(roadmap, meeting.place)


def _can_plan(scenario: Scenario) -> bool:
    """True for supported robot models, and obstacles that do not move."""
    return can_steer(scenario) and not moves(scenario.obstacles)


@register(NAME, _can_plan, kind="privileged")
class PrivilegedPlanner(PrivilegedPolicy):
    """Shortest paths on the map to the point of earliest meeting.

    Robots move at full speed and shorten the step before a waypoint, so they stay on their path;
    nonholonomic robots turn on the spot. Paths are replanned after a merge. The clearance to
    obstacles is r/2, or less if necessary. V may increase.
    """

    name = NAME

    def watch(self, simulator: Simulator) -> None:
        """As ``PrivilegedPolicy.watch``."""
        super().watch(simulator)
        self._active = simulator.active
        self._goals: list[PathsTo | None] = [None] * simulator.num_envs
        self._turns = simulator.positions[:, :, None].copy()  # waypoints of robots, (B, n, P, d)
        self._next = np.zeros(self._active.shape, np.int64)

    def _velocities(self, simulator: Simulator, active: Mask, begun: Mask) -> Array:
        positions, scenario = simulator.positions.copy(), simulator.scenario
        self._update_plans(simulator, positions, active, begun)
        distance = np.linalg.norm(self._to_next_turn(positions), axis=-1)
        self._next += distance <= _ARRIVED * scenario.speed_limit * scenario.tau
        return without_overshoot(self._to_next_turn(positions), scenario)

    def _to_next_turn(self, positions: Array) -> Array:
        """Offset (B, n, d) to the next waypoint, m."""
        self._next = np.minimum(self._next, self._turns.shape[2] - 1)
        turn = np.take_along_axis(self._turns, self._next[..., None, None], axis=2)[:, :, 0]
        return turn - positions

    def _update_plans(
        self, simulator: Simulator, positions: Array, active: Mask, begun: Mask
    ) -> None:
        """Plan for environments that were reset, and replan where robots have merged."""
        merged = (active != self._active).any(axis=1)
        self._active = active
        for team in np.flatnonzero((begun | merged) & (active.sum(axis=1) > 1)).tolist():
            here, goal = positions[team], self._goals[team]
            if begun[team] or goal is None:
                table, radius = simulator.obstacles[team].copy(), simulator.scenario.merge_radius
                goal = self._goals[team] = plan(table, here[active[team]], radius)
            for robot in np.flatnonzero(active[team]).tolist():
                way = goal.way(here[robot])
                if (more := len(way) - self._turns.shape[2]) > 0:
                    longer = (0, 0), (0, 0), (0, more), (0, 0)
                    self._turns = np.pad(self._turns, longer, mode="edge")
                self._turns[team, robot, : len(way)] = way
                self._turns[team, robot, len(way) :] = way[-1]  # it rests at the end
                self._next[team, robot] = 0
