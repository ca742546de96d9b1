"""PPO compiled end to end: environment, network and optimiser in one JAX program.

    python examples/15_jax_ppo.py

It needs `pip install '.[jax]'`, on a CPU, GPU or TPU. All robots share one network
that scores angles of the raw heading from f, under certified headings (theorem C), at first small
ones. The cost of contact rises. Advantages of merged robots continue with their survivor's.
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
HOLD, PLAYED, REST = 4, 1, 10  # steps of a decision, and of a held-out one; decisions
CONTACT, WIDTH, HELD_OUT = 1.0, 32, 1_000_000  # cost, at most once in REST; units; seed
ANGLES = 0.1 * jnp.array(sorted(range(-15, 16), key=abs))  # rad from f
HEADINGS = jnp.stack([jnp.cos(ANGLES), jnp.sin(ANGLES)], axis=-1)


def make(num_envs, mode, guarantee="heading"):
    """Environments, with the heading filter or bare; contact is penalised below."""
    fields = {"min_alignment": 0.05, "max_turn_rate": 100.0} if guarantee else {}
    fields |= {"num_envs": num_envs, "autoreset_mode": mode, "final_obs": mode == "SAME_STEP"}
    return rj.make(given.scenario, guarantee, reward={"collision_penalty": 0.0}, **fields)


env = make(given.envs, "SAME_STEP")
layout, n = env.scenario.observation_layout, env.scenario.n_robots
RULE = "tangent-merged-tuned" if layout.obstacle_slots else "bearing-only"


def new_network(key):
    """Layers by name: of neighbours, obstacles, all features, and of each choice; the critic's."""
    widths = {"neighbours": (2, WIDTH, WIDTH), "obstacles": (4, WIDTH, WIDTH)}
    widths |= {"trunk": (4 * WIDTH + 4 + len(ANGLES), 128, 128), "glance": (128, 16)}
    network, widths = {}, widths | {"actor": (20, 32, 1), "critic": (257, 64, 1)}
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
        x = x @ weight + bias
        x = activation(x) if len(bias) > 1 else x
    return x


def pooled(layers, rows):
    """Mean and maximum over rows, with zero for those that are absent."""
    present = jnp.any(rows != 0.0, axis=-1, keepdims=True)
    found = jnp.where(present, through(layers, rows, jax.nn.relu), 0.0)
    return [found.mean(axis=-2), found.max(axis=-2)]


def clearances(edges):
    """Angles from each heading to the nearest silhouette, (..., choices), rad; negative within."""
    turns = jnp.arctan2(edges[..., 1::2], edges[..., ::2])[..., None, :, :]
    right, half = turns[..., 1], (turns[..., 0] - turns[..., 1]) % (2 * jnp.pi) / 2
    apart = (ANGLES[:, None] - right - half + jnp.pi) % (2 * jnp.pi) - jnp.pi
    free = jnp.where(jnp.any(edges != 0.0, axis=-1)[..., None, :], jnp.abs(apart) - half, 1.0)
    return jnp.clip(free.min(axis=-1), -0.5, 1.0)


def evaluate(network, seen, last, rest):
    """Logits (..., n, choices) and values (..., n), of observations, last choices and ``rest``."""
    neighbours = seen[..., layout.neighbours, :]
    edges = seen[..., layout.obstacles, :].reshape(*seen.shape[:-2], layout.obstacle_slots, 4)
    edges = edges if layout.obstacle_slots else jnp.zeros((*seen.shape[:-2], 1, 4))
    sets = pooled(network["neighbours"], neighbours) + pooled(network["obstacles"], edges)
    free, turns = clearances(edges), jnp.abs(ANGLES - ANGLES[last][..., None])
    x = [*sets, neighbours.sum(axis=-2), HEADINGS[last], 4.0 * free]
    x = through(network["trunk"], jnp.concatenate(x, axis=-1))
    views = [jnp.repeat(through(network["glance"], x)[..., None, :], len(ANGLES), axis=-2)]
    for view in (4.0 * free, ANGLES, jnp.abs(ANGLES), turns):
        views.append(jnp.broadcast_to(view, free.shape)[..., None])
    scores = through(network["actor"], jnp.concatenate(views, axis=-1), jax.nn.relu)
    sees = jnp.any(neighbours != 0.0, axis=(-2, -1))[..., None]
    team = (sees * x).sum(axis=-2) / jnp.maximum(sees.sum(axis=-2), 1)
    known = [x, jnp.broadcast_to(team[..., None, :], x.shape), rest[..., None] / REST]
    value = through(network["critic"], jnp.concatenate(known, axis=-1))
    return scores[..., 0] - 1.5 * jnp.abs(ANGLES), value[..., 0]


def hold(env, state, seen, choices, steps):
    """Steps with the same choices; rewards, contacts and merges up to the episode's end."""

    def step(now, _):
        state, _, told = now
        seen, state, _, met, late, info = env.step(None, state, HEADINGS[choices])
        runs, end = ~told["ended"], (met | late) & ~told["ended"]
        told = {
            "final": jnp.where(end[:, *[None] * 3], info.get("final_obs", seen), told["final"]),
            "into": jnp.where((runs & ~end)[:, None], info["merged_into"], told["into"]),
            "reward": told["reward"] + runs[:, None] * info["robot_rewards"],
            "touched": told["touched"] | runs[:, None] & info.get("contact", False),
            "ended": told["ended"] | end,
            "late": told["late"] | end & late,
        }
        return (state, seen, told), None

    none = jnp.zeros(choices.shape, bool)
    told = {"final": seen, "touched": none, "ended": none[:, 0], "late": none[:, 0]}
    told |= {"into": jnp.broadcast_to(jnp.arange(n), none.shape), "reward": jnp.zeros(none.shape)}
    return jax.lax.scan(step, (state, seen, told), None, steps)[0]


