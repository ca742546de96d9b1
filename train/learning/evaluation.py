"""How good a policy is on starts that it was not trained on."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from numpy.typing import NDArray

from baselines.learned.learned_policy import LearnedPolicy, PolicySettings
from rendezvous_env.experiment import scenarios

from ..comparing import statistics
from ..comparing.episodes import play
from .settings import EVALUATION_SEEDS


def held_out(
    scenario: str, weights: Mapping[str, NDArray[Any]], settings: PolicySettings, starts: int
) -> dict[str, Any]:
    """The row of results.csv that a network earns, choosing without noise.

    Args:
        scenario: name, or path of a TOML file.
        weights: of the network, by name.
        settings: of the policy.
        starts: how many.
    """
    chosen = scenarios.resolve(scenario)
    episodes, _ = play(
        chosen,
        lambda: LearnedPolicy(chosen, weights, settings),
        margin=settings.promised_margin,
        episodes=starts,
        seed=EVALUATION_SEEDS,
    )
    limit = chosen.max_steps * chosen.tau
    return statistics.summarise(chosen.name, "learned", episodes, limit)
