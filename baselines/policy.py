"""Policy protocol, base classes and registry."""

import inspect
import math
import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple, Protocol, TypeVar, overload, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.checks import Registry, bools, choice, raise_invalid, short_repr
from rendezvous_env.deprecation import warn_renamed
from rendezvous_env.field_checks import known_fields
from rendezvous_env.scenario.scenario import Scenario
from rendezvous_env.scenario.scenarios import ScenarioLike, resolve
from rendezvous_env.suggestions import closest_match

Float32 = NDArray[np.float32]
Mask = NDArray[np.bool_]


class Policy(Protocol):
    """Protocol of a policy: actions of all robots from their observations."""

    def __call__(self, observations: NDArray[Any], time: ArrayLike) -> Float32:
        """Actions of all robots.

        Args:
            observations: (..., n, rows, d), see ``scenario.observation_layout``; rows of merged
                robots are zero.
            time: since the start of each episode, s, (...) or a number.

        Returns:
            Actions, (..., n, a), within ``scenario.action_bounds``.
        """
        ...

    def reset(self, mask: Mask | None = None) -> None:
        """Reset the state of environments where ``mask`` (...) is true; None resets all."""
        ...


@runtime_checkable
class RealTimePolicy(Policy, Protocol):
    """Policy whose memory depends on elapsed time instead of the number of calls."""

    def after(self, elapsed: float, observations: NDArray[Any], time: ArrayLike) -> Float32:
        """Actions, held for at most τ, ``elapsed`` > 0 s after the previous call, if any."""
        ...


class TeamPolicy(ABC):
    """Base class of policies that accept batched arrays or the dicts of PettingZoo.

    Usage: ``actions = policy(observations, time)``.
    """

    scenario: Scenario

    @property
    def guarantee(self) -> dict[str, Any] | None:
        """Arguments of ``certificate`` for the policy; None without a guarantee."""
        return None

    @abstractmethod
    def act(self, observations: NDArray[Any], time: ArrayLike) -> Float32:
        """Actions (..., n, a); see ``Policy``."""

    @overload
    def __call__(self, observations: Mapping[str, Any], time: ArrayLike) -> dict[str, Float32]: ...

    @overload
    def __call__(self, observations: NDArray[Any], time: ArrayLike) -> Float32: ...

    def __call__(self, observations: Any, time: ArrayLike) -> Any:
        """As ``Policy``, or with dicts by agent name for the active robots of one environment.

        Dict values are observations (rows, d) or (rows·d,).

        Raises:
            KeyError: for an unknown agent name.
            ValueError: for observations of another shape.
        """
        if not isinstance(observations, Mapping):
            return self.act(observations, time)
        layout, n = self.scenario.observation_layout, self.scenario.n_robots
        robots = {f"robot_{i}": i for i in range(n)}
        table = np.zeros((n, *layout.shape), dtype=np.float32)
        for name, seen in observations.items():
            if name not in robots:
                known = f"they are robot_0 to robot_{n - 1}"
                raise KeyError(f"there is no robot {short_repr(name)}; {known}")
            given = np.asarray(seen)
            if given.shape not in (layout.shape, (table[0].size,)):
                raise ValueError(
                    f"observation of {name} has shape {given.shape}; it must be {layout.shape}"
                )
            table[robots[name]] = given.reshape(layout.shape)
        actions = self.act(table, time)
        return {name: actions[robots[name]] for name in observations}

    def reset(self, mask: Mask | None = None) -> None:  # noqa: B027 - most policies have no state
        """Reset the state of environments where ``mask`` (...) is true; None resets all."""


class StatefulPolicy(TeamPolicy):
    """Base class of policies with memory, one per environment of the observations' leading axes."""

    _leading: tuple[int, ...] | None = None  # None before the first call

    @abstractmethod
    def _start(self, teams: int) -> None:
        """Allocate the memory of a number of environments."""

    @abstractmethod
    def _forget(self, which: Mask) -> None:
        """Clear the memory of the given environments, (B,)."""

    def _teams_of(self, observations: NDArray[Any]) -> Float32:
        """Observations as (B, n, rows, d); memory starts anew if the leading axes change."""
        n, layout = self.scenario.n_robots, self.scenario.observation_layout
        seen = np.ascontiguousarray(layout.checked(observations), dtype=np.float32)
        if seen.ndim < 3 or seen.shape[-3] != n:
            raise ValueError(
                f"observations have shape {seen.shape}; scenario {self.scenario.name!r} needs "
                f"(..., {n}, {layout.rows}, {layout.dim})"
            )
        if seen.shape[:-3] != self._leading:
            self._begin(seen.shape[:-3])
        return seen.reshape(-1, *seen.shape[-3:])

    def _begin(self, leading: tuple[int, ...]) -> None:
        self._leading = leading
        self._start(math.prod(leading))

    def _as_given(self, values: NDArray[Any]) -> NDArray[Any]:
        """Reshape values (B, ...) to the leading axes of the observations."""
        assert self._leading is not None
        return values.reshape(*self._leading, *values.shape[1:])

    def reset(self, mask: Mask | None = None) -> None:
        """As ``Policy.reset``; a ValueError for a mask of another shape."""
        if mask is None:
            self._leading = None
        elif self._leading is not None:
            self._forget(bools("mask", mask, self._leading, "environments").reshape(-1))


