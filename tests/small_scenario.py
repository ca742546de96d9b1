"""Common parts of learner tests: a small scenario, and the experience of its robots."""

from types import SimpleNamespace

import rendezvous_env as rv

ROBOTS, SEED = 3, 4
SCENARIO = rv.Scenario(
    n_robots=ROBOTS,
    merge_radius=0.25,
    spawn_size=1.1,
    time_step=0.2,
    allow_long_step=True,
    time_limit=4.4,
)
"""A small scenario with merges, rendezvous and time-outs under random actions."""
BARE = {"guarantee": None, "learning_preset": False}


class Lives:
    """Experience of the robots of one team, simulated separately in PettingZoo.

    ``found`` holds of every life that has ended: whose it was, what it saw, did and earned, what
    its future is valued from, and how it ended: "met", "late" or "merged".
    """

    def __init__(self, team):
        self.found, self._open, self._time = [], {}, 0
        self.env = rv.parallel_env(SCENARIO)
        self.seen, _ = self.env.reset(seed=SEED + team)

    def step(self, actions):
        """Step the active robots with their actions of all robots by name."""
        alive = list(self.env.agents)
        new, rewards, ends, cuts, infos = self.env.step({name: actions[name] for name in alive})
        met = infos[alive[0]]["success"]
        for name in alive:
            life = self._open.setdefault(
                name, SimpleNamespace(times=[], seen=[], acts=[], rewards=[])
            )
            life.times.append(self._time)
            life.seen.append(self.seen[name])
            life.acts.append(actions[name])
            life.rewards.append(rewards[name])
            if ends[name] or cuts[name]:
                into = name if met or cuts[name] else f"robot_{infos[name]['merged_into']}"
                kind = "met" if met else "late" if cuts[name] else "merged"
                self.found.append((self.env.index(name), self._open.pop(name), new[into], kind))
        self.seen = new if self.env.agents else self.env.reset()[0]
        self._time += 1

    def unfinished(self):
        """Continuing robots, likewise."""
        for name, life in self._open.items():
            yield self.env.index(name), life, self.seen[name], "running"
