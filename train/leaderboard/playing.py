"""Evaluation of a trained policy on held-out initial conditions."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rendezvous_env.simulator import Simulator

from ..learn.settings import EVALUATION_SEEDS
from .environments import COSTS


@dataclass(frozen=True)
class EvaluationSetup:
    """Environments that stop when their episode ends, with the policy that controls them."""

    env: Any
    """Vector environment whose ``costs`` are COSTS."""
    act: Callable[[NDArray[np.float32], NDArray[np.float64]], Any]
    """(observations, times (B,) in s) → actions."""


def play(
    player: EvaluationSetup, watch: Callable[[Simulator], None] = lambda simulator: None
) -> dict[str, list[Any]]:
    """Run one episode per environment from the held-out seeds 2⁶¹, 2⁶¹ + 1, ….

    Args:
        player: environments and their policy.
        watch: called with the simulator after the reset.

    Returns:
        Arrays (B,) by name: "success"; "clean" (collision-free success); "time" (s, the time limit
        without success); "touches" (robot steps with a contact); "risen" (robot steps in which V
        increased between merges without any contact in the team); "rise" (sum of increases of V
        between merges over the initial V); "steps" (robot steps).
    """
    env, simulator = player.env, player.env.unwrapped.simulator
    seen, _ = env.reset(seed=EVALUATION_SEEDS)
    watch(simulator)
    total = {name: np.zeros(simulator.active.shape) for name in COSTS}
    over = np.zeros(len(simulator.active), dtype=np.bool_)
    while not over.all():
        seen, _, met, late, infos = env.step(player.act(seen, simulator.time))
        over |= met | late
        for name in COSTS:
            total[name] += infos[f"cost_{name}"]
    limit, success = simulator.max_steps * simulator.scenario.tau, infos["success"]
    names = {"contact": "touches", "leaderboard_risen": "risen", "leaderboard_steps": "steps"}
    return {
        "success": success.astype(int).tolist(),
        "clean": (success & (infos["contacts"] == 0)).astype(int).tolist(),
        "time": np.where(success, infos["time"], limit).round(6).tolist(),
        "rise": total["rise"].max(axis=1).round(9).tolist(),  # the same for all robots
        **{own: total[name].sum(axis=1).astype(int).tolist() for name, own in names.items()},
    }
