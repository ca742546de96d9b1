"""Rollouts: contents of a trajectory, optional recordings, callbacks."""

import numpy as np
import pytest
from conftest import five, law_of
from guarantees import same

import rendezvous_env as rv
from rendezvous_env import Scenario, rollout, trajectory
from rendezvous_env.safety.lyapunov import lyapunov

DUO = Scenario(n_robots=2, local_frames="global", time_limit=10.0)
STARTS = {"positions": [[[0.0, 0], [0.5, 0]], [[0.0, 0], [5.05, 0]]]}


def test_two_robots_match_hand_computation():
    duo = DUO.replace(merge_radius=0.5)  # τ = 0.25 s
    start = {"positions": [[0.0, 0.0], [1.8, 0.0]]}
    traj = rollout(duo, law_of(duo), options=start)
    # they close in at 2 m/s: 1.8, 1.3, 0.8 and then 0.5 after 0.15 s of the third step
    np.testing.assert_allclose(traj.times, [0, 0.25, 0.5, 0.75])
    np.testing.assert_allclose(traj.positions[:, 0, 0, 0], [0, 0.25, 0.5, 0.9], atol=1e-6)
    np.testing.assert_allclose(traj.positions[:, 0, 1, 0], [1.8, 1.55, 1.3, 0.9], atol=1e-6)
    np.testing.assert_allclose(traj.lyapunov[:, 0], [3.6, 2.6, 1.6, 0], atol=1e-6)
    np.testing.assert_allclose(traj.lyapunov_before_merge[:, 0], [2.6, 1.6, 1.0], atol=1e-6)
    np.testing.assert_allclose(traj.lyapunov_after_merge[:, 0], [2.6, 1.6, 0.0], atol=1e-6)
    assert traj.active[:, 0].tolist() == [[True, True]] * 3 + [[True, False]]
    assert traj.success.tolist() == [True] and traj.rendezvous_time.tolist() == [0.75]
    (merge,) = traj.merges
    assert merge[:3] == (0, 0.75, (1,)) and merge.lyapunov_before == pytest.approx(1.0, abs=1e-6)
    assert traj.largest_rise_between_merges == pytest.approx(-0.6, abs=1e-6)


def test_arrays_are_consistent(kind):
    scenario = five(kind, time_limit=4.0)
    traj = rollout(scenario, law_of(scenario), seed=3, num_envs=6, record="all")
    steps, layout = len(traj.times) - 1, scenario.observation_layout
    assert traj.positions.shape == (steps + 1, 6, 5, scenario.dim)
    assert traj.headings.shape == (steps + 1, 6, 5, scenario.model.n_angles)
    assert traj.observations.shape == (steps + 1, 6, 5, *layout.shape)
    assert traj.actions.shape == (steps, 6, 5, scenario.action_size)
    assert traj.rewards.shape == (steps, 6) and traj.contacts.shape == (steps, 6, 5)
    assert traj.scenario is scenario and steps <= scenario.max_steps
    np.testing.assert_allclose(np.diff(traj.times), scenario.tau)
    together = traj.active.sum(axis=-1)
    assert (np.diff(together, axis=0) <= 0).all()
    np.testing.assert_array_equal(traj.success, np.isfinite(traj.rendezvous_time))
    np.testing.assert_array_equal(traj.success, together[-1] == 1)
    gone = traj.active[:-1] & ~traj.active[1:]
    assert sum(len(merge.robots) for merge in traj.merges) == gone.sum() > 0
    start = lyapunov(traj.positions[0], scenario.sensing_graph.base_weights(5))
    np.testing.assert_allclose(traj.lyapunov[0], start, rtol=1e-12)
    alone = rollout(scenario, law_of(scenario), seed=5)  # a seed for each team
    np.testing.assert_array_equal(traj.positions[: len(alone.times), 2], alone.positions[:, 0])


def test_finished_environment_stays_constant():
    traj = rollout(DUO, law_of(DUO), num_envs=2, options=STARTS, record="all")
    end = round(traj.rendezvous_time[0] / DUO.tau)
    assert end < len(traj.times) - 1
    for array in (traj.positions, traj.active, traj.lyapunov, traj.observations):
        np.testing.assert_array_equal(array[end:, 0], [array[end, 0]] * len(array[end:]))
    assert (traj.rewards[end:, 0] == 0).all()
    assert [merge.env for merge in traj.merges] == [0, 1]


