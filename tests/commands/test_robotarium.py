"""An exported file with its differential drive in a plain simulation of the Robotarium's robots."""

import numpy as np
import pytest

from train import cli, standalone

ARENA, TICK = np.array([1.6, 1.0]), 0.033
"""Half its size, m; s."""
WHEEL, BASE, FASTEST = 0.016, 0.105, 12.5
"""Radius and distance of wheels, m; rad/s."""
AHEAD, COLLISION, NEAR = 0.025, 0.135, 0.17
"""Where ahead of the axle collisions are counted, below which distance, and from where a robot's
proximity sensors tell that another is near, m."""


def simulate(file, n, seed, seconds, careful=True):
    """Unicycles in Euler's steps, wheels cut off one by one where they are too fast; how often they
    collided, were outside and had wheels too fast, how close they came, and how wide they stand.
    """
    random, poses = np.random.default_rng(seed), np.zeros((0, 3))
    while len(poses) < n:
        drawn = random.uniform([-1.3, -0.75, -np.pi], [1.3, 0.75, np.pi])
        if len(poses) == 0 or np.hypot(*(poses - drawn).T[:2]).min() > 0.25:
            poses = np.vstack([poses, drawn])
    robots, drives = (
        [kind() for _ in range(n)] for kind in (file.RobotPolicy, file.DifferentialDrive)
    )
    errors, closest, pairs = np.zeros(3, int), np.inf, np.triu_indices(n, 1)
    for _ in range(round(seconds / TICK)):
        heads = np.stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])], axis=-1)
        points = poses[:, :2] + AHEAD * heads
        offsets = points - points[:, np.newaxis]
        apart = np.linalg.norm(offsets, axis=-1)
        outside = (np.abs(poses[:, :2]) > ARENA).any(axis=1)
        errors[:2] += (apart[pairs] <= COLLISION).sum(), outside.sum()
        closest = min(closest, apart[pairs].min())
        for i in range(n):
            others = np.arange(n) != i
            bearings = offsets[i, others] / apart[i, others, np.newaxis]
            wanted = robots[i].act(bearings, [], TICK)
            if careful:
                wanted = file.keep_apart(wanted, bearings[apart[i, others] < NEAR])
            v, omega = drives[i].command(wanted, poses[i, 2], TICK)
            speeds = (v + np.array([-0.5, 0.5]) * BASE * omega) / WHEEL
            errors[2] += (np.abs(speeds) > FASTEST).any()
            left, right = np.clip(speeds, -FASTEST, FASTEST)
            v, omega = 0.5 * WHEEL * (left + right), WHEEL * (right - left) / BASE
            poses[i] += TICK * np.array([v * heads[i, 0], v * heads[i, 1], omega])
    return errors.tolist(), closest, apart.max()


@pytest.fixture(scope="module")
def file_for(tmp_path_factory):
    folder = tmp_path_factory.mktemp("robotarium")

    def load(policy, n):
        path = folder / f"{policy.replace('-', '_')}_{n}.py"
        words = ["export", "--policy", policy, "--standalone", str(path), "--checks", "50"]
        assert cli.main([*words, "--scenario", f"robotarium-{n}"]) == 0
        return standalone.load(path)

    return load


def test_a_team_packs_and_touches_nothing(file_for):
    file = file_for("bearing-only", 4)
    errors, closest, diameter = simulate(file, 4, seed=0, seconds=20.0)
    assert errors == [0, 0, 0] and closest > 0.15 and diameter < 0.34
    (collisions, _, wheels), *_ = simulate(file, 4, seed=0, seconds=20.0, careful=False)
    assert collisions > 100 and wheels == 0


@pytest.mark.slow
@pytest.mark.parametrize("policy", ["bearing-only", "learned", "learned-tank"])
@pytest.mark.parametrize(("n", "wide"), [(4, 0.34), (10, 0.75), (20, 1.25)])
def test_teams_of_the_robotarium(file_for, policy, n, wide):
    file = file_for(policy, n)
    errors, closest, diameter = simulate(file, n, 1, seconds=20.0)
    assert errors == [0, 0, 0] and closest > 0.15
    assert diameter < wide or policy == "learned-tank"  # which takes its time
