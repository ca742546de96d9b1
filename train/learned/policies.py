"""Which policies a command can compare: the scripted and the learned ones, by name.

The one place that turns a name into a policy. ``learned`` and ``learned-tank`` are shipped,
``learned:PATH`` is that of a run or a checkpoint.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import baselines
from baselines import policy as registry
from rendezvous_env.experiment.scenario import Scenario, nearest_word
from rendezvous_env.trajectory import Policy

from ..errors import UserError
from . import learned_policy
from .perception import check_readable

LEARNED = learned_policy.NAME
LEARNED_TANK = learned_policy.TANK_NAME
SHIPPED = (LEARNED, LEARNED_TANK)
_AT_PATH = f"{LEARNED}:"
_BEST = (LEARNED_TANK, "tank-joined", LEARNED, "tangent-joined-tuned", "tangent-joined")
"""Policies for obstacles; the sooner, the more starts are met cleanly (README, Results)."""
_ON_REQUEST = ("blind", "privileged")
"""Kinds of policies that are compared where they are named."""
_ABOUT = {
    LEARNED: "Chooses how far aside of f the joined rule aims; certified, shipped with its weights",
    LEARNED_TANK: "Chooses where to go, all round, under an energy tank; shipped with its weights",
}


def names(scenario: Scenario) -> list[str]:
    """Names of all policies that fit a scenario and can run here, in the order of their kinds."""
    shipped = [name for name in SHIPPED if left_out(name) is None and _can_steer(scenario)]
    found = baselines.names(scenario) + shipped
    return sorted(found, key=lambda name: registry.in_order(kind_of(name)))


def kind_of(name: str) -> str:
    """The kind of a policy, one of ``baselines.policy.KINDS``."""
    return LEARNED if learned_path(name) is not None else registry.kind_of(name)


def about(name: str) -> str:
    """What a policy is, in a line; empty if nothing is said of it."""
    return _ABOUT[name] if name in SHIPPED else registry.about(name)


def left_out(name: str = LEARNED) -> str | None:
    """Why a policy that is shipped cannot run here, in words; None if it can."""
    if not (learned_policy.shipped(name) / "checkpoint.json").is_file():
        return "no pretrained policy is installed"
    return learned_policy.missing_extra()


def make(name: str, scenario: Scenario) -> Policy:
    """A new policy of that name.

    Raises:
        ValueError: if it is unknown, does not fit, or cannot be read.
    """
    if path := learned_path(name):
        return learned_policy.load(path, scenario)
    return baselines.make(name, scenario)


def learned_path(name: str) -> Path | None:
    """Folder of a learned policy; None for the name of a scripted one."""
    if name in SHIPPED:
        return learned_policy.shipped(name)
    return Path(name.removeprefix(_AT_PATH)) if name.startswith(_AT_PATH) else None


def fitting(scenario: Scenario, wanted: Sequence[str]) -> list[str]:
    """Those of the wanted policies that fit a scenario; if none is named all that fit and are not
    only there on request, but those that see nothing or everything only where nothing else fits.
    """
    known = names(scenario)
    if not wanted:
        usual = [name for name in known if name in SHIPPED or not registry.on_request(name)]
        return [name for name in usual if kind_of(name) not in _ON_REQUEST] or usual
    return [
        name
        for name in wanted
        if name in known or (learned_path(name) is not None and _can_steer(scenario))
    ]


def best(scenario: Scenario) -> str:
    """The policy to take where none is named: the best that fits, for obstacles if there are any,
    else the law of such robots.
    """
    known = fitting(scenario, ())
    return next((name for name in _BEST if scenario.obstacles and name in known), known[0])


def _can_steer(scenario: Scenario) -> bool:
    """Whether learned policies fit the robots of a scenario."""
    try:
        check_readable(scenario)
    except ValueError:
        return False
    return True


def check_names(wanted: Sequence[str]) -> None:
    """Refuse a name that no policy has, and a learned policy that cannot be read.

    Raises:
        UserError: with the nearest known name, or with what is wrong with the learned policy.
    """
    known = [*baselines.names(), *SHIPPED]
    for name in wanted:
        if learned_path(name) is not None:
            _check_learned(name)
        elif name not in known:
            near = nearest_word(name, known)
            hint = f"did you mean {near!r}? " if near else ""
            raise UserError(
                f"policy {name!r} is unknown; {hint}known are {', '.join(known)}, {_AT_PATH}PATH"
            )


def _check_learned(name: str) -> None:
    if name in SHIPPED and (reason := left_out(name)):
        raise UserError(f"policy {name!r}: {reason}")
    try:
        learned_policy.load(learned_path(name), Scenario(n_robots=2))
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
