"""Law (4) with certified headings, for the robots of many teams."""

import numpy as np

from ..compilation import kernel, unfolded_kernel
from ..engine.pool.sharing import each_block
from ..equations.rows import degree_of, net_bearing_of
from ..equations.vectors import combine, dot, load, split, store
from .heading import certify_one, scale_of_step, turn_limit
from .teams import teams_of_block


@kernel
def steer_headings(
    share, observations, constants, held, headings, actions, alignment, lyapunov_rate
):
    """Law (4) with the certified heading, for the teams that this thread takes.

        v = min(1, r/(2Dτ)) h hᵀ f                                  (eq. 4, theorem C, theory 4)
        v = min(1, r/(2Dτ)) max(0, hᵀf − e) h,   e = 2 sin(η/2) D   with bearing errors (N1')

    Args:
        share: this thread's part, as sharing.py says.
        observations: (B, n, rows, d), m/s, in the robots' own frames.
        constants: of the scenario and of the wrapper, see steering.py.
        held: raw vectors, (B, n, d), of any unit.
        headings: h, (B, n, d), unit vectors or zero; brought up to date.
        actions: v, (B, n, d) float32, m/s; filled in.
        alignment: |hᵀf|/‖f‖, (B, n); filled in, NaN where f is zero.
        lyapunov_rate: −2 (hᵀf)², (B, n), m²/s²; filled in. With errors −2 hᵀf max(0, hᵀf − e).

    Returns:
        Whether all blocks are done, see ``each_block``.
    """
    arguments = observations, constants, held, headings, actions, alignment, lyapunov_rate
    return each_block(share, _steer_teams, arguments)


@unfolded_kernel
def _steer_teams(block, arguments):
    observations, constants, held, headings, actions, alignment, lyapunov_rate = arguments
    first, last = teams_of_block(block, len(observations))
    limit = turn_limit(constants.max_turn)
    for team in range(first, last):
        for i in range(observations.shape[1]):
            f = net_bearing_of(observations[team, i], constants.neighbour_slots)
            degree = degree_of(observations[team, i], constants.neighbour_slots)
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
                    scale = scale_of_step(degree, constants.merge_radius, constants.duration)
            else:
                _, h = split(raw)
            along = dot(h, f)
            sure = along
            if constants.error_chord > 0.0:
                sure = max(along - constants.error_chord * degree, 0.0)
            store(h, headings[team, i])
            store(combine(sure * scale, h, 0.0, h), actions[team, i])
            strength, _ = split(f)
            alignment[team, i] = abs(along) / strength if strength > 0.0 else np.nan
            lyapunov_rate[team, i] = -2.0 * along * sure