def test_largest_rise_is_per_environment_while_running():
    """V decreases in every step under law (1); finished environments do not count."""
    found = rollout(DUO, law_of(DUO), num_envs=2, options=STARTS)
    assert found.running.sum(axis=0).tolist() == [2, len(found.running)]
    rise = found.largest_rise_between_merges
    assert rise.shape == (2,) and (rise < -0.1).all()
    flee = lambda seen, time: -0.5 * law_of(DUO)(seen, time)  # noqa: E731
    away = rollout(DUO, flee, options=STARTS, num_envs=2)
    np.testing.assert_allclose(away.largest_rise_between_merges, 0.2, atol=1e-6)  # 2 · τ · 1 m/s


def test_packed_robots_are_active_until_rendezvous():
    """Packed robots do not merge."""
    packing = rv.Scenario(n_robots=3, body_radius=0.1, meeting="pack", merge_radius=0.4)
    found = rollout(packing, law_of(packing), num_envs=3)
    steps = np.rint(found.rendezvous_time / packing.tau)
    assert found.success.all() and found.running.sum(axis=0).tolist() == steps.tolist()
    assert len(set(steps)) > 1 and (found.largest_rise_between_merges < 0.0).all()


class Still:
    """Stateful policy that returns its observations since the last reset."""

    def reset(self, mask=None):
        self.seen = []

    def __call__(self, observations, time):
        self.seen.append((observations.shape, time.tolist()))
        return np.zeros((1, 3, 2))


def test_any_callable_or_name_is_policy():
    policy = Still()
    traj, seen = rv.rollout("fig3", policy), policy.seen
    assert not traj.success.any() and np.isinf(traj.rendezvous_time).all()
    assert np.isclose(traj.times[-1], 30.0)
    assert seen[0][0] == (1, 3, *traj.scenario.observation_layout.shape)
    np.testing.assert_allclose([time for _, (time,) in seen], traj.times[:-1])
    assert traj.obstacles.shape[:2] == (1, 3) and traj.merges == []
    with pytest.raises(ValueError, match="is unknown"):
        rollout("duu", policy)


def test_observations_and_actions_are_optional():
    policy = law_of(DUO)
    plain = rollout(DUO, policy, num_envs=3)
    for name in ("observations", "actions"):
        with pytest.raises(AttributeError, match=rf'{name} were not recorded; .* record="{name}"'):
            getattr(plain, name)
    whole = rollout(DUO, policy, num_envs=3, record="all")
    both = rollout(DUO, policy, num_envs=3, record=("actions", "observations"))
    for k, actions in enumerate(whole.actions):
        np.testing.assert_array_equal(policy(whole.observations[k], plain.times[k]), actions)
    assert same(vars(whole), vars(both))
    assert same(vars(whole) | {"recorded": {}}, vars(plain))
    assert list(rollout(DUO, policy, record="actions").recorded) == ["actions"]


def test_policy_may_modify_and_reuse_arrays():
    law, given = law_of(DUO), np.zeros((1, 2, 2), np.float32)

    def frugal(seen, time):
        given[...] = law(seen, time)
        seen[...] = np.nan
        return given

    whole, again = (rollout(DUO, policy, record="all") for policy in (law, frugal))
    played = {"policy": whole.policy, "played_by": whole.played_by}
    assert same(vars(whole), vars(again) | played)
    assert whole == whole and whole != again  # arrays are compared by whoever wants to


@pytest.mark.parametrize("record", ["everything", 3, ("actions", "rewards"), [["actions"]]])
def test_unrecordable_policy_is_rejected(record):
    with pytest.raises(ValueError, match=r"record is .*'observations', 'actions', or \"all\""):
        rollout(DUO, law_of(DUO), record=record)


def test_large_recording_warns():
    message = r"may record .* GB.*; use fewer environments or steps, or record"
    with pytest.warns(UserWarning, match=message) as warned:
        with pytest.raises(ZeroDivisionError):
            rollout("clutter-24", lambda seen, time: 1 / 0, num_envs=20_000, record="all")
    assert warned[0].filename == __file__


def test_announced_size_equals_stored_size(monkeypatch):
    scenario = five("unicycle", time_limit=1.0)
    monkeypatch.setattr(trajectory, "_MUCH", 0.0)
    said = rf"may record 0.0 GB, 0.00\d+ MB a step for up to {scenario.max_steps} steps"
    with pytest.warns(UserWarning, match=said) as caught:
        found = rollout(scenario, law_of(scenario), num_envs=4, record="all")
    kept = sum(
        array.nbytes
        for name, array in (vars(found) | dict(found.recorded)).items()
        if isinstance(array, np.ndarray) and name not in ("times", "obstacles")
    )
    a_step = float(str(caught[0].message).split(" MB a step")[0].split()[-1]) * 1e6
    assert a_step * (scenario.max_steps + 1) == pytest.approx(kept, rel=0.02)
