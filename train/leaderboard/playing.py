"""Play held-out starts with whatever came of an algorithm, and count."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rendezvous_env.simulator import Simulator

from ..learn.settings import EVALUATION_SEEDS
from .teams import COSTS


@dataclass(frozen=True)
class Player:
    """Teams that rest when they have ended, and what chooses for them."""

    teams: Any  # a vector environment of B teams with ``costs`` of ``teams.COSTS``
    act: Callable[[NDArray[np.float32], NDArray[np.float64]], Any]
    """From observations and times (B,), s, to actions."""


def play(
    player: Player, watch: Callable[[Simulator], None] = lambda simulator: None
) -> dict[str, list[Any]]:
    """One episode of each team from the held-out starts 2⁶¹, 2⁶¹ + 1, …, by name, a number each.

    "success", "clean" (met and touched nothing), "time" (s; the limit where they did not meet),
    "touches" and "risen" (robot steps with a contact; in which V rose between merges, nobody of the
    team in contact), "rise" (sum of V's rises between merges, share of V₀), "steps" (of robots).
    ``watch`` is called with the simulator once the teams have begun.
    """
    teams, simulator = player.teams, player.teams.unwrapped.simulator
    seen, _ = teams.reset(seed=EVALUATION_SEEDS)
    watch(simulator)
    total = {name: np.zeros(simulator.active.shape) for name in COSTS}
    over = np.zeros(len(simulator.active), dtype=np.bool_)
    while not over.all():
        seen, _, met, late, infos = teams.step(player.act(seen, simulator.time))
        over |= met | late
        for name in COSTS:
            total[name] += infos[f"cost_{name}"]
    limit, success = simulator.max_steps * simulator.scenario.tau, infos["success"]
    names = {"contact": "touches", "leaderboard_risen": "risen", "leaderboard_steps": "steps"}
    return {
        "success": success.astype(int).tolist(),
        "clean": (success & (infos["contacts"] == 0)).astype(int).tolist(),
        "time": np.where(success, infos["time"], limit).round(6).tolist(),
        "rise": total["rise"].max(axis=1).round(9).tolist(),  # all robots are told the team's
        **{own: total[name].sum(axis=1).astype(int).tolist() for name, own in names.items()},
    }
