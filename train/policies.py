"""Policies and scenarios by name, for commands.

Policies: registered names; ``learned:PATH`` of a run, a checkpoint or an exported network;
``module:function`` for custom ones. Scenarios: by name or TOML file.
"""

import hashlib
import importlib
import inspect
import math
import os
import re
import sys
import tomllib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
from rendezvous_env.baselines import policy as registry
from rendezvous_env.baselines.learned import shipped
from rendezvous_env.baselines.policy import AT_PATH, builder_of, file_of
from rendezvous_env.baselines.steering import can_steer

from rendezvous_env import baselines
from rendezvous_env.checks import short_repr
from rendezvous_env.graphs.random_graphs import FAMILIES, CustomFamily
from rendezvous_env.rewards.custom_terms import COSTS, TERMS
from rendezvous_env.robots.robot_models import is_custom
from rendezvous_env.safety.theorems.certificate import certificate
from rendezvous_env.scenario import scenarios
from rendezvous_env.scenario.scenario import Scenario
from rendezvous_env.sensors.custom_sensors import IMPERFECTIONS
from rendezvous_env.simulator import Simulator
from rendezvous_env.suggestions import closest_match
from rendezvous_env.trajectory import Policy, begin

from .checks import GivenScenario, UserError, unknown_name, user_error

_BEST = ("learned-tank", "tank-merged", "learned", "tangent-merged-tuned", "tangent-merged")
"""Policies for obstacles, in order of decreasing collision-free success."""
_ON_REQUEST = ("blind", "privileged")
"""Kinds of policies that are compared only if named."""
_WHERE_SENSORS_ERR = ("learned-tank-noise", "learned-search")
"""Policies without an advantage for exact sensors."""
_LINK_KEEPING = "link-keeping"
_found: dict[str, tuple[Any, str | None]] = {}
"""Custom functions imported by this process, with the digests of their files."""


def kind_of(name: str) -> str:
    """Kind of a policy, one of ``baselines.policy.KINDS``; "own" for an unregistered name."""
    try:
        return registry.kind_of(name)
    except KeyError:
        return "own"


def labels_of(wanted: Sequence[str]) -> dict[str, str]:
    """Labels of policies given as NAME or LABEL=NAME, by their names; empty without a label."""
    labels: dict[str, str] = {}
    for given in wanted:
        label, equals, name = given.partition("=")
        if not equals or ":" in label or given in baselines.names():
            label, name = "", given
        elif not label.isprintable() or not label.strip() or label in baselines.names():
            raise UserError(f"--policies {given}: label {label!r} is invalid; give another word")
        if name in labels:
            raise UserError(f"policy {name!r} is named twice; name each once")
        if label and label in labels.values():
            raise UserError(f"--policies {given}: two policies have the label {label!r}")
        labels[name] = label
    return labels


def about(name: str) -> str:
    """One-line description of a policy; empty if there is none."""
    return "" if ":" in name else registry.about(name)


def make(name: str, scenario: Scenario) -> Policy:
    """New policy by name; a ValueError if it is unknown, does not fit or is not readable."""
    if is_user_policy(name):
        if (policy := _make_own(name, scenario)) is None:
            raise ValueError(f"policy {name!r} does not fit scenario {scenario.name!r}")
        return policy
    return baselines.make(name, scenario)


def tried(name: str, scenario: Scenario) -> Policy:
    """As ``make`` with a UserError, which also covers the first step of a custom policy."""
    try:
        fitting(scenario, [name])
        return make(name, scenario)
    except (ValueError, OSError) as error:
        raise UserError(str(error)) from error


def called(name: str, policy: Policy, observations: Any, now: Any) -> Any:
    """Actions of a policy at ``now.time``; a UserError names a custom policy that fails."""
    if not is_user_policy(name):
        return policy(observations, now.time)
    with _code_of(name, f" for {observations.shape[-3]} robots"):
        return policy(observations.copy(), now.time)  # a copy, which the policy may modify


def learned_path(name: str, scenario: Scenario | None = None) -> Path | None:
    """Folder of a learned policy for a scenario's robot model, default single integrators."""
    if name in shipped.NAMES:
        return shipped.folder(name, scenario)
    return Path(name.removeprefix(AT_PATH)) if name.startswith(AT_PATH) else None


def fitting(scenario: Scenario, wanted: Sequence[str], *, brief: bool = False) -> list[str]:
    """Policies among the wanted ones that fit a scenario; by default all that compete in it.

    By default, policies on request are excluded. Policies without observations and oracles are
    included only if nothing else fits. ``brief`` excludes policies without a chance, see
    ``_is_hopeless``.
    """
    known = baselines.names(scenario)
    if not wanted:
        usual = [n for n in known if not registry.on_request(n)]
        found = [name for name in usual if kind_of(name) not in _ON_REQUEST] or usual
        return [name for name in found if not (brief and _is_hopeless(name, scenario))]
    return [
        name
        for name in wanted
        if name in known
        or (name.startswith(AT_PATH) and can_steer(scenario))
        or (is_user_policy(name) and _fits_own(name, scenario))
    ]


