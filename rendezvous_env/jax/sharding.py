"""Distribution of environments over devices."""

from collections.abc import Sequence
from typing import Any

import jax
import numpy as np
from jax.sharding import AxisType, Mesh, NamedSharding, PartitionSpec

from ..checks import raise_invalid
from .environment import State


def shard(state: State, devices: Sequence[Any] | None = None) -> State:
    """Distribute the environments of a state, the last axis of its arrays, over devices.

    ``step`` then computes each part on its device and returns arrays distributed likewise. The
    numbers are those of one device.

    Args:
        state: of ``reset`` with ``num_envs=B``.
        devices: devices of JAX, whose number divides B; None is all, ``jax.devices()``.

    Raises:
        ValueError: if the number of devices does not divide B, or the state has no batch axis.
    """
    chosen = jax.devices() if devices is None else list(devices)
    number = len(state.status) if state.status.ndim else None
    if number is None or number % len(chosen):
        raise_invalid("num_envs", number, f"a multiple of {len(chosen)} devices")
    mesh = Mesh(np.array(chosen), ("envs",), axis_types=(AxisType.Auto,))

    def split(array: jax.Array) -> jax.Array:
        axes = [None] * (array.ndim - 1)
        return jax.device_put(array, NamedSharding(mesh, PartitionSpec(*axes, "envs")))

    return jax.tree.map(split, state)
