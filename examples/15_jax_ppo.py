"""PPO compiled end to end: environment, network and optimiser in one JAX program.

    python examples/15_jax_ppo.py

It needs `pip install '.[jax]'`, on a CPU, GPU or TPU. All robots share one network that scores
angles of the raw heading from f, under certified headings (theorem C). Angles into near obstacles
are closed. Robots remember their waiting. Advantages of merged robots continue with the survivor's.
"""

import argparse
import itertools
import time

import jax
import jax.numpy as jnp
from rendezvous_env.baselines import jax as policies

import rendezvous_env.jax as rj

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--scenario", default="clutter-8", help="single integrators in the plane")
sizes = {"updates": 300, "envs": 256, "steps": 32, "held-out": 500, "report": 50, "seed": 0}
for name, usual in sizes.items():  # steps are decisions in an update, reports count updates
    parser.add_argument(f"--{name}", type=int, default=usual)
given = parser.parse_args()
GAMMA, LAMBDA, CLIP, MINIBATCHES, ENTROPY, RATE = 0.996, 0.95, 0.2, 8, 2e-3, 1e-3
HOLD, PLAYED, REST, WAIT = 4, 1, 40, 100  # steps: of a decision, of a held-out one, of memories
CONTACT, NEAR, CLOSED, WIDTH, HELD_OUT = 0.5, 0.6, -1e6, 32, 1_000_000  # cost; rad; logit; units
ANGLES = 0.1 * jnp.array(sorted(range(-15, 16), key=abs))  # rad from f
WIDE = jnp.abs(ANGLES) > 1.25  # a robot there nearly waits
STOPS = jnp.where(jnp.abs(ANGLES) < 1.45, 0.0, 1.1)  # rad; as an obstacle of this half-width
HEADINGS = jnp.stack([jnp.cos(ANGLES), jnp.sin(ANGLES)], axis=-1)


def make(num_envs, mode, guarantee="heading"):
    """Environments, with the heading filter or bare; ``collect`` adds the cost of contact."""
    fields = {"min_alignment": 0.05, "max_turn_rate": 100.0} if guarantee else {}
    reward = {"collision_penalty": 0.0, "time_penalty": 0.5}
    fields |= {"num_envs": num_envs, "autoreset_mode": mode, "reward": reward}
    return rj.make(given.scenario, guarantee, **fields)


env = make(given.envs, "SAME_STEP")
layout, n = env.scenario.observation_layout, env.scenario.n_robots
RULE = "tangent-merged-tuned" if layout.obstacle_slots else "bearing-only"


def new_network(key):
    """Layers by name: of neighbours, obstacles, all features, and of each choice; the critic's."""
    widths = {"neighbours": (2, WIDTH, WIDTH), "obstacles": (4, WIDTH, WIDTH)}
    widths |= {"trunk": (4 * WIDTH + 5 + len(ANGLES), 128, 128), "glance": (128, 16)}
    network, widths = {}, widths | {"actor": (21, 32, 1), "critic": (257, 64, 1)}
    for name, each in widths.items():
        for inputs, outputs in itertools.pairwise(each):
            key, own = jax.random.split(key)
            scale = 0.01 if outputs == 1 else 2**0.5
            weight = scale * jax.nn.initializers.orthogonal()(own, (inputs, outputs))
            network.setdefault(name, []).append((weight, jnp.zeros(outputs)))
    return network


def through(layers, x, activation=jnp.tanh):
    """Output of layers for x; linear if it is one number."""
    for weight, bias in layers:
        x = activation(x @ weight + bias) if len(bias) > 1 else x @ weight + bias
    return x


def pooled(layers, rows):
    """Mean and maximum over rows, with zero for those that are absent."""
    present = jnp.any(rows != 0.0, axis=-1, keepdims=True)
    found = jnp.where(present, through(layers, rows, jax.nn.relu), 0.0)
    return [found.mean(axis=-2), found.max(axis=-2)]


def clearances(edges):
    """Angles from headings to silhouettes, (..., choices), rad; those into near ones are closed."""
    turns = jnp.arctan2(edges[..., 1::2], edges[..., ::2])[..., None, :, :]
    right, half = turns[..., 1], (turns[..., 0] - turns[..., 1]) % (2 * jnp.pi) / 2
    apart = (ANGLES[:, None] - right - half + jnp.pi) % (2 * jnp.pi) - jnp.pi
    free = jnp.where(jnp.any(edges != 0.0, axis=-1)[..., None, :], jnp.abs(apart) - half, 1.0)
    widest = jnp.maximum(jnp.where(free < 0.0, half, 0.0).max(axis=-1), STOPS)
    closed = widest > jnp.maximum(widest.min(axis=-1, keepdims=True), NEAR)  # farthest if all
    return jnp.clip(free.min(axis=-1), -0.5, 1.0), closed


