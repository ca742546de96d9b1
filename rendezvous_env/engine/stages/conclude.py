"""The last stage: reward, rendezvous, time limit, what is given out."""

from ...compilation import inner_kernel
from ...outcome import SCORES
from ...rewards.terms import team_reward
from ..memory import (
    AWAITING_RESET,
    MERGED,
    PACKED,
    RENDEZVOUS,
    RUNNING,
    SCORED,
    TIME_OUT,
    lane_count,
    pair_of,
    statistics_of,
    tally_of,
)

_RUNNING, _AWAITING = float(RUNNING), float(AWAITING_RESET)  # as they stand in the statistics
_RENDEZVOUS, _TIME_OUT = float(RENDEZVOUS), float(TIME_OUT)


@inner_kernel(inline="text")
def conclude_block(block, setup, teams, output, scratch):
    """Bring the statistics up to date and write everything but observations, contacts and
    clearances.
    """
    first, last, n = block.first, block.first + block.count, teams.merged_into.shape[1]
    statistics, tally = statistics_of(teams, block.index), tally_of(scratch.tally)
    _conclude(setup, pair_of(scratch.pair, setup.layout.axes).half_lyapunov, tally, statistics)
    for row in range(SCORES):
        # slices, since ``first + lane`` might be negative for all that the compiler knows: no SIMD
        told, score = output.scores[row, first:last], scratch.tally[SCORED + row]
        for lane in range(len(told)):
            told[lane] = score[lane]
    status, contacts = output.status[first:last], output.contacts[first:last]
    for lane in range(len(status)):
        status[lane] = int(statistics.status[lane])
        contacts[lane] = int(statistics.contacts[lane])
    earned = output.robot_rewards[first:last]
    for i in range(n):
        for lane in range(len(earned)):
            earned[lane, i] = tally.reward[lane]
    for lane in range(block.count):
        if statistics.active[lane] < n:  # who exists, and earns
            team, merged = first + lane, tally.proximity[lane] == MERGED
            for i in range(n):
                active = teams.merged_into[team, i] == i
                output.active[team, i] = active
                earns = active or (merged and scratch.took_part[lane, i])
                if not (setup.constants.all_earn or earns):
                    output.robot_rewards[team, i] = 0.0


@inner_kernel(inline="text")
def _conclude(setup, half_lyapunov, tally, statistics):
    """Reward, rendezvous and time limit over lanes: the one place where an episode ends."""
    constants, time_share = setup.constants, 1.0 / setup.constants.max_steps
    for lane in range(lane_count(setup.layout.width)):
        status = statistics.status[lane]
        before, now = statistics.lyapunov[lane], 2.0 * half_lyapunov[lane]
        initial = statistics.initial_lyapunov[lane]
        contacts, running = tally.contacts[lane], status == _RUNNING
        steps = statistics.steps[lane] + (1.0 if running else 0.0)
        packed = tally.proximity[lane] == PACKED
        met = running & ((statistics.active[lane] == 1.0) | packed)
        over = running & (steps >= constants.max_steps)
        # where edges come and go there may be none at the start
        progress = (before - now) / initial if initial > 0.0 else 0.0
        closeness, weights = tally.closeness[lane], constants.reward_weights
        reward = team_reward(progress, time_share, contacts, closeness, met, weights)
        ended = _RENDEZVOUS if met else _TIME_OUT if over else _RUNNING
        statistics.status[lane] = ended if running | (status == _AWAITING) else status
        statistics.steps[lane] = steps
        statistics.lyapunov[lane] = now
        statistics.path_length[lane] += tally.way[lane]
        statistics.contacts[lane] += contacts
        merged = tally.proximity[lane] == MERGED
        tally.reward[lane] = reward if running else 0.0
        tally.elapsed[lane] = steps * constants.duration
        tally.walked[lane] = statistics.path_length[lane]
        tally.lyapunov[lane] = now
        tally.lyapunov_before_merge[lane] = tally.lyapunov_before_merge[lane] if merged else now
        tally.lyapunov_after_merge[lane] = tally.lyapunov_after_merge[lane] if merged else now
