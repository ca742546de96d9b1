#!/usr/bin/env bash
# jnp.nonzero(mask, size=...) fails on a mask sharded over a mesh of jax.make_mesh.
#
# Versions: jax 0.10.2, jaxlib 0.10.2, numpy 2.3.5, Python 3.11, four virtual CPU devices.
# Input: a mask of eight environments, sharded over the only axis of jax.make_mesh((4,), ("envs",)).
# Guess: make_mesh and jax.sharding.Mesh give the same result, the indices of True entries.
# Seen: ShardingTypeError from cumsum with make_mesh, whose axes are of type Explicit by default;
#   the indices with a Mesh whose axis type is Auto. So code that compacts masks of environments
#   (autoreset of some) has to ask for AxisType.Auto.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet jax==0.10.2 jaxlib==0.10.2 numpy==2.3.5
JAX_PLATFORMS=cpu XLA_FLAGS=--xla_force_host_platform_device_count=4 "$folder/venv/bin/python" - <<'PYTHON'
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import AxisType, Mesh, NamedSharding, PartitionSpec

mask = np.array([True, False, False, True, True, False, False, False])


def indices(mesh):
    placed = jax.device_put(mask, NamedSharding(mesh, PartitionSpec("envs")))
    return np.asarray(jax.jit(lambda x: jnp.nonzero(x, size=4, fill_value=-1)[0])(placed)).tolist()


auto = indices(Mesh(np.array(jax.devices()), ("envs",), axis_types=(AxisType.Auto,)))
made = jax.make_mesh((4,), ("envs",))
try:
    found = indices(made)
except Exception as error:
    found = type(error).__name__
print("Mesh, Auto:", auto, "· make_mesh,", made.axis_types, ":", found)
assert auto == [0, 3, 4, -1]
assert found == "ShardingTypeError", "make_mesh works now"
PYTHON
