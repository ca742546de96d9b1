"""What a rollout keeps, and what it says of that."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import five, law_of

from rendezvous_env import Scenario, rollout, trajectory

DUO = Scenario(n_robots=2, time_limit=2.0)


def test_observations_and_actions_only_on_request():
    policy = law_of(DUO)
    plain = rollout(DUO, policy, num_envs=3)
    for name in ("observations", "actions"):
        with pytest.raises(AttributeError, match=rf'{name} were not kept; .* record="{name}"'):
            getattr(plain, name)
    whole = rollout(DUO, policy, num_envs=3, record="all")
    both = rollout(DUO, policy, num_envs=3, record=("actions", "observations"))
    steps = len(plain.times) - 1
    assert whole.observations.shape == (steps + 1, 3, 2, *DUO.observation_layout.shape)
    assert whole.actions.shape == (steps, 3, 2, 2) and whole.actions.dtype == np.float32
    for kept in (whole, both):
        np.testing.assert_array_equal(kept.positions, plain.positions)
        np.testing.assert_array_equal(kept.rewards, plain.rewards)
        np.testing.assert_array_equal(kept.actions, whole.actions)
        for k in range(steps):
            chosen = policy(kept.observations[k], plain.times[k])
            np.testing.assert_array_equal(chosen, kept.actions[k])
    assert list(rollout(DUO, policy, record="actions").recorded) == ["actions"]


@pytest.mark.parametrize("record", ["everything", 3, ("actions", "rewards"), [["actions"]]])
def test_what_cannot_be_recorded_is_refused(record):
    with pytest.raises(ValueError, match=r"record is .*'observations', 'actions', or \"all\""):
        rollout(DUO, law_of(DUO), record=record)


def test_a_large_recording_is_announced(monkeypatch):
    monkeypatch.setattr(trajectory, "_MUCH", 1e4)
    with pytest.warns(UserWarning, match=r"may keep 0.0 GB, 0.00\d+ MB a step for up to 20 steps"):
        rollout(DUO, law_of(DUO), num_envs=64)
    monkeypatch.setattr(trajectory, "_MUCH", 1e9)
    announced = []
    with pytest.warns(UserWarning, match=r"may keep .* GB.*; take fewer teams or steps, or record"):
        with pytest.raises(RuntimeError, match="enough"):
            announced.append(1)
            rollout("clutter-24", stop_at_once, num_envs=20_000, record="all")
    assert announced


def stop_at_once(observations, time):
    raise RuntimeError("enough")


def test_the_size_announced_is_the_size_kept(monkeypatch):
    scenario = five("unicycle", time_limit=1.0)
    found = rollout(scenario, law_of(scenario), num_envs=4, record="all")
    kept = sum(
        array.nbytes
        for name, array in (vars(found) | dict(found.recorded)).items()
        if isinstance(array, np.ndarray) and name not in ("times", "obstacles")
    )
    monkeypatch.setattr(trajectory, "_MUCH", 0.0)
    with pytest.warns(UserWarning) as caught:
        rollout(scenario, law_of(scenario), num_envs=4, record="all")
    a_step = float(str(caught[0].message).split(" MB a step")[0].split()[-1]) * 1e6
    assert a_step * (scenario.max_steps + 1) == pytest.approx(kept, rel=0.02)


def test_the_largest_rise_is_that_of_each_team_while_it_runs():
    """Law (1) lets V fall in every step; a team that has finished no longer counts."""
    duo = Scenario(n_robots=2, local_frames="global")
    starts = {"positions": [[[0.0, 0], [0.5, 0]], [[0.0, 0], [5.05, 0]]]}
    found = rollout(duo, law_of(duo), num_envs=2, options=starts)
    assert found.running.sum(axis=0).tolist() == [2, len(found.running)]
    rise = found.largest_rise_between_merges
    assert rise.shape == (2,) and (rise < -0.1).all()
    flee = lambda seen, time: -0.5 * law_of(duo)(seen, time)  # noqa: E731
    away = rollout(duo, flee, options=starts, num_envs=2)
    np.testing.assert_allclose(away.largest_rise_between_merges, 0.2, atol=1e-6)  # 2 · τ · 1 m/s
