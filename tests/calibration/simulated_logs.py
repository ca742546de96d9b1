"""Logs of simulated robots with known sensors, as tables of bearings and poses."""

import math

import numpy as np

import rendezvous_env as rv

STEP = 0.1
ARENA = 4.0  # m, half the edge of the square in which robots drive
KNOWN = {
    "min_range": 0.7, "field_of_view": 1.6, "view_falloff": 0.2,
    "detection": ((1.0, 0.75), (4.0, 0.35)), "persistence": 0.6, "noise": 0.02,
    "noise_correlation": 0.4, "bias": 0.01, "observer_bias": 0.02, "outliers": 0.02,
    "sample_period": 0.25, "delay_time": 0.2,
}  # fmt: skip
"""Parameters of the sensor of the round trip."""


def scenario_of(sensing, n_robots=5):
    return rv.Scenario(
        n_robots=n_robots, robot_model="unicycle", max_speed=0.6, max_turn_rate=1.5,
        merge_radius=1e-6, time_step=STEP, allow_long_step=True, time_limit=1e5,
        spawn_size=2.0 * ARENA, sensing=rv.Sensing(**sensing),
    )  # fmt: skip


def yaws(sim):
    return sim.headings[..., 0]


def drive(sim, random, goals):
    """Actions towards goals, which are drawn anew where reached."""
    offset = goals - sim.positions
    reached = np.linalg.norm(offset, axis=-1) < 0.3
    goals[reached] = random.uniform(-ARENA, ARENA, (reached.sum(), 2))
    turn = np.arctan2(offset[..., 1], offset[..., 0]) - yaws(sim)
    turn = (turn + math.pi) % (2.0 * math.pi) - math.pi
    speed = 0.6 * np.clip(np.cos(turn), 0.1, 1.0)
    return np.stack([speed, np.clip(2.0 * turn, -1.5, 1.5)], axis=-1).astype(np.float32)


def simulate(sensing=None, seeds=(0,), duration=1200.0, n_robots=5, every_step=False):
    """For each seed, bearings (time, observer, target, bearing) and poses (time, robot, x, y,
    heading).

    Rows are those of samples, or of every step, where they are held between samples.
    """
    scenario = scenario_of(KNOWN if sensing is None else sensing, n_robots)
    sim, random = rv.Simulator(scenario, len(seeds)), np.random.default_rng(seeds[0])
    rows = sim.reset(list(seeds))
    goals = random.uniform(-ARENA, ARENA, (len(seeds), n_robots, 2))
    period, delay = scenario.sensing.sample_period, scenario.delay_steps
    others = np.array([[j for j in range(n_robots) if j != i] for i in range(n_robots)])
    steps = int(duration / STEP)
    poses = np.zeros((len(seeds), steps, n_robots, 5))
    poses[..., 0], poses[..., 1] = STEP * np.arange(steps)[:, None], np.arange(n_robots)
    seen = [[] for _ in seeds]
    for step in range(steps):
        poses[:, step, :, 2:4], poses[:, step, :, 4] = sim.positions, yaws(sim)
        if step >= delay and (every_step or is_sample(step - delay, period)):
            neighbours = scenario.observation_layout.split(rows).neighbours
            for own, kept in zip(neighbours, seen, strict=True):
                i, slot = np.nonzero(own.any(axis=-1))
                x, y = own[i, slot].T.astype(np.float64)
                time = np.full(len(i), step * STEP)
                kept.append(np.column_stack([time, i, others[i, slot], np.arctan2(y, x)]))
        rows = sim.step(drive(sim, random, goals)).observations
    assert sim.active.all()
    return [(np.concatenate(b), p.reshape(-1, 5)) for b, p in zip(seen, poses, strict=True)]


def is_sample(step, period):
    """True at the first step at or after a multiple of the period."""
    if period == 0.0 or step == 0:
        return True
    ticks = [math.floor(k * STEP / period + 1e-9) for k in (step - 1, step)]
    return ticks[1] > ticks[0]


def truth_of(name):
    """Known value of a parameter of a fit, such as detection[2.5 m]."""
    if name.startswith("detection"):
        distances, chances = zip(*KNOWN["detection"], strict=True)
        return float(np.interp(float(name[10:-3]), distances, chances))
    return KNOWN.get(name, 0.0)
