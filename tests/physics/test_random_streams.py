"""Counter-based random numbers."""

import numpy as np
import pytest
from scipy import stats

from rendezvous_env import Scenario, Simulator
from rendezvous_env.physics.random_streams import (
    ACTUATION,
    FRAMES,
    GRAPH,
    OBSTACLES,
    SENSING,
    START,
    draw_rotation,
    mix,
    uniform,
)
from rendezvous_env.physics.random_streams import stream_key as compiled_stream_key

PURPOSES = (START, FRAMES, OBSTACLES, GRAPH, SENSING, ACTUATION)


def stream_key(seed, episode, purpose):
    """Plain integer in Python, as numba would return a signed one."""
    return np.uint64(compiled_stream_key(seed, episode, purpose))


def numbers(seed, episode, purpose, count=2000):
    key = stream_key(seed, episode, purpose)
    return np.array([uniform(key, k) for k in range(count)])


def test_mix_is_splitmix64():
    """The generator with seed 0 gives these words (Vigna's reference implementation)."""
    state = 0
    words = []
    for _ in range(3):
        state = (state + 0x9E3779B97F4A7C15) % 2**64
        words.append(int(mix(np.uint64(state))))
    assert words == [0xE220A8397B1DCDAF, 0x6E789E6AA1B965F4, 0x06C45D188009454F]


def test_value_depends_on_key_and_counter_only():
    key = stream_key(5, 1, START)
    for k in (7, 0, 7):
        word = mix(np.uint64((int(key) + (k + 1) * 0x9E3779B97F4A7C15) % 2**64))
        assert uniform(key, k) == (int(word) >> 11) / 2**53


@pytest.mark.kernels
def test_values_are_uniform_in_streams_and_seeds():
    firsts = np.array([uniform(stream_key(seed, 0, START), 0) for seed in range(3000)])
    for drawn in (firsts, *(numbers(3, 0, purpose) for purpose in PURPOSES)):
        assert drawn.min() >= 0 and drawn.max() < 1
        assert stats.kstest(drawn, "uniform").pvalue > 1e-3
        assert abs(np.corrcoef(drawn[:-1], drawn[1:])[0, 1]) < 3.5 / np.sqrt(len(drawn))


def test_streams_are_uncorrelated():
    streams = {
        (seed, episode, purpose): numbers(seed, episode, purpose)
        for seed in (0, 1, 2, 2**63 - 1)
        for episode in (0, 1, 2)
        for purpose in PURPOSES
    }
    assert len({stream.tobytes() for stream in streams.values()}) == len(streams) == 72
    correlations = np.corrcoef(np.stack(list(streams.values()))) - np.eye(72)
    assert np.abs(correlations).max() < 0.12


def test_start_and_frames_use_separate_streams():
    sim = Simulator(Scenario(n_robots=2, dim=3, spawn_size=7.0), 3)
    for episode in (0, 1):
        sim.reset(40 if episode == 0 else None)
        for team in range(3):
            first = numbers(40 + team, episode, START, 3)
            np.testing.assert_array_equal(sim.positions[team, 0], 7.0 * (first - 0.5))
            key = stream_key(40 + team, episode, FRAMES)
            frame = np.reshape(draw_rotation(key, 3, (0, 1, 2)), (3, 3))
            np.testing.assert_array_equal(sim.frames[team, 1], frame)


@pytest.mark.kernels
@pytest.mark.parametrize("d", [2, 3])
def test_rotations_are_uniform(d):
    keys = [stream_key(k, 0, FRAMES) for k in range(3000)]
    drawn = np.array([draw_rotation(key, 0, tuple(range(d))) for key in keys]).reshape(-1, d, d)
    np.testing.assert_allclose(
        drawn.transpose(0, 2, 1) @ drawn, np.tile(np.eye(d), (3000, 1, 1)), atol=1e-14
    )
    np.testing.assert_allclose(np.linalg.det(drawn), 1)
    assert np.abs(drawn.mean(axis=0)).max() < 0.06
    if d == 2:
        turns = np.arctan2(drawn[:, 1, 0], drawn[:, 0, 0])
        assert stats.kstest(turns, stats.uniform(-np.pi, 2 * np.pi).cdf).pvalue > 1e-3
    else:  # each entry of a uniform rotation is uniform in [−1, 1] (Archimedes)
        for entry in drawn.reshape(3000, 9).T:
            assert stats.kstest(entry, stats.uniform(-1, 2).cdf).pvalue > 1e-4
