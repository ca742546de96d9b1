"""Training with randomised sensors: ranges, groups, and bitwise resumption."""

import math

import numpy as np
import pytest
from training_runs import UPDATE, assert_goes_on, config

from baselines.learned import checkpoints
from rendezvous_env.sensors.sensing import Sensing
from train.learn import ppo, trainer
from train.learn.environments import make_environments
from train.learn.sensing_ranges import check_ranges, draw

RANGES = {
    "noise": (0.05, 0.2), "bias": (0.0, 0.1), "dropout": (0.1, 0.3), "range": (10.0, 20.0),
    "field_of_view": (math.pi, 6.0), "occlusion": ("obstacles", "both"), "delay": (1, 3),
}  # fmt: skip
DRAWN = {
    "sensing_noise": (0.05, 0.3), "sensing_dropout": (0.0, 0.5), "sensing_delay": (0, 2),
    "sensing_groups": 3, "sensing_updates": 2,
}  # fmt: skip
"""Three groups of 3, 3 and 2 environments; one or two get a new sensor in every update."""


class TestRanges:
    def test_sampled_sensor_lies_in_range(self):
        given, keys = Sensing(sectors=8), [(0, g, k) for g in range(20) for k in range(20)]
        drawn = [draw(given, RANGES, 0.5, key) for key in keys]
        assert all(sensing.sectors == 8 and sensing.error == 0.0 for sensing in drawn)
        for name in ("noise", "bias", "dropout", "range", "field_of_view", "delay"):
            low, high = RANGES[name]
            exact = getattr(Sensing(), name)
            found = np.array([v for s in drawn if (v := getattr(s, name)) != exact])
            assert low <= found.min() and found.max() <= high, name
            assert found.max() - found.min() > 0.9 * (high - low), name
            # 400 draws with chance 1/2: five standard deviations are 50
            assert abs(len(found) - 200) < 50, name
        assert {s.delay for s in drawn} == {0, 1, 2, 3}
        assert {s.occlusion for s in drawn} == {"none", "obstacles", "both"}

    def test_sensor_follows_key_and_probability(self):
        keys, noise = [(seed, g) for seed in range(4) for g in range(4)], {"noise": (0.0, 1.0)}
        drawn, again = ([draw(Sensing(), noise, 1.0, key) for key in keys] for _ in range(2))
        assert drawn == again and len(set(drawn)) == len(keys)
        given, ranges = Sensing(bias=0.1), {"noise": (0.2, 0.2), "occlusion": ("robots",)}
        expected = Sensing(noise=0.2, bias=0.1, occlusion="robots")
        assert draw(given, ranges, 1.0, (0,)) == expected
        assert draw(given, ranges, 0.0, (0,)) == given

    def test_effects_of_measured_sensors_are_drawn_from_their_ranges(self):
        ranges = {
            "min_range": (0.5, 1.0), "sample_period": (0.1, 0.3), "observer_bias": (0.01, 0.02),
            "noise_correlation": (0.2, 0.4), "persistence": (1.0, 2.0), "outliers": (0.001, 0.01),
        }  # fmt: skip
        drawn = [draw(Sensing(delay=2), ranges, 1.0, (key,)) for key in range(200)]
        for name, (low, high) in ranges.items():
            found = np.array([getattr(sensing, name) for sensing in drawn])
            assert low <= found.min() and found.max() <= high, name
            assert np.ptp(found) > 0.9 * (high - low), name

    def test_a_delay_that_is_drawn_replaces_the_other_kind(self):
        drawn = draw(Sensing(delay=2), {"delay_time": (0.1, 0.2)}, 1.0, (0,))
        assert drawn.delay == 0 and 0.1 <= drawn.delay_time <= 0.2
        drawn = draw(Sensing(delay_time=0.3), {"delay": (1, 3)}, 1.0, (0,))
        assert drawn.delay_time == 0.0 and 1 <= drawn.delay <= 3
        with pytest.raises(ValueError, match=r"delay and sensing\.delay_time both have a range"):
            check_ranges({"delay": (1, 2), "delay_time": (0.1, 0.2)}, 0.5)


