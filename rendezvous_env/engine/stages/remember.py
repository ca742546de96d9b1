"""Stages that update the memories of sensors, and hold rows between samples.

Memories, (blocks, 2, count, L) float32, store the numbers of this step and the previous one, each
at the parity of its step. Repeating a step leaves them unchanged.
"""

import math

import numpy as np

from ...compilation import inner_kernel, kernel
from ...graphs.edges import pair_index
from ...physics.random_streams import SENSING, mix, stream_key
from ...sensors.chance import gaussian, step_key, unit_number
from ..memory import lane_count, sensed_step
from .apply_noise import halve

DETECTED, DRIFTED, OUTLIER, OBSERVER = range(1, 5)
"""Parts of the stream of sensing."""
_PART = np.uint64(0x9E6C63D0876A9A47)
_FARTHEST = np.float32(6.34)  # of ``gaussian``; one in 4·10⁹ numbers is beyond it
_ONE_BIT, _MOST, _ZERO = np.uint32(1), np.float32(1.0 - 2.0**-24), np.float32(0.0)
_ROUNDING = 1e-9  # Share of a sample period by which a step may miss a sample


@inner_kernel
def part_key(key, part):
    """Key of a part of a stream, DETECTED to OBSERVER."""
    return mix(key ^ (np.uint64(part) * _PART))


@inner_kernel
def part_keys(width, block, moves, part, seeds, episodes, environment, keys):
    """Keys of a part of the sensing streams: of the episode, and of the step."""
    lanes = lane_count(width)
    for lane in range(min(lanes, len(seeds) - block * lanes)):
        key = stream_key(seeds[block * lanes + lane], episodes[block * lanes + lane], SENSING)
        key = part_key(key, part)
        keys[0, lane] = key
        keys[1, lane] = step_key(key, sensed_step(environment, lane, lanes, moves))


@inner_kernel
def parities(width, moves, environment, words):
    """Parity of the step of every lane, and whether it is the first one of an episode."""
    lanes = lane_count(width)
    for lane in range(lanes):
        step = sensed_step(environment, lane, lanes, moves)
        words[0, lane], words[1, lane] = np.uint32(step & 1), np.uint32(1 if step == 0 else 0)


@inner_kernel(inline="code")
def is_sampled(step, samples_per_step):
    """True if a sample came since the previous step; always without a sample period, 0."""
    count = math.floor(step * samples_per_step + _ROUNDING)
    before = math.floor((step - 1) * samples_per_step + _ROUNDING)
    return step == 0 or samples_per_step == 0.0 or count > before


@inner_kernel
def is_due(width, moves, samples, environment):
    """True if a sample of ``samples_of`` is due in any lane.

    Rows of the other lanes are replaced by their held rows.
    """
    lanes, due = lane_count(width), False
    for number in range(len(samples)):
        due = due or samples[number] == 0.0
        for lane in range(0 if due else lanes):
            due = due or is_sampled(sensed_step(environment, lane, lanes, moves), samples[number])
    return due


@kernel
def remember_detection(
    width, first, last, moves, redraws, seeds, episodes, environments, keys, words, memory
):
    """Update the u of every ordered pair: kept, or sampled again by the observer's ``Redraws``.

    Working memory: keys (2, L), words (3, 4, L).
    """
    n = len(redraws.lowest)
    for block in range(first, last):
        part_keys(width, block, moves, DETECTED, seeds, episodes, environments[block], keys)
        parities(width, moves, environments[block], words[0])
        odd, begins = words[0, 0], words[0, 1]
        for one in range(n):
            for other in range(one + 1, n):
                couple = pair_index(one, other, n)
                halve(width, keys[1], couple, words[1, 0], words[1, 1])
                for side in range(2):
                    observer, number = (other if side else one), 2 * couple + side
                    low, scale = redraws.lowest[observer], redraws.scales[observer]
                    kept = memory[block, 0, number], memory[block, 1, number]
                    _redraw(width, low, scale, words[1, side], odd, begins, kept[0], kept[1])


