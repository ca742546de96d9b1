"""Reward terms of a user's own: functions of what happened in one step of a batch of teams."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..checks import Registry, check_shape, floats, number, refuse


class RewardStep(NamedTuple):
    """What happened in one step of B teams; a term may read all of it and change none."""

    scenario: Any
    """The Scenario."""
    actions: NDArray[np.float32]
    """(B, n, a), as they were given, in the robots' own frames."""
    positions_before: NDArray[np.float64]
    """(B, n, d), m."""
    positions: NDArray[np.float64]
    """(B, n, d), m; a merged-away robot is where the robot is that it became part of."""
    took_part: NDArray[np.bool_]
    """(B, n), whether the robot existed on its own before the step."""
    active: NDArray[np.bool_]
    """(B, n), whether it does after it."""
    contact: NDArray[np.bool_]
    """(B, n), whether it touched an obstacle in the step."""
    clearance: NDArray[np.float64]
    """(B, n), distance to the nearest obstacle, m; inf without obstacles."""
    time: NDArray[np.float64]
    """(B,), s since the start of the episode."""
    met: NDArray[np.bool_]
    """(B,), whether the step brought the rendezvous."""
    rise: NDArray[np.float64]
    """(B,), by how much V rose before any merge, as a share of V at the start; never below 0."""
    links_lost: NDArray[np.int64]
    """(B, n), links of each robot that were lost other than by merging; 0 but on proximity
    graphs."""

    def read_only(self) -> "RewardStep":
        """The same, with arrays that refuse to be written to."""
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
"""Costs of a robot in a step: whether it touched an obstacle; by how much V of its team rose before
any merge, as a share of V at the start; how many of its links were lost other than by merging."""

TERMS = Registry("reward term", "rv.reward_term")
"""By name."""


def reward_term(name: str, term: Term | None = None) -> Any:
    """Register a reward term: a function from a ``RewardStep`` to numbers, (B,) or (B, n).

    ``RewardWeights(custom={name: weight})`` adds weight × term in every step. (B,) is earned by the
    team and each of its robots; of (B, n) each robot earns its own, and the team the mean over the
    robots that took part. A term treats every team by itself. One of the same name is replaced;
    without ``term`` a decorator is returned.

    Raises:
        ValueError: for what is no name, or that of a built-in cost, or cannot be called.
    """
    if isinstance(name, str) and name in COSTS:
        refuse("name of a reward term", name, f"none of the costs {', '.join(COSTS)}")
    return TERMS.add(name, term)


def as_custom(field: str, value: Any) -> tuple[tuple[str, float], ...]:
    """Weights of registered terms, from a mapping or pairs, in the order of the names."""
    try:
        pairs = dict(value)
    except (TypeError, ValueError):
        refuse(field, value, "a mapping of names to weights")
    for name in pairs:
        TERMS.check(field, name)
    return tuple(sorted((name, number(f"{field}.{name}", pairs[name])) for name in pairs))


def add_custom_terms(
    step: RewardStep,
    running: NDArray[np.bool_],
    rewards: NDArray[np.float64],
    robot_rewards: NDArray[np.float64],
) -> dict[str, NDArray[np.float64]]:
    """Add the custom terms of a step to the rewards of teams, (B,), and of robots, (B, n); teams
    that are not ``running``, (B,), earn nothing. What each term, by name, added for teams, (B,).
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
    """What a term gave, (B,) or (B, n), for each robot, (B, n); 0 where it does not count."""
    earned = floats(what, given)
    check_shape(what, earned, counts.shape[:1], counts.shape)
    each = np.broadcast_to(earned[:, None] if earned.ndim == 1 else earned, counts.shape)
    if not np.isfinite(each[counts]).all():
        raise ValueError(f"{what} gave a number that is not finite")
    return np.where(counts, each, 0.0)
