"""Any function of what robots see as a policy that keeps a guarantee: the wrappers' arithmetic,
where there is no environment to wrap.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.experiment.checks import bools, refuse
from rendezvous_env.experiment.scenarios import resolve
from rendezvous_env.faces.holding import check_period
from rendezvous_env.guarantee.action_filter import ActionFilter
from rendezvous_env.guarantee.energy_tank import EnergyTank
from rendezvous_env.guarantee.steering import Steering

from .policy import of_whole_teams, within_limits

if TYPE_CHECKING:
    from rendezvous_env.experiment.scenarios import ScenarioLike

Choose = Callable[[NDArray[np.float32]], ArrayLike]
"""Observations (..., n, rows, d) → choices (..., n, k), in [−1, 1]."""


class _FilteredPolicy(ABC):
    """Choices that are held for some steps, in each of which a filter makes actions of them.

    It remembers with the leading axes of the observations; other leading axes are other teams, and
    start anew.
    """

    def __init__(
        self, scenario: ScenarioLike, choose: Choose, decision_period: int, **settings: Any
    ) -> None:
        self.scenario = resolve(scenario)
        if not callable(choose):
            refuse("choose", choose, "a function of observations (..., n, rows, d)")
        self.choose = choose
        self.decision_period = check_period(decision_period)
        self._settings = settings
        self._begin(())

    @abstractmethod
    def _make_filter(self, teams: int) -> ActionFilter:
        """The filter of so many teams."""

    @abstractmethod
    def _act(self, teams: NDArray[np.float32], elapsed: float) -> NDArray[np.float32]:
        """Actions (B, n, a) of a step, for what the teams see, (B, n, rows, d), so many s after the
        step before.
        """

    def _begin(self, leading: tuple[int, ...]) -> None:
        self._leading, teams = leading, math.prod(leading)
        self._filter = self._make_filter(teams)
        self._steps = np.full(teams, np.inf)
        """Since the last choice, (B,), in units of τ; inf before the first."""

    def __call__(self, observations: NDArray[Any], time: ArrayLike) -> NDArray[np.float32]:
        """Actions (..., n, a); see ``Policy``.

        Raises:
            ValueError: for observations or choices of another shape, or a choice that is not
                finite, naming the robot.
        """
        return self._after(self.scenario.tau, observations)

    def _after(self, elapsed: float, observations: NDArray[Any]) -> NDArray[np.float32]:
        """Actions, where the call before was so many seconds ago."""
        seen = of_whole_teams(observations, self.scenario)
        if seen.shape[:-3] != self._leading:
            self._begin(seen.shape[:-3])
        teams = seen.reshape(-1, *seen.shape[-3:])
        share = elapsed / self.scenario.tau
        self._steps += share
        due = self._steps + 0.5 * share >= self.decision_period  # or sooner than the next call
        if due.any():
            self._decide(teams, due)
            self._steps[due] = 0.0
        return self._act(teams, elapsed).reshape(*seen.shape[:-2], -1)

    def _decide(self, teams: NDArray[np.float32], due: NDArray[np.bool_]) -> None:
        """New choices for the teams that are due; the others keep theirs."""
        before = None if due.all() else self._filter.get_state()
        shown = self._filter.view(teams)
        choices = np.asarray(self.choose(shown.reshape(*self._leading, *shown.shape[1:])))
        wanted = *self._leading, self.scenario.n_robots, self._filter.action_size
        if choices.shape != wanted:
            raise ValueError(
                f"choose gave an array of shape {choices.shape}; it must be (..., n, k) = {wanted}"
            )
        self._filter.hold(choices.reshape(len(teams), *wanted[-2:]))
        if before is not None:
            now = self._filter.get_state()
            for name, array in now.items():
                array[~due] = before[name][~due]
            self._filter.set_state(now)

    def reset(self, mask: NDArray[np.bool_] | None = None) -> None:
        """Forget the teams where ``mask`` (...) is true, of all if it is None.

        A ``reset`` that ``choose`` has is called in the same way.

        Raises:
            ValueError: for another mask.
        """
        if mask is None:
            self._begin(self._leading)
        else:
            which = bools("mask", mask, self._leading, "teams").reshape(-1)
            self._filter.forget(which)
            self._steps[which] = np.inf
        if callable(forget := getattr(self.choose, "reset", None)):
            forget(mask)


class HeadingPolicy(_FilteredPolicy):
    """A function that chooses vectors, made certain to meet (theorem C); as
    ``HeadingVectorWrapper`` has it.

        ṗᵢ = hᵢ hᵢᵀ fᵢ                                                  (Zhao & Zheng, eq. 4)

    hᵢ is the certified heading of the vector chosen. Nonholonomic robots choose turn rates through
    the gate of theory 3.

    Args:
        scenario: whose robots it steers.
        choose: what they see, (..., n, rows, d), rows of robots that are gone being zero, to raw
            vectors (..., n, d) in the same frames, of any length; for nonholonomic robots to turn
            rates (..., n, d − 1) in units of the highest. It is asked once in each period, for
            all teams together, those too whose period is not over. If it has a memory, and a method
            ``reset(mask)``, that is called with the policy's.
        min_alignment: ε, in (0, 1).
        max_turn_rate: ω_max, rad/s; for nonholonomic robots the scenario's limit holds too.
        frame: "net_bearing" (x along f; single integrators only) or "local".
        decision_period: base steps for which a vector is held.
        certified: False lets the vector through as hᵢ, without any guarantee.
        bearing_error: η, rad: V never rises between merges while no bearing is wrong by more
            (theorem N1').

    Raises:
        ValueError: naming the argument, its value and what would be right.
    """

    _filter: Steering

    def __init__(
        self,
        scenario: ScenarioLike,
        choose: Choose,
        *,
        min_alignment: float = 0.1,
        max_turn_rate: float = 3.0,
        frame: str = "net_bearing",
        decision_period: int = 1,
        certified: bool = True,
        bearing_error: float = 0.0,
    ) -> None:
        super().__init__(
            scenario,
            choose,
            decision_period,
            min_alignment=min_alignment,
            max_turn_rate=max_turn_rate,
            frame=frame,
            certified=certified,
            bearing_error=bearing_error,
        )
        kept = certified and bearing_error == 0.0 and not self._filter.turns_body
        self.min_alignment = min_alignment if kept else None
        """ε that is kept in every step; None if there is none."""

    def _make_filter(self, teams: int) -> ActionFilter:
        return Steering(self.scenario, teams, **self._settings)

    def after(
        self, elapsed: float, observations: NDArray[Any], time: ArrayLike
    ) -> NDArray[np.float32]:
        """As a call, where the call before was so many seconds ago; see ``RealTimePolicy``."""
        return self._after(elapsed, observations)

    def _act(self, teams: NDArray[np.float32], elapsed: float) -> NDArray[np.float32]:
        actions = self._filter.act(teams, elapsed)
        return within_limits(actions.astype(np.float64), self.scenario)


class TankPolicy(_FilteredPolicy):
    """A function that chooses velocities, carried out while a tank lasts (theorem D); as
    ``EnergyTankWrapper`` has it.

    The ledger is that of robots which know of no contact and no merge: each step books as it was
    commanded, and what an absorbed robot had left is lost.

    Args:
        scenario: whose robots it steers.
        choose: as for ``HeadingPolicy``, to wanted velocities (..., n, d) in units of v_max, or to
            base actions (..., n, a) in units of their bounds for other robot models.
        budget: B of each robot's tank at the start, m²/s.
        min_alignment: ε, in (0, 1): how fast robots are promised to meet.
        frame: "net_bearing" (x along f; single integrators only) or "local".
        decision_period: base steps for which a wish is held; the ledger is kept in each.
        observe_level: whether one row more tells the level of a robot's own tank.
        bearing_error: η, rad: the promises hold while no bearing is wrong by more.

    Raises:
        ValueError: naming the argument, its value and what would be right.
    """

    _filter: EnergyTank

    def __init__(
        self,
        scenario: ScenarioLike,
        choose: Choose,
        *,
        budget: float = 0.0,
        min_alignment: float = 0.05,
        frame: str = "net_bearing",
        decision_period: int = 1,
        observe_level: bool = False,
        bearing_error: float = 0.0,
    ) -> None:
        super().__init__(
            scenario,
            choose,
            decision_period,
            budget=budget,
            min_alignment=min_alignment,
            frame=frame,
            observe_level=observe_level,
            bearing_error=bearing_error,
        )

    def _make_filter(self, teams: int) -> ActionFilter:
        return EnergyTank(self.scenario, teams, **self._settings)

    def _act(self, teams: NDArray[np.float32], elapsed: float) -> NDArray[np.float32]:
        actions = self._filter.act(teams)
        self._filter.book()
        return actions

    @property
    def levels(self) -> NDArray[np.float64]:
        """A of the tanks, (..., n), m²/s."""
        return self._filter.levels.reshape(*self._leading, self.scenario.n_robots)
