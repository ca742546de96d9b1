"""The JAX form as a Gymnasium vector environment of torch tensors, which share its memory."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import jax.numpy as jnp
import numpy as np
import torch
from gymnasium.vector import AutoresetMode, VectorEnv
from torch.utils.dlpack import from_dlpack

from ..checks import raise_invalid
from ..jax import RendezvousJaxEnv, State, make

if TYPE_CHECKING:
    from ..scenario.scenarios import ScenarioLike

__all__ = ["JaxTorchVectorEnv", "to_jax", "to_torch"]

Tensors = dict[str, torch.Tensor]


def to_torch(array: Any) -> torch.Tensor:
    """Tensor with the memory of a JAX array, on its device, by DLPack; never write to it."""
    return from_dlpack(array)


def to_jax(tensor: Any) -> Any:
    """JAX array with the memory of a tensor, by DLPack; of other arrays, a copy."""
    if not isinstance(tensor, torch.Tensor):
        return jnp.asarray(tensor)
    return jnp.from_dlpack(tensor.detach().contiguous())


class JaxTorchVectorEnv(VectorEnv[torch.Tensor, torch.Tensor, Any]):
    """B environments of ``rendezvous_env.jax`` whose arrays are tensors on the device of JAX.

    Observations are (B, n, rows, d), actions (B, n, a), rewards, terminations and truncations (B,);
    infos are tensors by name, see ``RendezvousJaxEnv.step``. Tensors share the memory of JAX
    arrays, which nothing may modify: clone them before writing in place. Environments that end are
    reset in the same step, with their last observations in ``infos["final_obs"]``.

    Args:
        scenario, guarantee: as ``rendezvous_env.jax.make``.
        num_envs: B.
        autoreset_mode: "SameStep" or "Disabled".
        **options: as ``rendezvous_env.jax.make``.

    Raises:
        NotImplementedError, TypeError, ValueError: as ``rendezvous_env.jax.make``.
    """

    def __init__(
        self,
        scenario: ScenarioLike = "cloud-8",
        num_envs: int = 1,
        guarantee: str | None = None,
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        **options: Any,
    ) -> None:
        given = {"final_obs": True, **options, "autoreset_mode": autoreset_mode}
        self.functions: RendezvousJaxEnv = make(scenario, guarantee, num_envs=num_envs, **given)
        """The pure functions."""
        self.num_envs = num_envs
        self.single_observation_space = self.functions.single_observation_space
        self.single_action_space = self.functions.single_action_space
        self.observation_space = self.functions.observation_space
        self.action_space = self.functions.action_space
        mode = AutoresetMode.SAME_STEP if self.functions.autoreset else AutoresetMode.DISABLED
        self.metadata = {"render_modes": [], "autoreset_mode": mode}
        self.state: State | None = None
        """State of the environments; None before the first reset."""

    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[torch.Tensor, Tensors]:
        """Begin the first episodes of a seed, as ``make_vec``; None samples one.

        Raises:
            ValueError: for an invalid seed, or options, which the JAX form does not have.
        """
        if options:
            raise_invalid("options", options, "None, since the JAX form has no reset options")
        if seed is None:
            seed = int(np.random.SeedSequence().generate_state(1, np.uint64)[0] >> np.uint64(1))
        observations, self.state = self.functions.reset(seed)
        return to_torch(observations), {}

    def step(
        self, actions: Any
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor, Tensors]:
        """Advance all environments; ``actions`` are a tensor (B, n, a) on the same device.

        Raises:
            RuntimeError: before the first reset.
            ValueError: for actions of another shape.
        """
        if self.state is None:
            raise RuntimeError("call reset() before step()")
        seen, self.state, *told, infos = self.functions.step(None, self.state, to_jax(actions))
        reward, met, cut = (to_torch(array) for array in told)
        return to_torch(seen), reward, met, cut, {k: to_torch(v) for k, v in infos.items()}
