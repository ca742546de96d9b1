"""How good a policy is on starts that it was not trained on."""

from __future__ import annotations

from typing import Any

import torch

from rendezvous_env.experiment import scenarios

from ..comparing import statistics
from ..comparing.episodes import play
from ..learned import learned_policy
from ..learned.learned_policy import LearnedPolicy, PolicySettings
from .settings import EVALUATION_SEEDS


def held_out(scenario: str, network: Any, settings: PolicySettings, starts: int) -> dict[str, Any]:
    """The row of results.csv that a network earns, choosing without noise.

    Args:
        scenario: name, or path of a TOML file.
        network: for ``settings``.
        settings: of the policy.
        starts: how many.
    """
    chosen = scenarios.resolve(scenario)
    with torch.random.fork_rng():
        episodes, _ = play(
            chosen,
            lambda: LearnedPolicy(chosen, network, settings),
            margin=settings.promised_margin,
            episodes=starts,
            seed=EVALUATION_SEEDS,
        )
    limit = chosen.max_steps * chosen.tau
    return statistics.summarise(chosen.name, learned_policy.NAME, episodes, limit)
