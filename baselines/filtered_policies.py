"""Any function of what robots see as a policy that keeps a guarantee: the wrappers' arithmetic,
where there is no environment to wrap.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.checks import refuse
from rendezvous_env.envs.guarantee import check_period
from rendezvous_env.safety.heading import HeadingFilter
from rendezvous_env.safety.safety_filter import SafetyFilter
from rendezvous_env.safety.tank import EnergyTank
from rendezvous_env.scenario.scenarios import resolve

from .policy import RememberingPolicy, within_limits

if TYPE_CHECKING:
    from rendezvous_env.scenario.scenario import Scenario
    from rendezvous_env.scenario.scenarios import ScenarioLike

Choose = Callable[[NDArray[np.float32]], ArrayLike]
"""Observations (..., n, rows, d) → choices (..., n, k), in [−1, 1]."""


class DecidingPolicy(RememberingPolicy):
    """Decides every ``decision_period`` steps, and acts on the decision in each of them."""

    def __init__(self, scenario: Scenario, decision_period: int) -> None:
        self.scenario, self.decision_period = scenario, decision_period
        self._steps: NDArray[np.float64] = np.zeros(0)
        """Since the last decision, (B,), in units of τ; inf before the first."""

    @abstractmethod
    def _decide(self, teams: NDArray[np.float32], due: NDArray[np.bool_]) -> None:
        """New decisions for the teams that are due, (B,), which see (B, n, rows, d)."""

    @abstractmethod
    def _act(self, teams: NDArray[np.float32], elapsed: float) -> NDArray[np.float32]:
        """Actions (B, n, a) of a step, so many s after the step before."""

    def _settle(self, share: float) -> None:
        """Take note that the step before lasted so much of τ."""

    def act(self, observations: NDArray[Any], time: ArrayLike) -> NDArray[np.float32]:
        """Actions (..., n, a); see ``Policy``.

        Raises:
            ValueError: for observations or choices of another shape, or a choice that is not
                finite, naming the robot.
        """
        return self._after(self.scenario.tau, observations)

    def _after(self, elapsed: float, observations: NDArray[Any]) -> NDArray[np.float32]:
        """Actions, where the call before was so many seconds ago."""
        teams = self._teams_of(observations)
        share = elapsed / self.scenario.tau
        self._settle(share)
        self._steps += share
        due = self._steps + 0.5 * share >= self.decision_period  # or sooner than the next call
        if due.any():
            self._decide(teams, due)
            self._steps[due] = 0.0
        return self._as_given(self._act(teams, elapsed))

    def _start(self, teams: int) -> None:
        self._steps = np.full(teams, np.inf)

    def _forget(self, which: NDArray[np.bool_]) -> None:
        self._steps[which] = np.inf


class FilteredPolicy(DecidingPolicy):
    """Choices that are held for some steps, in each of which a filter makes actions of them.

    Args:
        scenario: whose robots it steers.
        choose: what they see, (..., n, rows, d), to what the filter takes. It is asked once in
            each period, for all teams together, those too whose period is not over. If it has a
            memory, and a method ``reset(mask)``, that is called with the policy's.
        make_filter: the filter of so many teams.
        decision_period: base steps for which a choice is held.
    """

    _filter: Any

    def __init__(
        self,
        scenario: ScenarioLike,
        choose: Choose,
        make_filter: Callable[[int], SafetyFilter],
        decision_period: int = 1,
    ) -> None:
        if not callable(choose):
            refuse("choose", choose, "a function of observations (..., n, rows, d)")
        super().__init__(resolve(scenario), check_period(decision_period))
        self.choose, self._make_filter = choose, make_filter
        self._begin(())

    def _start(self, teams: int) -> None:
        super()._start(teams)
        self._filter = self._make_filter(teams)

    def _act(self, teams: NDArray[np.float32], elapsed: float) -> NDArray[np.float32]:
        if isinstance(self._filter, HeadingFilter):
            actions = self._filter.act(teams, elapsed)
            return within_limits(actions.astype(np.float64), self.scenario)
        commanded: NDArray[np.float32] = self._filter.act(teams)
        if self._filter.keeps_ledger:
            self._filter.book()
        return commanded

    def _decide(self, teams: NDArray[np.float32], due: NDArray[np.bool_]) -> None:
        before = None if due.all() else self._filter.get_state()
        seen = self._as_given(self._filter.view(teams))
        choices = np.asarray(self.choose(seen))
        wanted = *seen.shape[:-2], self._filter.action_size
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

    def _forget(self, which: NDArray[np.bool_]) -> None:
        super()._forget(which)
        self._filter.forget(which)

    def reset(self, mask: NDArray[np.bool_] | None = None) -> None:
        """As ``DecidingPolicy.reset``; a ``reset`` that ``choose`` has is called as well."""
        if mask is None:
            self._begin(self._leading or ())
        else:
            super().reset(mask)
        if callable(forget := getattr(self.choose, "reset", None)):
            forget(mask)


class HeadingPolicy(FilteredPolicy):
    """A function that chooses vectors, made certain to meet (theorem C); as
    ``HeadingVectorWrapper`` has it.

        ṗᵢ = hᵢ hᵢᵀ fᵢ                                                  (Zhao & Zheng, eq. 4)

    hᵢ is the certified heading of the vector chosen. Nonholonomic robots choose turn rates through
    the gate of theory 3.

    Args:
        scenario: whose robots it steers.
        choose: what they see, (..., n, rows, d), rows of robots that are gone being zero, to raw
            vectors (..., n, d) in the same frames, of any length; for nonholonomic robots to turn
            rates (..., n, d − 1) in units of the highest; see ``FilteredPolicy``.
        decision_period: base steps for which a vector is held.
        settings: those of ``HeadingVectorWrapper``: ``min_alignment=0.1``, ``max_turn_rate=3.0``,
            ``frame="net_bearing"``, ``certified=True``, ``bearing_error=0.0``.

    Raises:
        TypeError: for another setting.
        ValueError: naming the argument, its value and what would be right.
    """

    def __init__(
        self, scenario: ScenarioLike, choose: Choose, *, decision_period: int = 1, **settings: Any
    ) -> None:
        make_filter = partial(HeadingFilter, resolve(scenario), **settings)
        super().__init__(scenario, choose, make_filter, decision_period)
        bare = not settings.get("certified", True) or settings.get("bearing_error", 0.0) != 0.0
        kept = not (bare or self._filter.turns_body)
        margin: float = settings.get("min_alignment", 0.1)
        self.min_alignment = margin if kept else None
        """ε that is kept in every step; None if there is none."""

    def after(
        self, elapsed: float, observations: NDArray[Any], time: ArrayLike
    ) -> NDArray[np.float32]:
        """As a call, where the call before was so many seconds ago; see ``RealTimePolicy``."""
        return self._after(elapsed, observations)


class TankPolicy(FilteredPolicy):
    """A function that chooses velocities, carried out while a tank lasts (theorem D); as
    ``EnergyTankWrapper`` has it.

    The energy budget is that of robots which know of no contact and no merge: each step books as it
    was commanded, and what an absorbed robot had left is lost.

    Args:
        scenario: whose robots it steers.
        choose: as for ``HeadingPolicy``, to desired velocities (..., n, d) in units of v_max, or to
            base actions (..., n, a) in units of their bounds for other robot models.
        decision_period: base steps for which a choice is held; the budget is kept in each.
        settings: those of ``EnergyTankWrapper``: ``budget=0.0``, ``min_alignment=0.05``,
            ``frame="net_bearing"``, ``observe_level=False``, ``bearing_error=0.0``.

    Raises:
        TypeError, ValueError: as ``HeadingPolicy``.
    """

    def __init__(
        self, scenario: ScenarioLike, choose: Choose, *, decision_period: int = 1, **settings: Any
    ) -> None:
        make_filter = partial(EnergyTank, resolve(scenario), **settings)
        super().__init__(scenario, choose, make_filter, decision_period)

    @property
    def levels(self) -> NDArray[np.float64]:
        """A of the tanks, (..., n), m²/s."""
        return self._as_given(self._filter.levels)
