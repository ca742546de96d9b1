"""A privileged reference: it knows the map and where everybody is, and plans.

What it passes cleanly says which starts are possible at all, and how fast: the ceiling for policies
that see bearings alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.experiment.checks import bools, refuse
from rendezvous_env.simulator import Simulator

from .policy import Policy, is_single_integrator, register, within_limits
from .roadmap import Array, Roadmap, WaysTo

if TYPE_CHECKING:
    from rendezvous_env.experiment.scenario import Scenario

NAME = "privileged-planner"
_CLEARANCES = tuple(0.1 * 0.5**k for k in range(8))
"""m; the widest with which all robots can meet is kept."""
_GRID = 13
"""Places along each side of a square grid that are tried; a second, finer one follows."""
_ARRIVED = 1e-5
"""Share of a full step within which a turn has been reached: what float32 leaves of it."""


@dataclass(frozen=True)
class Meeting:
    """Where a team meets."""

    place: Array
    """(2,), m."""
    left_out: int
    """Robots that cannot reach it."""


def meeting_place(roadmap: Roadmap, positions: Array) -> Meeting:
    """Where the last robot arrives first; among equals, where the ways together are shortest.

    Of the robots' own places, the corners of obstacles and a grid over the team; and then of a
    finer grid about the best of these.

    Args:
        roadmap: of the team.
        positions: (n, 2), m.
    """
    to_corners, _ = roadmap.to_corners(positions)
    low, high = positions.min(axis=0), positions.max(axis=0)
    places = np.concatenate([_grid(low, high), positions])
    ways = roadmap.distances(positions, to_corners, places)
    best = _best(np.concatenate([places, roadmap.corners]), np.hstack([ways, to_corners]))
    reach = (high - low).max() / (_GRID - 1)
    finer = np.concatenate([best.place[None], _grid(best.place - reach, best.place + reach)])
    return _best(finer, roadmap.distances(positions, to_corners, finer))


def _grid(low: Array, high: Array) -> Array:
    x, y = np.linspace(low, high, _GRID).T
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def _best(places: Array, ways: Array) -> Meeting:
    """Of places (K, 2), to which the ways (n, K) lead, m."""
    left_out = np.isinf(ways).sum(axis=0)
    ways = np.where(np.isinf(ways), 0.0, ways)
    chosen = np.lexsort((ways.sum(axis=0), ways.max(axis=0), left_out))[0]
    return Meeting(places[chosen], int(left_out[chosen]))


def plan(table: Array, positions: Array) -> WaysTo:
    """The ways on which a team meets soonest; who cannot get there stays where it is.

    Args:
        table: obstacles, (M, width), see ``experiment.packing``.
        positions: (n, 2), m.
    """
    found: tuple[Roadmap, Meeting] | None = None
    for clearance in _CLEARANCES:
        roadmap = Roadmap(table, clearance)
        meeting = meeting_place(roadmap, positions)
        if found is None or meeting.left_out < found[1].left_out:
            found = roadmap, meeting
        if meeting.left_out == 0:
            break
    assert found is not None
    return WaysTo(found[0], found[1].place)


class PrivilegedPlanner:
    """Every robot takes the shortest way to the place where the last of them arrives first.

    It goes at full speed from turn to turn, and shortens the step before one so that it never
    leaves its way. After a merge, which moves the survivor, ways start anew. It keeps some
    centimetres from obstacles where it can, and its V may rise.

    Args:
        scenario: single integrators in the plane.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self._simulator: Simulator | None = None
        self._goals: list[WaysTo | None] = []
        self._active: NDArray[np.bool_] = np.zeros((0, 0), np.bool_)
        self._steps: NDArray[np.int64] = np.zeros(0, np.int64)
        self._turns: Array = np.zeros((0, 0, 0, 2))
        self._next: NDArray[np.int64] = np.zeros((0, 0), np.int64)

    def watch(self, simulator: Simulator) -> None:
        """Take the teams whose map and positions it may read; call it before an episode.

        Args:
            simulator: freshly reset.

        Raises:
            ValueError: if it is no simulator of such robots.
        """
        wanted = f"a Simulator of {self.scenario.n_robots} single integrators in 2-D"
        if not isinstance(simulator, Simulator):
            refuse("simulator", simulator, wanted)
        scenario = simulator.scenario
        if not _fits(scenario) or scenario.n_robots != self.scenario.n_robots:
            refuse("simulator", scenario, wanted)
        self._simulator = simulator
        self._active, self._steps = simulator.active, simulator.steps
        self._turns = simulator.positions[:, :, None]
        self._next = np.zeros(self._active.shape, np.int64)
        self.reset()

    def reset(self, mask: NDArray[np.bool_] | None = None) -> None:
        """Plan anew at the next call, for the teams where ``mask`` (B,) is true or for all."""
        if self._simulator is not None:
            batch = self._simulator.num_envs
            chosen = (
                np.ones(batch, bool) if mask is None else bools("mask", mask, (batch,), "teams")
            )
            kept = self._goals if self._goals else [None] * batch
            self._goals = [None if anew else goal for anew, goal in zip(chosen, kept, strict=True)]

    def __call__(self, observations: NDArray[Any], time: ArrayLike) -> NDArray[np.float32]:
        """Velocities (..., n, 2), of the teams that it watches; see ``Policy``.

        Raises:
            RuntimeError: if it watches none.
            ValueError: if the observations are those of other teams.
        """
        seen = self.scenario.observation_layout.checked(observations)
        if (simulator := self._simulator) is None:
            raise RuntimeError(
                f"{NAME} reads positions: call its watch(simulator) before an episode, as rollout "
                "and compare do"
            )
        teams = (simulator.num_envs, self.scenario.n_robots)
        if seen.shape[:-2] not in (teams, teams[teams[0] == 1 :]):
            raise ValueError(
                f"observations have shape {seen.shape}; those of the teams that {NAME} watches "
                f"have {(*teams, *seen.shape[-2:])}"
            )
        velocities = self._velocities(simulator)
        return within_limits(velocities, self.scenario).reshape(*seen.shape[:-2], 2)

    def _velocities(self, simulator: Simulator) -> Array:
        """(B, n, 2), m/s, in the robots' own frames."""
        positions, active = simulator.positions, simulator.active
        self._keep_up(simulator, positions, active)
        speed, duration = simulator.scenario.speed_limit, simulator.scenario.tau
        rest, distance = self._to_next_turn(positions)
        self._next += distance <= _ARRIVED * speed * duration
        rest, distance = self._to_next_turn(positions)
        rate = np.minimum(speed / np.where(distance > 0, distance, 1.0), 1.0 / duration)
        x, y = np.moveaxis(np.where(active[..., None], rest * rate[..., None], 0.0), -1, 0)
        frames = simulator.frames  # local → global; their transpose leads back
        return np.stack(
            [
                frames[..., 0, 0] * x + frames[..., 1, 0] * y,
                frames[..., 0, 1] * x + frames[..., 1, 1] * y,
            ],
            axis=-1,
        )

    def _to_next_turn(self, positions: Array) -> tuple[Array, Array]:
        """The straight way (B, n, 2) to the turn that comes next, and its length (B, n), m."""
        self._next = np.minimum(self._next, self._turns.shape[2] - 1)
        turn = np.take_along_axis(self._turns, self._next[..., None, None], axis=2)[:, :, 0]
        rest = turn - positions
        return rest, np.hypot(rest[..., 0], rest[..., 1])

    def _keep_up(self, simulator: Simulator, positions: Array, active: NDArray[np.bool_]) -> None:
        """Plan for teams that begin an episode, and find new ways where robots have merged."""
        steps = simulator.steps
        begun = np.array([goal is None for goal in self._goals]) | (steps < self._steps)
        merged = (active != self._active).any(axis=1)
        self._active, self._steps = active, steps
        for team in np.flatnonzero((begun | merged) & (active.sum(axis=1) > 1)).tolist():
            here = positions[team]
            if begun[team] or self._goals[team] is None:
                self._goals[team] = plan(simulator.obstacles[team], here[active[team]])
            goal = self._goals[team]
            assert goal is not None
            for robot in np.flatnonzero(active[team]).tolist():
                self._put(team, robot, goal.way(here[robot]))

    def _put(self, team: int, robot: int, way: Array) -> None:
        """Keep a way; those that turn less often rest at their end."""
        if (more := len(way) - self._turns.shape[2]) > 0:
            self._turns = np.pad(self._turns, ((0, 0), (0, 0), (0, more), (0, 0)), mode="edge")
        self._turns[team, robot, : len(way)] = way
        self._turns[team, robot, len(way) :] = way[-1]
        self._next[team, robot] = 0


def _fits(scenario: Scenario) -> bool:
    return is_single_integrator(scenario) and scenario.dim == 2


@register(NAME, fits=_fits, kind="privileged")
def _privileged_planner(scenario: Scenario) -> Policy:
    """Shortest ways on the map to where the last robot arrives first."""
    return PrivilegedPlanner(scenario)
