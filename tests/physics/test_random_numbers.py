"""Random rotations: inverse normal distribution, and small rotations."""

import math

import numpy as np
import pytest
from scipy import special, stats

from rendezvous_env.compilation import kernel
from rendezvous_env.physics.random_streams import SENSING, stream_key, word_of
from rendezvous_env.sensors.chance import (
    cosine_and_sine,
    gaussian,
    is_small,
    step_key,
    turned_by_chance,
)

SEED, EPISODE = 3, 1


@kernel
def fill_words(out):
    key = step_key(stream_key(SEED, EPISODE, SENSING), 0)
    for counter in range(out.shape[0]):
        out[counter] = word_of(key, counter)


@kernel
def fill_gaussians(words, out):
    for k in range(words.shape[0]):
        out[k] = gaussian(words[k])


@kernel
def fill_rotations(angles, small, cosines, sines):
    for k in range(angles.shape[0]):
        cosines[k], sines[k] = cosine_and_sine(angles[k], small)


@kernel
def fill_turned(rows, deviation, small, words, others, out):
    for k in range(rows.shape[0]):
        row = rows[k, 0], rows[k, 1], rows[k, 2]
        out[k, 0], out[k, 1], out[k, 2] = turned_by_chance(
            row, deviation, small, words[k], others[k]
        )


def halves(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Index of the words of a step, uint32."""
    fill_words(words := np.empty(count, np.uint64))
    return (words >> np.uint64(32)).astype(np.uint32), words.astype(np.uint32)


def gaussians(words: np.ndarray) -> np.ndarray:
    """Number for each word of 32 bits, float64."""
    fill_gaussians(words, numbers := np.empty(words.size, np.float32))
    return numbers.astype(np.float64)


def rotations(angles: np.ndarray, small: bool) -> np.ndarray:
    """cos and sin, (2, …), float32."""
    fill_rotations(angles, small, *(found := np.empty((2, len(angles)), np.float32)))
    return found


class TestOneNumber:
    def test_gaussian_is_inverse_distribution_function(self):
        most = 2**31 - 1
        magnitudes = np.concatenate(
            [np.linspace(0, most, 10**6), np.geomspace(1, most, 10**6), [0, most]]
        ).astype(np.int64)
        expected = -special.ndtri((magnitudes + 0.5) * 2.0**-32)
        found = gaussians((magnitudes << 1).astype(np.uint32))
        assert np.abs(found - expected).max() < 2.5e-6
        far = expected > 0.1
        assert np.abs(found / expected - 1)[far].max() < 1e-6
        assert np.abs(found - expected)[~far].max() < 1e-7
        assert (gaussians((magnitudes << 1 | 1).astype(np.uint32)) == -found).all()
        assert 6.3 < found.max() < 6.34

    @pytest.mark.kernels
    def test_plain_python_gives_same_bits(self):
        _, words = halves(100)
        plain = getattr(gaussian, "py_func", gaussian)
        numbers = [plain(word) for word in words]
        assert {type(number) for number in numbers} == {np.float32}
        assert numbers == gaussians(words).tolist()


class TestOneTurn:
    def test_cosine_and_sine_are_accurate(self):
        angles = np.linspace(-2 * math.pi * 6.4, 2 * math.pi * 6.4, 10**6).astype(np.float32)
        exact = np.array([np.cos(angles, dtype=float), np.sin(angles, dtype=float)])
        assert np.abs(rotations(angles, small=False) - exact).max() < 1.5e-7
        near = angles[np.abs(angles) <= math.pi / 4]
        assert (rotations(near, small=True) == rotations(near, small=False)).all()

    @pytest.mark.kernels
    def test_small_angles_use_short_formula(self):
        largest = gaussians(np.zeros(1, np.uint32))[0]
        deviations = np.linspace(0.0, 0.2, 1000).astype(np.float32)
        small = np.array([is_small(deviation) for deviation in deviations])
        assert (largest * deviations[small] < math.pi / 4).all()
        assert small[deviations <= 0.12].all()

    @pytest.mark.parametrize("deviation", [0.05, 0.8])
    def test_directions_across_are_uniform_in_3d(self, deviation):
        count = 400_000
        rows = np.random.default_rng(0).normal(size=(count, 3)).astype(np.float32)
        rows[:10], rows[10:20, :2], rows[20:30] = 0.0, 0.0, 1e-9
        words, others = halves(count)
        found, deviation = np.empty_like(rows), np.float32(deviation)
        fill_turned(rows, deviation, is_small(deviation), words, others, found)
        assert not found[:10].any()
        true, seen = rows[10:].astype(float), found[10:].astype(float)
        lengths = np.linalg.norm(true, axis=1)
        np.testing.assert_allclose(np.linalg.norm(seen, axis=1), lengths, rtol=1e-6)
        angles = np.abs(deviation * gaussians(words[10:]))
        along = (true * seen).sum(axis=1) / lengths**2
        np.testing.assert_allclose(along, np.cos(angles), atol=1e-6)
        # the turn about the row, counted from the part of x across it
        across = np.cross(true, [1.0, 0.0, 0.0])
        turn = np.arctan2((seen * across).sum(axis=1) * lengths, -seen @ [1, 0, 0] * lengths**2
                          + along * lengths**2 * true[:, 0])  # fmt: skip
        turn = turn[np.abs(np.sin(angles)) > 1e-3]
        assert stats.kstest(turn, stats.uniform(-math.pi, 2 * math.pi).cdf).pvalue > 0.01


@pytest.mark.kernels
def test_step_keys_are_distinct():
    key = np.uint64(stream_key(SEED, EPISODE, SENSING))
    keys = {int(np.uint64(step_key(key, step))) for step in (0, 1, 2, 10**15)}
    assert len(keys | {int(key)}) == 5
