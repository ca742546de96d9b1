"""The energy tank: wishes in, actions out. The memory and the arithmetic behind theorem D's
wrappers and policies.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..engine.state_checks import check_observations
from ..experiment.checks import bools, flag, number, refuse
from ..experiment.scenario import Scenario
from .action_filter import ActionFilter
from .bearing_errors import check_bearing_error, error_chord
from .heading import check_gate_constants
from .tank_law import book_deposits, spend_tanks
from .teams import over_teams

_LARGEST = float(np.finfo(np.float32).max)
_FULLEST = 1e60
"""Level that no episode can have, m²/s: sums of such levels are still finite."""


class _Constants(NamedTuple):
    """What the kernels need to know of the scenario and of the tank's arguments."""

    neighbour_slots: int
    gravity_row: int
    merge_radius: float
    duration: float
    min_alignment: float
    dead_zone: float
    speed_limit: float
    yaw_limit: float
    pitch_limit: float
    error_chord: float


def unit_of_tanks(scenario: Scenario) -> float:
    """The unit r D̄, m²/s, in which levels are shown: twice the most that a robot can earn in a
    step; 1 without links.
    """
    return float(scenario.merge_radius * scenario.max_degree) or 1.0


class EnergyTank(ActionFilter):
    """Energy tanks, frames and held wishes of the robots of B teams (theorem D).

        A ← A + G(Δ),   G(Δ) = 2 f·Δ − (2/r) D ‖Δ‖² − ε² τ s ‖f‖²              (guarantees 8)

    A wish is carried out where A + G ≥ 0, else law (4) along it: see tank.py. Nonholonomic robots
    keep the account without the term ε²; with an empty tank they drive with v = s mᵀf, and turn
    through the gate of theory 3. One step is

        tank.hold(wishes); actions = tank.act(observations); …; tank.book(…)

    where G is that of the actions as they are sent, in float32. A policy, which learns of neither
    contacts nor merges, calls ``book()`` bare: then every step books as commanded, and the tank of
    a robot that is gone is lost.

    Args:
        scenario: whose robots they are.
        num_envs: B.
        budget: B_i, the level of every robot's tank at the start of an episode, m²/s.
        min_alignment: ε, in (0, 1).
        frame: "net_bearing" (x along f; single integrators only, the other models keep the body
            frame) or "local".
        observe_level: whether ``view`` shows one row more, (A/(r D̄), 0, …).
        bearing_error: η, rad: the account stays right while no bearing is wrong by more. A step is
            charged 2 e ‖Δ‖ more, e = 2 sin(η/2) D, and owes τ s max(0, ε‖f‖ − e)² in place of its
            last term. (Section 8 fades ε there; a tank needs no dead zone, and owes more without.)
        num_threads: most threads that may be used; None is one for each core.

    Raises:
        ValueError: naming the argument, its value and what would be right.
    """

    keeps_ledger = True

    def __init__(
        self,
        scenario: Scenario,
        num_envs: int,
        *,
        budget: float = 0.0,
        min_alignment: float = 0.05,
        frame: str = "net_bearing",
        observe_level: bool = False,
        bearing_error: float = 0.0,
        num_threads: int | None = None,
    ) -> None:
        super().__init__(
            scenario,
            num_envs,
            action_size=scenario.action_size,
            frame=frame,
            num_threads=num_threads,
        )
        check_gate_constants(min_alignment, self._sight.dead_zone)
        self.budget = number("budget", budget, 0.0, unit="m²/s")
        self.observes_level = flag("observe_level", observe_level)
        bounds = [*map(float, scenario.action_bounds), 0.0, 0.0]
        self._constants = _Constants(
            neighbour_slots=self._sight.neighbour_slots,
            gravity_row=scenario.observation_layout.gravity.start,
            merge_radius=scenario.merge_radius,
            duration=scenario.tau,
            min_alignment=float(min_alignment),
            dead_zone=self._sight.dead_zone,
            speed_limit=bounds[0],
            yaw_limit=bounds[1],
            pitch_limit=bounds[2],
            error_chord=error_chord(check_bearing_error(bearing_error)),
        )
        team = num_envs, scenario.n_robots
        self._levels = np.full(team, self.budget)
        self._deposits = np.zeros(team)
        self.carried_out = np.zeros(team, dtype=np.bool_)
        self._nobody, self._no_team = np.zeros(team, np.bool_), np.zeros(num_envs, np.bool_)
        self._themselves = np.tile(np.arange(scenario.n_robots), (num_envs, 1))

    @property
    def levels(self) -> NDArray[np.float64]:
        """A, (B, n), m²/s; zero for a robot whose tank a survivor has taken over."""
        return self._levels.copy()

    @property
    def normalised_levels(self) -> NDArray[np.float64]:
        """A/(r D̄), (B, n), see ``unit_of_tanks``."""
        return self._levels / unit_of_tanks(self.scenario)

    @property
    def told(self) -> dict[str, NDArray[Any]]:
        """What there is to tell of the last step, (B, n) each; not copied."""
        return {"tank": self._levels, "carried_out": self.carried_out, **super().told}

    @property
    def _memory(self) -> dict[str, NDArray[np.float64]]:
        return {"levels": self._levels, **super()._memory}

    def _begin(self, which: Any) -> None:
        super()._begin(which)
        self._levels[which] = self.budget
        self._deposits[which] = 0.0
        self.carried_out[which] = False

    def view(self, observations: NDArray[np.float32]) -> NDArray[np.float32]:
        """As ``ActionFilter.view``; one row more, (B, n, rows + 1, d), with ``observe_level``."""
        seen = super().view(observations)
        if not self.observes_level:
            return seen
        level = np.zeros_like(seen[..., :1, :])
        level[..., 0, 0] = np.minimum(self.normalised_levels, _LARGEST)
        return np.concatenate([seen, level], axis=-2)

    def act(self, observations: NDArray[np.float32]) -> NDArray[np.float32]:
        """As ``ActionFilter.act``; what the step earns waits for ``book``."""
        observations = check_observations(observations, self._seen)
        actions = np.zeros(self._held.shape, dtype=np.float32)
        fixed = (observations, self._constants, self._held, self._levels, actions)
        told = (self._deposits, self.carried_out, self.alignment, self.lyapunov_rate)
        turns = self.turns_body
        over_teams(lambda part: spend_tanks(part, turns, *fixed, told), *self._batch)
        return actions

    def book(
        self,
        contact: ArrayLike | None = None,
        merged_into: ArrayLike | None = None,
        resting: ArrayLike | None = None,
    ) -> None:
        """Bring the levels up to the end of the step; arguments as ``ActionFilter.book``.

        In a step with contact a robot books min(0, G); who merges hands its tank to the survivor; a
        step that a merge cuts short books as commanded.
        """
        team, survivors = self._levels.shape, self._themselves
        touched, passed = self._nobody, self._no_team
        if contact is not None:
            touched = np.ascontiguousarray(bools("contact", contact, team, "robots"))
        if resting is not None:
            passed = np.ascontiguousarray(bools("resting", resting, team[:1], "teams"))
        if merged_into is not None:
            survivors = _robots("merged_into", merged_into, team)
        book_deposits(self._levels, self._deposits, touched, survivors, passed)

    def check_state(self, state: Any) -> dict[str, NDArray[Any]]:
        """As ``ActionFilter.check_state``; no level is below zero.

        Raises:
            ValueError: naming what does not fit.
        """
        checked = super().check_state(state)
        if (wrong := (checked["levels"] < 0) | (checked["levels"] > _FULLEST)).any():
            team, robot = np.argwhere(wrong)[0].tolist()
            raise ValueError(
                f"state: levels of robot_{robot} in team {team} is "
                f"{checked['levels'][team, robot]}; it must be from 0 to {_FULLEST:g} m²/s"
            )
        return checked


def _robots(name: str, value: Any, team: tuple[int, ...]) -> NDArray[np.int64]:
    """Indices (B, n) of robots that there are.

    Raises:
        ValueError: for another shape or type, or an index out of range.
    """
    robots = np.asarray(value)
    if robots.shape != team or robots.dtype.kind not in "iu":
        refuse(name, value, f"whole numbers of shape (B, n) = {team}")
    if robots.min() < 0 or robots.max() >= team[1]:
        refuse(name, value, f"indices of robots, from 0 to {team[1] - 1}")
    return np.ascontiguousarray(robots, dtype=np.int64)