def remember(memory, choices, hit, steps):
    """Last choices, shares of steps at wide angles, and steps to the next cost of contact."""
    _, waited, rest = memory
    waited = waited + steps / WAIT * (WIDE[choices] - waited)
    return choices, waited, jnp.where(hit, REST, jnp.maximum(rest - steps, 0))


forgotten = lambda envs: tuple(jnp.zeros((envs, n), kind) for kind in (int, float, int))  # noqa: E731


def evaluate(network, seen, memory):
    """Logits (..., n, choices) and values (..., n), of observations and ``remember``."""
    last, waited, rest = memory
    neighbours = seen[..., layout.neighbours, :]
    edges = seen[..., layout.obstacles, :].reshape(*seen.shape[:-2], layout.obstacle_slots, 4)
    edges = edges if layout.obstacle_slots else jnp.zeros((*seen.shape[:-2], 1, 4))
    sets = pooled(network["neighbours"], neighbours) + pooled(network["obstacles"], edges)
    (free, closed), turns = clearances(edges), jnp.abs(ANGLES - ANGLES[last][..., None])
    x = [*sets, neighbours.sum(axis=-2), HEADINGS[last], 2.0 * waited[..., None], 4.0 * free]
    x = through(network["trunk"], jnp.concatenate(x, axis=-1))
    views = [jnp.repeat(through(network["glance"], x)[..., None, :], len(ANGLES), axis=-2)]
    for view in (4.0 * free, ANGLES, jnp.abs(ANGLES), turns, 4.0 * waited[..., None] * WIDE):
        views.append(jnp.broadcast_to(view, free.shape)[..., None])
    scores = through(network["actor"], jnp.concatenate(views, axis=-1), jax.nn.relu)
    sees = jnp.any(neighbours != 0.0, axis=(-2, -1))[..., None]
    team = (sees * x).sum(axis=-2) / jnp.maximum(sees.sum(axis=-2), 1)
    known = [x, jnp.broadcast_to(team[..., None, :], x.shape), rest[..., None] / REST]
    value = through(network["critic"], jnp.concatenate(known, axis=-1))
    return jnp.where(closed, CLOSED, scores[..., 0] - 1.5 * jnp.abs(ANGLES)), value[..., 0]


def hold(env, state, seen, choices, steps):
    """Steps with the same choices; rewards, contacts and merges up to the episode's end."""

    def step(now, _):
        state, _, reward, touched, into, ended = now
        seen, state, _, met, late, info = env.step(None, state, HEADINGS[choices])
        runs, ended = ~ended[:, None], ended | met | late
        touched |= runs & info.get("contact", False)
        into = jnp.where(ended[:, None], into, info["merged_into"])
        return (state, seen, reward + runs * info["robot_rewards"], touched, into, ended), None

    zero, robots = jnp.zeros(choices.shape), jnp.broadcast_to(jnp.arange(n), choices.shape)
    return jax.lax.scan(step, (state, seen, zero, zero > 0, robots, zero[:, 0] > 0), None, steps)[0]


def collect(network, contact, now, key):
    """One decision of all robots, and the sample of it."""
    state, seen, memory = now
    logits, value = evaluate(network, seen, memory)
    choices = jax.random.categorical(key, logits)
    acted = state.merged_into.T == jnp.arange(n)
    sample = {"seen": seen, "memory": memory, "choices": choices, "acted": acted}
    sample |= {"value": value, "log_prob": of(jax.nn.log_softmax(logits), choices)}
    state, seen, reward, touched, into, ended = hold(env, state, seen, choices, HOLD)
    hit = touched & (memory[2] == 0)
    sample |= {"reward": reward - contact * hit, "into": into, "ended": ended[:, None]}
    memory = remember(memory, choices, hit, HOLD)
    return (state, seen, jax.tree.map(lambda part: part * ~sample["ended"], memory)), sample


of = lambda values, index: jnp.take_along_axis(values, index[..., None], axis=-1)[..., 0]  # noqa: E731


def advantages(samples, value):
    """Generalised advantage estimates; those of a merged robot continue with its survivor's."""

    def back(now, sample):
        value, later = (jnp.take_along_axis(part, sample["into"], axis=1) for part in now)
        later = GAMMA * ~sample["ended"] * (value + LAMBDA * later)
        later += sample["reward"] - sample["value"]
        return (sample["value"], later), later

    return jax.lax.scan(back, (value, jnp.zeros_like(value)), samples, reverse=True)[1]


def loss_of(network, batch, bonus):
    """Loss of PPO with clipping, over the robots that acted."""
    logits, value = evaluate(network, batch["seen"], batch["memory"])
    log_probs, weight = jax.nn.log_softmax(logits), batch["acted"] / batch["acted"].mean()
    ratio, gain = jnp.exp(of(log_probs, batch["choices"]) - batch["log_prob"]), batch["gain"]
    gain = gain - (weight * gain).mean()
    gain /= jnp.sqrt((weight * gain**2).mean()) + 1e-8
    policy = jnp.minimum(ratio * gain, jnp.clip(ratio, 1 - CLIP, 1 + CLIP) * gain)
    entropy = -(jnp.exp(log_probs) * log_probs).sum(axis=-1)
    return (weight * (0.5 * (value - batch["target"]) ** 2 - policy - bonus * entropy)).mean()


