"""Common parts of the guarantee wrappers for PettingZoo and vector environments."""

import functools
import inspect
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

from ..checks import check_int, choice, counted, raise_invalid
from ..engine.state_checks import check_entries, check_finite, check_keys
from ..field_checks import known_fields
from ..limits import MAX_HELD_STEPS
from ..safety.gains import Gains
from ..safety.heading import HeadingFilter
from ..safety.links import LinkKeeping
from ..safety.safety_filter import FILTERS, SafetyFilter
from ..safety.settings import MAX_TURN_RATE, TANK_MARGIN
from ..safety.tank import EnergyTank
from ..simulator import Simulator
from ..state_view import STANDING
from .overrides import arguments_of
from .spaces import choice_box, observation_box

AnyFilter = SafetyFilter | type[SafetyFilter] | str
"""A filter, its class or its name."""
_Constructor = TypeVar("_Constructor", bound=Callable[..., None])
_holders: weakref.WeakValueDictionary[int, Any] = weakref.WeakValueDictionary()
"""Wrapper by the id of its filter; kept outside filters, which are pickled."""
_OF_STATES = ("decision_period", "env", "observed")
_OF_INFOS = (
    *STANDING, "active", "clearance", "contact", "final_info", "final_obs", "merged_into",
    "robot_rewards", "summary",
)  # fmt: skip
"""Reserved names of infos."""


def check_period(decision_period: int) -> int:
    """Validated decision period, a positive integer."""
    return check_int("decision_period", decision_period, 1, MAX_HELD_STEPS)


def layers_of(env: Any) -> Iterator[Any]:
    """Layers of an environment of either API, outermost first.

    PettingZoo's conversions between parallel and AEC form are included.
    """
    while env is not None:
        yield env
        beneath = getattr(env, "env", None)
        env = getattr(env, "aec_env", None) if beneath is None else beneath


def component_mask(env: Any) -> NDArray[np.bool_] | None:
    """True for action components that a robot has, (n, a), also under a filter; None if all are."""
    masks = [layer.action_mask for layer in layers_of(env) if hasattr(layer, "action_mask")]
    own: NDArray[np.bool_] | None = masks[0] if masks else env.unwrapped.scenario.action_mask
    return None if own is None or own.all() else own


def settings_of(kind: type[SafetyFilter]) -> list[str]:
    """Names of the settings of a filter."""
    return [name for name in arguments_of(kind)[2:] if name != "num_threads"]


def make_filter(
    safety_filter: AnyFilter, simulator: Simulator, settings: Mapping[str, Any]
) -> SafetyFilter:
    """Create a filter for a simulator; raises for an unknown name or other environments."""
    scenario, num_envs = simulator.scenario, simulator.num_envs
    own = ["decision_period"]  # an argument of the wrapper, listed for suggestions
    if isinstance(safety_filter, SafetyFilter):
        known_fields(settings, own, "a safety_filter instance", "setting")
        if (safety_filter.scenario, len(safety_filter.held)) != (scenario, num_envs):
            raise_invalid(
                "safety_filter",
                safety_filter,
                f"of this scenario and {counted(num_envs, 'environment')}",
            )
        return safety_filter
    kind: Any = safety_filter
    if not isinstance(kind, type):
        kind = FILTERS[choice("safety_filter", kind, FILTERS)]
    if not issubclass(kind, SafetyFilter):
        raise_invalid("safety_filter", kind, "a SafetyFilter, a subclass of it, or the name of one")
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


