"""Policies from functions of observations, under the same safety filters as the wrappers."""

from abc import abstractmethod
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.checks import raise_invalid
from rendezvous_env.envs.guarantee import check_period, settings_of
from rendezvous_env.field_checks import known_fields
from rendezvous_env.safety.heading import HeadingFilter
from rendezvous_env.safety.safety_filter import SafetyFilter
from rendezvous_env.safety.settings import MAX_TURN_RATE, TANK_MARGIN
from rendezvous_env.safety.tank import EnergyTank
from rendezvous_env.scenario.scenario import Scenario
from rendezvous_env.scenario.scenarios import ScenarioLike, resolve

from .policy import Float32, Mask, StatefulPolicy, within_limits

Choose = Callable[[Float32], ArrayLike]
"""Observations (..., n, rows, d) → actions of the filter (..., n, k), in [−1, 1]."""


_CERTIFIED: dict[str, dict[str, Any]] = {
    "heading": {"min_alignment": 0.1, "max_turn_rate": MAX_TURN_RATE, "bearing_error": 0.0},
    "tank": {"budget": 0.0, "min_alignment": TANK_MARGIN, "bearing_error": 0.0},
    "gains": {"min_gain": None, "max_gain": None},
    "links": {"share": 0.5, "bearing_error": 0.0},
}
"""Settings of filters that certificates depend on, with their defaults."""


def guarantee_with(by: Any, settings: Mapping[str, Any]) -> dict[str, Any] | None:
    """Arguments of ``certificate`` for a policy's filter, by its name, with these settings.

    None for a filter that no theorem covers. A policy's tank does not observe merges.
    """
    if by not in _CERTIFIED or not settings.get("certified", True):
        return None
    usual = _CERTIFIED[by] | ({"observes_merges": False} if by == "tank" else {})
    return {"by": by} | {name: settings.get(name, value) for name, value in usual.items()}


class DecidingPolicy(StatefulPolicy):
    """Policy with action repeat: a new decision every ``decision_period`` steps."""

    def __init__(self, scenario: Scenario, decision_period: int) -> None:
        self.scenario, self.decision_period = scenario, decision_period
        self._steps: NDArray[np.float64] = np.zeros(0)
        """Steps since the last decision, (B,), in units of τ; inf before the first."""

    @abstractmethod
    def _decide(self, teams: Float32, due: Mask) -> None:
        """Update the decisions of due environments, (B,), from observations (B, n, rows, d)."""

    @abstractmethod
    def _act(self, teams: Float32, elapsed: float) -> Float32:
        """Actions (B, n, a) of a step, ``elapsed`` s after the previous one."""

    def _settle(self, share: float) -> None:
        """Account for the previous step, which lasted this fraction of τ."""

    def act(self, observations: NDArray[Any], time: ArrayLike) -> Float32:
        """As ``Policy``; a ValueError names a robot whose action is not finite."""
        return self._after(self.scenario.tau, observations)

    def _after(self, elapsed: float, observations: NDArray[Any]) -> Float32:
        teams = self._teams_of(observations)
        share = elapsed / self.scenario.tau
        self._settle(share)
        self._steps += share
        due = self._steps + 0.5 * share >= self.decision_period  # now instead of at the next call
        if due.any():
            self._decide(teams, due)
            self._steps[due] = 0.0
        return self._as_given(self._act(teams, elapsed))

    def _start(self, teams: int) -> None:
        self._steps = np.full(teams, np.inf)

    def _forget(self, which: Mask) -> None:
        self._steps[which] = np.inf


class FilteredPolicy(DecidingPolicy):
    """Policy that applies a safety filter to a function with action repeat.

    ``choose`` is called once per ``decision_period`` for the whole batch; its method
    ``reset(mask)``, if any, is called with the policy's. ``make_filter`` takes the batch size.
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
            raise_invalid("choose", choose, "a function of observations (..., n, rows, d)")
        super().__init__(resolve(scenario), check_period(decision_period))
        self.choose, self._make_filter = choose, make_filter
        self._begin(())

    def _start(self, teams: int) -> None:
        super()._start(teams)
        self._filter = self._make_filter(teams)

    def _act(self, teams: Float32, elapsed: float) -> Float32:
        if isinstance(self._filter, HeadingFilter):
            actions = self._filter.apply(teams, elapsed=elapsed)
            return within_limits(actions.astype(np.float64), self.scenario)
        commanded: Float32 = self._filter.apply(teams)
        if self._filter.uses_feedback:
            self._filter.update()
        return commanded

    def _decide(self, teams: Float32, due: Mask) -> None:
        before = None if due.all() else self._filter.get_state()
        seen = self._as_given(self._filter.observe(teams)).copy()  # the filter has its own memory
        choices = np.asarray(self.choose(seen))
        wanted = *seen.shape[:-2], self._filter.action_size
        if choices.shape != wanted:
            needed = f"(..., n, k) = {wanted}, with k = {wanted[-1]} {self._meaning_of_choices()}"
            raise ValueError(f"choose returned shape {choices.shape}; it must be {needed}")
        self._filter.hold(choices.reshape(len(teams), *wanted[-2:]))
        if before is not None:
            now = self._filter.get_state()
            for name, array in now.items():
                array[~due] = before[name][~due]
            self._filter.set_state(now)

    def _meaning_of_choices(self) -> str:
        """The k numbers of a robot's choice, for messages."""
        rates = "turn rates in units of the maximum"
        if isinstance(self._filter, EnergyTank):
            return "parts of an action in units of its bounds"
        if not isinstance(self._filter, HeadingFilter):
            return "numbers of a robot's choice"
        if self._filter.mixes_models:
            return f"parts of a heading vector, or for nonholonomic robots first {rates}"
        return rates if self._filter.turns_body else "parts of a heading vector"

    def _forget(self, which: Mask) -> None:
        super()._forget(which)
        self._filter.forget(which)

    def reset(self, mask: Mask | None = None) -> None:
        """As ``StatefulPolicy.reset``; also resets ``choose``."""
        if mask is None:
            self._begin(self._leading or ())
        else:
            super().reset(mask)
        if callable(forget := getattr(self.choose, "reset", None)):
            forget(mask)


