#!/usr/bin/env bash
# Jumanji's time limit is a terminal state in RobotWarehouse and Cleaner, a truncation in two other tasks.
#
# Versions: jumanji 1.1.2, jax 0.10.2, jaxlib 0.10.2, numpy 2.4.6, Python 3.11, CPU.
# Input: tasks with several agents and time_limit=5, steps of permitted actions until the last time step.
# Guess: discount 1 in each, since the task does not end there and dm_env marks truncation like this.
# Seen: LevelBasedForaging and Connector give 1 per agent, RobotWarehouse and Cleaner 0, as after a
#   collision. So one learner bootstraps values at the limit in two tasks and not in the others, and
#   it cannot tell the limit from a failure there, since step type LAST is the same.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --no-compile jumanji==1.1.2 jax==0.10.2 jaxlib==0.10.2 numpy==2.4.6
JAX_PLATFORMS=cpu MPLBACKEND=agg "$folder/venv/bin/python" - <<'PYTHON'
import jax
import jax.numpy as jnp
from jumanji.environments import Cleaner, Connector, LevelBasedForaging, RobotWarehouse


def end(env):
    """Number of steps and discount of the last one; each agent takes its first permitted action."""
    step = jax.jit(env.step)
    state, timestep = jax.jit(env.reset)(jax.random.key(0))
    count = 0
    while not timestep.last():
        state, timestep = step(state, jnp.argmax(timestep.observation.action_mask, axis=-1))
        count += 1
    return count, timestep.discount.ravel().tolist()


found = {}
for task in (LevelBasedForaging, Connector, RobotWarehouse, Cleaner):
    count, discounts = end(task(time_limit=5))
    print(f"{task.__name__}: {count} steps, discount at the end {discounts}")
    assert count == 5
    found[task.__name__] = set(discounts)
assert found["LevelBasedForaging"] == found["Connector"] == {1.0}
assert found["RobotWarehouse"] == found["Cleaner"] == {0.0}, "the limit is a truncation now"
PYTHON
