"""The compiled step, run over the blocks of a batch by several threads."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..compilation import entry_point
from ..outcome import StepOutput
from ..physics.random_streams import ignore_overflow
from . import threads
from .memory_layout import MemoryLayout, OutputBuffers, scratch
from .preparation import constants, layout, robot, sensor
from .stages.step import step_blocks
from .state import State

_WORK_PER_THREAD = 32768
"""Rows computed below which another thread costs more than it saves: some 70 µs, as long as a
sleeping thread takes to wake."""


class BatchRunner:
    """Advances and observes B teams.

    Args:
        state: of the teams.
        num_threads: most threads that may be used; None is one for each core.
        max_steps: after which episodes end.
    """

    def __init__(self, state: State, num_threads: int | None, max_steps: int) -> None:
        place, n = state.place, state.place.scenario.n_robots
        self._state, self._parts = state, state.parts()
        self.width = _width(place, num_threads)
        """Threads of a step."""
        self.layout, self.robot = layout(place), robot(place.scenario)
        self._sensor = sensor(state)
        self._scratch = [scratch(place) for _ in range(self.width)]
        self.team_scratch = self._scratch[0][1]
        """Working memory for one team."""
        self._blocks = np.arange(place.blocks)
        self.buffers = OutputBuffers(place)
        """Where it writes what it gives out."""
        self._last: StepOutput | None = None
        self._may_crowd = place.scenario.observation_layout.neighbour_slots < n - 1
        self._no_actions = np.zeros((place.batch, n, place.scenario.action_size), np.float32)
        self._run: Callable[..., Any] | None = None
        self.limit(max_steps)

    def limit(self, max_steps: int) -> None:
        """Let episodes end after so many steps."""
        self._constants = constants(self._state.scenario, max_steps)

    def step(self, actions: NDArray[np.float32]) -> StepOutput:
        """Advance all teams.

        Args:
            actions: (B, n, a), checked.
        """
        output = self.buffers.new()
        self._share(True, self._blocks, actions, output, self.width)
        # the next step's arrays come from other memory: where both steps' were free at once, the
        # system would take it back, and clear it anew for every step of large teams
        self._last = output
        return output

    def observe(self) -> StepOutput:
        """All teams as they are."""
        output = self.buffers.new()
        self._share(False, self._blocks, self._no_actions, output, 1)
        return output

    def observe_again(self, which: NDArray[np.int64], output: StepOutput) -> None:
        """Write anew what some teams see; those that share a block with them see the same."""
        blocks = np.unique(which // self._state.lanes)
        self._share(False, blocks, self._no_actions, output, 1)

    def _share(
        self,
        moves: bool,
        blocks: NDArray[np.int64],
        actions: NDArray[np.float32],
        output: StepOutput,
        width: int,
    ) -> None:
        """Let up to ``width`` threads step or observe some blocks."""
        if self._may_crowd:
            output.crowded.fill(-1)
        setup = (self.layout, self._constants, self.robot)
        fixed = (moves, blocks, setup, self._sensor, self._parts)
        written, scratch = tuple(output), self._scratch
        if (run := self._run) is None:  # before threads share it: compiling may be interrupted
            writable = (np.empty_like(actions), written, scratch[0])
            run = entry_point(step_blocks, ((0, 0, 0), *fixed, *writable))
            run = self._run = ignore_overflow(run)
        if width == 1:  # as ``share`` would, without the way there
            run(threads.part_of_all(len(blocks)), *fixed, actions, written, scratch[0])
        else:
            threads.share(
                lambda part: run(part, *fixed, actions, written, scratch[part[2]]),
                len(blocks),
                width,
            )


def _width(place: MemoryLayout, num_threads: int | None) -> int:
    """As many threads as have so much work, in rows, each."""
    n, layout = place.scenario.n_robots, place.scenario.observation_layout
    rows = n * (place.neighbours + 1 + layout.rows - layout.neighbour_slots)
    most = threads.most_threads(num_threads)
    return max(1, min(most, place.batch * rows // _WORK_PER_THREAD, place.blocks))
