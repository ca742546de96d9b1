"""What a learned policy is shown: tables made from the robot's own observations, and its memory.

Nothing here knows a position or a distance. The tables are in the frame with x along f, so a policy
that reads them does not notice how the world is turned.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.silhouettes import TWO_PI, joined_interval_2d
from rendezvous_env.compilation import allocating_kernel, kernel
from rendezvous_env.engine.state_checks import (
    check_entries,
    check_finite,
    check_mask,
    check_numbers,
    check_observations,
)
from rendezvous_env.experiment.scenario import Scenario
from rendezvous_env.guarantee.heading import scale_of_step

VERSION = 2
"""Of what the columns mean; a network trained with another one cannot read the tables."""
NEIGHBOUR_COLUMNS = 3
"""Unit bearing x, y; gain a_ij, m/s."""
OBSTACLE_COLUMNS = 6
"""Counter-clockwise edge x, y; clockwise edge x, y; how fast each turns, rad/s."""
CONTEXT_COLUMNS = 22
"""‖f‖/D; ‖f‖, m/s, at most 2; 1/number of neighbours; time since the start, min, and how fresh it
is; own velocity and direction of f, averaged over a short and a long time, x, y each; how fast f
turns, rad/s; the carried heading, x, y; of the silhouettes joined before f whether they leave
nothing free, whether any is seen, both edges and the gaps beyond them, rad."""
FASTEST = 3.0
"""Turn rates are cut off here, rad/s."""
SHORT, LONG = 1.0, 5.0
"""Times over which is averaged, s."""
_FRESH = 8.0  # s


class Perceived(NamedTuple):
    """What one robot is shown, taken apart; every part is a view."""

    neighbours: Any
    """(..., K, NEIGHBOUR_COLUMNS); zero rows are absent."""
    obstacles: Any
    """(..., M, OBSTACLE_COLUMNS); zero rows are absent."""
    context: Any
    """(..., CONTEXT_COLUMNS)."""


class PerceptionLayout(NamedTuple):
    """Which part of a flat row of numbers is what. Nobody else counts columns."""

    neighbour_slots: int
    """K."""
    obstacle_slots: int
    """M."""

    @property
    def size(self) -> int:
        """Numbers for each robot."""
        sets = self.neighbour_slots * NEIGHBOUR_COLUMNS + self.obstacle_slots * OBSTACLE_COLUMNS
        return sets + CONTEXT_COLUMNS

    def split(self, shown: Any) -> Perceived:
        """Take (..., size) apart, an array or a tensor."""
        leading, K, M = shown.shape[:-1], self.neighbour_slots, self.obstacle_slots
        stop = K * NEIGHBOUR_COLUMNS
        return Perceived(
            shown[..., :stop].reshape(*leading, K, NEIGHBOUR_COLUMNS),
            shown[..., stop:-CONTEXT_COLUMNS].reshape(*leading, M, OBSTACLE_COLUMNS),
            shown[..., -CONTEXT_COLUMNS:],
        )


class Memory(NamedTuple):
    """What robots remember from decision to decision, in their local frames."""

    edges: NDArray[np.float64]
    """(B, n, M, 2, 2), edges of obstacles at the last decision; zero where none was seen."""
    towards: NDArray[np.float64]
    """(B, n, 2), direction of f then; zero before the first decision."""
    averages: NDArray[np.float64]
    """(B, n, 4, 2), of the velocity over SHORT and LONG, of the direction of f over both."""
    time: NDArray[np.float64]
    """(B, n), s since the first decision."""


class _Constants(NamedTuple):
    neighbour_slots: int
    decision_time: float
    merge_radius: float
    duration: float
    speed_limit: float


def check_readable(scenario: Scenario) -> None:
    """Refuse robots that a learned policy cannot steer.

    Raises:
        ValueError: unless they are single integrators in the plane.
    """
    if scenario.robot_model != "single_integrator" or scenario.dim != 2:
        raise ValueError(
            f"scenario {scenario.name!r} has {scenario.robot_model} robots in {scenario.dim}-D; "
            "learned policies steer single_integrator robots in 2-D"
        )


class Perception:
    """Shows B teams of n robots to a network, once for each decision.

    Args:
        scenario: whose robots see.
        num_envs: B.
        decision_time: s between two decisions of a team.
        obstacle_slots: M, at least the scenario's; further rows are absent. None is the scenario's.

    Raises:
        ValueError: for robots that it cannot show, or too few obstacle slots.
    """

    def __init__(
        self,
        scenario: Scenario,
        num_envs: int,
        *,
        decision_time: float,
        obstacle_slots: int | None = None,
    ) -> None:
        check_readable(scenario)
        rows = scenario.observation_layout
        slots = rows.obstacle_slots if obstacle_slots is None else obstacle_slots
        if slots < rows.obstacle_slots:
            raise ValueError(
                f"obstacle_slots is {slots}; scenario {scenario.name!r} needs "
                f"{rows.obstacle_slots} or more"
            )
        self.layout = PerceptionLayout(rows.neighbour_slots, slots)
        self._constants = _Constants(
            neighbour_slots=rows.neighbour_slots,
            decision_time=float(decision_time),
            merge_radius=float(scenario.merge_radius),
            duration=float(scenario.tau),
            speed_limit=float(scenario.speed_limit),
        )
        robots = num_envs, scenario.n_robots
        self._seen = (*robots, *rows.shape)
        self._memory = Memory(
            edges=np.zeros((*robots, rows.obstacle_slots, 2, 2)),
            towards=np.zeros((*robots, 2)),
            averages=np.zeros((*robots, 4, 2)),
            time=np.zeros(robots),
        )

    def see(
        self,
        observations: NDArray[np.float32],
        headings: NDArray[np.float64],
        which: NDArray[np.bool_] | None = None,
    ) -> NDArray[np.float32]:
        """What the robots are shown; brings the memory up to date.

        Args:
            observations: (B, n, rows, 2), in the robots' own frames.
            headings: those carried, (B, n, 2), in the same frames; zero where there is none.
            which: (B,), whose memory moves on; the others are shown as zeros. None is all teams.

        Returns:
            (B, n, layout.size); zeros for a robot without neighbours.

        Raises:
            ValueError: for arrays of another shape or type; nothing has changed then.
        """
        observations = check_observations(observations, self._seen)
        headings = check_numbers("headings", headings, self._memory.towards.shape, "(B, n, 2)")
        teams = np.arange(len(observations))
        if which is not None:
            teams = np.flatnonzero(check_mask(which, len(observations)))
        shown = np.zeros((*observations.shape[:2], self.layout.size), dtype=np.float32)
        _show(teams, observations, headings, self._constants, self._memory, shown)
        return shown

    def forget(self, mask: NDArray[np.bool_] | None = None) -> None:
        """Forget what all teams saw, or those of a mask (B,).

        Raises:
            ValueError: for a bad mask; nothing has changed then.
        """
        which = slice(None) if mask is None else check_mask(mask, len(self._memory.time))
        for array in self._memory:
            array[which] = 0.0

    def get_state(self) -> dict[str, NDArray[np.float64]]:
        """The memory, as copies."""
        return {name: array.copy() for name, array in self._memory._asdict().items()}

    def set_state(self, state: Mapping[str, ArrayLike]) -> None:
        """Put back what ``get_state`` took out.

        Raises:
            ValueError: naming what does not fit, see ``check_state``; nothing has changed then.
        """
        for name, array in self.check_state(state).items():
            getattr(self._memory, name)[...] = array

    def check_state(self, state: Any) -> dict[str, NDArray[Any]]:
        """The arrays of a state that ``set_state`` would put back.

        Raises:
            ValueError: naming an entry that is missing, of another shape or not finite.
        """
        checked = check_entries(self._memory._asdict(), state)
        check_finite(checked, tuple(checked))
        return checked


@allocating_kernel
def _show(teams, observations, headings, constants, memory, shown):  # type: ignore[no-untyped-def]
    """Fill the rows of ``shown`` (B, n, size) that belong to these teams."""
    K, M = constants.neighbour_slots, memory.edges.shape[2]
    intervals = np.empty((M, 2))
    for k in range(len(teams)):
        team = teams[k]
        for i in range(observations.shape[1]):
            rows, out = observations[team, i], shown[team, i]
            f, degree, count = _sum_of(rows[:K])
            if count == 0:
                continue
            strength = math.hypot(f[0], f[1])
            u = (f[0] / strength, f[1] / strength, 0.0) if strength > 0.0 else (1.0, 0.0, 0.0)
            _show_neighbours(rows[:K], u, out)
            for m in range(M):
                first = K * NEIGHBOUR_COLUMNS + m * OBSTACLE_COLUMNS
                edges, before = rows[K + 2 * m : K + 2 * m + 2], memory.edges[team, i, m]
                _show_obstacle(
                    edges, u, before, constants.decision_time, out[first : first + OBSTACLE_COLUMNS]
                )
            context = out[out.shape[0] - CONTEXT_COLUMNS :]
            context[0], context[1] = strength / degree, min(strength, 2.0)
            context[2] = 1.0 / count
            _show_motion(team, i, f, degree, u, headings[team, i], constants, memory, context[3:16])
            silhouettes = rows[K : K + 2 * M].reshape((M, 2, 2))
            _show_joined(joined_interval_2d(u, silhouettes, intervals), context[16:])


@kernel
def _sum_of(rows):  # type: ignore[no-untyped-def]
    """f, D and the number of neighbours."""
    x, y, degree, count = 0.0, 0.0, 0.0, 0
    for k in range(rows.shape[0]):
        gain = math.hypot(rows[k, 0], rows[k, 1])
        if gain > 0.0:
            x, y, degree, count = x + rows[k, 0], y + rows[k, 1], degree + gain, count + 1
    return (x, y), degree, count


@kernel
def _along(vector, u, out):  # type: ignore[no-untyped-def]
    """Write a vector in the frame with x along u."""
    out[0] = vector[0] * u[0] + vector[1] * u[1]
    out[1] = vector[1] * u[0] - vector[0] * u[1]


@kernel
def _turn_rate(before, now, time):  # type: ignore[no-untyped-def]
    """From one direction to another, rad/s counter-clockwise, cut off at FASTEST."""
    across = before[0] * now[1] - before[1] * now[0]
    rate = math.atan2(across, before[0] * now[0] + before[1] * now[1]) / time
    return min(max(rate, -FASTEST), FASTEST)


@kernel
def _show_neighbours(rows, u, out):  # type: ignore[no-untyped-def]
    for k in range(rows.shape[0]):
        gain = math.hypot(rows[k, 0], rows[k, 1])
        if gain > 0.0:
            place = out[k * NEIGHBOUR_COLUMNS : (k + 1) * NEIGHBOUR_COLUMNS]
            _along((rows[k, 0] / gain, rows[k, 1] / gain), u, place)
            place[2] = gain


@kernel
def _show_obstacle(edges, u, before, time, out):  # type: ignore[no-untyped-def]
    """Write both edges of an obstacle and how fast they turned since the last decision."""
    if edges[0, 0] == 0.0 and edges[0, 1] == 0.0:
        before[:] = 0.0
        return
    known = before[0, 0] != 0.0 or before[0, 1] != 0.0
    for s in range(2):
        _along(edges[s], u, out[2 * s : 2 * s + 2])
        if known:
            out[4 + s] = _turn_rate(before[s], edges[s], time)
        before[s, 0], before[s, 1] = edges[s, 0], edges[s, 1]


@kernel
def _show_motion(team, i, f, degree, u, heading, constants, memory, out):  # type: ignore[no-untyped-def]
    """Write and remember what only time tells: own motion, turning of f, the carried heading."""
    towards, averages = memory.towards[team, i], memory.averages[team, i]
    first = towards[0] == 0.0 and towards[1] == 0.0
    speed = heading[0] * f[0] + heading[1] * f[1]
    speed *= scale_of_step(degree, constants.merge_radius, constants.duration)
    speed = min(max(speed, -constants.speed_limit), constants.speed_limit)
    for axis in range(2):
        for k in range(4):
            now = speed * heading[axis] if k < 2 else u[axis]
            before = averages[k, axis] if not first else (0.0 if k < 2 else now)
            kept = math.exp(-constants.decision_time / (SHORT if k % 2 == 0 else LONG))
            averages[k, axis] = kept * before + (1.0 - kept) * now
    out[0] = memory.time[team, i] / 60.0
    out[1] = math.exp(-memory.time[team, i] / _FRESH)
    for k in range(4):
        _along(averages[k], u, out[2 + 2 * k : 4 + 2 * k])
    if not first:
        out[10] = _turn_rate(towards, u, constants.decision_time)
    _along(heading, u, out[11:13])
    towards[0], towards[1] = u[0], u[1]
    memory.time[team, i] += constants.decision_time


@kernel
def _show_joined(joined, out):  # type: ignore[no-untyped-def]
    """Write the interval of silhouettes before f."""
    low, high, gap_below, gap_above = joined
    if high < low:
        return
    if high - low >= TWO_PI:
        out[0] = 1.0
        return
    out[1], out[2], out[3], out[4], out[5] = 1.0, high, low, gap_above, gap_below
