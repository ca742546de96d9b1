#!/usr/bin/env bash
# VMAS's port of simple_spread has a fifth of MPE2's acceleration, and six times its reward.
#
# Versions: vmas 1.5.2, torch 2.13.0, mpe2 1.1.1, pettingzoo 1.27.0, gymnasium 1.4.0, numpy 2.4.6,
#   Python 3.11, CPU.
# Input: three agents, same positions, at rest; no action for a step, then full force along x, no contact.
# Guess: same velocities, positions and rewards, since mass, damping and time step are equal.
# Seen: at rest the reward is the sum of distances to the landmarks times 3 in VMAS, times 1/2 in
#   MPE2, at the defaults of both. Velocities under full force have the ratio 1 to 5. MPE2 moves with the
#   velocity of the step before, VMAS with the new one. So neither returns nor policies carry over.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --no-compile vmas==1.5.2 torch==2.13.0 mpe2==1.1.1 pettingzoo==1.27.0 \
    gymnasium==1.4.0 numpy==2.4.6
SDL_VIDEODRIVER=dummy "$folder/venv/bin/python" - <<'PYTHON'
import numpy as np
import torch
import vmas
from mpe2 import simple_spread_v3

AGENTS = np.array([[-0.8, -0.8], [0.0, 0.7], [0.8, -0.5]])
LANDMARKS = np.array([[0.5, 0.5], [-0.5, 0.5], [0.0, -0.9]])
TOTAL = np.linalg.norm(AGENTS[:, None] - LANDMARKS, axis=-1).min(axis=0).sum()

mpe2 = simple_spread_v3.parallel_env(continuous_actions=True)
mpe2.reset(seed=0)
world = mpe2.unwrapped.world
for entities, places in ((world.agents, AGENTS), (world.landmarks, LANDMARKS)):
    for entity, place in zip(entities, places, strict=True):
        entity.state.p_pos, entity.state.p_vel = place.copy(), np.zeros(2)

port = vmas.make_env("simple_spread", num_envs=1, device="cpu", seed=0)
for entities, places in ((port.agents, AGENTS), (port.world.landmarks, LANDMARKS)):
    for entity, place in zip(entities, places, strict=True):
        entity.set_pos(torch.tensor(place, dtype=torch.float32)[None], None)
        entity.set_vel(torch.zeros(1, 2), None)


def step(force):
    """Reward, position and velocity along x of the first agent in MPE2 and in VMAS."""
    _, rewards, *_ = mpe2.step({agent: np.array([0, 0, force, 0, 0], np.float32) for agent in mpe2.agents})
    _, port_rewards, *_ = port.step([torch.tensor([[force, 0.0]])] * 3)
    state, port_state = world.agents[0].state, port.agents[0].state
    return (
        (rewards["agent_0"], state.p_pos[0], state.p_vel[0]),
        (port_rewards[0].item(), port_state.pos[0, 0].item(), port_state.vel[0, 0].item()),
    )


rest, port_rest = step(0.0)
moved, port_moved = step(1.0)
later, port_later = step(1.0)
print(f"sum of distances {TOTAL:.4f} · reward at rest: MPE2 {rest[0]:.4f}, VMAS {port_rest[0]:.4f}")
for name, base, copy in (("first", moved, port_moved), ("second", later, port_later)):
    print(f"{name} step: MPE2 x {base[1]:.4f}, speed {base[2]:.4f} · VMAS x {copy[1]:.4f}, speed {copy[2]:.4f}")
assert np.isclose(rest[0], -TOTAL / 2) and np.isclose(port_rest[0], -3 * TOTAL), "the rewards are others now"
assert np.isclose(moved[2], 5 * port_moved[2]) and np.isclose(later[2], 5 * port_later[2]), "the speeds agree now"
assert np.isclose(moved[1], -0.8) and np.isclose(port_moved[1], -0.79), "positions advance in another order now"
PYTHON