def _is_hopeless(name: str, scenario: Scenario) -> bool:
    """True if a policy lacks the sensing that a scenario requires, or is made for other sensors.

    These are laws from the literature, which sense no obstacles, among obstacles; and policies for
    imperfect sensors where sensors are exact.
    """
    blind_to_obstacles = kind_of(name) == "field" or name == _LINK_KEEPING
    exact = scenario.sensing.exact and name in _WHERE_SENSORS_ERR
    return exact or (blind_to_obstacles and bool(scenario.obstacles))


def source_digest(name: str) -> str | None:
    """``digest_of`` the factory of a policy without weights.

    For ``module:function`` it is the digest of the file as imported by this process.
    """
    if not is_user_policy(name):
        return digest_of(builder_of(name))
    find_function(name)
    return _found[name][1]


def best(scenario: Scenario) -> str:
    """Default policy: the best that fits among obstacles, else the law of the robot model."""
    known = fitting(scenario, ())
    return next((name for name in _BEST if scenario.obstacles and name in known), known[0])


def check_names(wanted: Sequence[str]) -> None:
    """Raise a UserError for unknown or repeated names and unreadable learned policies."""
    known = baselines.names()
    for name in wanted:
        if wanted.count(name) > 1:
            raise UserError(f"policy {name!r} is named twice; name each once")
        if is_user_policy(name):
            find_function(name)
        elif learned_path(name) is not None:
            with user_error(f"policy {name!r}: ", ValueError):
                make(name, _read_by(name))
        elif name not in known:
            raise unknown_name("policy", name, (*known, f"{AT_PATH}PATH", "MODULE:FUNCTION"))


def _read_by(name: str) -> Scenario:
    """Scenario with robots for which a learned policy can be read: points, else unicycles."""
    points = Scenario(n_robots=2)
    try:
        make(name, points)
    except ValueError:
        unicycles = points.replace(robot_model="unicycle")
        with suppress(ValueError):
            make(name, unicycles)
            return unicycles
    return points


def promised_margin(name: str, policy: Policy) -> float | None:
    """Minimum alignment ε that a policy keeps by construction.

    1 for law (1), ``min_alignment`` of a policy with certified headings, else None.
    """
    margin = 1.0 if name == "bearing-only" else getattr(policy, "min_alignment", None)
    return None if margin is None else float(margin)


def promised_time(name: str, policy: Policy, scenario: Scenario) -> float:
    """Guaranteed rendezvous time of a policy from any initial condition, s, from its certificate.

    It is infinite without a guarantee, for example for tanks, which do not observe merges here.
    """
    asked: dict[str, Any] = {"by": "law"}
    if name == _LINK_KEEPING:
        asked = {"by": "links", "share": 1.0}
    elif name != "bearing-only":
        if (margin := promised_margin(name, policy)) is None:
            return math.inf
        asked = {"by": "heading", "min_alignment": margin}
    found = certificate(scenario, **asked)
    # only law (1) tolerates unknown errors
    told = asked["by"] == "law" or found.bearing_error == 0.0
    return found.time_bound if told else math.inf


def resolve_scenario(name: str, changes: Sequence[str] = ()) -> Scenario:
    """Scenario by name or TOML file with the overrides of ``--set``.

    Overrides are FIELD=VALUE with TOML values and become part of the scenario's name.
    """
    try:
        given: dict[str, Any] = {}
        for change in changes:
            field, equals, value = change.partition("=")
            if not equals:
                raise UserError(f"--set {change}: write FIELD=VALUE, as in n_robots=9")
            table, dot, inner = field.partition(".")
            if dot:
                raise UserError(f"--set {change}: write {table}={{{inner}={value}}}")
            if field in given:
                raise UserError(f"--set {change}: {field} is named twice; give one value")
            try:
                given[field] = tomllib.loads(f"value = {value}")["value"]
            except tomllib.TOMLDecodeError:
                given[field] = value  # plain text
        scenario = name.scenario if isinstance(name, GivenScenario) else scenarios.resolve(name)
        said = [re.sub(r"[^\w.+-]+", "-", change.replace("_", "-")) for change in changes]
        own_name = {"name": "-".join([scenario.name, *said])}
        return scenario.replace(**(own_name | given)) if changes else scenario
    except OSError as error:
        raise UserError(f"scenario {name} cannot be read: {error.strerror or error}") from error
    except (ValueError, TypeError) as error:
        what = f"--set {' '.join(changes)}: " if changes else ""
        raise UserError(f"{what}{error}") from error


