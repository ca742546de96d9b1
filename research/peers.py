"""Throughput comparison with similar simulators, in alternating runs, for docs/throughput.md.

Run ``peers.py``. It needs ``pip install mpe2 vmas jaxmarl``; missing packages are skipped. Random
actions are sampled in advance, except those of JaxMARL, sampled in its scan. Rendering is off.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from functools import partial
from typing import Any

from rich.console import Console

import rendezvous_env as rv
from train.bench.bench import Config, measure
from train.bench.cases import Case, Running, one_team, spread_out, stepping
from train.checks import installed

ROBOTS, BATCHES = (3, 8), (1, 1024, 4096)
OURS = "make_vec"
_TAPE, STEPS = 8, 100
"""Number of random actions of VMAS, which repeat; steps of JaxMARL in a call."""


def vmas(n: int, num_envs: int) -> Running:
    """VMAS's simple_spread: n agents that observe the relative positions of all others."""
    import torch
    from vmas import make_env

    env = make_env("simple_spread", num_envs, n_agents=n, device="cpu", seed=0)
    env.reset()
    tape = itertools.cycle(2.0 * torch.rand(_TAPE, n, num_envs, 2) - 1.0)
    return Running(lambda: env.step(list(next(tape))))


def jaxmarl(n: int, num_envs: int) -> Running:
    """JaxMARL's simple_spread, a jitted scan over vectorised environments: 100 steps per call."""
    import jax
    from jaxmarl import make

    env = make("MPE_simple_spread_v3", num_agents=n, num_landmarks=n)

    def one(state: Any, key: Any) -> tuple[Any, Any]:
        acting, moving = jax.random.split(key)
        keys = dict(zip(env.agents, jax.random.split(acting, n), strict=True))
        chosen = {name: env.action_space(name).sample(keys[name]) for name in env.agents}
        seen, state, reward, *_ = env.step(moving, state, chosen)
        return state, (seen[env.agents[0]].sum(), reward[env.agents[0]])

    @jax.jit
    def many(state: Any, key: Any) -> tuple[Any, Any]:
        def all_of(state: Any, key: Any) -> tuple[Any, Any]:
            return jax.vmap(one)(state, jax.random.split(key, num_envs))

        return jax.lax.scan(all_of, state, jax.random.split(key, STEPS))

    key = jax.random.PRNGKey(0)
    now = [jax.vmap(env.reset)(jax.random.split(key, num_envs))[1]]

    def step() -> None:
        now[0], told = many(now[0], key)
        jax.block_until_ready(told)

    return Running(step)


def ours(n: int, num_envs: int) -> Running:
    """Training environment of this project."""
    return stepping(rv.make_vec(spread_out(n), num_envs))


def cases(n: int) -> Iterator[list[Case]]:
    """Cases in alternating order: one environment with dicts, and each number of environments."""
    yield one_team("peers", spread_out(n))
    for count in BATCHES:
        own = [Case(OURS, "peers", n, count, count, _UNIT, partial(ours, n, count))]
        for name, (build, steps) in _PEERS.items():
            counted = ("peers", n, count, count * steps, _UNIT)
            own += [Case(name, *counted, partial(build, n, count), OURS)] * installed(name.lower())
        yield own


_UNIT = "team steps"
_PEERS = {"VMAS": (vmas, 1), "JaxMARL": (jaxmarl, STEPS)}
"""Step function and number of steps per call."""


if __name__ == "__main__":
    console = Console()
    for n in ROBOTS:
        for row in cases(n):
            for told in measure(row, Config()):
                ratio = "" if told["ratio"] is None else f"{told['ratio']:.3g} of {told['against']}"
                counted = f"n = {n}, B = {told['num_envs']}"
                console.print(f"{counted:16} {told['name']:24} {told['rate']:14,.0f}/s  {ratio}")
