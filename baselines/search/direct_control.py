"""Speeds and turn rates chosen by a network, and a robot's memory of its search."""

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from rendezvous_env.checks import check_shape, floats
from rendezvous_env.engine.state_checks import StatefulMixin, check_mask, check_observations
from rendezvous_env.engine.threads import Calls, Slice
from rendezvous_env.safety.safety_filter import SafetyFilter, over_teams
from rendezvous_env.scenario.scenario import Scenario

from ..network_actions import check_choices, raise_not_finite
from ..policy import Float32, Mask
from ..records import Array, Records
from .memory_kernels import EDGES, FIELDS, Body, command, move_memory, show_memory


class SearchMemory(StatefulMixin):
    """Memory of the robots of B environments, see ``memory_kernels``, and its features.

    Args:
        scenario: of unicycles.
        num_envs: B.
        layout: of the features, with a number of ``neighbour_slots`` and ``obstacle_slots``.
    """

    def __init__(self, scenario: Scenario, num_envs: int, layout: Any) -> None:
        rows, robots = scenario.observation_layout, (num_envs, scenario.n_robots)
        self.layout = layout
        self.body = Body(
            rows.neighbour_slots,
            float(scenario.merge_radius),
            float(scenario.action_bounds[0]),
            float(scenario.action_bounds[1]),
            float(scenario.tau),
        )
        self._records = Records(robots, FIELDS)
        self._edges = np.zeros((*robots, rows.obstacle_slots, EDGES))

    @property
    def arrays(self) -> tuple[Array, Array]:
        """Memory of robots, (B, n, size), and of obstacles, (B, n, M, EDGES); not copied."""
        return self._records.array, self._edges

    @property
    def _memory(self) -> dict[str, Array]:
        return {"edges": self._edges, **self._records.views}


class DirectCommands(SafetyFilter):
    """Filter that passes on chosen speeds and turn rates, without a guarantee.

    Args:
        scenario: of unicycles.
        num_envs: B.
        memory: updated in every step.
        num_threads: as of ``SafetyFilter``.
    """

    chooses_vectors = False

    def __init__(
        self,
        scenario: Scenario,
        num_envs: int,
        memory: SearchMemory,
        num_threads: int | None = None,
    ) -> None:
        super().__init__(scenario, num_envs, 2, "local", num_threads)
        self._search = memory

    def apply_calls(
        self, part: Slice, observations: Float32, actions: Float32, elapsed: float | None = None
    ) -> Calls:
        """As ``SafetyFilter.apply_calls``."""
        memory = self._search
        passed = memory.body.tau if elapsed is None else float(elapsed)
        given = self.held, memory.body, memory.arrays, passed
        return [partial(command, part, observations, *given, actions)]


class DirectController:
    """Speeds and turn rates from a network, for B environments.

    The interface is that of ``BaseController``: show → (a network chooses) → choose → apply.

    Args:
        commands: choices, (choices, 2): speed and turn rate in units of their limits.
        scenario: of unicycles; a ValueError for other robots.
        num_envs: B.
        layout: as of ``SearchMemory``.
        num_threads: as of ``SafetyFilter``.
    """

    uses_feedback = False
    action_diagnostics = ()
    tank = bodies = None

    def __init__(
        self,
        commands: ArrayLike,
        scenario: Scenario,
        num_envs: int,
        layout: Any,
        num_threads: int | None = None,
    ) -> None:
        check_searches(scenario)
        self.perception = memory = SearchMemory(scenario, num_envs, layout)
        self._seen = num_envs, scenario.n_robots, *scenario.observation_layout.shape
        self._limits = np.array([memory.body.speed, memory.body.turn_rate])
        self._table = np.array(commands)
        self.steering = DirectCommands(scenario, num_envs, memory, num_threads)
        self.choices = np.zeros(self._seen[:2], dtype=np.int64)
        self._num_threads = num_threads

    def settle(self, share: float) -> None:
        """Account for the previous step, which lasted this fraction of τ."""
        if share != 1.0:
            body = self.perception.body
            move_memory(self.perception.arrays, (share - 1.0) * body.tau, body)

    def show(
        self,
        shown: Float32,
        observations: Float32,
        which: Mask | None = None,
        elapsed: Array | None = None,
    ) -> Float32:
        """Features (B, n, size) of environments of a mask (B,); see ``BaseController.show``."""
        observations, memory = check_observations(observations, self._seen), self.perception
        teams = np.arange(len(observations))
        if which is not None:
            teams = np.flatnonzero(check_mask(which, len(observations)))
        slots = memory.layout.neighbour_slots, memory.layout.obstacle_slots
        given = teams, observations, memory.arrays, memory.body, slots, shown
        over_teams(
            lambda part: [partial(show_memory, part, *given)],
            len(teams),
            self._seen[1],
            self._num_threads,
        )
        return shown

    def choose(self, choices: ArrayLike) -> None:
        """Set choices (B, n) until the next call; a ValueError names the robot of a wrong one."""
        self.choices = check_choices(choices, self.choices.shape, len(self._table))
        self.head(self._table[self.choices])

    def head(self, vectors: ArrayLike) -> None:
        """Set speeds and turn rates (B, n, 2) in units of their limits, in place of choices.

        A ValueError names the robot whose vector is not finite.
        """
        given = floats("actions", vectors)
        check_shape("actions", given, (*self.choices.shape, 2), axes="(B, n, 2)")
        raise_not_finite(given)
        self.steering.held[...] = np.clip(given, -1.0, 1.0) * self._limits

    def apply(self, observations: Float32, *, elapsed: float | None = None) -> Float32:
        """Actions (B, n, 2), as ``BaseController.apply``."""
        return self.steering.apply(observations, elapsed=elapsed)

    def apply_calls(
        self, part: Slice, observations: Float32, actions: Float32, elapsed: float | None = None
    ) -> Calls:
        """As ``apply``, unchecked, for a slice, with output ``actions``."""
        return self.steering.apply_calls(part, observations, actions, elapsed)

    def update_calls(self, part: Slice, contact: Any, merged_into: Any, resting: Any) -> Calls:
        """No operation, see ``uses_feedback``."""
        return ()

    def forget(self, which: Mask | None = None) -> None:
        """Clear the memory of all environments or of those of a mask (B,)."""
        self.steering.forget(which)
        self.perception.forget(which)


def check_searches(scenario: Scenario) -> None:
    """Raise a ValueError for robots other than unicycles."""
    if scenario.robot_model != "unicycle":
        raise ValueError(
            f"scenario {scenario.name!r} has {scenario.model.name} robots; a network without a "
            "filter (guarantee 'none') commands unicycles"
        )
