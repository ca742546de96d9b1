"""What stands between a policy and its robots: choices held, and the frames a policy looks along.

Everything here comes from the robots' own observations: no position, no global frame.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..engine.state_checks import (
    check_entries,
    check_finite,
    check_mask,
    check_observations,
    check_rotations,
)
from ..experiment.checks import choice, floats, shown, whole
from ..experiment.limits import MOST_TEAMS
from ..experiment.scenario import Scenario
from .frames import look_along_net_bearing
from .teams import over_teams

FRAMES = ("net_bearing", "local")
_LARGEST_FLOAT32 = float(np.finfo(np.float32).max)
_ROUNDING = 1e-6
"""So far from a rotation may a frame be that was put back."""


class _Sight(NamedTuple):
    """What looking along f takes to know."""

    neighbour_slots: int
    dead_zone: float


def _check_steerable(scenario: Scenario) -> None:
    """A heading becomes a velocity along it, or the turn rates of a body: nothing else is driven by
    law (4).
    """
    model = scenario.model
    if not model.bounded and model.theorem is None:
        raise ValueError(
            f"scenario has {model.name} robots, whose action is {model.action}; law (4) steers "
            "robots whose action is a velocity, or a speed and turn rates, as robot_model "
            "'single_integrator', 'unicycle' and 'nonholonomic_3d'"
        )


def check_goes_anywhere(scenario: Scenario, theorem: str) -> None:
    """Refuse robots whose action is not their velocity.

    Args:
        scenario: whose robots they are.
        theorem: which needs it, in words.

    Raises:
        ValueError: naming the robot model.
    """
    model = scenario.model
    if not model.bounded:
        raise ValueError(
            f"scenario has {model.name} robots, whose action is {model.action}; {theorem} needs "
            "robots whose action is their velocity, as robot_model 'single_integrator'"
        )


class ActionFilter(ABC):
    """What the policies of B teams chose, held, and what the robots do because of it.

    A subclass says what that is (``act``) and what more is remembered (``_memory``).

    Args:
        scenario: whose robots they are.
        num_envs: B.
        action_size: numbers that a policy chooses for a robot.
        frame: "net_bearing" (x along f; single integrators only, the other models keep the body
            frame) or "local".
        num_threads: most threads that may be used; None is one for each core.

    Raises:
        ValueError: naming the argument, its value and what would be right.
    """

    chooses_vectors = True
    """Whether a choice is a vector, which turns with the frame it is seen in."""
    lowest_choice = -1.0
    """The least that each number of a choice can be; the most is 1."""
    keeps_ledger = False
    """Whether it wants to be told how a step went, see ``book``."""
    observes_level = False
    """Whether ``view`` adds one row, the level of a robot's own tank."""

    def __init__(
        self,
        scenario: Scenario,
        num_envs: int,
        *,
        action_size: int,
        frame: str,
        num_threads: int | None,
    ) -> None:
        _check_steerable(scenario)
        dead_zone = scenario.dead_zone if scenario.dead_zone > 0 else 1.0
        choice("frame", frame, FRAMES)
        if num_threads is not None:
            num_threads = whole("num_threads", num_threads, 1, MOST_TEAMS)
        n, d, layout = scenario.n_robots, scenario.dim, scenario.observation_layout
        self.scenario = scenario
        self.turns_body = scenario.model.nonholonomic
        self.along_net_bearing = frame == "net_bearing" and not self.turns_body
        self.action_size = action_size
        self._sight = _Sight(layout.neighbour_slots, float(dead_zone))
        self._batch = num_envs, n, num_threads
        self._seen = (num_envs, n, *layout.shape)
        self._frames = np.tile(np.eye(d), (num_envs, n, 1, 1))
        self._held = np.zeros((num_envs, n, action_size))
        self.alignment = np.full((num_envs, n), np.nan)
        self.lyapunov_rate = np.zeros((num_envs, n))

    @property
    def told(self) -> dict[str, NDArray[Any]]:
        """What there is to tell of the last step, (B, n) each; not copied."""
        return {"alignment": self.alignment, "lyapunov_rate": self.lyapunov_rate}

    @property
    def _memory(self) -> dict[str, NDArray[np.float64]]:
        """What is remembered from step to step; not copied."""
        return {"frames": self._frames, "held": self._held}

    def forget(self, mask: NDArray[np.bool_] | None = None) -> None:
        """Forget everything about all teams, or about those of a mask (B,).

        Raises:
            ValueError: for a bad mask; nothing has changed then.
        """
        self._begin(slice(None) if mask is None else check_mask(mask, len(self._held)))

    def _begin(self, which: Any) -> None:
        """Remember of these teams what is known before an episode."""
        self._frames[which] = np.eye(self.scenario.dim)
        self._held[which] = 0.0
        self.alignment[which] = np.nan
        self.lyapunov_rate[which] = 0.0

    def view(self, observations: NDArray[np.float32]) -> NDArray[np.float32]:
        """Observations as the policy sees them; brings the frames up to date.

        Args:
            observations: (B, n, rows, d), in the robots' own frames.

        Returns:
            Of the same shape; with x along f where that is asked for, unchanged otherwise.

        Raises:
            ValueError: for observations of another shape or type; nothing has changed then.
        """
        observations = check_observations(observations, self._seen)
        if not self.along_net_bearing:
            return observations
        seen = np.empty_like(observations)
        first_rows = self.scenario.observation_layout.obstacles.stop

        fixed = (observations, self._sight, first_rows, self._frames, seen)
        over_teams(lambda part: look_along_net_bearing(part, *fixed), *self._batch)
        return seen

    def hold(self, raw: ArrayLike) -> None:
        """Take new choices, fixed in the robots' local frames from now on.

        Args:
            raw: (B, n, k): vectors (d,) as the policy sees them, or numbers in the body frame.

        Raises:
            ValueError: for a wrong shape, or naming the robot whose choice is not finite.
        """
        vectors = floats("actions", raw)
        if vectors.shape != self._held.shape:
            raise ValueError(
                f"actions have shape {vectors.shape}; they must be (B, n, k) = {self._held.shape}"
            )
        if not (finite := np.abs(vectors) <= _LARGEST_FLOAT32).all():
            team, robot, _ = (int(k) for k in np.argwhere(~finite)[0])
            raise ValueError(
                f"action of robot_{robot} in team {team} is "
                f"{shown(vectors[team, robot].tolist())}; it must be finite, in float32"
            )
        if self.along_net_bearing and self.chooses_vectors:
            vectors = np.einsum("bnij,bnj->bni", self._frames, vectors)
        self._held[...] = vectors

    @abstractmethod
    def act(self, observations: NDArray[np.float32]) -> NDArray[np.float32]:
        """Actions for the base environment; sets what is ``told``.

        Args:
            observations: (B, n, rows, d), in the robots' own frames.

        Returns:
            (B, n, a) float32; zero for robots that see no neighbour.

        Raises:
            ValueError: for observations of another shape or type; nothing has changed then.
        """

    def book(  # noqa: B027 - most keep no ledger
        self,
        contact: ArrayLike | None = None,
        merged_into: ArrayLike | None = None,
        resting: ArrayLike | None = None,
    ) -> None:
        """Learn how the step went in which the actions last given were held; see ``keeps_ledger``.

        Args:
            contact: (B, n) bool, whether the robot touched an obstacle; None is nobody.
            merged_into: (B, n) int, the robot that each one is now part of, itself while it is on
                its own; None: nobody knows.
            resting: (B,) bool, teams that the step passed by; None is no team.

        Raises:
            ValueError: for another shape or type, or a robot that is none; nothing has changed
                then.
        """

    def get_state(self) -> dict[str, NDArray[np.float64]]:
        """The memory, as copies."""
        return {name: array.copy() for name, array in self._memory.items()}

    def set_state(self, state: Mapping[str, ArrayLike]) -> None:
        """Put back what ``get_state`` took out.

        Raises:
            ValueError: naming what does not fit, see ``check_state``; nothing has changed then.
        """
        checked = self.check_state(state)
        for name, array in self._memory.items():
            array[...] = checked[name]

    def check_state(self, state: Any) -> dict[str, NDArray[Any]]:
        """The arrays of a state that ``set_state`` would put back.

        Raises:
            ValueError: naming an entry that is missing, of another shape or not finite, or a frame
                that is no rotation.
        """
        checked = check_entries(self._memory, state)
        check_finite(checked, tuple(checked))
        check_rotations(checked, np.ones(len(self._held), np.bool_), _ROUNDING)
        return checked