KINDS = {
    "law": "laws, most of them of the paper",
    "field": "laws from the literature",
    "rule": "rules for obstacles",
    "tank": "rules under an energy tank",
    "own": "policies of users",
    "learned": "learned policies",
    "privileged": "oracle baselines, which use the map and all positions",
    "blind": "blind baselines, which ignore observations",
}
"""Kinds of policies, in the order of lists and tables."""


class _Entry(NamedTuple):
    build: Callable[..., Policy]
    fits: Callable[[Scenario], bool]
    kind: str
    on_request: bool


_registry: dict[str, _Entry] = {}
_FORMER = {
    "tangent-joined": "tangent-merged",
    "tangent-joined-certified": "tangent-merged-certified",
    "tangent-joined-tuned": "tangent-merged-tuned",
    "tank-joined": "tank-merged",
}
"""Deprecated names of policies."""
AT_PATH = "learned:"
"""Prefix of the path of a learned policy in a name."""
_readers: dict[str, Callable[[str, Scenario], Policy]] = {}
"""Readers of policies by prefix of their names, such as AT_PATH."""
_builders = Registry("policy", "baselines.policy.register")
_Builder = TypeVar("_Builder", bound=Callable[..., Policy])


def register(
    name: str, fits: Callable[[Scenario], bool], *, kind: str = "own", on_request: bool = False
) -> Callable[[_Builder], _Builder]:
    """Register the decorated builder ``(scenario, **options) -> Policy``, a function or class.

    Args:
        name: name for ``make``.
        fits: scenario → whether the policy can control its robots.
        kind: one of KINDS; policies of a kind keep the order of registration.
        on_request: whether a comparison includes it only if named.

    Raises:
        ValueError: for an unknown kind, an invalid name, a name of another kind, or a builder that
            is not callable.
    """
    choice("kind", kind, KINDS)
    checked = _builders.add(name, None)
    if ":" in name:
        raise_invalid("name of a policy", name, "without a colon, as commands read MODULE:FUNCTION")
    if name in _registry and kind_of(name) != kind:
        raise_invalid("name of a policy", name, f"another: it is one of the {KINDS[kind_of(name)]}")
    if not callable(fits):
        raise_invalid(f"fits of policy {name!r}", fits, "a function of a scenario")

    def enter(build: _Builder) -> _Builder:
        _registry[name] = _Entry(checked(build), fits, kind, on_request)
        return build

    return enter


def names(scenario: ScenarioLike | None = None) -> list[str]:
    """Names of the policies that fit a scenario, or of all policies, in the order of KINDS."""
    kinds, resolved = list(KINDS), None if scenario is None else resolve(scenario)
    fitting = [n for n, entry in _registry.items() if resolved is None or entry.fits(resolved)]
    return sorted(fitting, key=lambda name: kinds.index(_registry[name].kind))


def register_reader(prefix: str, read: Callable[[str, Scenario], Policy]) -> None:
    """Register a reader of names with a prefix for ``make``; ``read`` gets the rest of the name."""
    _readers[prefix] = read


def current_name(name: str) -> str:
    """Name of a policy that may be given by a deprecated name; other names are returned as given.

    A policy that users register under a deprecated name keeps it.
    """
    return name if name in _registry else _FORMER.get(name, name)


# The next four raise a KeyError for an unregistered name; deprecated ones are accepted.


def kind_of(name: str) -> str:
    """Kind of a policy, one of KINDS."""
    return "learned" if name.startswith(AT_PATH) else _entry(name).kind


def on_request(name: str) -> bool:
    """True if a comparison includes a policy only if named."""
    return _entry(name).on_request


def builder_of(name: str) -> Callable[..., Policy]:
    """Builder of a policy."""
    return _entry(name).build


