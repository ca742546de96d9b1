"""What the guarantee wrappers of PettingZoo and of vector environments share.

What may be wrapped, a filter from its name and settings, and the wrapper's memory.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..checks import UnknownFieldError, choice, nearest_word, refuse, shown, whole
from ..engine.state_checks import check_entries, check_finite, check_keys
from ..limits import MOST_HELD_STEPS
from ..safety.gains import Gains
from ..safety.heading import HeadingFilter
from ..safety.links import LinkKeeping
from ..safety.safety_filter import FILTERS, SafetyFilter
from ..safety.tank import EnergyTank
from ..scenario.scenario import Scenario
from .overrides import NamesUnknownArguments, arguments_of

AnyFilter = SafetyFilter | type[SafetyFilter] | str
"""A filter that has been made, or its class or its name, to be made of settings."""


# ---- what the wrappers of both worlds share ------------------------------------------------------


def check_period(decision_period: int) -> int:
    """A decision period that is a positive whole number.

    Raises:
        ValueError: if it is not.
    """
    return whole("decision_period", decision_period, 1, MOST_HELD_STEPS)


def check_not_guaranteed(env: Any, wrapper: str, layers: type, guarantees: type) -> None:
    """Refuse to put one guarantee upon another.

    Args:
        env: what is to be wrapped.
        wrapper: the name of the class that wraps it.
        layers: the class of all wrappers of this world.
        guarantees: the class of those with a guarantee.

    Raises:
        TypeError: naming both.
    """
    while isinstance(env, layers):
        if isinstance(env, guarantees):
            raise TypeError(
                f"env is under {type(env).__name__} already, and {wrapper} cannot stand on it: one "
                "would undo what the other guarantees; wrap the environment itself"
            )
        env = env.env  # type: ignore[attr-defined]


def make_filter(
    safety_filter: AnyFilter,
    scenario: Scenario,
    num_envs: int,
    num_threads: int | None,
    settings: Any,
) -> SafetyFilter:
    """The filter of these teams.

    Raises:
        TypeError: for a setting that it does not know, with the nearest one.
        ValueError: for an unknown name, or a filter of other teams.
    """
    if isinstance(safety_filter, SafetyFilter):
        size = (safety_filter.scenario, len(safety_filter.held))
        if size != (scenario, num_envs) or settings:
            refuse("safety_filter", safety_filter, f"of this scenario and {num_envs} teams")
        return safety_filter
    kind = safety_filter
    if not isinstance(kind, type):
        kind = FILTERS[choice("safety_filter", kind, FILTERS)]
    known = [name for name in arguments_of(kind)[2:] if name != "num_threads"]
    for key in settings:
        if key not in known:
            near = nearest_word(key, known)
            hint = f"did you mean {near!r}?" if near else f"known are {', '.join(known)}"
            raise UnknownFieldError(f"{kind.__name__} has no setting {shown(key)}; {hint}")
    making: Any = kind
    made: SafetyFilter = making(scenario, num_envs, num_threads=num_threads, **settings)
    return made


def check_begun(begun: bool, wrapper: object) -> None:
    """Refuse a step before a reset: the filter has seen nothing then.

    Raises:
        RuntimeError: naming the wrapper.
    """
    if not begun:
        raise RuntimeError(
            f"call reset() of {type(wrapper).__name__} before step(); an environment that was "
            "reset before it was wrapped needs a new reset"
        )


def restore(
    env: Any, safety_filter: SafetyFilter, observed: NDArray[np.float32], state: Mapping[str, Any]
) -> NDArray[np.float32]:
    """Put a wrapper's state back: the environment's episodes, the filter's memory.

    Args:
        env: what is wrapped.
        safety_filter: the wrapper's.
        observed: observations like those it remembers.
        state: "env", the filter's part, and "observed".

    Returns:
        The remembered observations.

    Raises:
        ValueError: naming what does not fit; nothing has changed then.
    """
    key = safety_filter.state_key
    check_keys(state, ("env", key, "observed"))
    checked = check_entries({"observed": observed}, state)
    check_finite(checked, ("observed",))
    remembered = safety_filter.check_state(state[key])
    env.set_state(state["env"])
    safety_filter.set_state(remembered)
    return checked["observed"].copy()


# ---- the settings of the four theorems, for both worlds ------------------------------------------


class HeadingSettings(NamesUnknownArguments):
    """Theorem C: ``HeadingVectorWrapper``."""

    steering: HeadingFilter

    def __init__(
        self,
        env: Any,
        min_alignment: float = 0.1,
        max_turn_rate: float = 3.0,
        frame: str = "net_bearing",
        decision_period: int = 1,
        certified: bool = True,
        bearing_error: float = 0.0,
    ) -> None:
        super().__init__(  # type: ignore[call-arg]
            env,
            HeadingFilter,
            decision_period,
            min_alignment=min_alignment,
            max_turn_rate=max_turn_rate,
            frame=frame,
            certified=certified,
            bearing_error=bearing_error,
        )


class TankSettings(NamesUnknownArguments):
    """Theorem D: ``EnergyTankWrapper``."""

    tank: EnergyTank

    def __init__(
        self,
        env: Any,
        budget: float = 0.0,
        min_alignment: float = 0.05,
        frame: str = "net_bearing",
        decision_period: int = 1,
        observe_level: bool = False,
        bearing_error: float = 0.0,
    ) -> None:
        super().__init__(  # type: ignore[call-arg]
            env,
            EnergyTank,
            decision_period,
            budget=budget,
            min_alignment=min_alignment,
            frame=frame,
            observe_level=observe_level,
            bearing_error=bearing_error,
        )


class GainSettings(NamesUnknownArguments):
    """Theorem G: ``GainWrapper``."""

    gains: Gains

    def __init__(
        self,
        env: Any,
        min_gain: float | None = None,
        max_gain: float | None = None,
        frame: str = "net_bearing",
        decision_period: int = 1,
    ) -> None:
        super().__init__(  # type: ignore[call-arg]
            env, Gains, decision_period, min_gain=min_gain, max_gain=max_gain, frame=frame
        )


class LinkSettings(NamesUnknownArguments):
    """Theorem R: ``LinkKeepingWrapper``."""

    links: LinkKeeping

    def __init__(
        self,
        env: Any,
        share: float = 0.5,
        bearing_error: float = 0.0,
        frame: str = "net_bearing",
        decision_period: int = 1,
    ) -> None:
        super().__init__(  # type: ignore[call-arg]
            env,
            LinkKeeping,
            decision_period,
            share=share,
            bearing_error=bearing_error,
            frame=frame,
        )
