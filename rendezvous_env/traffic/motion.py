"""Motion of obstacles over one step: planned displacement, clock, and the moved shapes.

The state of an obstacle is a row of ``STATE`` numbers: its displacement from the initial place
(3), m; its own clock, s, which stops while a robot blocks it; the velocity of a random walk (3),
m/s; and the number of directions sampled so far.
"""

import math

import numpy as np

from ..compilation import kernel
from ..obstacles.moving import STEADY, STILL, WALK, WAYPOINTS
from ..obstacles.polygon import POLYGON
from ..obstacles.shape import MIDDLE, OWN
from ..physics.random_streams import mix, uniform

CLOCK, COURSE, DRAWN, STATE = 3, 4, 7, 8
"""Columns of a state, and its size."""
SHARE = 3
"""Column of a plan, (M, 4), after the displacement over a whole step: the fraction that an obstacle
executes until a robot blocks it."""
_ROUNDING = 1e-9


@kernel
def plan_motion(traffic, states, duration, key, dim, plans):
    """Write the displacement of each obstacle over a step without robots, (M, 4).

    It samples and reflects the directions of random walks. ``key`` is that of the episode's stream.
    """
    for m in range(len(traffic.kinds)):
        kind, state, plan = traffic.kinds[m], states[m], plans[m]
        plan[:] = 0.0
        plan[SHARE] = 1.0
        if kind == STEADY:
            for k in range(3):
                plan[k] = traffic.velocities[m, k] * duration
        elif kind == WAYPOINTS:
            _plan_waypoints(traffic, m, state, state[CLOCK] + duration, plan)
        elif kind == WALK:
            _plan_walk(traffic, m, state, duration, key, dim, plan)


@kernel
def _plan_waypoints(traffic, m, state, time, plan):
    """Displacement to the place at a time, linear between waypoints."""
    times, places = traffic.times[m], traffic.places[m]
    last = times[len(times) - 1]
    if traffic.repeats[m]:
        time -= last * math.floor(time / last)
    after = 0
    while after < len(times) - 1 and times[after] < time:
        after += 1
    before = max(after - 1, 0)
    span = times[after] - times[before]
    share = min(max((time - times[before]) / span, 0.0), 1.0) if span > 0.0 else 1.0
    for k in range(3):
        target = places[before, k] + share * (places[after, k] - places[before, k])
        plan[k] = target - state[k]


@kernel
def _plan_walk(traffic, m, state, duration, key, dim, plan):
    """Displacement along the current direction, up to the box."""
    count = math.floor(state[CLOCK] / traffic.walks[m, 1] + _ROUNDING) + 1.0
    if state[DRAWN] < count:
        state[DRAWN] = count
        _draw_course(traffic.walks[m, 0], mix(key ^ np.uint64(m + 1)), 2 * int(count), dim, state)
    for k in range(dim):
        low, high = traffic.boxes[m, 0, k], traffic.boxes[m, 1, k]
        if (state[k] >= high and state[COURSE + k] > 0.0) or (
            state[k] <= low and state[COURSE + k] < 0.0
        ):
            state[COURSE + k] = -state[COURSE + k]
        target = state[k] + state[COURSE + k] * duration
        plan[k] = min(max(target, low), high) - state[k]


@kernel
def _draw_course(speed, key, counter, dim, state):
    """Sample a uniform direction from two numbers of a stream."""
    angle, height = 2.0 * math.pi * uniform(key, counter), 0.0
    if dim == 3:
        height = 2.0 * uniform(key, counter + 1) - 1.0
    level = math.sqrt(max(1.0 - height * height, 0.0))
    state[COURSE] = speed * level * math.cos(angle)
    state[COURSE + 1] = speed * level * math.sin(angle)
    state[COURSE + 2] = speed * height


@kernel
def execute_plan(traffic, states, plans, duration, world):
    """Move obstacles by the executed fraction of their plans, and their clocks likewise."""
    for m in range(len(traffic.kinds)):
        if traffic.kinds[m] != STILL:
            for k in range(3):
                states[m, k] += plans[m, SHARE] * plans[m, k]
            states[m, CLOCK] += plans[m, SHARE] * duration
            place_shape(traffic, m, states[m], world)


@kernel
def place_shape(traffic, m, state, world):
    """Write the row of an obstacle that is displaced from its initial place."""
    row, base = world.shapes[m], traffic.base[m]
    for k in range(len(row)):
        row[k] = base[k]
    for k in range(3):
        row[MIDDLE + k] += state[k]
    if world.kinds[m] == POLYGON:
        for corner in range(world.corners[m]):
            row[OWN + 2 * corner] += state[0]
            row[OWN + 2 * corner + 1] += state[1]
