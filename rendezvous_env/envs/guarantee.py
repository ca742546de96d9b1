"""What the guarantee wrappers of PettingZoo and of vector environments share."""

import functools
import inspect
import weakref
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import numpy as np

from ..checks import choice, known_fields, refuse, whole
from ..engine.state_checks import check_entries, check_finite, check_keys
from ..limits import MOST_HELD_STEPS
from ..safety.gains import Gains
from ..safety.heading import HeadingFilter
from ..safety.links import LinkKeeping
from ..safety.safety_filter import FILTERS, SafetyFilter
from ..safety.settings import MAX_TURN_RATE, TANK_MARGIN
from ..safety.tank import EnergyTank
from ..simulator import Simulator
from ..state_view import STANDING
from .overrides import arguments_of

AnyFilter = SafetyFilter | type[SafetyFilter] | str
"""A filter, or its class or name, from which settings make one."""
_Constructor = TypeVar("_Constructor", bound=Callable[..., None])
_holders: weakref.WeakValueDictionary[int, Any] = weakref.WeakValueDictionary()
"""The wrapper that holds a filter, by the filter's id; not on filters, which are pickled."""
_OF_STATES = ("bodies", "decision_period", "env", "observed", "perception", "shown", "touched")
_OF_INFOS = (
    *STANDING, "active", "clearance", "contact", "final_info", "final_obs", "merged_into",
    "robot_rewards", "summary",
)  # fmt: skip
"""Names that filters cannot have."""


def check_period(decision_period: int) -> int:
    """A decision period that is a positive whole number."""
    return whole("decision_period", decision_period, 1, MOST_HELD_STEPS)


def check_not_guaranteed(env: Any, wrapper: str, layers: type, guarantees: type) -> None:
    """Refuse one guarantee upon another; ``layers`` are all wrappers of this API, ``guarantees``
    ours.
    """
    while isinstance(env, layers):
        if isinstance(env, guarantees):
            raise TypeError(
                f"env is under {type(env).__name__} already, and {wrapper} cannot stand on it: one "
                "would undo what the other guarantees; wrap the environment itself"
            )
        env = env.env  # type: ignore[attr-defined]


def settings_of(kind: type[SafetyFilter]) -> list[str]:
    """Names of what a user can choose of a filter."""
    return [name for name in arguments_of(kind)[2:] if name != "num_threads"]


def make_filter(
    safety_filter: AnyFilter, simulator: Simulator, settings: Mapping[str, Any]
) -> SafetyFilter:
    """The filter of these teams; one of other teams and unknown names are refused."""
    scenario, num_envs = simulator.scenario, simulator.num_envs
    own = ["decision_period"]  # of the wrapper, which has taken it where it is spelt so
    if isinstance(safety_filter, SafetyFilter):
        known_fields(settings, own, "a safety_filter that is made", "setting")
        if (safety_filter.scenario, len(safety_filter.held)) != (scenario, num_envs):
            refuse("safety_filter", safety_filter, f"of this scenario and {num_envs} teams")
        return safety_filter
    kind: Any = safety_filter
    if not isinstance(kind, type):
        kind = FILTERS[choice("safety_filter", kind, FILTERS)]
    if not issubclass(kind, SafetyFilter):
        refuse("safety_filter", kind, "a SafetyFilter, a subclass of it, or the name of one")
    known_fields(settings, [*settings_of(kind), *own], kind.__name__, "setting")
    arguments = {"num_threads": simulator.num_threads, **settings}
    try:
        inspect.signature(kind).bind(scenario, num_envs, **arguments)
    except TypeError as error:
        takes = "it must take (scenario, num_envs, *, num_threads=None, …)"
        raise TypeError(
            f"safety_filter: constructor of {kind.__name__}: {error}; {takes}"
        ) from None
    made: SafetyFilter = kind(scenario, num_envs, **arguments)
    return made


