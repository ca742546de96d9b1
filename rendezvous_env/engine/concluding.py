"""How a step ends for a block of teams: reward, rendezvous, time limit, what is given out."""

from ..compilation import inlined_kernel, kernel
from ..experiment.rewards import team_reward
from .lanes import LANES, width
from .scratch import NEAR, SCORED, TOUCHES, WAY
from .teams import (
    ACTIVE,
    CONTACTS,
    FRESH,
    INITIAL_LYAPUNOV,
    LYAPUNOV,
    LYAPUNOV_AFTER_MERGE,
    LYAPUNOV_BEFORE_MERGE,
    PATH_LENGTH,
    RENDEZVOUS,
    REWARD,
    RUNNING,
    SCORES,
    STATUS,
    STEPS,
    TIME_OUT,
)

_RUNNING, _FRESH = float(RUNNING), float(FRESH)  # as they stand in the book
_RENDEZVOUS, _TIME_OUT = float(RENDEZVOUS), float(TIME_OUT)
_BEFORE_MERGE = SCORED + LYAPUNOV_BEFORE_MERGE
_AFTER_MERGE = SCORED + LYAPUNOV_AFTER_MERGE


@inlined_kernel
def conclude_block(block, lanes, physics, span, teams, results, scratch):
    """Bring the books up to date and write everything but observations, contacts and
    clearances.
    """
    first, book, tally = block * LANES, teams.book[block], scratch.tally
    _conclude(span, scratch.pair, physics.max_steps, physics.reward_weights, tally, book)
    for row in range(SCORES):
        for lane in range(lanes):
            results.scores[row, first + lane] = tally[(SCORED + row) * LANES + lane]
    for lane in range(lanes):
        results.status[first + lane] = int(book[STATUS * LANES + lane])
    _reward_robots(first, lanes, physics.all_earn, book, teams, results, scratch)


@kernel
def _conclude(span, found, max_steps, reward_weights, tally, book):
    """Reward, rendezvous and time limit over lanes: the one place where an episode ends.

    Args:
        span: how much of a block, see lanes.py.
        found: half of V, one number.
        max_steps: time limit.
        reward_weights: of ``team_reward``.
        tally: see scratch.py; its scores are filled in.
        book: of these teams, brought up to date.
    """
    time_share = 1.0 / max_steps
    for lane in range(width(span)):
        status, before = book[STATUS * LANES + lane], book[LYAPUNOV * LANES + lane]
        initial, now = book[INITIAL_LYAPUNOV * LANES + lane], 2.0 * found[lane]
        touches, running = tally[TOUCHES * LANES + lane], status == _RUNNING
        steps = book[STEPS * LANES + lane] + (1.0 if running else 0.0)
        met = running & (book[ACTIVE * LANES + lane] == 1.0)
        over = running & (steps >= max_steps)
        progress = (before - now) / initial if before > 0.0 else 0.0
        reward = team_reward(progress, time_share, touches, met, reward_weights)
        ended = _RENDEZVOUS if met else _TIME_OUT if over else _RUNNING
        book[STATUS * LANES + lane] = ended if running | (status == _FRESH) else status
        book[STEPS * LANES + lane] = steps
        book[LYAPUNOV * LANES + lane] = now
        book[PATH_LENGTH * LANES + lane] += tally[WAY * LANES + lane]
        book[CONTACTS * LANES + lane] += touches
        merged = tally[NEAR * LANES + lane] == 2.0
        tally[(SCORED + REWARD) * LANES + lane] = reward if running else 0.0
        for row in (_BEFORE_MERGE, _AFTER_MERGE):
            tally[row * LANES + lane] = tally[row * LANES + lane] if merged else now


@inlined_kernel
def _reward_robots(first, lanes, all_earn, book, teams, results, scratch):
    """Who exists, and what everybody earns."""
    n, tally = teams.merged_into.shape[1], scratch.tally
    results.active[first : first + lanes] = True
    for i in range(n):
        for lane in range(lanes):
            results.robot_rewards[first + lane, i] = tally[(SCORED + REWARD) * LANES + lane]
    for lane in range(lanes):
        if book[ACTIVE * LANES + lane] < n:
            team, merged = first + lane, tally[NEAR * LANES + lane] == 2.0
            for i in range(n):
                active = teams.merged_into[team, i] == i
                results.active[team, i] = active
                if not (all_earn or active or (merged and scratch.took_part[lane, i])):
                    results.robot_rewards[team, i] = 0.0
