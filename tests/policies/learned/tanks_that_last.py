"""That V and the tanks together never rise, whatever is chosen: for points, unicycles and space."""

import numpy as np

import rendezvous_env as rv
from baselines.learned.guide import GuidedTeams
from baselines.learned.policy_settings import ALL_ROUND


def check_v_and_tanks(scenario, settings, *, teams=8, level=None, every=20):
    """Theorem D under arbitrary choices without obstacles, until the first merge.

    ``level`` is that of each tank at first, m²/s, if it is known; choices are made anew ``every``
    so many steps. Gives how often V rose, and in how many teams nobody merged.
    """
    free = scenario.replace(obstacles=(), time_step=None, time_limit=60.0)
    guided, simulator = GuidedTeams(settings, free, teams), rv.Simulator(free, teams)
    seen, random = simulator.reset(4), np.random.default_rng(4)
    levels = guided.tank.levels.sum(axis=1) if level is None else free.n_robots * level
    before = simulator.lyapunov() + levels
    rises, apart = 0, np.ones(teams, bool)
    for step in range(300):
        if step % every == 0:
            guided.choose(random.integers(len(ALL_ROUND), size=guided.choices.shape))
        v = simulator.lyapunov()
        seen = simulator.step(guided.act(seen)).observations
        apart &= (simulator.merged_into == np.arange(free.n_robots)).all(axis=1)
        rises += int((simulator.lyapunov() > v)[apart].sum())
        now = simulator.lyapunov() + guided.tank.levels.sum(axis=1)
        assert (now <= before + 1e-9)[apart].all() and guided.tank.levels.min() >= 0.0
        before = now
    return rises, int(apart.sum())