class HoldsFilter:
    """The filter of a guarantee wrapper, and the wrapper's memory from step to step."""

    env: Any
    _base: Any
    """The environment of ours under all wrappers."""

    def _hold(
        self, base: Any, safety_filter: AnyFilter, decision_period: int, settings: Mapping[str, Any]
    ) -> None:
        """Take up a filter of the teams of this environment, before anything is seen."""
        self._base = base
        self.decision_period = check_period(decision_period)
        self.filter = made = make_filter(safety_filter, base.simulator, settings)
        self._check_names(made)
        self._take_alone(made)
        setattr(self, made.state_key, made)
        scenario = base.scenario
        shape = base.simulator.num_envs, scenario.n_robots, *scenario.observation_layout.shape
        self._observed = np.zeros(shape, dtype=np.float32)
        self._seen = -1

    def _check_names(self, made: SafetyFilter) -> None:
        """Refuse a filter that calls its memory, or what it tells, what others are called."""
        kind, key = type(made).__name__, made.state_key
        if not (isinstance(key, str) and key.isidentifier()) or key[0] == "_":
            refuse(f"state_key of {kind}", key, "a word that does not begin with _")
        if key in _OF_STATES or hasattr(type(self), key) or hasattr(self._base, key):
            refuse(f"state_key of {kind}", key, "no name of an environment's own, which this is")
        of_infos = {*_OF_INFOS, *self._base.simulator.costs}
        if taken := sorted(of_infos & set(made.told)):
            raise ValueError(
                f"{kind} tells {taken[0]!r}, which environments tell in infos themselves; give it "
                "another name"
            )

    def _take_alone(self, made: SafetyFilter) -> None:
        """Refuse a filter that another wrapper holds: it remembers one batch of teams."""
        holder = _holders.get(id(made))
        if holder is not None and holder.filter is made:
            raise ValueError(
                f"safety_filter: this {type(made).__name__} is held by another "
                f"{type(holder).__name__}, whose teams it remembers; make one for each wrapper"
            )
        _holders[id(made)] = self

    def __setstate__(self, state: dict[str, Any]) -> None:
        """A copy holds the copy of its filter alone, too."""
        self.__dict__.update(state)
        _holders[id(self.filter)] = self

    def _note_seen(self) -> None:
        """Note that what is remembered is of the teams as they are now."""
        self._seen = self._base.simulator.changes

    def _check_seen(self) -> None:
        """Refuse a step from what the filter has not seen: before a reset, or after a step that was
        made beneath the wrapper or has failed.
        """
        if self._seen != self._base.simulator.changes:
            raise RuntimeError(
                f"call reset() of {type(self).__name__} before step(); an environment that was "
                "reset, stepped or given a state before it was wrapped or beneath its wrapper, or "
                "whose last step was interrupted, needs a new reset of the wrapper, or its "
                "set_state()"
            )

    def _step_beneath(self, actions: Any) -> Any:
        """One step of what is wrapped; a wrapper between that makes others of it is refused, or a
        reset.
        """
        before = self._base.simulator.changes
        told = self.env.step(actions)
        if self._base.simulator.changes != before + 1:
            raise RuntimeError(
                f"a wrapper beneath {type(self).__name__} has stepped or reset the teams itself, "
                "or kept a step from them; put it around the guarantee, and reset()"
            )
        return told

    def get_state(self) -> dict[str, Any]:
        """The running episodes and the wrapper's memory, as copies."""
        return {
            "env": self._base.get_state(),
            self.filter.state_key: self.filter.get_state(),
            "observed": self._observed.copy(),
        }

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Put back what ``get_state`` took out; a ValueError names what does not fit, and nothing
        has changed then.
        """
        key = self.filter.state_key
        check_keys(state, ("env", key, "observed"), exactly=True)
        checked = check_entries({"observed": self._observed}, state)
        check_finite(checked, ("observed",))
        remembered = self.filter.check_state(state[key])
        self._base.set_state(state["env"])
        self.filter.set_state(remembered)
        self._observed = checked["observed"].copy()
        self._note_seen()


# ---- constructors of the four wrappers, the same for both APIs -----------------------------------


class _Constructed:
    """A base beside a GuaranteeWrapper, whose constructor comes from ``declared_for``."""

    def _make(self, *arguments: Any, **settings: Any) -> None:
        super().__init__(*arguments, **settings)


def declared_for(kind: type[SafetyFilter]) -> Callable[[_Constructor], _Constructor]:
    """Turns a declaration into a constructor: arguments given, and defaults, go to the filter.

    Unknown keywords are refused with a TypeError that names the nearest argument.
    """

    def fill(declared: _Constructor) -> _Constructor:
        signature = inspect.signature(declared)
        known = list(signature.parameters)[1:]

        @functools.wraps(declared)
        def make(self: Any, *arguments: Any, **given: Any) -> None:
            ours = [c for c in type(self).__mro__ if c.__module__.startswith(__package__)]
            known_fields(given, known, ours[0].__name__, "argument")
            bound = signature.bind(self, *arguments, **given)
            bound.apply_defaults()
            settings = {name: bound.arguments[name] for name in known}
            self._make(settings.pop("env"), kind, settings.pop("decision_period"), **settings)

        return make  # type: ignore[return-value]

    return fill


class HeadingSettings(_Constructed):
    """Theorem C: ``HeadingVectorWrapper``."""

    steering: HeadingFilter

    @declared_for(HeadingFilter)
    def __init__(
        self,
        env: Any,
        min_alignment: float = 0.1,
        max_turn_rate: float = MAX_TURN_RATE,
        frame: str = "net_bearing",
        decision_period: int = 1,
        certified: bool = True,
        bearing_error: float = 0.0,
    ) -> None: ...


class TankSettings(_Constructed):
    """Theorem D: ``EnergyTankWrapper``."""

    tank: EnergyTank

    @declared_for(EnergyTank)
    def __init__(
        self,
        env: Any,
        budget: float = 0.0,
        min_alignment: float = TANK_MARGIN,
        frame: str = "net_bearing",
        decision_period: int = 1,
        observe_level: bool = False,
        bearing_error: float = 0.0,
    ) -> None: ...


class GainSettings(_Constructed):
    """Theorem G: ``GainWrapper``."""

    gains: Gains

    @declared_for(Gains)
    def __init__(
        self,
        env: Any,
        min_gain: float | None = None,
        max_gain: float | None = None,
        frame: str = "net_bearing",
        decision_period: int = 1,
    ) -> None: ...


class LinkSettings(_Constructed):
    """Theorem R: ``LinkKeepingWrapper``."""

    links: LinkKeeping

    @declared_for(LinkKeeping)
    def __init__(
        self,
        env: Any,
        share: float = 0.5,
        bearing_error: float = 0.0,
        frame: str = "net_bearing",
        decision_period: int = 1,
    ) -> None: ...
