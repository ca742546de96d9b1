#!/usr/bin/env bash
# JaxMARL's particle tasks with max_steps=25 last 26 steps; those of MPE2 with max_cycles=25 last 25.
#
# Versions: jaxmarl 0.2.0, jax 0.10.2, jaxlib 0.10.2, mpe2 1.1.1, pettingzoo 1.27.0, Python 3.11, CPU.
# Input: simple_spread of both libraries at their defaults, and JaxMARL's simple_tag; no agent acts.
# Guess: episodes of 25 steps in each, since positions, rewards and observations of a step agree.
# Seen: 26 steps in JaxMARL, which compares the counter before it adds the step; 25 in MPE2. So
#   undiscounted returns of the same policy differ by one step's reward, about 4 %.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --no-compile jaxmarl==0.2.0 jax==0.10.2 jaxlib==0.10.2 \
    mpe2==1.1.1 pettingzoo==1.27.0
SDL_VIDEODRIVER=dummy JAX_PLATFORMS=cpu "$folder/venv/bin/python" - <<'PYTHON'
import jax
import jaxmarl
from mpe2 import simple_spread_v3


def jaxmarl_steps(name):
    env = jaxmarl.make(name)
    assert env.max_steps == 25
    step, key = jax.jit(env.step), jax.random.key(0)
    _, state = env.reset(key)
    for count in range(1, 40):
        _, state, _, dones, _ = step(key, state, {agent: 0 for agent in env.agents})
        if dones["__all__"]:
            return count


def mpe2_steps():
    env = simple_spread_v3.parallel_env(max_cycles=25)
    env.reset(seed=0)
    count = 0
    while env.agents:
        env.step({agent: 0 for agent in env.agents})
        count += 1
    return count


found = [jaxmarl_steps("MPE_simple_spread_v3"), jaxmarl_steps("MPE_simple_tag_v3"), mpe2_steps()]
print("steps: JaxMARL simple_spread, JaxMARL simple_tag, MPE2 simple_spread:", found)
assert found == [26, 26, 25], "the lengths are others now"
PYTHON
