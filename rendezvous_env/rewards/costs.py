"""Costs per robot and step, for constrained learning.

As in Safety-Gymnasium's converters to Gymnasium, infos have ``cost_NAME`` and their sum, ``cost``.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..checks import raise_invalid, short_repr
from ..suggestions import closest_match
from .custom_terms import COSTS, TERMS, RewardStep, of_step

Costs = dict[str, NDArray[np.float64]]
"""Costs by infos key, (B, n) each."""


def as_costs(field: str, value: Any) -> tuple[str, ...]:
    """Names of costs, each once, from one name or several."""
    names = (value,) if isinstance(value, str) else value
    if not isinstance(names, tuple | list):
        raise_invalid(field, value, f"names from {', '.join(COSTS)}")
    for name in names:
        if not isinstance(name, str) or not (name in COSTS or name in TERMS):
            hint = closest_match(name, [*COSTS, *TERMS], after=" ")
            raise ValueError(
                f"{field}: {short_repr(name)} is unknown; {hint}known are {', '.join(COSTS)}, and "
                "terms registered with rv.reward_term"
            )
    if len(set(names)) < len(names):
        raise_invalid(field, value, "each name once")
    return tuple(names)


def no_costs(names: tuple[str, ...], shape: tuple[int, int]) -> Costs:
    """Zero costs and their sum; empty without names."""
    keys = [f"cost_{name}" for name in names]
    return {key: np.zeros(shape) for key in (["cost", *keys] if names else [])}


def costs_of(names: tuple[str, ...], step: RewardStep, running: NDArray[np.bool_]) -> Costs:
    """Costs of a step for each active robot in ``running`` environments, (B,)."""
    paying = running[:, None] & step.took_part
    costs = no_costs(names, paying.shape)
    for name in names:
        term = COSTS.get(name) or TERMS[name]
        each = of_step(f"cost {name!r}", term(step), paying)
        costs[f"cost_{name}"] = each
        costs["cost"] += each
    return costs