@inner_kernel(inline="code")
def _redraw(width, low, scale, words, odd, begins, even_step, odd_step):
    """Keep or redraw the u of an ordered pair in every lane: of the words that draw anew, those
    from ``low`` on, u is the rank.
    """
    for lane in range(lane_count(width)):
        word, is_odd = words[lane], odd[lane] != 0
        a, b = even_step[lane], odd_step[lane]
        rank = np.float32(np.int32(np.uint32(word - low) >> _ONE_BIT)) * scale
        now = (a if is_odd else b) if word < low else min(rank, _MOST)
        now = unit_number(word) if (begins[lane] != 0) | (scale == _ZERO) else now
        even_step[lane] = a if is_odd else now
        odd_step[lane] = now if is_odd else b


@kernel
def remember_errors(
    width, first, last, moves, kept, seeds, episodes, environments, keys, words, memory
):
    """Update the error e of every row, see ``sensors.effects``; as ``remember_detection``.

    ``kept`` is that of ``memory_of_errors``. Rows of obstacles follow those of pairs.
    """
    n, count = len(kept), memory.shape[2]
    pairs = n * (n - 1)
    for block in range(first, last):
        part_keys(width, block, moves, DRIFTED, seeds, episodes, environments[block], keys)
        parities(width, moves, environments[block], words[0])
        one, other = 0, 1
        for couple in range((count + 1) // 2):
            halve(width, keys[1], couple, words[1, 0], words[1, 1])
            for side in range(min(2, count - 2 * couple)):
                number = 2 * couple + side
                observer = (number - pairs) * n // max(count - pairs, 1)
                if number < pairs:
                    observer = other if side else one
                now = kept[observer, 0], kept[observer, 1]
                memories = memory[block, 0, number], memory[block, 1, number]
                _drift(width, now, words[1, side], words[0], memories)
            other += 1
            if other == n:
                one, other = one + 1, one + 2


@inner_kernel(inline="code")
def _drift(width, kept, words, parity, memories):
    """Update the error e of a row in every lane, by k and √(1 − k²)."""
    (share, rest), (even, odd_one) = kept, memories
    odd, begins = parity[0], parity[1]
    for lane in range(lane_count(width)):
        z = gaussian(words[lane])
        a, b, is_odd = even[lane], odd_one[lane], odd[lane] != 0
        now = share * (a if is_odd else b) + rest * z
        now = min(max(now, -_FARTHEST), _FARTHEST)
        now = z if begins[lane] != 0 else now
        even[lane], odd_one[lane] = (a if is_odd else now), (now if is_odd else b)


@kernel
def hold_observations(
    lanes, first, last, moves, samples, merged_into, environments, held, observations
):
    """Write the rows of the last sample, (B, n, K + M·S, d); zeros for inactive robots.

    A step without a new sample of a robot repeats its held rows, see ``samples_of``.
    """
    n = held.shape[1]
    kept = held.reshape(held.shape[0], n, held.shape[2] * held.shape[3])
    batch, _, rows_each, d = observations.shape
    shown = observations.reshape(batch, n, rows_each * d)
    for block in range(first, last):
        for lane in range(min(lanes, len(merged_into) - block * lanes)):
            b, step = block * lanes + lane, sensed_step(environments[block], lane, lanes, moves)
            fresh = is_sampled(step, samples[0])
            for i in range(n):
                own, rows = kept[b, i], shown[b, i]
                if len(samples) > 1:
                    fresh = is_sampled(step, samples[i])
                if fresh:
                    for k in range(len(own)):
                        own[k] = rows[k]
                elif merged_into[b, i] == i:
                    for k in range(len(own)):
                        rows[k] = own[k]
                else:
                    for k in range(len(own)):
                        rows[k] = 0.0
