"""Last stage: reward, rendezvous, time limit, and the output of the step."""

from ...compilation import inner_kernel, kernel
from ...outcome import SCORES
from ...rewards.terms import team_reward
from ..memory import (
    ACTIVE,
    AFTER_MERGE,
    AWAITING_RESET,
    BEFORE_MERGE,
    CLOSENESS,
    CONTACTS,
    ELAPSED,
    FINAL,
    INITIAL_LYAPUNOV,
    LYAPUNOV,
    MERGED,
    PACKED,
    PATH_LENGTH,
    PROXIMITY,
    RENDEZVOUS,
    REWARD,
    RUNNING,
    SENSED_LYAPUNOV,
    STATUS,
    STEP_CONTACTS,
    STEP_LENGTH,
    STEPS,
    TIME_OUT,
    WALKED,
    is_near,
    lane_count,
)

_RUNNING, _AWAITING = float(RUNNING), float(AWAITING_RESET)  # as stored in environments
_RENDEZVOUS, _TIME_OUT = float(RENDEZVOUS), float(TIME_OUT)


@kernel
def conclude_step(
    width,
    first,
    last,
    duration,
    max_steps,
    reward_weights,
    all_earn,
    reach,
    environments,
    merged_into,
    took_part,
    scores,
    active,
    status,
    robot_rewards,
    contacts,
):
    """Update environments and write all output except observations, contacts and clearances.

    ``active`` is initialised to True, which stays where nothing has merged. Returns the number of
    environments with possible contact in the next step, see ``is_near``.
    """
    lanes, n, near = lane_count(width), merged_into.shape[1], 0
    for block in range(first, last):
        environment, start = environments[block], block * lanes
        count = min(lanes, len(merged_into) - start)  # at most a constant
        end = start + count
        _conclude(width, duration, max_steps, reward_weights, environment)
        _write_scores(width, start, count, environment, scores)
        codes, touched, earned = status[start:end], contacts[start:end], robot_rewards[start:end]
        for lane in range(count):
            codes[lane] = int(environment[STATUS * lanes + lane])
            touched[lane] = int(environment[CONTACTS * lanes + lane])
        for i in range(n):
            for lane in range(count):
                earned[lane, i] = environment[REWARD * lanes + lane]
        merged = 0
        for lane in range(lanes):
            merged += environment[ACTIVE * lanes + lane] < n
            near += is_near(environment, lane, lanes, reach)
        if merged > 0:
            given = merged_into, took_part, active, robot_rewards
            _leave_out_merged(width, start, count, all_earn, environment, *given)
    return near


@inner_kernel(inline="code")
def _write_scores(width, start, count, environment, scores):
    """Copy the fields of ``scores``, (SCORES, B); faster for all lanes, a constant number."""
    lanes = lane_count(width)
    for row in range(SCORES):
        # slices, since ``start + lane`` might be negative for the compiler: no SIMD
        score, field = scores[row, start : start + count], (REWARD + row) * lanes
        if count == lanes:
            for lane in range(lanes):
                score[lane] = environment[field + lane]
        else:
            for lane in range(count):
                score[lane] = environment[field + lane]


@inner_kernel
def _leave_out_merged(
    width, start, count, all_earn, environment, merged_into, took_part, active, robot_rewards
):
    """Mark merged robots as inactive; they are rewarded in the step of their merge, or always."""
    lanes, n = lane_count(width), merged_into.shape[1]
    for lane in range(count):
        b = start + lane
        if environment[ACTIVE * lanes + lane] < n:
            merges = environment[PROXIMITY * lanes + lane] == MERGED
            for i in range(n):
                active[b, i] = merged_into[b, i] == i
                earns = active[b, i] or (merges and took_part[b, i])
                if not (all_earn or earns):
                    robot_rewards[b, i] = 0.0


@inner_kernel(inline="code")
def _conclude(width, duration, max_steps, reward_weights, environment):
    """Reward, rendezvous and time limit over lanes: the only code that ends episodes."""
    lanes, time_share = lane_count(width), 1.0 / max_steps
    for lane in range(lanes):
        status = environment[STATUS * lanes + lane]
        before = environment[LYAPUNOV * lanes + lane]
        now = environment[SENSED_LYAPUNOV * lanes + lane]
        awaiting, initial = status == _AWAITING, environment[INITIAL_LYAPUNOV * lanes + lane]
        touched, running = environment[STEP_CONTACTS * lanes + lane], status == _RUNNING
        proximity = environment[PROXIMITY * lanes + lane]
        steps = environment[STEPS * lanes + lane] + (1.0 if running else 0.0)
        met = running & ((environment[ACTIVE * lanes + lane] == 1.0) | (proximity == PACKED))
        over = running & (steps >= max_steps)
        # a switching graph may have no links initially
        progress = (before - now) / initial if initial > 0.0 else 0.0
        closeness = environment[CLOSENESS * lanes + lane]
        reward = team_reward(progress, time_share, touched, closeness, met, reward_weights)
        ended = _RENDEZVOUS if met else _TIME_OUT if over else _RUNNING
        path_length = (
            environment[PATH_LENGTH * lanes + lane] + environment[STEP_LENGTH * lanes + lane]
        )
        merged = proximity == MERGED
        first, last = (
            environment[BEFORE_MERGE * lanes + lane],
            environment[AFTER_MERGE * lanes + lane],
        )
        environment[STATUS * lanes + lane] = ended if running | awaiting else status
        environment[INITIAL_LYAPUNOV * lanes + lane] = now if awaiting else initial
        environment[STEPS * lanes + lane] = steps
        environment[LYAPUNOV * lanes + lane] = now
        environment[PATH_LENGTH * lanes + lane] = path_length
        environment[CONTACTS * lanes + lane] += touched
        environment[REWARD * lanes + lane] = reward if running else 0.0
        environment[ELAPSED * lanes + lane] = steps * duration
        environment[WALKED * lanes + lane] = path_length
        environment[FINAL * lanes + lane] = now
        environment[BEFORE_MERGE * lanes + lane] = first if merged else now
        environment[AFTER_MERGE * lanes + lane] = last if merged else now


@kernel
def add_step(status, resting, step, totals, first, stop, is_last):
    """Add rewards (B,) and (B, n), and contacts (B, n), of a step to those of several.

    It covers first ≤ b < stop. Unless the step ``is_last``, its contacts are cleared, and
    environments that have ended are marked as ``resting``, (B,).
    """
    (rewards, robot_rewards, contact), (earned, robots_earned, touched) = step, totals
    for b in range(first, stop):
        earned[b] += rewards[b]
        for i in range(contact.shape[1]):
            robots_earned[b, i] += robot_rewards[b, i]
            touched[b, i] |= contact[b, i]
        if not is_last:
            resting[b] = status[b] != RUNNING
            for i in range(contact.shape[1]):
                contact[b, i] = False
