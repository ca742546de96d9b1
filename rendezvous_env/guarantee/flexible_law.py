"""Law (4) with certified headings, for the robots of many teams."""

import numpy as np

from ..compilation import inlined_kernel, kernel
from ..engine.sharing import Share, begin, end, take
from ..equations.rows import degree_of, net_bearing_of
from ..equations.vectors import combine, dot, load, split, store
from .heading import certify_one, scale_of_step, turn_limit
from .teams import TEAMS_AT_ONCE


@kernel
def steer_headings(
    share, observations, constants, held, headings, actions, alignment, lyapunov_rate
):
    """``_steer_teams`` of the teams that this thread takes."""
    share, done = Share(*share), 0
    begin(share)
    block = take(share)
    while block < share.blocks:
        first, last = block * TEAMS_AT_ONCE, min((block + 1) * TEAMS_AT_ONCE, len(observations))
        _steer_teams(
            first, last, observations, constants, held, headings, actions, alignment, lyapunov_rate
        )
        done += 1
        block = take(share)
    return end(share, done)


@inlined_kernel
def _steer_teams(
    first, last, observations, constants, held, headings, actions, alignment, lyapunov_rate
):
    """Law (4) with the certified heading: v = min(1, r/(2Dτ)) h hᵀ f, for teams first … last −
    1.
    """
    limit = turn_limit(constants.max_turn)
    for team in range(first, last):
        for i in range(observations.shape[1]):
            f = net_bearing_of(observations[team, i], constants.neighbour_slots)
            raw, scale = load(held[team, i]), 1.0
            if constants.certified:
                h = certify_one(
                    raw,
                    f,
                    load(headings[team, i]),
                    constants.min_alignment,
                    constants.dead_zone,
                    limit,
                )
                if constants.long_step:
                    degree = degree_of(observations[team, i], constants.neighbour_slots)
                    scale = scale_of_step(degree, constants.merge_radius, constants.duration)
            else:
                _, h = split(raw)
            along = dot(h, f)
            store(h, headings[team, i])
            store(combine(along * scale, h, 0.0, h), actions[team, i])
            strength, _ = split(f)
            alignment[team, i] = abs(along) / strength if strength > 0.0 else np.nan
            lyapunov_rate[team, i] = -2.0 * along * along
