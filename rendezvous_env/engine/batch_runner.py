"""Runner of step stages over the blocks of a batch, in several threads."""

from collections import deque
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from itertools import groupby, starmap
from operator import call
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ..compilation import entry_point
from ..outcome import SCORES, StepOutput
from . import threads
from .memory_layout import scratch
from .preparation import clocks, constants, events, robot, sensor, traffic
from .stages.conclude import add_step
from .state import BatchState
from .step import StepStages
from .thread_tuner import ThreadTuner
from .threads import Calls, Slice

_FLOAT32, _BOOL, _INT64 = np.dtype(np.float32), np.dtype(np.bool_), np.dtype(np.int64)
_WORK_PER_THREAD = 49152
"""Minimum number of computed rows per thread; below it, overhead of 50 to 100 µs dominates."""
_WORK_AHEAD = 12288
"""Rows that a thread computes while another thread wakes up."""
_OBSTACLES, _ERRING, _CONTROLLED = 4, 2, 3
"""Relative cost of obstacle rows, of imperfect sensors, and of steps with a controller."""

_FEW = 6
"""A group of blocks is observed as a whole if at least one in this number of its blocks needs it:
calls for one block take as long as for several."""

_Observations = NDArray[np.float32]  # annotations within ``step_n`` are looked up in every step
ObservationCallback = Callable[[Slice, _Observations], Calls]
"""Maps a slice of the batch and observations (B, n, rows, d) to calls that read them."""


class BatchController(Protocol):
    """Controller that maps observations to actions by slices of the batch, as safety filters do."""

    uses_feedback: bool
    """True if ``update_calls`` follow every step. An attribute ``reuses_calls``, if True, promises
    that calls can be made again in further steps, with the same arrays."""

    @property
    def action_diagnostics(self) -> Sequence[NDArray[Any]]:
        """Diagnostics that ``apply_calls`` write, (B, n) each; not copied."""
        ...

    def apply_calls(
        self, part: Slice, observations: NDArray[np.float32], actions: NDArray[np.float32]
    ) -> Calls:
        """Calls that write the actions of a slice's environments."""
        ...

    def update_calls(self, part: Slice, contact: Any, merged_into: Any, resting: Any) -> Calls:
        """Calls that process the result of a step.

        Arguments are contacts, (B, n), the robot that each one has merged into, (B, n), and the
        environments that did not step, (B,).
        """
        ...


class RolloutResult(NamedTuple):
    """Output of several consecutive steps."""

    output: StepOutput  # output of the last step
    rewards: NDArray[np.float64]  # (B,), sum over the steps
    robot_rewards: NDArray[np.float64]  # (B, n), sum over the steps
    contact: NDArray[np.bool_]  # (B, n), robots in contact in any of the steps


class DiagnosticsSnapshot:
    """Diagnostics of the last action of each robot, (B, n) each.

    ``restore`` undoes changes by a step for robots without ``part`` in it, (B, n).
    """

    def __init__(self, values: Sequence[NDArray[Any]], part: NDArray[np.bool_]) -> None:
        self._values, self._before = values, [one.copy() for one in values]
        self._inactive = ~part

    def restore(self) -> None:
        """Restore the diagnostics of robots outside ``part``."""
        for values, before in zip(self._values, self._before, strict=True):
            np.copyto(values, before, where=self._inactive)

    put_back = restore  # its name in version 0.2


class _ControlledSteps(NamedTuple):
    """Consecutive steps of a batch under a controller."""

    controller: BatchController
    state: BatchState
    actions: NDArray[np.float32]
    output: StepOutput
    resting: NDArray[np.bool_]  # (B,), environments that do not take part

    def calls(self, mine: Slice, observations: NDArray[np.float32], stages: Calls) -> Calls:
        """Calls of a step of some environments, from its ``stages``."""
        controller, output = self.controller, self.output
        calls = [*controller.apply_calls(mine, observations, self.actions), *stages]
        if controller.uses_feedback:
            outcome = output.contact, self.state.merged_into, self.resting
            calls += controller.update_calls(mine, *outcome)
        return calls

    def run(
        self,
        mine: Slice,
        observations: NDArray[np.float32],
        stages: Calls,
        count: int,
        add: Callable[[int, int, bool], Any],
    ) -> None:
        """Make several steps of some environments, and ``add`` up rewards and contacts."""
        reuses, rows = getattr(self.controller, "reuses_calls", False), slice(*mine[:2])
        diagnostics = [one[rows] for one in self.controller.action_diagnostics]
        follows = self.state.scenario.on_merge == "follow"
        for number in range(count):
            if number and diagnostics:
                part = ~self.resting[rows, None] & (follows | self.output.active[rows])
                snapshot = DiagnosticsSnapshot(diagnostics, part)
            if number < 2 or not reuses:  # the first step has other observations
                calls = self.calls(mine, observations, stages)
            for one in calls:
                one()
            if number and diagnostics:
                snapshot.restore()
            add(*mine[:2], number == count - 1)
            observations = self.output.observations