def about(name: str) -> str:
    """One-line description of a policy, from its builder's docstring; empty without one."""
    return (inspect.getdoc(_entry(name).build) or "").partition("\n")[0].rstrip(".")


def _entry(name: str) -> _Entry:
    return _registry[current_name(name)]


def make(name: str | os.PathLike[str], scenario: ScenarioLike, **options: Any) -> Policy:
    """Create a policy for a scenario: a Scenario, the name of one or a TOML file.

    ``name`` is one of ``names(scenario)``, or "learned:PATH" of a training run, a checkpoint or an
    exported network; a Path is equivalent. ``options`` are those of the policy, for example
    ``clearance`` of "tangent-merged".

    Raises:
        ValueError: for an unknown name or option, or a policy that does not fit the scenario; the
            message lists the valid ones.
    """
    scenario = resolve(scenario)
    if isinstance(name, os.PathLike):
        name = f"{AT_PATH}{os.fspath(name)}"
    for prefix, read in _readers.items():
        if isinstance(name, str) and name.startswith(prefix):
            known_fields(options, (), f"policy {short_repr(name)}", "option")
            return read(name.removeprefix(prefix), scenario)
    if isinstance(name, str) and (current := current_name(name)) != name:
        warn_renamed(f"policy {name!r}", repr(current))
        name = current
    fitting = names(scenario)
    if not isinstance(name, str) or name not in fitting:
        known = "is unknown"
        if isinstance(name, str) and name in _registry:
            slots = scenario.observation_layout.obstacle_slots
            robots = f"{scenario.model.name} robots in {scenario.dim}-D"
            known = f"does not fit {robots} with {slots} obstacle slots"
        elif isinstance(name, str) and os.path.exists(name):
            known += f"; a path is written {AT_PATH}{name}"
        elif isinstance(name, str) and ":" in name:
            module, _, function = name.partition(":")
            known += f" (commands read MODULE:FUNCTION; in Python call {module}.{function} itself)"
        right = f"those that fit are {', '.join(fitting)}{closest_match(name, fitting, '; ')}"
        raise ValueError(f"policy {short_repr(name)} {known}; {right}")
    build = _registry[name].build
    allowed = [option for option in inspect.signature(build).parameters if option != "scenario"]
    known_fields(options, allowed, f"policy {name!r}", "option")
    return build(scenario, **options)


def file_of(build: Callable[..., Any]) -> Path | None:
    """Source file of a function; None for an interactive definition."""
    try:
        found = inspect.getsourcefile(build)
    except TypeError:  # a callable object
        return None
    return Path(found) if found is not None and Path(found).is_file() else None


def of_model(*models: str, dim: int | None = None) -> Callable[[Scenario], bool]:
    """Predicate: whether a scenario has one of the given robot models and dimensions."""
    return lambda scenario: scenario.robot_model in models and dim in (None, scenario.dim)


is_single_integrator = of_model("single_integrator")
"""True if actions are velocities."""
in_the_plane = of_model("single_integrator", dim=2)
"""True if actions are velocities in the plane."""
is_double_integrator = of_model("double_integrator")
"""True if actions are accelerations."""


def within_limits(actions: NDArray[np.float64], scenario: Scenario) -> Float32:
    """Limit actions (..., n, a), or (..., a), to the scenario's bounds.

    Velocities and accelerations are scaled to their limit with their direction kept, also in mixed
    teams; speeds and turn rates of the other models are clipped individually.
    """
    for_each = scenario.per_robot and actions.shape[-2:-1] == (scenario.n_robots,)
    bounds = scenario.robot_bounds if for_each else scenario.action_bounds
    if is_single_integrator(scenario) or is_double_integrator(scenario):
        actions = _shortened(actions, bounds)
    elif for_each and scenario.mixes_models:
        turns = scenario.nonholonomic_robots[:, np.newaxis]
        actions = np.where(turns, actions, _shortened(actions, bounds))
    limited: Float32 = np.clip(actions, -bounds, bounds).astype(np.float32)
    return limited


def _shortened(vectors: NDArray[np.float64], bounds: NDArray[np.float64]) -> NDArray[np.float64]:
    """Vectors (..., a), at most as long as the first of their bounds (..., a)."""
    sizes = np.linalg.norm(vectors, axis=-1, keepdims=True)
    shortened: NDArray[np.float64] = vectors * (
        np.minimum(sizes, bounds[..., :1]) / np.where(sizes > 0, sizes, 1.0)
    )
    return shortened