class TestGroups:
    def test_groups_renew_sensors_in_turn(self, tmp_path):
        given = config(tmp_path, **DRAWN)
        groups, ranges, generations = make_environments(given, 0), given.sensing_ranges(), []
        groups.reset(seed=list(range(5, 13)))
        assert [teams.num_envs for teams in groups.groups] == [3, 3, 2]
        for update in range(5):
            before = [teams.env.simulator.get_state() for teams in groups.groups]
            which, seen = groups.renew(update)
            assert len(seen) == which.sum()
            generations.append(groups.generations.tolist())
            for g, k in enumerate(generations[-1]):
                expected = draw(Sensing(), ranges, given.sensing_chance, (given.seed, g, k))
                assert groups.groups[g].env.scenario.sensing == expected
                state = groups.groups[g].env.simulator.get_state()
                np.testing.assert_array_equal(before[g]["seed"], state["seed"])
                renewed = (before[g]["positions"] != state["positions"]).any()
                assert renewed == (update > 0 and generations[-2][g] != k)
                assert state["episode"].tolist() == [k] * groups.groups[g].num_envs
        # offsets ⌊2 g/3⌋ = 0, 0, 1
        assert generations == [[0, 0, 0], [0, 0, 1], [1, 1, 1], [1, 1, 2], [2, 2, 2]]

    def test_groups_equal_their_environments(self, tmp_path):
        """With exact sensors, groups are bitwise equal to environments without groups."""
        exact = {"sensing_noise": (0.1, 0.2), "sensing_chance": 0.0, "sensing_groups": 3}
        apart, together = (make_environments(config(tmp_path, **more), 0) for more in (exact, {}))
        seeds, choices = list(range(40, 48)), np.random.default_rng(0)
        seen, _ = together.reset(seed=seeds)
        np.testing.assert_array_equal(apart.reset(seed=seeds)[0], seen)
        ended = 0
        for _ in range(60):
            chosen = np.where(seen.any(axis=-1), choices.integers(0, 9, (8, 4)), 0)
            *arrays, infos = together.step(chosen)
            *others, told = apart.step(chosen)
            for one, other in zip(arrays, others, strict=True):
                np.testing.assert_array_equal(one, other)
            for key in ("active", "merged_into", "robot_rewards", "contact"):
                np.testing.assert_array_equal(infos[key], told[key], key)
            seen, over = arrays[0], arrays[2] | arrays[3]
            ended += over.sum()
            for key in ("success", "time", "contacts") if over.any() else ():
                mine, theirs = (i["final_info"]["summary"][key][over] for i in (infos, told))
                np.testing.assert_array_equal(mine, theirs)
        assert ended > 8

    def test_robot_without_observation_takes_choice_zero(self, tmp_path):
        drawn = {"sensing_range": (0.3, 0.3), "sensing_chance": 1.0, "sensing_groups": 2}
        teams = make_environments(config(tmp_path, **drawn), 0)
        seen, _ = teams.reset(seed=list(range(8)))
        assert not seen.any()
        teams.step(np.full((8, 4), 3))
        assert not any(group.controller.choices.any() for group in teams.groups)


@pytest.mark.slow
def test_interrupted_training_resumes_bitwise(tmp_path):
    """With memory, a global critic and a curriculum: groups and their sensors are state."""
    more = {"total_steps": 6 * UPDATE, "eval_every": 0, "guarantee": "tank", "curriculum": (1, 3)}
    more |= {"memory": "recurrent", "memory_units": 4, "critic": "global"}
    run = assert_goes_on(tmp_path, 5, **DRAWN, **more)
    state = checkpoints.read(checkpoints.find(run), trainer.STATE_FILES)[1]["state"]
    assert state["robots/teams/generations"].tolist() == [2, 2, 3]
    assert ppo.run(config(tmp_path / "exact", **more | {"total_steps": UPDATE})).status == 0
    first = [folder / "metrics.csv" for folder in (tmp_path / "exact", run)]
    assert first[0].read_text().splitlines()[1] != first[1].read_text().splitlines()[1]
