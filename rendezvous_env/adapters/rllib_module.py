"""Set network for RLlib, invariant to number and order of neighbours and obstacles."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from gymnasium.spaces import Discrete
from ray.rllib.core.columns import Columns
from ray.rllib.core.rl_module.apis.value_function_api import ValueFunctionAPI
from ray.rllib.core.rl_module.torch.torch_rl_module import TorchRLModule
from torch import Tensor, nn


def sets_of(layout: Any) -> tuple[tuple[int, int], ...]:
    """Size and element width of the leading sets in observations of ``layout``.

    The sets are neighbours and obstacles of a training environment.
    """
    shape = getattr(layout, "shape", None) or (layout.size,)
    parts = layout.split(np.zeros(shape, dtype=np.float32))
    sets = parts.neighbours, parts.obstacles
    return tuple((len(one), one[0].size if len(one) else 0) for one in sets)


class SetModule(TorchRLModule, ValueFunctionAPI):
    """Deep Sets module: policy and value of one robot from its observation.

    A network per set processes each element, a neighbour or an obstacle, as direction and length.
    Absent elements, zero rows, are ignored. Two more layers process the mean over each set, its
    size and the rest of the observation.

    ``model_config``: ``sets`` (see ``sets_of``) and ``units``, the width of all layers (64).
    """

    def setup(self) -> None:
        """Create the layers."""
        sets, units = self.model_config["sets"], self.model_config.get("units", 64)
        self._sets = [(count, width) for count, width in sets if count]
        size = int(np.prod(self.observation_space.shape))
        context = size - sum(count * width for count, width in self._sets)
        self.elements = nn.ModuleList(
            nn.Sequential(nn.Linear(width + 1, units), nn.Tanh()) for _, width in self._sets
        )
        self.trunk = nn.Sequential(
            nn.Linear(len(self._sets) * (units + 1) + context, units), nn.Tanh(),
            nn.Linear(units, units), nn.Tanh(),
        )  # fmt: skip
        discrete = isinstance(self.action_space, Discrete)
        outputs = self.action_space.n if discrete else self.action_space.shape[0]
        self.choice, self.value = nn.Linear(units, int(outputs)), nn.Linear(units, 1)
        self.log_std = None if discrete else nn.Parameter(torch.full((int(outputs),), -0.5))
        nn.init.zeros_(self.choice.weight)  # starts without a preference

    def _forward(self, batch: dict[str, Any], **_: Any) -> dict[str, Tensor]:
        embeddings = self._embed(batch)
        chosen = self.choice(embeddings)
        if self.log_std is not None:
            chosen = torch.cat([chosen, self.log_std.expand_as(chosen)], dim=-1)
        return {Columns.EMBEDDINGS: embeddings, Columns.ACTION_DIST_INPUTS: chosen}

    def compute_values(self, batch: dict[str, Any], embeddings: Tensor | None = None) -> Tensor:
        """Value estimates, (B,)."""
        seen = self._embed(batch) if embeddings is None else embeddings
        return self.value(seen).squeeze(-1)

    def _embed(self, batch: dict[str, Any]) -> Tensor:
        flat, start, pooled = batch[Columns.OBS].flatten(1), 0, []
        for (count, width), network in zip(self._sets, self.elements, strict=True):
            rows = flat[:, start : start + count * width].unflatten(1, (count, width))
            pooled.append(_pool(rows, network))
            start += count * width
        return self.trunk(torch.cat([*pooled, flat[:, start:]], dim=1))


def _pool(rows: Tensor, network: nn.Module) -> Tensor:
    """Mean over the present rows of (B, count, width), and log(1 + count): (B, units + 1)."""
    length = rows.norm(dim=-1, keepdim=True)
    present = (length > 0.0).to(rows.dtype)
    seen = network(torch.cat([rows / length.clamp_min(1e-8), length], dim=-1)) * present
    number = present.sum(dim=1)
    return torch.cat([seen.sum(dim=1) / number.clamp_min(1.0), number.log1p()], dim=1)