def adam(network, slope, count, first, second, rate):
    """A step of Adam (Kingma & Ba 2015), with the norm of the gradient limited to 0.5."""
    size = jnp.sqrt(sum((part**2).sum() for part in jax.tree.leaves(slope)))
    slope = jax.tree.map(lambda g: g * jnp.minimum(1.0, 0.5 / (size + 1e-9)), slope)
    first = jax.tree.map(lambda m, g: 0.9 * m + 0.1 * g, first, slope)
    second = jax.tree.map(lambda v, g: 0.999 * v + 0.001 * g * g, second, slope)
    rate, later = rate / (1 - 0.9**count), 1 / (1 - 0.999**count)
    move = lambda w, m, v: w - rate * m / (jnp.sqrt(later * v) + 1e-5)  # noqa: E731
    return jax.tree.map(move, network, first, second), (count + 1, first, second)


def update(now, index):
    """Collect decisions of all environments, then improve the network in minibatches."""
    network, moments, acting, key = now
    left = 1.0 - index / given.updates
    contact = CONTACT * jnp.clip(2.0 * (1.0 - left), 0.15, 1.0)
    key, order, *keys = jax.random.split(key, given.steps + 2)
    play = lambda *now: collect(network, contact, *now)  # noqa: E731
    acting, samples = jax.lax.scan(play, acting, jnp.stack(keys))
    gain = advantages(samples, evaluate(network, *acting[1:])[1])
    samples |= {"gain": gain, "target": gain + samples["value"]}
    flat = jax.tree.map(lambda part: part.reshape(-1, *part.shape[2:]), samples)

    def improve(now, rows):
        batch = jax.tree.map(lambda part: part[rows], flat)
        slope = jax.grad(loss_of)(now[0], batch, ENTROPY * left)
        return adam(now[0], slope, *now[1], RATE * left), None

    rows = jax.random.permutation(order, gain.size // n // MINIBATCHES * MINIBATCHES)
    (network, moments), _ = jax.lax.scan(improve, (network, moments), rows.reshape(MINIBATCHES, -1))
    return (network, moments, acting, key), (samples["reward"].mean(), samples["acted"].sum())


def judge(act, memory, guarantee="heading"):
    """Share of held-out environments that meet, and meet without contact, and their mean time."""
    env = make(given.held_out, "DISABLED", guarantee)
    begun = *env.reset(HELD_OUT)[::-1], memory, jnp.zeros((given.held_out, n), bool)
    runs = lambda now: (now[0].status == 0).any()  # noqa: E731
    state, *_, touched = jax.lax.while_loop(runs, lambda now: act(env, *now), begun)
    met, times = state.status == 1, state.steps * env.scenario.tau
    return met.mean(), (met & ~touched.any(axis=-1)).mean(), (met * times).sum() / met.sum()


@jax.jit
def judge_network(network):
    """Greedy choices, made anew in each step."""

    def act(env, state, seen, memory, touched):
        choices = evaluate(network, seen, memory)[0].argmax(axis=-1)
        state, seen, _, hit, *_ = hold(env, state, seen, choices, PLAYED)
        return state, seen, remember(memory, choices, hit, PLAYED), touched | hit

    return judge(act, forgotten(given.held_out))


@jax.jit
def judge_rule():
    """The tuned rule, or law (1) without obstacles, as a JAX function."""
    rule = policies.make(RULE, env.scenario)

    def act(env, state, seen, memory, touched):
        actions, memory = rule.act(seen, memory)
        seen, state, *_, info = env.step(None, state, actions)
        return state, seen, memory, touched | info.get("contact", False)

    return judge(act, rule.begin((given.held_out,)), guarantee=None)


TEXT = "{}: {:.1%} met, {:.1%} without contact, {:.1f} s"
print(TEXT.format(RULE, *judge_rule()), flush=True)
key, first = jax.random.split(jax.random.key(given.seed))
network, (seen, state) = new_network(first), env.reset(given.seed)
zeros = jax.tree.map(jnp.zeros_like, network)
now = network, (1, zeros, zeros), (state, seen, forgotten(given.envs)), key
print(TEXT.format("before", *judge_network(network)), flush=True)
many = jax.jit(lambda now, indices: jax.lax.scan(update, now, indices))
for done in range(0, given.updates, given.report):
    begun = time.perf_counter()
    now, (rewards, decisions) = many(now, jnp.arange(done, done + given.report))
    rate = HOLD * float(decisions.sum()) / (time.perf_counter() - begun)
    name = f"update {done + given.report}, {rate:,.0f} robot steps/s"
    print(TEXT.format(name, *judge_network(now[0])), flush=True)
