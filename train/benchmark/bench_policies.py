"""What ``rendezvous bench`` times of learned policies: their ticks, with NumPy and with torch."""

from __future__ import annotations

import importlib.util
from typing import Any

import numpy as np
from numpy.typing import NDArray

import baselines
import rendezvous_env as rv
from baselines.learned import checkpoints, shipped
from baselines.learned.learned_policy import LearnedPolicy

from .bench_cases import Case, Running

TICKS = "robot ticks"
"""Robots times base steps; most steps decide nothing, but guide and certify."""


class TorchChooser:
    """What ``baselines.learned.chooser.Chooser`` does, by the network that was trained.

    Args:
        name: of a shipped policy without a recurrent memory.
        policy: which chooses by it.
    """

    def __init__(self, name: str, policy: LearnedPolicy) -> None:
        from ..learning.networks import make_network
        from ..learning.run_state import tensors

        settings, rows = policy.settings, policy.scenario.observation_layout
        layout = settings.layout(rows.neighbour_slots, rows.obstacle_slots)
        sizes: dict[str, Any] = {"set_width": settings.set_width, "hidden": settings.hidden}
        self.network = make_network(layout, len(settings.angles), **sizes)
        _, tables = checkpoints.read(shipped.folder(name), ["network"])
        self.network.load_state_dict(tensors(tables["network"]))

    def choose(self, shown: NDArray[np.float32], hidden: Any = None) -> NDArray[np.int64]:
        """The likeliest choices (N,) for rows (N, size)."""
        import torch

        with torch.no_grad():
            chosen = self.network._predict(torch.as_tensor(shown), deterministic=True)
        return chosen.numpy()


def learned(num_envs: int) -> list[Case]:
    """Ticks of the policy ``learned`` on what four robots see among discs at their starts."""
    scenario = rv.scenarios.get("clutter-8")
    seen = rv.Simulator(scenario, num_envs).reset(0)

    def build(chooser: Any) -> Running:
        policy = baselines.make("learned", scenario)
        assert isinstance(policy, LearnedPolicy)
        if chooser is not None:
            policy._chooser = chooser("learned", policy)
        return Running(lambda: policy(seen, 0.0), lambda: True)

    n = scenario.n_robots
    size = ("learned", n, num_envs, num_envs * n, TICKS)
    numpy = Case("learned, NumPy", *size, lambda: build(None), "learned, torch")
    if importlib.util.find_spec("stable_baselines3") is None:
        return [numpy]
    return [numpy, Case("learned, torch", *size, lambda: build(TorchChooser))]
