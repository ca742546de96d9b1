"""Custom reward terms: functions of one step of a batch of environments."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..checks import Registry, check_shape, floats, number, raise_invalid


class RewardStep(NamedTuple):
    """Read-only data of one step of B environments, for reward terms and costs."""

    scenario: Any
    """The Scenario."""
    actions: NDArray[np.float32]
    """Actions as given, (B, n, a), in the robots' frames."""
    positions_before: NDArray[np.float64]
    """Positions before the step, (B, n, d), m."""
    positions: NDArray[np.float64]
    """Positions after the step, (B, n, d), m; a merged robot has that of its survivor."""
    took_part: NDArray[np.bool_]
    """True if each robot was active before the step, (B, n)."""
    active: NDArray[np.bool_]
    """True if each robot is active after the step, (B, n)."""
    contact: NDArray[np.bool_]
    """True if each robot had a contact in the step, (B, n)."""
    clearance: NDArray[np.float64]
    """Distance to the nearest obstacle, (B, n), m; inf without obstacles."""
    time: NDArray[np.float64]
    """Time since the start of the episode, (B,), s."""
    met: NDArray[np.bool_]
    """True if rendezvous occurred in the step, (B,)."""
    rise: NDArray[np.float64]
    """Increase of V before any merge relative to the initial V, (B,), at least 0."""
    links_lost: NDArray[np.int64]
    """Number of links lost other than by merging, (B, n); nonzero on proximity graphs only."""

    def read_only(self) -> "RewardStep":
        """Copy with read-only arrays."""
        views = {k: v.view() for k, v in self._asdict().items() if isinstance(v, np.ndarray)}
        for view in views.values():
            view.flags.writeable = False
        return self._replace(**views)


Term = Callable[[RewardStep], Any]
COSTS: dict[str, Term] = {
    "contact": lambda step: step.contact,
    "rise": lambda step: step.rise,
    "link_lost": lambda step: step.links_lost,
}
"""Built-in costs per robot and step: contact; increase of V before any merge relative to the
initial V; number of links lost other than by merging."""

TERMS = Registry("reward term", "rv.reward_term")
"""Registered terms by name."""


def reward_term(name: str, term: Term | None = None) -> Any:
    """Register a reward term: a function from a ``RewardStep`` to values, (B,) or (B, n).

    ``RewardWeights(custom={name: weight})`` adds weight × term in every step. Values (B,) are team
    rewards, given to each robot; values (B, n) are individual, and the team reward is the mean over
    active robots. A term must treat environments independently. An existing term of the same name
    is replaced. Without ``term`` this is a decorator.

    Raises:
        ValueError: for an invalid name, that of a built-in cost, or a term that is not callable.
    """
    if isinstance(name, str) and name in COSTS:
        raise_invalid("name of a reward term", name, f"none of the costs {', '.join(COSTS)}")
    return TERMS.add(name, term)


def as_custom(field: str, value: Any) -> tuple[tuple[str, float], ...]:
    """Weights of registered terms, from a mapping or pairs, in the order of the names."""
    try:
        pairs = dict(value)
    except (TypeError, ValueError):
        raise_invalid(field, value, "a mapping of names to weights")
    for name in pairs:
        TERMS.check(field, name)
    return tuple(sorted((name, number(f"{field}.{name}", pairs[name])) for name in pairs))


def add_custom_terms(
    step: RewardStep,
    running: NDArray[np.bool_],
    rewards: NDArray[np.float64],
    robot_rewards: NDArray[np.float64],
) -> dict[str, NDArray[np.float64]]:
    """Add the custom terms of a step to team rewards, (B,), and robot rewards, (B, n).

    Environments that are not ``running``, (B,), are excluded. Returns what each term added to team
    rewards, (B,), by name.
    """
    added = {}
    took_part = step.took_part
    earning = running[:, None] & (took_part | (step.scenario.on_merge == "follow"))
    for name, weight in step.scenario.reward.custom:
        earned = floats(f"reward term {name!r}", TERMS[name](step))
        each = weight * of_step(f"reward term {name!r}", earned, earning)
        robot_rewards += each
        team = np.where(took_part, each, 0.0).sum(axis=1) / took_part.sum(axis=1)
        added[name] = np.where(running, weight * earned if earned.ndim == 1 else team, 0.0)
        rewards += added[name]
    return added


def of_step(what: str, given: Any, counts: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Values of a term, (B,) or (B, n), per robot, (B, n); 0 where they do not count."""
    earned = floats(what, given)
    check_shape(what, earned, counts.shape[:1], counts.shape)
    each = np.broadcast_to(earned[:, None] if earned.ndim == 1 else earned, counts.shape)
    if not np.isfinite(each[counts]).all():
        raise ValueError(f"{what} returned a number that is not finite")
    return np.where(counts, each, 0.0)
