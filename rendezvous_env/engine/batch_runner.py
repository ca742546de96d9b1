"""The compiled step, run over the blocks of a batch by several threads."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ..compilation import entry_point
from ..outcome import SCORES, StepOutput
from ..physics.random_streams import ignore_overflow
from . import threads
from .memory import RUNNING
from .memory_layout import scratch
from .preparation import constants, layout, robot, sensor
from .stages.step import step_blocks
from .state import State
from .thread_tuner import ThreadTuner
from .threads import Calls, Slice

_FLOAT32, _BOOL, _INT64 = np.dtype(np.float32), np.dtype(np.bool_), np.dtype(np.int64)
_WORK_PER_THREAD = 49152
"""Rows computed below which another thread costs more than it saves: 50 to 100 µs."""
_WORK_AHEAD = 12288
"""Rows that a thread computes while it takes another to wake up."""
_OBSTACLES, _ERRING, _PILOTED = 4, 2, 3
"""So many times as long take rows of obstacles, sensors that err, and steps with a pilot."""

_Seen = NDArray[np.float32]  # annotations within ``drive`` are looked up in every step
_Steps = Iterator[Callable[[], Any]]
Show = Callable[[Slice, _Seen], Calls]
"""What looks at observations (B, n, rows, d) of some teams."""


class Pilot(Protocol):
    """Turns observations into actions, by slices of the batch, as safety filters do."""

    uses_feedback: bool
    """Whether ``update_calls`` follow every step."""

    @property
    def action_diagnostics(self) -> Sequence[NDArray[Any]]:
        """Diagnostics that ``apply_calls`` write, (B, n) each; not copied."""
        ...

    def apply_calls(
        self, part: Slice, observations: NDArray[np.float32], actions: NDArray[np.float32]
    ) -> Calls:
        """Calls that write the actions of the environments of a slice."""
        ...

    def update_calls(self, part: Slice, contact: Any, merged_into: Any, resting: Any) -> Calls:
        """Calls that record the outcome of a step: contacts, (B, n), the robot that each one is
        part of, (B, n), and the environments that did not step, (B,).
        """
        ...


class Driven(NamedTuple):
    """What some steps in a row give out."""

    output: StepOutput  # Of the last one
    rewards: NDArray[np.float64]  # (B,), of all of them
    robot_rewards: NDArray[np.float64]  # (B, n), likewise
    contact: NDArray[np.bool_]  # (B, n), whether the robot touched an obstacle in any of them


class Kept:
    """What is told of the last action of each robot of some teams: what a step would tell of those
    that take no ``part`` in it, (B, n), is undone.
    """

    def __init__(self, told: Sequence[NDArray[Any]], part: NDArray[np.bool_]) -> None:
        self._told, self._before, self._gone = told, [one.copy() for one in told], ~part

    def put_back(self) -> None:
        """Undo what has been told since of robots that were gone."""
        for values, before in zip(self._told, self._before, strict=True):
            np.copyto(values, before, where=self._gone)


class BatchRunner:
    """Advances and observes B teams, by at most ``num_threads`` threads, None for one of each core;
    episodes end after ``max_steps``.
    """

    def __init__(self, state: State, num_threads: int | None, max_steps: int) -> None:
        place, n = state.place, state.place.scenario.n_robots
        self._state, self._parts, self._num_threads = state, state.parts(), num_threads
        rows = 1 + place.neighbours + _OBSTACLES * (place.rows - place.neighbours)
        rows *= 1 if place.scenario.sensing.exact else _ERRING
        self._work_of_step = place.batch * n * rows
        self._tuner = self._tuner_of(1)
        self._tuners: dict[int, ThreadTuner] = {}  # of decisions of so many steps
        self.layout, self.robot = layout(place), robot(place.scenario)
        self._sensor = sensor(state)
        self._scratch = [scratch(place) for _ in range(self._tuner.max_threads)]
        self.team_scratch = self._scratch[0][1]
        """Working memory for one team."""
        self._blocks = np.arange(place.blocks)
        seen, robots = place.scenario.observation_layout.shape, (place.batch, n)
        self._shapes = (*robots, *seen), (SCORES, place.batch), robots, (place.batch,)
        self._everybody = np.ones(robots, np.bool_)  # to copy it is quicker than to fill
        self._crowded = np.full(place.batch, -1)
        self._last: StepOutput | None = None
        self._may_crowd = place.scenario.observation_layout.neighbour_slots < n - 1
        self._actions = np.zeros((place.batch, n, place.scenario.action_size), np.float32)
        self._run: Callable[..., Any] | None = None
        self.limit(max_steps)

    def _tuner_of(self, steps: int) -> ThreadTuner:
        """Of as many threads as have enough work each in so many steps, and the share of it that
        the first one does ahead of the others.
        """
        work = steps * self._work_of_step
        if (most := min(self._state.place.blocks, work // _WORK_PER_THREAD)) <= 1:
            return ThreadTuner(1, 0.0)  # to ask how many cores there are takes a while
        most = min(most, threads.max_threads(self._num_threads))
        return ThreadTuner(most, min(_WORK_AHEAD / work, 1.0))

    def limit(self, max_steps: int) -> None:
        """Let episodes end after so many steps."""
        found = constants(self._state.scenario, self.robot, max_steps)
        self._setup = self.layout, found, self.robot

    def new_output(self) -> StepOutput:
        """Room for what a step gives out, fresh but for ``crowded``, in which nobody touches an
        obstacle and no robot has merged, as in most steps; kernels write what is otherwise.
        """
        seen, scores, robots, teams = self._shapes
        return StepOutput(
            np.empty(seen, _FLOAT32),
            np.empty(scores),
            np.zeros(robots, _BOOL),
            np.empty(robots),
            self._everybody.copy(),
            np.empty(teams, _INT64),
            np.empty(robots),
            np.empty(teams, _INT64),
            self._crowded,
        )

    def step(self, actions: NDArray[np.float32]) -> StepOutput:
        """Advance all teams under actions (B, n, a), checked."""
        output = self.new_output()
        advance = self._work(True, self._blocks, actions, output)
        blocks = len(self._blocks)
        if (tuner := self._tuner).max_threads == 1:  # a single team would feel what is left out
            advance((0, blocks, 0))()
        else:
            threads.share(lambda part: [advance(part)], blocks, tuner.begin(), tuner.head_start)
            tuner.end()
        # the next step's arrays come from other memory: where both steps' were free at once, the
        # system would take it back, and clear it anew for every step of large teams
        self._last = output
        return output

    def drive(
        self,
        pilot: Pilot,
        seen: NDArray[np.float32],
        resting: NDArray[np.bool_],
        count: int,
        show: Show | None = None,
    ) -> Driven:
        """``Simulator.drive``: each thread leads its own teams through all steps; those that are
        resting, (B,), pass the first one by; it is written to.
        """
        teams, output, actions = self._state.teams, self.new_output(), self._actions
        earned, robots_earned, touched = output.rewards, output.robot_rewards, output.contact
        if count > 1:
            earned, robots_earned = np.zeros_like(earned), np.zeros_like(robots_earned)
            touched = np.zeros_like(touched)
        lanes = self._state.lanes
        follows = self._state.scenario.on_merge == "follow"
        if (tuner := self._tuners.get(count)) is None:
            tuner = self._tuners[count] = self._tuner_of(_PILOTED * count)
        while len(self._scratch) < tuner.max_threads:
            self._scratch.append(scratch(self._state.place))
        advance = self._work(True, self._blocks, actions, output)

        def step(part: Slice, mine: Slice, now: _Seen) -> _Steps:
            yield from pilot.apply_calls(mine, now, actions)
            yield advance(part)
            if pilot.uses_feedback:
                yield from pilot.update_calls(mine, output.contact, teams.merged_into, resting)

        def lead(part: Slice, mine: Slice) -> None:
            rows, now = slice(*mine[:2]), seen
            told = [one[rows] for one in pilot.action_diagnostics]
            for number in range(count):
                if number:
                    np.not_equal(output.status[rows], RUNNING, out=resting[rows])
                    output.contact[rows] = False
                    kept = Kept(told, ~resting[rows, None] & (follows | output.active[rows]))
                for one in step(part, mine, now):
                    one()
                if number:
                    kept.put_back()
                earned[rows] += output.rewards[rows]
                robots_earned[rows] += output.robot_rewards[rows]
                touched[rows] |= output.contact[rows]
                now = output.observations

        def calls_of(part: Slice) -> Calls:
            mine = part[0] * lanes, min(part[1] * lanes, len(actions)), part[2]
            led = step(part, mine, seen) if count == 1 else [partial(lead, part, mine)]
            return [*led, *(show(mine, output.observations) if show is not None else ())]

        threads.share(calls_of, len(self._blocks), tuner.begin(), tuner.head_start)
        tuner.end()
        self._last = output
        return Driven(output, earned, robots_earned, touched)

    def observe(self) -> StepOutput:
        """All teams as they are."""
        output = self.new_output()
        self._observe(self._blocks, output)
        return output

    def observe_again(self, which: NDArray[np.int64], output: StepOutput) -> NDArray[np.int64]:
        """Write anew what some teams see, and those of their blocks, which see the same: all these
        teams.
        """
        lanes, (batch,) = self._state.lanes, self._shapes[3]
        blocks = np.unique(which // lanes)
        self._observe(blocks, output)
        teams = (blocks[:, np.newaxis] * lanes + np.arange(lanes)).reshape(-1)
        return teams[teams < batch]

    def _observe(self, blocks: NDArray[np.int64], output: StepOutput) -> None:
        self._work(False, blocks, self._actions, output)((0, len(blocks), 0))()

    def _work(
        self,
        moves: bool,
        blocks: NDArray[np.int64],
        actions: NDArray[np.float32],
        output: StepOutput,
    ) -> Callable[[Slice], Callable[[], Any]]:
        """What steps or observes a part of some blocks; compiled here, which may be interrupted."""
        if self._may_crowd:
            output.crowded.fill(-1)
        written, scratch = tuple(output), self._scratch
        fixed = moves, blocks, self._setup, self._sensor, self._parts
        if (run := self._run) is None:
            # of actions that may be written to, as those of callers need not be
            arguments = (0, 0, 0), *fixed, np.empty_like(actions), written, scratch[0]
            run = self._run = ignore_overflow(entry_point(step_blocks, arguments))

        return lambda part: partial(run, part, *fixed, actions, written, scratch[part[2]])
