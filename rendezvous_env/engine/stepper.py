"""The compiled step, run over the blocks of a batch by several threads."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..compilation import entry_point
from .allocation import Arrangement, Forms, hands_of_threads, lanes_of_threads
from .memory import Results
from .pool import threads
from .pool.sharing import example_part
from .preparation import constants, layout, robot, sensor
from .quiet import quietly
from .state import State
from .step import step_blocks

_WORK_PER_THREAD = 32768
"""Rows computed below which another thread costs more than it saves: some 70 µs, as long as a
sleeping thread takes to wake. Between the steps of a learner they sleep."""
_WORK_PER_AWAKE_THREAD = 4096
"""The same in a loop that does hardly anything but step, which finds them awake."""
_CLOSE = 5e-5
"""From the end of a step to the next in such a loop, s; threads stay awake three times as long."""
_CLOSE_STEPS = 8
"""How many close steps make a loop."""


class Stepper:
    """Advances and observes B teams.

    Args:
        state: of the teams.
        num_threads: most threads that may be used; None is one for each core.
        max_steps: after which episodes end.
    """

    def __init__(self, state: State, num_threads: int | None, max_steps: int) -> None:
        place, n = state.place, state.place.scenario.n_robots
        self._state = state
        self._sure_width = _width(place, num_threads, _WORK_PER_THREAD)
        self.width = max(self._sure_width, _width(place, num_threads, _WORK_PER_AWAKE_THREAD))
        """Most threads of a step."""
        self._ended, self._close_steps = -math.inf, 0
        self.layout, self.robot = layout(place), robot(place.scenario)
        self._sensor = sensor(state)
        self.hands = hands_of_threads(place, self.width)
        """Working memory for one team, with a leading axis for the threads."""
        self._at_work = tuple(lanes_of_threads(place, self.width)), tuple(self.hands)
        self._blocks = np.arange(place.blocks)
        self.forms = Forms(place)
        """Where it writes what it gives out."""
        self._last: Results | None = None
        self._may_crowd = place.scenario.observation_layout.neighbour_slots < n - 1
        self._no_actions = np.zeros((place.batch, n * place.scenario.action_size), np.float32)
        self._run: Callable[..., Any] | None = None
        self.limit(max_steps)

    def limit(self, max_steps: int) -> None:
        """Let episodes end after so many steps."""
        self._constants = constants(self._state.scenario, max_steps)

    def step(self, actions: NDArray[np.float32]) -> Results:
        """Advance all teams.

        Args:
            actions: (B, n, a), checked.
        """
        results = self.forms.new()
        table = actions.reshape(self._state.batch, -1)
        self._share(True, self._blocks, table, results, self._width_now())
        self._ended = time.perf_counter()
        # the next step's arrays come from other memory: where both steps' were free at once, the
        # system would take it back, and clear it anew for every step of large teams
        self._last = results
        return results

    def _width_now(self) -> int:
        """Threads for this step: for little work several only if they are awake anyway."""
        if self.width == self._sure_width:
            return self.width
        close = time.perf_counter() - self._ended < _CLOSE
        self._close_steps = self._close_steps + 1 if close else 0
        return self.width if self._close_steps >= _CLOSE_STEPS else self._sure_width

    def observe(self) -> Results:
        """All teams as they are."""
        results = self.forms.new()
        self._share(False, self._blocks, self._no_actions, results, 1)
        return results

    def observe_again(self, which: NDArray[np.int64], results: Results) -> None:
        """Write anew what some teams see; those that share a block with them see the same."""
        blocks = np.unique(which // self._state.lanes)
        self._share(False, blocks, self._no_actions, results, 1)

    def _share(
        self,
        moves: bool,
        blocks: NDArray[np.int64],
        table: NDArray[np.float32],
        results: Results,
        width: int,
    ) -> None:
        """Let up to ``width`` threads step or observe some blocks."""
        if self._may_crowd:
            results.crowded.fill(-1)
        state = self._state
        seen_by = (self.robot, self._sensor)
        fixed = (moves, blocks, self.layout, self._constants, *seen_by, tuple(state.teams))
        kept, written = (state.links, state.obstacles), (tuple(results), *self._at_work)
        given = (*kept, table, *written)
        if (run := self._run) is None:  # before threads share it: compiling may be interrupted
            writable = (*kept, np.empty_like(table), *written)
            run = entry_point(step_blocks, (example_part(), *fixed, *writable))
            run = self._run = quietly(run)
        if width == 1:  # as ``share`` would, without the way there
            run(threads.part_of_all(len(blocks)), *fixed, *given)
        else:
            threads.share(lambda part: run(part, *fixed, *given), len(blocks), width)


def _width(place: Arrangement, num_threads: int | None, work: int) -> int:
    """As many threads as have so much work, in rows, each."""
    n, layout = place.scenario.n_robots, place.scenario.observation_layout
    rows = n * (place.neighbours + 1 + layout.rows - layout.neighbour_slots)
    most = threads.most_threads(num_threads)
    return max(1, min(most, place.batch * rows // work, place.blocks))
