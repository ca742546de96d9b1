"""JAX: a jitted policy gradient with a learned baseline, on Gymnasium's vector API."""

from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import optax
from held_out import SCENARIO, measure, settings

from rendezvous_env import vector

given = settings(__doc__, updates=40, num_envs=64)
envs = vector.training_env(SCENARIO, given.num_envs)
_, n, size = envs.observation_space.shape
HORIZON, DISCOUNT, SPREAD = 32, 0.97, 0.5


def layers(key, *widths):
    keys = jax.random.split(key, len(widths) - 1)
    pairs = pairwise(widths)
    return [
        (jax.random.normal(k, (a, b)) / jnp.sqrt(a), jnp.zeros(b))
        for k, (a, b) in zip(keys, pairs, strict=True)
    ]


def network(weights, seen):
    for matrix, bias in weights[:-1]:
        seen = jnp.tanh(seen @ matrix + bias)
    matrix, bias = weights[-1]
    return seen @ matrix + bias


@jax.jit
def best(weights, seen):
    return jnp.tanh(network(weights["policy"], seen))


@jax.jit
def sample(weights, seen, key):
    mean = best(weights, seen)
    return mean + SPREAD * jax.random.normal(key, mean.shape)


def loss(weights, seen, actions, returns, acted):
    values = network(weights["value"], seen)[..., 0]
    advantages = jax.lax.stop_gradient(returns - values)
    advantages = advantages / (jnp.std(advantages) + 1e-8)
    away = (actions - best(weights, seen)) / SPREAD
    errors = 0.5 * (away**2).sum(-1) * advantages + 0.5 * (returns - values) ** 2
    return (errors * acted).sum() / acted.sum()


optimiser = optax.adam(3e-3)


@jax.jit
def update(weights, state, *batch):
    changes, state = optimiser.update(jax.grad(loss)(weights, *batch), state)
    return optax.apply_updates(weights, changes), state


def random_steps():
    envs.step(envs.action_space.sample())
    return given.num_envs * n


def clip(actions):
    return np.clip(np.asarray(actions), -1, 1)


keys = iter(jax.random.split(jax.random.key(0), 2 + given.updates * HORIZON))
learned = {
    "policy": layers(next(keys), size, 64, 64, 2),
    "value": layers(next(keys), size, 64, 64, 1),
}


def train():
    state = optimiser.init(learned)
    seen, infos = envs.reset(seed=0)
    for _ in range(given.updates):
        path = []
        for _ in range(HORIZON):
            acted, actions = infos["active"], sample(learned, seen, next(keys))
            after, _, ends, cuts, infos = envs.step(clip(actions))
            path.append((seen, actions, infos["robot_rewards"], (ends | cuts)[:, None], acted))
            seen = after
        future = np.asarray(network(learned["value"], seen)[..., 0])
        returns = []
        for *_, rewards, over, _ in reversed(path):
            future = rewards + DISCOUNT * future * ~over
            returns.insert(0, future)
        observed, chosen, acted = (np.stack([step[i] for step in path]) for i in (0, 1, 4))
        weights, state = update(learned, state, observed, chosen, np.stack(returns), acted)
        learned.update(weights)
    return given.updates * HORIZON * given.num_envs * n


envs.reset(seed=0)
measure(random_steps, train, lambda seen: clip(best(learned, seen)), given.episodes)
