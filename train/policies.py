"""Which policies a command can compare: the scripted ones, by name.

The one place that turns a name into a policy; learned policies join here.
"""

from __future__ import annotations

from collections.abc import Sequence

import baselines
from rendezvous_env.scenario import Scenario, nearest_word
from rendezvous_env.trajectory import Policy

from .errors import UserError


def names(scenario: Scenario) -> list[str]:
    """Names of all policies that fit a scenario, sorted."""
    return baselines.names(scenario)


def make(name: str, scenario: Scenario) -> Policy:
    """A new policy of that name.

    Raises:
        ValueError: if it is unknown or does not fit.
    """
    return baselines.make(name, scenario)


def fitting(scenario: Scenario, wanted: Sequence[str]) -> list[str]:
    """Those of the wanted policies that fit a scenario; all that fit if none is named."""
    known = names(scenario)
    return [name for name in wanted if name in known] if wanted else known


def check_names(wanted: Sequence[str]) -> None:
    """Refuse a name that no policy has.

    Raises:
        UserError: with the nearest known name.
    """
    known = baselines.names()
    for name in wanted:
        if name not in known:
            near = nearest_word(name, known, cutoff=0.0)
            hint = f"did you mean {near!r}? " if near else ""
            raise UserError(f"policy {name!r} is unknown; {hint}known are {', '.join(known)}")


def promised_margin(name: str, policy: Policy) -> float | None:
    """Alignment margin ε that a policy keeps by construction; None if it promises none.

    It is 1 for law (1), and the attribute ``min_alignment`` of a policy with certified headings.
    """
    if name == "bearing-only":
        return 1.0
    margin = getattr(policy, "min_alignment", None)
    return None if margin is None else float(margin)
