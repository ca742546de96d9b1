#!/usr/bin/env bash
# XLA's CPU compiler removes a rounding by addition, so jit returns another float32 number.
#
# Versions: jax 0.10.2, jaxlib 0.10.2, numpy 2.3.5, Python 3.11, CPU.
# Input: x = 0.3 (float32); (x + R) - R with R = 1.5 * 2^23, the usual way to round to an integer
#   without a rounding instruction. It has one value in IEEE arithmetic, 0.
# Guess: jit and operation by operation give 0.0, since fast-math flags are off by default.
# Seen: operation by operation 0.0, as NumPy; under jax.jit 0.3, since (x + R) - R became x.
#   So a kernel that is exact in NumPy, numba and eager JAX needs jnp.round under jit.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet jax==0.10.2 jaxlib==0.10.2 numpy==2.3.5
JAX_PLATFORMS=cpu "$folder/venv/bin/python" - <<'PYTHON'
import jax
import jax.numpy as jnp
import numpy as np

R = np.float32(1.5 * 2**23)


def rounded(x):
    return (x + R) - R


x = np.float32(0.3)
expected = rounded(x)
eager = np.asarray(rounded(jnp.asarray(x)))
compiled = np.asarray(jax.jit(rounded)(jnp.asarray(x)))
print("NumPy", expected, "· eager", eager, "· jit", compiled, "· jnp.round", np.asarray(jax.jit(jnp.round)(x)))
assert expected == 0.0 and eager == 0.0
assert compiled == x, f"jit gives {compiled} now"
assert float(jax.jit(jnp.round)(x)) == 0.0
PYTHON