# names of version 0.2
Pilot, Driven, Show, Kept = BatchController, RolloutResult, ObservationCallback, DiagnosticsSnapshot


class BatchRunner:
    """Advances and observes B environments in at most ``num_threads`` threads.

    None is one thread per core. Episodes end after ``max_steps``.
    """

    def __init__(self, state: BatchState, num_threads: int | None, max_steps: int) -> None:
        place, n = state.place, state.place.scenario.n_robots
        self._state, self._num_threads = state, num_threads
        rows = 1 + place.neighbours + _OBSTACLES * (place.rows - place.neighbours)
        rows *= 1 if place.scenario.sensing.exact else _ERRING
        self._work_of_step = place.batch * n * rows
        self._tuner = self._tuner_of(1)
        self._tuners: dict[int, ThreadTuner] = {}  # by number of steps per call
        self.robot = robot(place.scenario)
        self._sensor, self._traffic = sensor(state), traffic(place.scenario)
        if self._traffic is not None:
            state.still_skins = self._traffic.skins
        self._clocks, self._events = clocks(place.scenario), events(place.scenario)
        self._scratch = [scratch(place) for _ in range(self._tuner.max_threads)]
        self.scratch = self._scratch[0]
        """Free working memory, between steps."""
        seen, robots = place.scenario.observation_layout.shape, (place.batch, n)
        self._shapes = (*robots, *seen), (SCORES, place.batch), robots, (place.batch,)
        # copying these is faster than filling
        self._all, self._far = np.ones(robots, np.bool_), np.full(robots, np.inf)
        self._overflow = np.full(place.batch, -1)
        self._last: StepOutput | None = None
        self._near: bool | None = None
        """True if a contact is possible in the next step; None if that is unknown."""
        self._may_overflow = place.scenario.observation_layout.neighbour_slots < n - 1
        self._add_step: Callable[..., Any] | None = None  # compiled on first use
        self._actions = np.zeros((place.batch, n, place.scenario.action_size), np.float32)
        self.limit(max_steps)

    def _tuner_of(self, steps: int) -> ThreadTuner:
        """Thread tuner for a number of steps.

        It limits the threads to those with enough work, and gives the first thread a larger share.
        """
        work = steps * self._work_of_step
        if (most := min(self._state.place.blocks, work // _WORK_PER_THREAD)) <= 1:
            return ThreadTuner(1, 0.0)  # querying the number of cores is slow
        most = min(most, threads.max_threads(self._num_threads))
        return ThreadTuner(most, min(_WORK_AHEAD / work, 1.0))

    def limit(self, max_steps: int) -> None:
        """Set the time limit of episodes, in steps."""
        found = constants(self._state.scenario, self.robot, max_steps)
        own = self._sensor, self._traffic, self._clocks, self._events
        self._stages = StepStages(self._state, self.robot, found, *own)

    def new_output(self) -> StepOutput:
        """Allocate the output of a step, new except for ``neighbour_overflow``.

        It is initialised without contacts and merges, as in most steps. Kernels write everything
        else.
        """
        seen, scores, robots, batch = self._shapes
        return StepOutput(
            np.empty(seen, _FLOAT32),
            np.empty(scores),
            np.zeros(robots, _BOOL),
            self._far.copy(),
            self._all.copy(),
            np.empty(batch, _INT64),
            np.empty(robots),
            np.empty(batch, _INT64),
            self._overflow,
        )

    def step(self, actions: NDArray[np.float32]) -> StepOutput:
        """Advance all environments under validated actions (B, n, a)."""
        output, place = self.new_output(), self._state.place
        blocks = place.blocks
        if (tuner := self._tuner).max_threads == 1:  # no threading overhead
            calls = self._calls_of_one_thread(actions, output)
            self._near = None  # unknown after an interrupt
            # one instruction, so an interrupt leaves all calls or none
            results = list(starmap(call, calls))
            self._near = results[-1] > 0
        else:
            calls_of = self._step_calls(actions, output)
            threads.share(calls_of, blocks, tuner.begin(), tuner.head_start)
            tuner.end()
        # keep this output alive until the next step: with both outputs freed at once, the system
        # would reclaim the memory, and zero it again in every step of large batches
        self._last = output
        return output

    def step_n(
        self,
        controller: BatchController,
        observations: NDArray[np.float32],
        resting: NDArray[np.bool_],
        count: int,
        callback: ObservationCallback | None = None,
    ) -> RolloutResult:
        """``Simulator.step_n``: each thread advances its own environments through all steps.

        Resting environments, (B,), skip the first step; the array is overwritten.
        """
        state, output, actions = self._state, self.new_output(), self._actions
        self._near = None
        lanes, totals = state.lanes, (output.rewards, output.robot_rewards, output.contact)
        if count > 1:
            totals = np.zeros_like(totals[0]), np.zeros_like(totals[1]), np.zeros_like(totals[2])
        if (tuner := self._tuners.get(count)) is None:
            tuner = self._tuners[count] = self._tuner_of(_CONTROLLED * count)
        while len(self._scratch) < tuner.max_threads:
            self._scratch.append(scratch(state.place))
        step_calls = self._step_calls(actions, output)
        steps = _ControlledSteps(controller, state, actions, output, resting)
        add = self._adding(output, resting, totals) if count > 1 else None

        def calls_of(part: Slice) -> Calls:
            mine = part[0] * lanes, min(part[1] * lanes, len(actions)), part[2]
            given = mine, observations, step_calls(part)
            calls = steps.calls(*given) if add is None else [partial(steps.run, *given, count, add)]
            seen = callback(mine, output.observations) if callback is not None else ()
            return [*calls, *seen]

        threads.share(calls_of, state.place.blocks, tuner.begin(), tuner.head_start)
        tuner.end()
        self._last = output
        return RolloutResult(output, *totals)

    def _adding(
        self, output: StepOutput, resting: NDArray[np.bool_], totals: tuple[NDArray[Any], ...]
    ) -> Callable[[int, int, bool], Any]:
        """Call of ``add_step`` for the environments from one to before another."""
        step = output.rewards, output.robot_rewards, output.contact
        given = output.status, resting, step, totals
        if self._add_step is None:
            self._add_step = entry_point(add_step, (*given, 0, 0, False))
        return partial(self._add_step, *given)

    def compile(self) -> None:
        """Compile all stages, as ``Simulator.compile``."""
        self._step_calls(self._actions, self.new_output())

    def observe(self) -> StepOutput:
        """Observe all environments in their current state."""
        output, place = self.new_output(), self._state.place
        starts = range(0, place.blocks, place.group)
        self._observe([(k, min(k + place.group, place.blocks)) for k in starts], output)
        return output

    def observe_again(self, which: NDArray[np.int64], output: StepOutput) -> NDArray[np.int64]:
        """Recompute the observations of some environments.

        The others of their blocks, or groups of blocks if many, are rewritten unchanged. Returns
        all these environments.
        """
        place, (batch,) = self._state.place, self._shapes[3]
        parts: list[tuple[int, int]] = []
        for first, blocks in groupby(np.unique(which // place.lanes).tolist(), self._group_of):
            found, stop = list(blocks), min(first + place.group, place.blocks)
            many = _FEW * len(found) >= stop - first
            parts += [(first, stop)] if many else [(block, block + 1) for block in found]
        self._observe(parts, output)
        ends = [(first * place.lanes, min(stop * place.lanes, batch)) for first, stop in parts]
        return np.concatenate([which[:0], *(np.arange(*each) for each in ends)])

    def _group_of(self, block: int) -> int:
        """First block of the group that stages process together."""
        return block - block % self._state.place.group

    def _observe(self, parts: Iterable[tuple[int, int]], output: StepOutput) -> None:
        if self._may_overflow:
            output.neighbour_overflow.fill(-1)
        calls = [
            one
            for part in parts
            for one in self._stages.calls(*part, None, output, self.scratch, False)
        ]
        self._near = None
        deque(starmap(call, [*calls, (self._state.settle,)]), 0)

    def _step_calls(
        self, actions: NDArray[np.float32], output: StepOutput
    ) -> Callable[[Slice], list[Callable[[], Any]]]:
        """Calls that advance the blocks of a slice.

        All stages are compiled before any is called, so an interrupt during compilation changes
        nothing.
        """
        if self._may_overflow:
            output.neighbour_overflow.fill(-1)
        stages, scratch, group = self._stages, self._scratch, self._state.place.group

        def calls_of(part: Slice) -> list[Callable[[], Any]]:
            first, last, thread = part
            return [
                partial(one[0], *one[1:])
                for start in range(first, last, group)
                for one in stages.calls(
                    start, min(start + group, last), actions, output, scratch[thread], True
                )
            ]

        if not stages.all_compiled:
            stages.calls(0, 1, actions, output, self.scratch, True)
        return calls_of

    def _calls_of_one_thread(
        self, actions: NDArray[np.float32], output: StepOutput
    ) -> list[tuple[Any, ...]]:
        """Calls that advance all blocks in one thread, as ``StepStages.calls``.

        With few blocks, contacts and merges are neither called nor compiled until they can occur.
        """
        stages, blocks = self._stages, self._state.place.blocks
        if blocks > self._state.place.group:
            return [(one,) for one in self._step_calls(actions, output)((0, blocks, 0))]
        if self._may_overflow:
            output.neighbour_overflow.fill(-1)
        if (near := self._near) is None:
            near = stages.all_compiled or stages.any_near()  # unnecessary calls cost little
        return stages.calls(0, blocks, actions, output, self.scratch, near)