def registered(scenario: Scenario) -> list[tuple[str, str | None]]:
    """Registered extensions used by a scenario, with the ``digest_of`` their functions.

    They are known to this process only. The digest of a robot model is that of its constants.
    """
    graph, model = scenario.sensing_graph, scenario.model
    terms = sorted({*dict(scenario.reward.custom), *scenario.costs} - {*COSTS})
    found: list[tuple[str, Callable[..., Any]]] = [
        *((name, IMPERFECTIONS[name]) for name in scenario.sensing.custom),
        *((name, TERMS[name]) for name in terms),
        *([(graph.kind, FAMILIES[graph.kind])] if isinstance(graph, CustomFamily) else []),
        *([(model.name, model.constants)] if is_custom(model) else []),
    ]
    return [(name, digest_of(function)) for name, function in found]


def digest_of(function: Callable[..., Any], path: Path | None = None) -> str | None:
    """Digest of the file that defines a function, or of its source lines in a notebook.

    ``path`` is another file to use. None if the source is unavailable.
    """
    if (path := path or file_of(function)) is not None:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    with suppress(OSError, TypeError):
        return hashlib.sha256(inspect.getsource(function).encode()).hexdigest()
    return None


def is_user_policy(name: str) -> bool:
    """True if a name has the form ``module:function``."""
    return ":" in name and not name.startswith(AT_PATH)


def find_function(name: str) -> Callable[[Scenario], Policy | None]:
    """Function by ``module:function``; the module may be in the current folder."""
    module_name, _, function_name = name.partition(":")
    if not all(part.isidentifier() for part in (*module_name.split("."), function_name)):
        raise UserError(f"policy {name!r}: write MODULE:FUNCTION, as in my_policies:make")
    with _code_of(name, f": importing {module_name} failed"):
        module = _imported(name, module_name)
    if (function := getattr(module, function_name, None)) is None:
        place = getattr(module, "__file__", None) or "built in"
        hint = closest_match(
            function_name, (key for key in vars(module) if key[0] != "_"), before="; "
        )
        raise UserError(f"policy {name!r}: {module_name} ({place}) has no {function_name!r}{hint}")
    if not callable(function):
        raise UserError(
            f"policy {name!r}: {function_name} in {module_name} is {short_repr(function)}; it "
            "must be a function of a scenario that returns a policy"
        )
    if name not in _found or _found[name][0] is not function:
        _found[name] = function, digest_of(function, _file_of(function, module))
    return function


def _file_of(function: Callable[..., Any], module: Any) -> Path | None:
    """File of a custom function; for a callable object, that of its module."""
    place = Path(file_of(function) or getattr(module, "__file__", None) or "")
    return place if place.is_file() else None


def _check_fresh(name: str) -> None:
    """Raise a UserError if the file of a function was edited after this process imported it.

    Worker processes would import another version.
    """
    function = find_function(name)
    place = _file_of(function, sys.modules[name.partition(":")[0]])
    if digest_of(function, place) != source_digest(name):
        raise UserError(
            f"policy {name!r}: {place} was edited since this program imported it; "
            "importlib.reload it, or restart"
        )


def _make_own(name: str, scenario: Scenario) -> Policy | None:
    """Create a custom policy for a scenario; None if it does not fit."""
    function = find_function(name)
    with _code_of(name, f" for scenario {scenario.name!r}"):
        policy = function(scenario)
    if policy is not None and (not callable(policy) or inspect.isclass(policy)):
        raise UserError(
            f"policy {name!r} returned {short_repr(policy)} for scenario {scenario.name!r}; it "
            "must return a function of observations (..., n, rows, d) and time, or None if it "
            "does not fit"
        )
    return policy


def _fits_own(name: str, scenario: Scenario) -> bool:
    """True if a custom policy can control the robots of a scenario, tested for one step."""
    if not name.startswith("__main__:"):  # otherwise it runs in this process and cannot be reloaded
        _check_fresh(name)
    if (policy := _make_own(name, scenario)) is None:
        return False
    simulator = Simulator(scenario, 1)
    observations = simulator.reset(0)
    with _code_of(name, f" in the first step of scenario {scenario.name!r}"):
        begin(policy, simulator)
        simulator.step(np.asarray(policy(observations, simulator.time)))
    return True


@contextmanager
def _code_of(name: str, where: str) -> Iterator[None]:
    """Convert an error in a user's code to a UserError that names the line."""
    try:
        yield
    except UserError:
        raise
    except Exception as error:
        kind = "" if isinstance(error, ModuleNotFoundError) else f"{type(error).__name__}: "
        raise UserError(f"policy {name!r}{where}: {kind}{error}") from error


def _imported(name: str, module: str) -> Any:
    here = os.getcwd()
    if here not in sys.path:  # last, so that no file there shadows a module of other packages
        sys.path.append(here)
        importlib.invalidate_caches()
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name is None or not f"{module}.".startswith(f"{error.name}."):
            raise
        raise UserError(
            f"policy {name!r}: there is no module {error.name!r}, neither installed nor as "
            f"{error.name.replace('.', '/')}.py in {here}"
        ) from error
