"""The compiled step, run over the blocks of a batch by several threads."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from operator import call
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ..outcome import SCORES, StepOutput
from . import threads
from .memory import RUNNING
from .memory_layout import scratch
from .pace import Pace
from .preparation import constants, robot, sensor
from .stages.step import StepStages
from .state import State
from .threads import Calls, Part

_FLOAT32, _BOOL, _INT64 = np.dtype(np.float32), np.dtype(np.bool_), np.dtype(np.int64)
_WORK_PER_THREAD = 49152
"""Rows computed below which another thread costs more than it saves: 50 to 100 µs."""
_WORK_AHEAD = 12288
"""Rows that a thread computes while it takes another to wake up."""
_OBSTACLES, _ERRING, _PILOTED = 4, 2, 3
"""So many times as long take rows of obstacles, sensors that err, and steps with a pilot."""

_Seen = NDArray[np.float32]  # annotations within ``drive`` are looked up in every step
_Steps = Iterator[Callable[[], Any]]
Show = Callable[[Part, _Seen], Calls]
"""What looks at observations (B, n, rows, d) of some teams."""


class Pilot(Protocol):
    """What makes actions of what is seen, for some teams at a time: safety filters do."""

    keeps_ledger: bool
    """Whether it wants to learn how a step went."""

    @property
    def of_actions(self) -> Sequence[NDArray[Any]]:
        """What ``act_of`` tells of robots besides, (B, n) each; not copied."""
        ...

    def act_of(
        self, teams: Part, observations: NDArray[np.float32], actions: NDArray[np.float32]
    ) -> Calls:
        """What writes the actions of all robots of teams, from the first of a part to before its
        second.
        """
        ...

    def book_of(self, teams: Part, contact: Any, merged_into: Any, resting: Any) -> Calls:
        """What learns of their step: who touched an obstacle, (B, n), who is part of whom, (B, n),
        and which teams rested, (B,).
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
        self._state, self._num_threads = state, num_threads
        rows = 1 + place.neighbours + _OBSTACLES * (place.rows - place.neighbours)
        rows *= 1 if place.scenario.sensing.exact else _ERRING
        self._work_of_step = place.batch * n * rows
        self._pace = self._pace_of(1)
        self._paces: dict[int, Pace] = {}  # of decisions of so many steps
        self.robot = robot(place.scenario)
        self._sensor = sensor(state)
        self._scratch = [scratch(place) for _ in range(self._pace.most)]
        self.scratch = self._scratch[0]
        """Working memory, between steps."""
        seen, robots = place.scenario.observation_layout.shape, (place.batch, n)
        self._shapes = (*robots, *seen), (SCORES, place.batch), robots, (place.batch,)
        # to copy these is quicker than to fill
        self._all, self._far = np.ones(robots, np.bool_), np.full(robots, np.inf)
        self._crowded = np.full(place.batch, -1)
        self._last: StepOutput | None = None
        self._may_crowd = place.scenario.observation_layout.neighbour_slots < n - 1
        self._actions = np.zeros((place.batch, n, place.scenario.action_size), np.float32)
        self.limit(max_steps)

    def _pace_of(self, steps: int) -> Pace:
        """Of as many threads as have enough work each in so many steps, and the share of it that
        the first one does ahead of the others.
        """
        work = steps * self._work_of_step
        if (most := min(self._state.place.blocks, work // _WORK_PER_THREAD)) <= 1:
            return Pace(1, 0.0)  # to ask how many cores there are takes a while
        most = min(most, threads.most_threads(self._num_threads))
        return Pace(most, min(_WORK_AHEAD / work, 1.0))

    def limit(self, max_steps: int) -> None:
        """Let episodes end after so many steps."""
        found = constants(self._state.scenario, self.robot, max_steps)
        self._stages = StepStages(self._state, self.robot, found, self._sensor)

    def new_output(self) -> StepOutput:
        """Arrays for the output of a step, new but for ``crowded``, in which nothing touches an
        obstacle and no robot has merged, as in most steps; kernels write all else.
        """
        seen, scores, robots, teams = self._shapes
        return StepOutput(
            np.empty(seen, _FLOAT32),
            np.empty(scores),
            np.zeros(robots, _BOOL),
            self._far.copy(),
            self._all.copy(),
            np.empty(teams, _INT64),
            np.empty(robots),
            np.empty(teams, _INT64),
            self._crowded,
        )

    def step(self, actions: NDArray[np.float32]) -> StepOutput:
        """Advance all teams under actions (B, n, a), checked."""
        output = self.new_output()
        calls_of = self._step_calls(actions, output)
        blocks = self._state.place.blocks
        if (pace := self._pace).most == 1:  # what is left out here one environment would notice
            deque(map(call, calls_of((0, blocks, 0))), 0)
        else:
            threads.share(calls_of, blocks, pace.begin(), pace.ahead)
            pace.end()
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
        state, output, actions = self._state, self.new_output(), self._actions
        earned, robots_earned, touched = output.rewards, output.robot_rewards, output.contact
        if count > 1:
            earned, robots_earned = np.zeros_like(earned), np.zeros_like(robots_earned)
            touched = np.zeros_like(touched)
        lanes = self._state.lanes
        follows = self._state.scenario.on_merge == "follow"
        if (pace := self._paces.get(count)) is None:
            pace = self._paces[count] = self._pace_of(_PILOTED * count)
        while len(self._scratch) < pace.most:
            self._scratch.append(scratch(self._state.place))
        calls_of_step = self._step_calls(actions, output, always=count > 1)

        def step(part: Part, mine: Part, now: _Seen) -> _Steps:
            yield from pilot.act_of(mine, now, actions)
            yield from calls_of_step(part)
            if pilot.keeps_ledger:
                yield from pilot.book_of(mine, output.contact, state.merged_into, resting)

        def lead(part: Part, mine: Part) -> None:
            rows, now = slice(*mine[:2]), seen
            told = [one[rows] for one in pilot.of_actions]
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

        def calls_of(part: Part) -> Calls:
            mine = part[0] * lanes, min(part[1] * lanes, len(actions)), part[2]
            led = step(part, mine, seen) if count == 1 else [partial(lead, part, mine)]
            return [*led, *(show(mine, output.observations) if show is not None else ())]

        threads.share(calls_of, state.place.blocks, pace.begin(), pace.ahead)
        pace.end()
        self._last = output
        return Driven(output, earned, robots_earned, touched)

    def observe(self) -> StepOutput:
        """All environments as they are."""
        output = self.new_output()
        self._observe(range(self._state.place.blocks), output)
        return output

    def observe_again(self, which: NDArray[np.int64], output: StepOutput) -> NDArray[np.int64]:
        """Write anew the observations of some environments, and those of their blocks, which are
        the same: all these environments.
        """
        lanes, (batch,) = self._state.lanes, self._shapes[3]
        blocks = np.unique(which // lanes)
        self._observe(blocks.tolist(), output)
        rewritten = (blocks[:, np.newaxis] * lanes + np.arange(lanes)).reshape(-1)
        return rewritten[rewritten < batch]

    def _observe(self, blocks: Iterable[int], output: StepOutput) -> None:
        if self._may_crowd:
            output.crowded.fill(-1)
        calls = [
            one
            for block in blocks
            for one in self._stages.calls(block, block + 1, None, output, self.scratch)
        ]
        deque(map(call, [*calls, self._state.settle]), 0)

    def _step_calls(
        self, actions: NDArray[np.float32], output: StepOutput, *, always: bool = False
    ) -> Callable[[Part], list[Callable[[], Any]]]:
        """The calls that advance the blocks of a part, whose stages are compiled before any is
        called: an interrupt while they are changes nothing. Contacts and merges are first compiled
        when something can meet, or ``always``.
        """
        if self._may_crowd:
            output.crowded.fill(-1)
        stages, scratch, group = self._stages, self._scratch, self._state.place.group
        stages.collides = stages.collides or always or stages.can_collide()

        def calls_of(part: Part) -> list[Callable[[], Any]]:
            first, last, thread = part
            if last - first <= group:
                return stages.calls(first, last, actions, output, scratch[thread])
            return [
                one
                for start in range(first, last, group)
                for one in stages.calls(
                    start, min(start + group, last), actions, output, scratch[thread]
                )
            ]

        return calls_of
