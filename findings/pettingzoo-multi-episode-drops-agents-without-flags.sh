#!/usr/bin/env bash
# PettingZoo's MultiEpisodeParallelEnv removes agents without a termination or truncation.
#
# Versions: pettingzoo 1.27.0, gymnasium 1.4.0, numpy 2.4.6, Python 3.11.
# Input: a parallel environment that passes parallel_api_test; agent "a" terminates after two steps
#   (a robot that has merged), "b" after three; wrapped for two episodes.
# Guess: the wrapper passes the test too, and parallel_to_aec over it runs to the end.
# Seen: "a" leaves env.agents with both flags False, since the wrapper sets all flags to False until
#   the last episode ends. parallel_api_test fails with AssertionError. A loop over
#   parallel_to_aec, which keeps "a" for want of a flag, ends in KeyError.
#   So a learner that masks agents by these flags counts absent agents as present.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pettingzoo==1.27.0 gymnasium==1.4.0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PYTHON'
import numpy as np
from gymnasium.spaces import Box
from pettingzoo import ParallelEnv
from pettingzoo.test import parallel_api_test
from pettingzoo.utils import parallel_to_aec
from pettingzoo.utils.wrappers import MultiEpisodeParallelEnv


class Leaving(ParallelEnv):
    metadata = {"name": "leaving"}
    render_mode = None
    last_step = {"a": 2, "b": 3}
    space = Box(-1.0, 1.0, (1,), np.float32)

    def __init__(self):
        self.possible_agents = list(self.last_step)

    def observation_space(self, agent):
        return self.space

    action_space = observation_space

    def reset(self, seed=None, options=None):
        self.agents, self.count = list(self.last_step), 0
        return {agent: np.zeros(1, np.float32) for agent in self.agents}, {agent: {} for agent in self.agents}

    def step(self, actions):
        acted, self.count = self.agents, self.count + 1
        ended = {agent: self.count >= self.last_step[agent] for agent in acted}
        self.agents = [agent for agent in acted if not ended[agent]]
        observations = {agent: np.zeros(1, np.float32) for agent in acted}
        infos = {agent: {} for agent in acted}
        return observations, dict.fromkeys(acted, 1.0), ended, dict.fromkeys(acted, False), infos


def api_test(env):
    try:
        parallel_api_test(env, num_cycles=20)
    except AssertionError:
        return "AssertionError"
    return "passed"


plain, wrapped = api_test(Leaving()), api_test(MultiEpisodeParallelEnv(Leaving(), 2))
env = MultiEpisodeParallelEnv(Leaving(), 2)
env.reset(seed=1)
for _ in range(2):
    _, _, terminations, truncations, _ = env.step({agent: np.zeros(1, np.float32) for agent in env.agents})
flags = (terminations["a"], truncations["a"])

turns = parallel_to_aec(MultiEpisodeParallelEnv(Leaving(), 2))
turns.reset(seed=1)
try:
    for agent in turns.agent_iter():
        _, _, terminated, truncated, _ = turns.last()
        turns.step(None if terminated or truncated else np.zeros(1, np.float32))
    converted = "ran"
except KeyError:
    converted = "KeyError"
print("parallel_api_test: plain", plain, "· wrapped", wrapped)
print("agents after two steps:", env.agents, "· flags of a:", flags)
print("parallel_to_aec:", converted)
assert plain == "passed"
assert env.agents == ["b"] and flags == (False, False), "the wrapper flags agents that leave now"
assert wrapped == "AssertionError", "the wrapped environment passes the test now"
assert converted == "KeyError", "the conversion runs now"
PYTHON
