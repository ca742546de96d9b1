"""TorchRL: one batched environment with the robots as one agent group."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from gymnasium.spaces import Box, MultiDiscrete, Space
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Bounded, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase

from ..deprecation import renamed_attribute, warn_renamed
from ..engine.memory import RENDEZVOUS, TIME_OUT
from ..envs.agents import names_of
from ..scenario.start_options import seeds_of_environments
from ..simulator import Simulator
from ..vector import training_env
from .reward_shaping import RewardShaping

if TYPE_CHECKING:
    from ..scenario.scenarios import ScenarioLike

__all__ = ["GROUP", "RendezvousTorchRLEnv"]

GROUP = "robots"
"""Agent group of all robots."""


class RendezvousTorchRLEnv(EnvBase):
    """B environments of ``vector.training_env`` as a TorchRL environment, batch size (B,).

    | key | shape | |
    |---|---|---|
    | ("robots", "observation") | (B, n, size) float32 | (B, n, rows, d) with ``flatten=False`` |
    | ("robots", "action") | (B, n, a) float32 | (B, n) int64 with ``discrete=True`` |
    | ("robots", "active") | (B, n, 1) bool | the robot is active (not merged) |
    | ("robots", "reward") | (B, n, 1) float32 | after a step |
    | ("robots", "info", "activated") | (B, n, 1) bool | see ``Simulator.conditions`` |
    | ("robots", "info", "cost") | (B, n, 1) float32 | with ``Scenario.costs``; also "cost_NAME" |
    | "contacts" | (B, 1) int64 | obstacle contacts so far, summed over robots and base steps |
    | "state" | (B, size) float32 | privileged; with ``return_state=True`` |
    | "terminated" | (B, 1) bool | all robots have met |
    | "truncated" | (B, 1) bool | the time limit |
    | "done" | (B, 1) bool | either |

    A merged robot observes zeros, its actions are ignored, and it receives the team reward until
    the end, so an early merge is not penalised. An ended environment stays unchanged until it is
    reset; collectors and ``rollout(break_when_any_done=False)`` do so.

    ``set_seed(s)`` gives environment b the seed s + b at its next reset. Without a seed, an
    environment continues with the next episode of its seed. ``reset(options=...)`` accepts the
    options of ``make_vec``.

    Args:
        scenario: a Scenario, the name of one or the path of a TOML file.
        num_envs: B, number of environments.
        return_state: whether to return the global state, for centralised critics.
        seed: as ``set_seed``.
        wrap: ``wrap(vector_env) -> vector_env``, applies a custom ``VectorWrapper``, for example
            one that changes rewards.
        device: of all tensors; None keeps them on the CPU, where they are computed, without copies.
        **arguments: of ``vector.training_env``, except ``autoreset_mode``; errors are the same.
    """

    teams = renamed_attribute("teams", "vector_env")

    def __init__(
        self,
        scenario: ScenarioLike = "clutter-8",
        num_envs: int = 1,
        *,
        return_state: bool = False,
        seed: int | None = None,
        wrap: Callable[[Any], Any] = lambda vector_env: vector_env,
        device: torch.device | str | None = None,
        **arguments: Any,
    ) -> None:
        mode = AutoresetMode.DISABLED
        self.vector_env: Any = training_env(scenario, num_envs, autoreset_mode=mode, **arguments)
        self.simulator: Simulator = self.vector_env.simulator
        self._wrapped = wrap(self.vector_env)
        self._shaping = RewardShaping(self._wrapped)
        super().__init__(device=device, batch_size=(num_envs,))
        self._gives_state = return_state
        self.group_map = {GROUP: names_of(self.simulator.scenario.n_robots)}
        """The single group and its robots."""
        self._make_specs()
        self._set_seed(seed)

    @property
    def max_steps(self) -> int:
        """Maximum number of steps of an episode."""
        return -(-self.simulator.max_steps // self._base_steps)

    @property
    def seconds_per_step(self) -> float:
        """Duration of an agent step, s."""
        return self._base_steps * float(self.simulator.scenario.tau)

    @property
    def _base_steps(self) -> int:
        return int(getattr(self.vector_env.env, "decision_period", 1))

    def _make_specs(self) -> None:
        batch, n = self.batch_size, len(self.group_map[GROUP])
        robots, one = torch.Size((*batch, n)), torch.Size((*batch, n, 1))
        done = Categorical(2, shape=torch.Size((*batch, 1)), dtype=torch.bool)

        def of_group(**entries: Any) -> Composite:
            return Composite({GROUP: Composite(entries, shape=robots)}, shape=batch)

        def unbounded(space: Space[Any]) -> Unbounded:
            return Unbounded(torch.Size((*batch, *(space.shape or ()))))

        self.action_spec = of_group(action=_action_spec(self.vector_env.single_action_space, batch))
        self.observation_spec = of_group(
            observation=unbounded(self.vector_env.single_observation_space),
            active=Categorical(2, shape=one, dtype=torch.bool),
        )
        specs: dict[str, Any] = {key: Unbounded(one) for key in self.simulator.costs}
        for key in self.simulator.conditions:
            specs[key] = Categorical(2, shape=one, dtype=torch.bool)
        if specs:
            self.observation_spec[GROUP, "info"] = Composite(specs, shape=robots)
        self.observation_spec["contacts"] = Unbounded(done.shape, dtype=torch.int64)
        if self._gives_state:
            state = self.vector_env.unwrapped.single_state_space
            self.observation_spec["state"] = unbounded(state)
        self.reward_spec = of_group(reward=Unbounded(one))
        self.done_spec = Composite(
            {key: done.clone() for key in ("done", "terminated", "truncated")}, shape=batch
        )

    def _set_seed(self, seed: int | None) -> None:
        count = self.batch_size[0]
        self._seeds = seeds_of_environments(seed, count) or [None] * count

    def _reset(
        self,
        tensordict: TensorDictBase | None = None,
        options: Mapping[str, Any] | None = None,
        **_: Any,
    ) -> TensorDictBase:
        asked = None if tensordict is None else tensordict.get("_reset", None)
        which = np.ones(self.batch_size, np.bool_)
        if asked is not None:
            which = asked.cpu().numpy().reshape(-1)
        seeds = [own if now else None for own, now in zip(self._seeds, which, strict=True)]
        given = {**(options or {}), "reset_mask": which}
        observations, infos = self._wrapped.reset(seed=seeds, options=given)
        self._seeds = [None if now else own for own, now in zip(self._seeds, which, strict=True)]
        status = self.simulator.status
        return self._given(observations, infos, status == RENDEZVOUS, status == TIME_OUT)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        actions = tensordict.get((GROUP, "action")).detach().cpu().numpy()
        observations, rewards, met, cut, infos = self._wrapped.step(actions)
        reward = self._shaping.robot_rewards(rewards, infos, infos["active"]).astype(np.float32)
        status = self.simulator.status  # ended environments stay done
        met, cut = met | (status == RENDEZVOUS), cut | (status == TIME_OUT)
        return self._given(observations, infos, met, cut, reward=reward)

    def _given(
        self,
        observations: NDArray[np.float32],
        infos: Mapping[str, Any],
        met: NDArray[np.bool_],
        cut: NDArray[np.bool_],
        **scalars: NDArray[Any],
    ) -> TensorDict:
        """Result of a step or a reset, in shared memory."""
        active = infos["active"]
        robots: dict[str, Any] = {"observation": torch.from_numpy(observations)}
        for key, values in {"active": active, **scalars}.items():
            robots[key] = torch.from_numpy(values[..., None])
        told = {key: infos[key].astype(np.float32) for key in self.simulator.costs}
        told |= {key: infos[key] for key in self.simulator.conditions}
        if told:
            kept = {key: torch.from_numpy(values[..., None]) for key, values in told.items()}
            robots["info"] = TensorDict(kept, batch_size=active.shape, device=self.device)
        given: dict[str, Any] = {
            GROUP: TensorDict(robots, batch_size=active.shape, device=self.device)
        }
        contacts = infos["contacts"]
        of_envs = {"done": met | cut, "terminated": met, "truncated": cut, "contacts": contacts}
        for key, values in of_envs.items():
            given[key] = torch.from_numpy(values[:, None])
        if self._gives_state:
            given["state"] = torch.from_numpy(self.vector_env.state())
        return TensorDict(given, batch_size=self.batch_size, device=self.device)

    def close(self, *, raise_if_closed: bool = True) -> None:
        """Close the vector environment."""
        self.vector_env.close()
        super().close(raise_if_closed=raise_if_closed)


def _action_spec(space: Space[Any], batch: torch.Size) -> Bounded | Categorical:
    """Action spec of B environments, from that of one."""
    if isinstance(space, MultiDiscrete):
        return Categorical(int(space.nvec[0]), shape=torch.Size((*batch, *space.shape)))
    assert isinstance(space, Box)
    low, high = (torch.from_numpy(bound.copy()) for bound in (space.low, space.high))
    return Bounded(low.expand(*batch, *low.shape), high.expand(*batch, *high.shape))


def __getattr__(name: str) -> Any:
    """Former names."""
    if name == "RendezvousEnv":
        warn_renamed(f"{__name__}.{name}", "RendezvousTorchRLEnv")
        return RendezvousTorchRLEnv
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