class FilterWrapperMixin:
    """Mixin of guarantee wrappers for both APIs: the filter and its memory."""

    _wraps: tuple[type, type]
    """Supported classes: of the API, and of this project."""
    _wanted: str
    """Description of supported environments, a template with the wrapper's name."""
    _changing: tuple[type, ...] = ()
    """Wrapper classes that change observations or actions, which invalidate a guarantee."""
    env: Any
    _base: Any
    """Innermost environment."""

    def __init__(
        self, env: Any, safety_filter: AnyFilter, decision_period: int = 1, **settings: Any
    ) -> None:
        self._base = base = self._base_of(env)
        self.decision_period = check_period(decision_period)
        self.filter = made = make_filter(safety_filter, base.simulator, settings)
        self._check_names(made)
        self._register_filter(made)
        setattr(self, made.state_key, made)
        scenario = base.scenario
        shape = base.simulator.num_envs, scenario.n_robots, *scenario.observation_layout.shape
        self._observed = np.zeros(shape, dtype=np.float32)
        self._seen = -1
        self._checks_passage = env is not base and not any(
            getattr(type(layer), "part_of_world", False) for layer in layers_of(env)
        )
        """True if wrappers beneath must not change actions or observations."""
        if self._checks_passage:
            self._vector_env_of(base).records_passage = True
        super().__init__(env)  # type: ignore[call-arg]  # the wrapper of the API
        robot = observation_box(scenario, base.flatten, made)
        self._make_spaces(robot, choice_box(made))

    def _base_of(self, env: Any) -> Any:
        """Innermost environment; a TypeError if it is not supported."""
        wrapper, (of_api, ours) = type(self).__name__, self._wraps
        base = isinstance(env, of_api) and env.unwrapped  # type: ignore[attr-defined]
        if not isinstance(base, ours):
            wanted = self._wanted.format(wrapper)
            raise TypeError(f"env is a {type(env).__name__}; it must be {wanted}")
        for layer in layers_of(env):
            if isinstance(layer, FilterWrapperMixin):
                raise TypeError(
                    f"env already has the safety filter {type(layer).__name__}, which {wrapper} "
                    "cannot wrap: two filters void both guarantees; wrap the environment itself"
                )
        for layer in layers_of(env):
            if isinstance(layer, self._changing):
                raise TypeError(
                    f"env is wrapped in {type(layer).__name__}, which changes observations or "
                    f"actions, and {wrapper} cannot wrap it; apply it outside {wrapper}"
                )
        for layer in reversed([*layers_of(env)]):
            if layer is not base and self._spaces_of(layer, base) != self._spaces_of(base, base):
                raise TypeError(
                    f"env is wrapped in {type(layer).__name__}, which changes the spaces of "
                    f"observations or actions, and {wrapper} cannot wrap it; apply it outside "
                    f"{wrapper}"
                )
        return base

    @staticmethod
    def _spaces_of(layer: Any, base: Any) -> Any:
        """Observation and action spaces as declared by a layer over ``base``."""
        raise NotImplementedError

    @staticmethod
    def _vector_env_of(base: Any) -> Any:
        """Innermost vector environment, which receives all actions."""
        raise NotImplementedError

    def _check_passage(
        self, actions: NDArray[np.float32] | None, observations: NDArray[np.float32], robots: Any
    ) -> None:
        """Raise a RuntimeError if a wrapper beneath has changed actions or observations.

        Compares the actions (B, n, a) of some robots, given by an index, and the observations (B,
        n, rows, d) with those of the base environment.
        """
        executed, observed = self._vector_env_of(self._base).passage
        changed = []
        if actions is not None and not np.array_equal(executed[robots], actions[robots]):
            changed.append("actions")
        if not np.array_equal(observed, observations):
            changed.append("observations")
        if changed:
            wrapper = type(self).__name__
            raise RuntimeError(
                f"a wrapper beneath {wrapper} ({self._named_between()}) has changed "
                f"{' and '.join(changed)}, which voids the guarantee of {wrapper}; apply it "
                f"outside {wrapper}, and reset(). A model of sensors or actuators declares the "
                "class attribute part_of_world = True"
            )

    def _make_spaces(self, observations: Box, choices: Box) -> None:
        """Create the spaces of the API from those of one robot."""
        raise NotImplementedError

    def _check_names(self, made: SafetyFilter) -> None:
        """Raise a ValueError if names of a filter's memory or infos are already in use."""
        kind, key = type(made).__name__, made.state_key
        if not (isinstance(key, str) and key.isidentifier()) or key[0] == "_":
            raise_invalid(f"state_key of {kind}", key, "a word that does not begin with _")
        if key in _OF_STATES or hasattr(type(self), key) or hasattr(self._base, key):
            raise_invalid(f"state_key of {kind}", key, "a name that environments do not use")
        of_infos = {*_OF_INFOS, *self._base.simulator.costs}
        of_infos |= {*self._base.simulator.conditions}
        if taken := sorted(of_infos & set(made.diagnostics)):
            raise ValueError(
                f"{kind} reports {taken[0]!r}, which is already a key of the environments' infos; "
                "give it another name"
            )

    def _register_filter(self, made: SafetyFilter) -> None:
        """Register the filter; raise a ValueError if another wrapper uses it."""
        holder = _holders.get(id(made))
        if holder is not None and holder.filter is made:
            raise ValueError(
                f"safety_filter: this {type(made).__name__} is used by another "
                f"{type(holder).__name__} and stores the state of its environments; make one for "
                "each wrapper"
            )
        _holders[id(made)] = self

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore a copy and register its filter."""
        self.__dict__.update(state)
        _holders[id(self.filter)] = self

    def _note_seen(self) -> None:
        """Mark the filter's memory as up to date."""
        self._seen = self._base.simulator.changes

    def _check_seen(self) -> None:
        """Raise a RuntimeError if the filter has not observed the current state.

        This is so before a reset, and after a failed step or a step of the inner environment.
        """
        if self._seen != self._base.simulator.changes:
            raise RuntimeError(
                f"call reset() of {type(self).__name__} before step(); the wrapper needs a reset() "
                "or set_state() after the environment was reset, stepped or given a state without "
                "it, or after an interrupted step"
            )

    def _step_beneath(self, actions: Any) -> Any:
        """Step the wrapped environment; raises if a wrapper in between steps again or resets."""
        before = self._base.simulator.changes
        returned = self.env.step(actions)
        if self._base.simulator.changes != before + 1:
            raise RuntimeError(
                f"a wrapper beneath {type(self).__name__} has stepped or reset the environments "
                "itself, or skipped a step; apply it outside the guarantee wrapper, and reset()"
            )
        self._check_infos(returned[-1])
        return returned

    def _check_infos(self, infos: Any) -> None:
        """Raise a RuntimeError if a wrapper beneath returns infos other than a dict."""
        if not isinstance(infos, Mapping):
            raise RuntimeError(
                f"a wrapper beneath {type(self).__name__} ({self._named_between()}) returns infos "
                f"as a {type(infos).__name__}; they must be a dict: apply it outside the guarantee "
                "wrapper"
            )

    def _named_between(self) -> str:
        """Classes of the wrappers beneath, the outermost first."""
        between = [one for one in layers_of(self.env) if one is not self._base]
        return ", ".join(type(one).__name__ for one in between)

    @property
    def _parts(self) -> dict[str, Any]:
        """Stateful parts by their key in a state."""
        return {self.filter.state_key: self.filter}

    @property
    def _arrays(self) -> dict[str, NDArray[Any]]:
        """Further arrays of a state, (B, ...)."""
        return {"observed": self._observed}

    def get_state(self) -> dict[str, Any]:
        """Copies of the running episodes and the wrapper's memory."""
        memory = {name: part.get_state() for name, part in self._parts.items()}
        memory |= {name: array.copy() for name, array in self._arrays.items()}
        return {"env": self._base.get_state(), **memory}

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Restore a state of ``get_state``.

        Raises:
            ValueError: naming an entry that does not fit; the state is unchanged.
        """
        parts = self._parts
        check_keys(state, ("env", *parts, *self._arrays), exactly=True)
        arrays = check_entries(self._arrays, state)
        check_finite(arrays, arrays)
        memories = {name: part.check_state(state[name]) for name, part in parts.items()}
        self._base.set_state(state["env"])
        for name, part in parts.items():
            part.set_state(memories[name])
        self._observed = self._observed.copy()  # callers may hold the old array
        for name, array in self._arrays.items():
            array[...] = arrays[name]
        self._note_seen()


# Constructors of the four wrappers, the same for both APIs.


def declared_for(kind: type[SafetyFilter]) -> Callable[[_Constructor], _Constructor]:
    """Decorator that turns a declaration into a constructor that builds the filter.

    Unknown keywords raise a TypeError that names the closest argument.
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
            env, period = settings.pop("env"), settings.pop("decision_period")
            FilterWrapperMixin.__init__(self, env, kind, period, **settings)

        return make  # type: ignore[return-value]

    return fill


class HeadingSettings(FilterWrapperMixin):
    """Settings of ``HeadingVectorWrapper`` (theorem C)."""

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


class TankSettings(FilterWrapperMixin):
    """Settings of ``EnergyTankWrapper`` (theorem D)."""

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


class GainSettings(FilterWrapperMixin):
    """Settings of ``GainWrapper`` (theorem G)."""

    gains: Gains

    @declared_for(Gains)
    def __init__(
        self,
        env: Any,
        min_gain: float | Sequence[float] | None = None,
        max_gain: float | Sequence[float] | None = None,
        frame: str = "net_bearing",
        decision_period: int = 1,
    ) -> None: ...


class LinkSettings(FilterWrapperMixin):
    """Settings of ``LinkKeepingWrapper`` (theorem R)."""

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
