"""Which policies a command can compare, by name: those of the registry, ``learned:PATH``, which is
that of a run, of a checkpoint or of an exported network, and ``module:function``, a user's own.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import baselines
from baselines import policy as registry
from baselines.learned import learned_policy, shipped
from baselines.learned.robots import can_steer
from rendezvous_env.experiment.scenario import Scenario, nearest_word
from rendezvous_env.trajectory import Policy

from . import own_policies
from .errors import UserError

_LEARNED = "learned"
_AT_PATH = f"{_LEARNED}:"
_BEST = ("learned-tank", "tank-joined", "learned", "tangent-joined-tuned", "tangent-joined")
"""Policies for obstacles; the sooner, the more starts are met cleanly (README, Results)."""
_ON_REQUEST = ("blind", "privileged")
"""Kinds of policies that are compared where they are named."""
_WHERE_SENSORS_ERR = ("learned-tank-noise",)
"""Policies that have nothing over others where sensors are exact."""


def names(scenario: Scenario) -> list[str]:
    """Names of all policies that fit a scenario, in the order of their kinds."""
    return baselines.names(scenario)


def kind_of(name: str) -> str:
    """The kind of a policy, one of ``baselines.policy.KINDS``."""
    if own_policies.is_own(name):
        return "own"
    return _LEARNED if name.startswith(_AT_PATH) else registry.kind_of(name)


def about(name: str) -> str:
    """What a policy is, in a line; empty if nothing is said of it."""
    return "" if ":" in name else registry.about(name)


def make(name: str, scenario: Scenario) -> Policy:
    """A new policy of that name.

    Raises:
        ValueError: if it is unknown, does not fit, or cannot be read.
    """
    if own_policies.is_own(name):
        if (policy := own_policies.make(name, scenario)) is None:
            raise ValueError(f"policy {name!r} does not fit scenario {scenario.name!r}")
        return policy
    if name.startswith(_AT_PATH):
        return learned_policy.load(Path(name.removeprefix(_AT_PATH)), scenario)
    return baselines.make(name, scenario)


def learned_path(name: str) -> Path | None:
    """Folder of a learned policy; None for the name of a scripted one."""
    if name in shipped.NAMES:
        return shipped.folder(name)
    return Path(name.removeprefix(_AT_PATH)) if name.startswith(_AT_PATH) else None


def fitting(scenario: Scenario, wanted: Sequence[str]) -> list[str]:
    """Those of the wanted policies that fit a scenario; if none is named all that fit and are not
    only there on request, but those that see nothing or everything only where nothing else fits.
    """
    known = names(scenario)
    if not wanted:
        usual = [name for name in known if not registry.on_request(name)]
        if scenario.sensing.exact:
            usual = [name for name in usual if name not in _WHERE_SENSORS_ERR]
        return [name for name in usual if kind_of(name) not in _ON_REQUEST] or usual
    return [name for name in wanted if name in known or _fits_unlisted(name, scenario)]


def _fits_unlisted(name: str, scenario: Scenario) -> bool:
    """Whether a policy that no registry lists fits a scenario."""
    if own_policies.is_own(name):
        return own_policies.fits(name, scenario)
    return name.startswith(_AT_PATH) and can_steer(scenario)


def source_file(name: str) -> Path | None:
    """The file in which a policy is made that has no weights; None if it stands in none."""
    home = own_policies if own_policies.is_own(name) else registry
    return home.source_file(name)


def best(scenario: Scenario) -> str:
    """The policy to take where none is named: the best that fits, for obstacles if there are any,
    else the law of such robots.
    """
    known = fitting(scenario, ())
    return next((name for name in _BEST if scenario.obstacles and name in known), known[0])


def check_names(wanted: Sequence[str]) -> None:
    """Refuse a name that no policy has, and a learned policy that cannot be read.

    Raises:
        UserError: with the nearest known name, or with what is wrong with the learned policy.
    """
    known = baselines.names()
    for name in wanted:
        if own_policies.is_own(name):
            own_policies.find(name)
        elif learned_path(name) is not None:
            _check_learned(name)
        elif name not in known:
            near = nearest_word(name, known)
            hint = f"did you mean {near!r}? " if near else ""
            raise UserError(
                f"policy {name!r} is unknown; {hint}known are {', '.join(known)}, {_AT_PATH}PATH, "
                "MODULE:FUNCTION"
            )


def _check_learned(name: str) -> None:
    try:
        make(name, Scenario(n_robots=2))
    except ValueError as error:
        raise UserError(f"policy {name!r}: {error}") from error


def promised_margin(name: str, policy: Policy) -> float | None:
    """Alignment margin ε that a policy keeps by construction; None if it promises none.

    It is 1 for law (1), and the attribute ``min_alignment`` of a policy with certified headings.
    """
    if name == "bearing-only":
        return 1.0
    margin = getattr(policy, "min_alignment", None)
    return None if margin is None else float(margin)
