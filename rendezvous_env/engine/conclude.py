"""The last stage: reward, rendezvous, time limit, what is given out."""

from ..compilation import unfolded_kernel
from ..equations.reward import team_reward
from .memory import (
    ACTIVE,
    AWAITING_RESET,
    CLOSENESS,
    CONTACTS,
    ELAPSED,
    INITIAL_LYAPUNOV,
    LYAPUNOV,
    LYAPUNOV_AFTER_MERGE,
    LYAPUNOV_BEFORE_MERGE,
    LYAPUNOV_NOW,
    MERGED,
    PATH_LENGTH,
    PROXIMITY,
    RENDEZVOUS,
    REWARD,
    RUNNING,
    SCORED,
    SCORES,
    STATUS,
    STEPS,
    TIME_OUT,
    TOUCHES,
    WALKED,
    WAY,
    lane_count,
)

_RUNNING, _AWAITING = float(RUNNING), float(AWAITING_RESET)  # as they stand in the statistics
_RENDEZVOUS, _TIME_OUT = float(RENDEZVOUS), float(TIME_OUT)
_BEFORE_MERGE = SCORED + LYAPUNOV_BEFORE_MERGE
_AFTER_MERGE = SCORED + LYAPUNOV_AFTER_MERGE


@unfolded_kernel
def conclude_block(block, count, layout, constants, teams, results, buffers):
    """Bring the statistics up to date and write everything but observations, contacts and
    clearances.
    """
    lanes = lane_count(layout.width)
    first, statistics, tally = block * lanes, teams.statistics[block], buffers.tally
    _conclude(layout, constants, buffers.pair, tally, statistics)
    for row in range(SCORES):
        # slices, since ``first + lane`` might be negative for all that the compiler knows: no SIMD
        told, found = results.scores[row, first : first + count], tally[(SCORED + row) * lanes :]
        for lane in range(len(told)):
            told[lane] = found[lane]
    status = results.status[first : first + count]
    contacts = results.contacts[first : first + count]
    for lane in range(len(status)):
        status[lane] = int(statistics[STATUS * lanes + lane])
        contacts[lane] = int(statistics[CONTACTS * lanes + lane])
    _reward_robots(first, count, layout, constants, statistics, teams, results, buffers)


@unfolded_kernel
def _conclude(layout, constants, found, tally, statistics):
    """Reward, rendezvous and time limit over lanes: the one place where an episode ends.

    Args:
        layout: of the memory.
        constants: of the scenario.
        found: half of V, one number.
        tally: see ``Lanes``; its scores are filled in.
        statistics: of these teams, brought up to date.
    """
    lanes, time_share = lane_count(layout.width), 1.0 / constants.max_steps
    for lane in range(lanes):
        status = statistics[STATUS * lanes + lane]
        before, now = statistics[LYAPUNOV * lanes + lane], 2.0 * found[lane]
        initial = statistics[INITIAL_LYAPUNOV * lanes + lane]
        touches, running = tally[TOUCHES * lanes + lane], status == _RUNNING
        steps = statistics[STEPS * lanes + lane] + (1.0 if running else 0.0)
        met = running & (statistics[ACTIVE * lanes + lane] == 1.0)
        over = running & (steps >= constants.max_steps)
        # where edges come and go there may be none at the start
        progress = (before - now) / initial if initial > 0.0 else 0.0
        closeness = tally[CLOSENESS * lanes + lane]
        reward = team_reward(
            progress, time_share, touches, closeness, met, constants.reward_weights
        )
        ended = _RENDEZVOUS if met else _TIME_OUT if over else _RUNNING
        statistics[STATUS * lanes + lane] = ended if running | (status == _AWAITING) else status
        statistics[STEPS * lanes + lane] = steps
        statistics[LYAPUNOV * lanes + lane] = now
        statistics[PATH_LENGTH * lanes + lane] += tally[WAY * lanes + lane]
        statistics[CONTACTS * lanes + lane] += touches
        merged = tally[PROXIMITY * lanes + lane] == MERGED
        tally[(SCORED + REWARD) * lanes + lane] = reward if running else 0.0
        tally[(SCORED + ELAPSED) * lanes + lane] = steps * constants.duration
        tally[(SCORED + WALKED) * lanes + lane] = statistics[PATH_LENGTH * lanes + lane]
        tally[(SCORED + LYAPUNOV_NOW) * lanes + lane] = now
        for row in (_BEFORE_MERGE, _AFTER_MERGE):
            tally[row * lanes + lane] = tally[row * lanes + lane] if merged else now


@unfolded_kernel
def _reward_robots(first, count, layout, constants, statistics, teams, results, buffers):
    """Who exists, and what everybody earns."""
    n, tally, lanes = teams.merged_into.shape[1], buffers.tally, lane_count(layout.width)
    earned = results.robot_rewards[first : first + count]
    reward = tally[(SCORED + REWARD) * lanes :]
    for i in range(n):
        for lane in range(len(earned)):
            earned[lane, i] = reward[lane]
    for lane in range(count):
        if statistics[ACTIVE * lanes + lane] < n:
            team, merged = first + lane, tally[PROXIMITY * lanes + lane] == MERGED
            for i in range(n):
                active = teams.merged_into[team, i] == i
                results.active[team, i] = active
                if not (constants.all_earn or active or (merged and buffers.took_part[lane, i])):
                    results.robot_rewards[team, i] = 0.0