class HeadingPolicy(FilteredPolicy):
    """Function that chooses heading vectors, with the filter of ``HeadingVectorWrapper``.

        ṗᵢ = hᵢ hᵢᵀ fᵢ,   hᵢ the certified heading of the chosen vector     (Zhao & Zheng, eq. 4)

    Args:
        scenario: the experiment.
        choose: observations (..., n, rows, d), zero for merged robots, → vectors (..., n, d) of any
            length in the same frames; for nonholonomic robots → turn rates (..., n, d − 1) in units
            of the maximum (theory 3). In mixed teams, (..., n, d): turn rates are the first d − 1.
            Called once per ``decision_period`` for the whole batch. A method ``reset(mask)`` is
            called with the policy's.
        decision_period: number of steps for which a vector is held.
        settings: those of ``HeadingVectorWrapper``: ``min_alignment=0.1``, ``max_turn_rate=3.0``,
            ``frame="net_bearing"``, ``certified=True``, ``bearing_error=0.0``.

    Raises:
        TypeError: for an unknown setting.
        ValueError: naming the argument, its value and the remedy.
    """

    def __init__(
        self, scenario: ScenarioLike, choose: Choose, *, decision_period: int = 1, **settings: Any
    ) -> None:
        known_fields(settings, settings_of(HeadingFilter), type(self).__name__, "setting")
        make_filter = partial(HeadingFilter, resolve(scenario), **settings)
        super().__init__(scenario, choose, make_filter, decision_period)
        bare = not settings.get("certified", True) or settings.get("bearing_error", 0.0) != 0.0
        promised = None if bare or self._filter.turns_body else settings.get("min_alignment", 0.1)
        self.min_alignment: float | None = promised
        """Minimum alignment ε of theorem C, reduced where ‖f‖ < 2δ; None if not certified."""
        self._guarantee = guarantee_with("heading", settings)

    @property
    def guarantee(self) -> dict[str, Any] | None:
        """As ``TeamPolicy``: the settings; None with ``certified=False``."""
        return self._guarantee

    def after(self, elapsed: float, observations: NDArray[Any], time: ArrayLike) -> Float32:
        """As ``RealTimePolicy.after``."""
        return self._after(elapsed, observations)


class TankPolicy(FilteredPolicy):
    """Function that chooses velocities, with the filter of ``EnergyTankWrapper`` (theorem D).

    The policy does not observe contacts and merges. Each step counts as commanded and lasts τ
    (also in ``RobotPolicy``); the stored energy of a merged robot is lost; stored energy does
    not follow V. On complete graphs of equal weights the time bound of ``certificate(by="tank")``
    therefore applies to the wrapper only (docs/guarantees.md).

    Args:
        scenario, decision_period: as ``HeadingPolicy``; the budget holds in every step.
        choose: observations → desired velocities (..., n, d) in units of v_max, or actions
            (..., n, a) in units of their bounds for other robot models.
        settings: those of ``EnergyTankWrapper``: ``budget=0.0``, ``min_alignment=0.05``,
            ``frame="net_bearing"``, ``observe_level=False``, ``bearing_error=0.0``.
    """

    def __init__(
        self, scenario: ScenarioLike, choose: Choose, *, decision_period: int = 1, **settings: Any
    ) -> None:
        known_fields(settings, settings_of(EnergyTank), type(self).__name__, "setting")
        make_filter = partial(EnergyTank, resolve(scenario), **settings)
        super().__init__(scenario, choose, make_filter, decision_period)
        self._guarantee = guarantee_with("tank", settings)

    @property
    def guarantee(self) -> dict[str, Any] | None:
        """As ``TeamPolicy``: the settings, of a tank that does not observe merges."""
        return self._guarantee

    @property
    def levels(self) -> NDArray[np.float64]:
        """Stored energies A, (..., n), m²/s."""
        return self._as_given(self._filter.levels)
