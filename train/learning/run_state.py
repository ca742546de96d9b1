"""The state of a run as named arrays: nested memory, optimiser, random generators."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray


def flatten(state: Mapping[str, Any], prefix: str = "") -> dict[str, NDArray[Any]]:
    """Nested arrays under names with slashes."""
    flat: dict[str, NDArray[Any]] = {}
    for key, value in state.items():
        if isinstance(value, Mapping):
            flat |= flatten(value, f"{prefix}{key}/")
        else:
            flat[prefix + key] = np.asarray(value)
    return flat


def unflatten(flat: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
    """The nested arrays that ``flatten`` took."""
    state: dict[str, Any] = {}
    for name, value in flat.items():
        *path, last = name.split("/")
        place = state
        for key in path:
            place = place.setdefault(key, {})
        place[last] = value
    return state


def tensors(arrays: Mapping[str, NDArray[Any]]) -> dict[str, torch.Tensor]:
    """Arrays as tensors that share their memory."""
    return {name: torch.from_numpy(array) for name, array in arrays.items()}


def optimizer_arrays(optimizer: torch.optim.Optimizer) -> dict[str, NDArray[Any]]:
    """Moments and step counts by parameter number."""
    return {
        f"{number}/{name}": value.cpu().numpy()
        for number, moments in optimizer.state_dict()["state"].items()
        for name, value in moments.items()
    }


def restore_optimizer(optimizer: torch.optim.Optimizer, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Put back what ``optimizer_arrays`` took out."""
    state = {int(number): tensors(moments) for number, moments in unflatten(arrays).items()}
    groups = optimizer.state_dict()["param_groups"]
    optimizer.load_state_dict({"state": state, "param_groups": groups})


def check_fits(state: Mapping[str, Any], robots: Any, policy: Any) -> None:
    """Refuse what would only fail later on.

    Args:
        state: what was stored of the robots' last step.
        robots: the VecEnv that goes on from there.
        policy: with the weights and the optimizer that were put back.

    Raises:
        ValueError: for another shape, or a weight that is not finite, saying which.
    """
    wanted = {
        "last_observations": (robots.num_envs, *robots.observation_space.shape),
        "last_episode_starts": (robots.num_envs,),
    }
    for name, shape in wanted.items():
        if np.shape(state[name]) != shape:
            raise ValueError(f"{name} has shape {np.shape(state[name])}; it must be {shape}")
    for weights in policy.parameters():
        if not torch.isfinite(weights).all():
            raise ValueError("a weight of the network is not finite")
        moments = policy.optimizer.state.get(weights, {})
        for name in ("exp_avg", "exp_avg_sq"):
            if name in moments and moments[name].shape != weights.shape:
                raise ValueError(f"{name} of the optimizer has shape {moments[name].shape}")


def random_state() -> dict[str, NDArray[Any]]:
    """Of NumPy's global generator, which shuffles samples, and of torch's, which explores."""
    _, keys, position, has_gauss, gauss = np.random.get_state()
    return {
        "numpy_keys": np.asarray(keys),
        "numpy_position": np.array([position, has_gauss]),
        "numpy_gauss": np.array([gauss]),
        "torch": torch.get_rng_state().numpy(),
    }


def restore_random(state: Mapping[str, NDArray[Any]]) -> None:
    """Put back what ``random_state`` took out."""
    position, has_gauss = (int(value) for value in state["numpy_position"])
    gauss = float(state["numpy_gauss"][0])
    np.random.set_state(("MT19937", state["numpy_keys"], position, has_gauss, gauss))
    torch.set_rng_state(torch.from_numpy(state["torch"]))
