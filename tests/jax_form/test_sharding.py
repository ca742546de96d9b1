"""Environments distributed over four devices of a CPU."""

import json

import pytest
from conftest import ROOT, run_python

PROGRAM = """
import json
import jax
import jax.numpy as jnp
import numpy as np
import rendezvous_env.jax as rj

jax.config.update("jax_enable_x64", True)
env = rj.make("cloud-8", num_envs=8, autoreset_mode="SAME_STEP", dim=2, n_robots=3, spawn_size=1.0)
layout = env.scenario.observation_layout


@jax.jit
def run(seen, state):
    def advance(now, _):
        seen, state = now
        action = rj.bearing_only_law(rj.net_bearing(seen, layout))
        seen, state, reward, *_ = env.step(None, state, action)
        return (seen, state), reward

    (seen, state), rewards = jax.lax.scan(advance, (seen, state), None, 80)
    return seen, state, rewards


seen, state = env.reset(3)
alone = run(seen, state)
shared = run(seen, rj.shard(state))
parts = {shard.data.shape for shard in shared[1].positions.addressable_shards}
errors = []
for envs in (6, None):
    try:
        rj.shard(rj.make("duo", num_envs=envs).reset(0)[1])
    except ValueError as error:
        errors.append(str(error))
print(json.dumps({
    "devices": len(jax.devices()),
    "apart": max(
        float(np.abs(np.asarray(a, float) - np.asarray(b, float)).max(initial=0.0))
        for a, b in zip(jax.tree.leaves(alone), jax.tree.leaves(shared), strict=True)
    ),
    "episodes": int(shared[1].episode.sum()),
    "parts": [list(part) for part in parts],
    "errors": errors,
}))
"""


@pytest.mark.slow
def test_sharded_environments_equal_those_of_one_device(tmp_path):
    pytest.importorskip("jax")
    program = tmp_path / "program.py"
    program.write_text(PROGRAM, encoding="utf-8")
    four = "--xla_force_host_platform_device_count=4"
    path = {"PYTHONPATH": str(ROOT), "JAX_PLATFORMS": "cpu", "XLA_FLAGS": four}
    told = json.loads(run_python(tmp_path, program, **path).stdout)
    assert told["devices"] == 4
    assert told["parts"] == [[3, 2, 2]], "each device has to hold two of eight environments"
    assert told["apart"] < 1e-12
    assert told["episodes"] > 0, "no environment was reset"
    refusal = "num_envs is {}; it must be a multiple of 4 devices"
    assert told["errors"] == [refusal.format(size) for size in (6, None)]
