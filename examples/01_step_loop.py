"""Step loop with PettingZoo: each robot moves along its net bearing."""

import rendezvous_env as rv

env = rv.parallel_env("fig3")
observations, infos = env.reset(seed=0)
bearings = env.unwrapped.scenario.observation_layout.neighbours
steps = 0
while env.agents:
    actions = {name: observations[name][bearings].sum(axis=0) for name in env.agents}
    observations, rewards, terminations, truncations, infos = env.step(actions)
    steps += 1
summary = next(iter(infos.values()))["summary"]
print(f"{steps} steps; met: {summary['success']} after {summary['time']:.2f} s")
