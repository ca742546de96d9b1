"""Edge weights of a random graph, tuned by gradient through the environment.

    python examples/16_jax_gradient.py --figure gradient.png

It needs `pip install '.[jax]'` and matplotlib. Six robots follow law (1). The sum of
the weights a_ij stays constant. The cost is a smooth maximum, over 100 initial conditions, of a
smooth time to rendezvous, τ Σ_t s/(s + 1 m), with s the sum of the distances of all robots.
"""

import argparse

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import rendezvous_env as rv
import rendezvous_env.jax as rj

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--figure", default="gradient.png")
parser.add_argument("--iterations", type=int, default=30)
parser.add_argument("--num-envs", type=int, default=100, help="initial conditions")
parser.add_argument("--seconds", type=float, default=8.0, help="duration of an episode")
parser.add_argument("--seed", type=int, default=4)
given = parser.parse_args()
N, EXTRA, RATE, SHARPNESS, TAU = 6, 2, 0.15, 4.0, 0.05  # robots, links, step, 1/s, s

random = np.random.default_rng(given.seed)
tree = [(int(random.integers(i)), i) for i in range(1, N)]
others = [(i, j) for j in range(N) for i in range(j) if (i, j) not in tree]
edges = np.array(tree + [others[k] for k in random.permutation(len(others))[:EXTRA]])
scenario = rv.Scenario(
    name="tuned-weights", n_robots=N, graph=edges.tolist(), spawn_size=4.0, max_speed=3.0,
    time_step=TAU, time_limit=given.seconds, allow_long_step=True,
)  # fmt: skip
env = rj.make(scenario, num_envs=given.num_envs, differentiable=True)
layout, (first, second) = env.scenario.observation_layout, np.triu_indices(N, 1)
_, begun = env.reset(given.seed)


def weights_of(logits):
    """Edge weights a_ij with a constant sum, m/s."""
    return len(edges) * jax.nn.softmax(logits)


def play(logits):
    """Smooth times, times to rendezvous, s, and success of all initial conditions."""
    matrix = jnp.zeros((N, N)).at[edges[:, 0], edges[:, 1]].set(weights_of(logits))
    matrix = jnp.broadcast_to((matrix + matrix.T)[..., None], (N, N, given.num_envs))
    resting = jnp.zeros(env.action_space.shape)  # a step at rest observes with these weights
    seen, state, *_ = env.step(None, begun.replace(weights=matrix), resting)

    def advance(now, _):
        seen, state = now
        action = rj.bearing_only_law(rj.net_bearing(seen, layout))
        seen, state, *_ = env.step(None, state, action)
        places = jnp.take_along_axis(state.positions, state.merged_into[:, None], axis=0)
        squares = ((places[first] - places[second]) ** 2).sum(axis=1)
        spread = jnp.sqrt(squares + 1e-6).sum(axis=0)
        return (seen, state), spread / (spread + 1.0)

    (_, state), shares = jax.lax.scan(advance, (seen, state), None, env.scenario.max_steps)
    return TAU * shares.sum(axis=0), state.steps * TAU, state.status == 1


def cost(logits):
    """Smooth maximum of the smooth times, s, and the results of the episodes."""
    smooth, times, met = play(logits)
    return jax.nn.logsumexp(SHARPNESS * smooth) / SHARPNESS, (times, met)


improve = jax.jit(jax.value_and_grad(cost, has_aux=True))
logits, tried = jnp.zeros(len(edges)), []
for iteration in range(given.iterations + 1):
    (value, (times, met)), slope = improve(logits)
    tried.append((float(times.max()), bool(met.all()), np.array(logits), np.array(times)))
    if iteration % 5 == 0 or iteration == given.iterations:
        told = f"slowest {times.max():.2f} s, mean {times.mean():.2f} s, {met.mean():.0%} met"
        print(f"iteration {iteration}: cost {value:.3f} s, {told}", flush=True)
    logits -= RATE * slope / (jnp.linalg.norm(slope) + 1e-9) * len(edges) ** 0.5
before, after = tried[0], min((one for one in tried if one[1]), key=lambda one: one[0])
print(f"slowest of {given.num_envs}: {before[0]:.2f} s before, {after[0]:.2f} s after")

plt.switch_backend("Agg")
figure, axes = plt.subplots(1, 3, figsize=(11, 3.6), layout="constrained")
angles = 2 * np.pi * np.arange(N) / N
places = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
for axis, name, (slowest, _, found, times) in (
    (axes[0], "before", before),
    (axes[1], "after", after),
):
    for pair, weight in zip(edges, np.array(weights_of(found)), strict=True):
        axis.plot(*places[pair].T, color="tab:blue", linewidth=2.5 * weight, zorder=1)
        x, y = 0.65 * places[pair[0]] + 0.35 * places[pair[1]]
        box = {"fc": "white", "ec": "none", "pad": 1}
        axis.text(x, y, f"{weight:.2f}", fontsize=8, ha="center", va="center", bbox=box)
    axis.scatter(*places.T, s=120, color="black", zorder=2)
    axis.text(0.0, 1.2, f"weights {name} (m/s), slowest {slowest:.2f} s", ha="center")
    axis.set(xlim=(-1.4, 1.4), ylim=(-1.2, 1.4), aspect="equal")
    axis.axis("off")
    shares = np.arange(1, len(times) + 1) / len(times)
    axes[2].step(np.sort(times), shares, where="post", label=name)
axes[2].set(xlabel="time to rendezvous (s)", ylabel="share of initial conditions", ylim=(0, 1.02))
axes[2].legend()
figure.savefig(given.figure, dpi=150)
