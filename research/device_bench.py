"""Rates of the JAX form on the device that JAX finds, for docs/throughput.md, to a JSON file.

    python research/device_bench.py --out device.json

The defaults take less than four minutes on a GPU. ``--small`` has sizes for a test on a CPU. Cases:
a step with observations, merges and autoreset under law (1); the engine on one thread of the CPU;
JaxMARL's ``simple_spread``, if installed; PPO of examples/15_jax_ppo.py from end to end. The first
three alternate, and rates are medians.
"""

from __future__ import annotations

import argparse
import json
import platform
import re
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

import jax
import numpy as np
from peers import jaxmarl

import rendezvous_env as rv
import rendezvous_env.jax as rj
from train import results
from train.checks import installed

ROOT = Path(__file__).resolve().parents[1]
STEPS = 100
"""Steps of a call of the JAX form, and of JaxMARL."""
SHORT = {"n_robots": 8, "dim": 2, "time_limit": 4.0}
"""Fields of the scenario ``cloud-8`` in the plane, whose episodes end by merges and time limits."""
RATE = re.compile(r"update \d+, ([\d,]+) robot steps/s")


def of_jax(num_envs: int) -> tuple[Callable[[], Any], int]:
    """Compiled steps under law (1) with observations, merges and autoreset."""
    env = rj.make("cloud-8", num_envs=num_envs, autoreset_mode="SAME_STEP", **SHORT)
    layout = env.scenario.observation_layout

    @jax.jit
    def run(seen: Any, state: Any) -> Any:
        def advance(now: Any, _: Any) -> Any:
            seen, state = now
            action = rj.bearing_only_law(rj.net_bearing(seen, layout))
            seen, state, reward, *_ = env.step(None, state, action)
            return (seen, state), reward.sum()

        return jax.lax.scan(advance, (seen, state), None, STEPS)

    now = [env.reset(0)]

    def call() -> None:
        now[0], rewards = run(*now[0])
        jax.block_until_ready((now[0], rewards))

    return call, STEPS * num_envs


def of_engine(num_envs: int) -> tuple[Callable[[], Any], int]:
    """The same steps of ``make_vec`` on one thread."""
    env = rv.make_vec("cloud-8", num_envs, num_threads=1, autoreset_mode="SAME_STEP", **SHORT)
    now = [env.reset(seed=0)[0]]

    def call() -> None:
        for _ in range(STEPS):
            now[0] = env.step(now[0].sum(axis=2))[0]

    return call, STEPS * num_envs


def of_jaxmarl(num_envs: int) -> tuple[Callable[[], Any], int]:
    """JaxMARL's simple_spread with as many agents, under random actions."""
    return jaxmarl(SHORT["n_robots"], num_envs).step, STEPS * num_envs


def alternating(
    cases: dict[str, tuple[Callable[[], Any], int]], seconds: float
) -> dict[str, dict[str, Any]]:
    """Rates of calls that alternate for a time, after a first call that compiles.

    Rates per second of CPU time suit a busy machine and a process on one core.
    """
    told: dict[str, dict[str, Any]] = {}
    for name, (call, steps) in cases.items():
        begun = time.perf_counter()
        call()
        told[name] = {"first_call_s": time.perf_counter() - begun, "steps_per_call": steps}
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in cases}
    end = time.perf_counter() + seconds
    while time.perf_counter() < end or min(map(len, times.values())) < 3:
        for name, (call, _) in cases.items():
            begun, used = time.perf_counter(), time.process_time()
            call()
            times[name].append((time.perf_counter() - begun, time.process_time() - used))
    for name, (_, steps) in cases.items():
        rates, of_cpu = steps / np.array(times[name]).T
        quartiles = np.percentile(rates, [25, 75]).tolist()
        told[name] |= {"steps_per_s": float(median(rates)), "quartiles": quartiles}
        told[name] |= {"steps_per_cpu_s": float(median(of_cpu)), "calls": len(rates)}
    return told


def ppo(envs: int, updates: int, steps: int) -> dict[str, Any]:
    """Robot steps/s of PPO, from the last of three reports, with compilation in the first."""
    sizes = {"envs": envs, "steps": steps, "updates": 3 * updates, "report": updates}
    words = [word for name, size in sizes.items() for word in (f"--{name}", str(size))]
    script = [sys.executable, str(ROOT / "examples" / "15_jax_ppo.py"), "--held-out", "16"]
    said = subprocess.run([*script, *words], capture_output=True, text=True, check=True).stdout
    rates = [float(rate.replace(",", "")) for rate in RATE.findall(said)]
    return {**sizes, "robot_steps_per_s": rates[-1], "all": rates}


def device() -> dict[str, str]:
    """Device, processor and versions."""
    found = jax.devices()[0]
    kind = {"platform": found.platform, "device": found.device_kind, "cpu": platform.machine()}
    return {**kind, "jax": jax.__version__, "python": platform.python_version()}


def main(words: list[str] | None = None) -> int:
    """Measure, print and write the results."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("device.json"))
    parser.add_argument("--num-envs", type=int, nargs="+", default=[65_536, 262_144])
    parser.add_argument("--peer-envs", type=int, default=4096, help="of engine and JaxMARL")
    parser.add_argument("--seconds", type=float, default=8.0, help="of a group of cases")
    parser.add_argument("--ppo-envs", type=int, default=8192)
    parser.add_argument("--ppo-updates", type=int, default=4, help="between two reports")
    parser.add_argument("--skip-ppo", action="store_true")
    parser.add_argument("--small", action="store_true", help="sizes for a test on a CPU")
    given = parser.parse_args(words)
    if given.small:
        given.num_envs, given.peer_envs, given.seconds = [64], 64, 0.0
        given.ppo_envs, given.ppo_updates = 8, 1
    result: dict[str, Any] = {"device": device(), "n_robots": SHORT["n_robots"], "rates": {}}
    for num_envs in given.num_envs:
        result["rates"][num_envs] = alternating({"jax": of_jax(num_envs)}, given.seconds)
        print(num_envs, json.dumps(result["rates"][num_envs]), flush=True)
    cases = {"jax": of_jax(given.peer_envs), "make_vec": of_engine(given.peer_envs)}
    if installed("jaxmarl"):
        cases["jaxmarl"] = of_jaxmarl(given.peer_envs)
    result["alternating"] = {"num_envs": given.peer_envs, **alternating(cases, given.seconds)}
    print(json.dumps(result["alternating"]), flush=True)
    if not given.skip_ppo:
        result["ppo"] = ppo(given.ppo_envs, given.ppo_updates, 2 if given.small else 32)
        print(json.dumps(result["ppo"]), flush=True)
    results.write_json(given.out, result)
    return 0


if __name__ == "__main__":
    sys.exit(main())