def collect(network, contact, now, key):
    """One decision of all robots, and the sample of it."""
    state, seen, last, rest = now
    logits, value = evaluate(network, seen, last, rest)
    choices = jax.random.categorical(key, logits)
    acted = state.merged_into.T == jnp.arange(n)
    sample = {"seen": seen, "last": last, "rest": rest, "choices": choices, "acted": acted}
    sample |= {"value": value, "log_prob": of(jax.nn.log_softmax(logits), choices)}
    state, seen, told = hold(env, state, seen, choices, HOLD)
    cut = told["late"][:, None] * evaluate(network, told["final"], choices, rest)[1]
    hit, goes_on = told["touched"] & (rest == 0), ~told["ended"][:, None]
    sample |= told | {"reward": told["reward"] - contact * hit + GAMMA * cut}
    rest = jnp.where(hit, REST, jnp.maximum(rest - 1, 0))
    return (state, seen, choices * goes_on, rest * goes_on), sample


of = lambda values, index: jnp.take_along_axis(values, index[..., None], axis=-1)[..., 0]  # noqa: E731


def advantages(samples, value):
    """Generalised advantage estimates; those of a merged robot continue with its survivor's."""

    def back(now, sample):
        value, later = (jnp.take_along_axis(part, sample["into"], axis=1) for part in now)
        goes_on = ~sample["ended"][:, None]
        later = sample["reward"] + GAMMA * goes_on * (value + LAMBDA * later) - sample["value"]
        return (sample["value"], later), later

    return jax.lax.scan(back, (value, jnp.zeros_like(value)), samples, reverse=True)[1]


def loss_of(network, batch, bonus):
    """Loss of PPO with clipping, over the robots that acted."""
    logits, value = evaluate(network, batch["seen"], batch["last"], batch["rest"])
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
        slope = jax.grad(loss_of)(now[0], {k: v[rows] for k, v in flat.items()}, ENTROPY * left)
        return adam(now[0], slope, *now[1], RATE * left), None

    rows = jax.random.permutation(order, gain.size // n)
    rows = rows[: len(rows) // MINIBATCHES * MINIBATCHES].reshape(MINIBATCHES, -1)
    (network, moments), _ = jax.lax.scan(improve, (network, moments), rows)
    return (network, moments, acting, key), (samples["reward"].mean(), samples["acted"].sum())


def judge(env, memory, act):
    """Share of held-out environments that meet, and meet without contact, and their mean time."""
    seen, state = env.reset(HELD_OUT)
    begun = state, seen, memory, jnp.zeros((given.held_out, n), bool)
    runs = lambda now: (now[0].status == 0).any()  # noqa: E731
    state, *_, touched = jax.lax.while_loop(runs, lambda now: act(*now), begun)
    met, times = state.status == 1, state.steps * env.scenario.tau
    return met.mean(), (met & ~touched.any(axis=-1)).mean(), (met * times).sum() / met.sum()


@jax.jit
def judge_network(network):
    """Greedy choices, but for the two widest angles, at which a robot nearly stops."""
    env = make(given.held_out, "DISABLED")

    def act(state, seen, last, touched):
        choices = evaluate(network, seen, last, 0 * last)[0][..., :-2].argmax(axis=-1)
        state, seen, told = hold(env, state, seen, choices, PLAYED)
        return state, seen, choices, touched | told["touched"]

    return judge(env, jnp.zeros((given.held_out, n), int), act)


@jax.jit
def judge_rule():
    """The tuned rule, or law (1) without obstacles, as a JAX function."""
    env = make(given.held_out, "DISABLED", guarantee=None)
    rule = policies.make(RULE, env.scenario)

    def act(state, seen, memory, touched):
        actions, memory = rule.act(seen, memory)
        seen, state, *_, info = env.step(None, state, actions)
        return state, seen, memory, touched | info.get("contact", False)

    return judge(env, rule.begin((given.held_out,)), act)


TEXT = "{}: {:.1%} met, {:.1%} without contact, {:.1f} s"
print(TEXT.format(RULE, *judge_rule()), flush=True)
key, first = jax.random.split(jax.random.key(given.seed))
network, (seen, state) = new_network(first), env.reset(given.seed)
zeros, none = jax.tree.map(jnp.zeros_like, network), jnp.zeros((given.envs, n), int)
now = network, (1, zeros, zeros), (state, seen, none, none), key
print(TEXT.format("before", *judge_network(network)), flush=True)
many = jax.jit(lambda now, indices: jax.lax.scan(update, now, indices))
for done in range(0, given.updates, given.report):
    begun = time.perf_counter()
    now, (rewards, decisions) = many(now, jnp.arange(done, done + given.report))
    rate = HOLD * float(decisions.sum()) / (time.perf_counter() - begun)
    name = f"update {done + given.report}, {rate:,.0f} robot steps/s"
    print(TEXT.format(name, *judge_network(now[0])), flush=True)
