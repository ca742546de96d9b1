"""Policies from trained networks: actions, supported scenarios, errors."""

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode
from inference_network import make_network, stirred

import baselines
from baselines import policy as registry
from baselines.learned import checkpoints, learned_policy, shipped
from baselines.learned.learned_policy import LearnedPolicy, load
from baselines.learned.policy_settings import PolicySettings
from baselines.learned.training_environment import FeatureVectorEnv
from rendezvous_env import Scenario, Simulator, make_vec
from rendezvous_env.scenario import scenarios
from train import policies
from train.learn import checkpoint

SETTINGS = PolicySettings(
    8, (16,), clearance=0.1, persistence=0.5, min_alignment=0.1, max_turn_rate=3.0,
    decision_time=0.05,
)  # fmt: skip
TANK = {"guarantee": "tank", "budget": 2.0, "memory": "features"}
HEAVY = Scenario(robot_model="double_integrator")
CLUTTER = scenarios.get("clutter-12").replace(time_limit=10.0)


@pytest.mark.parametrize("margin", [1e-9, 1.0])
def test_settings_have_valid_min_alignment(margin):
    with pytest.raises(ValueError, match=r"min_alignment is .* at least 1e-06 and less than 1"):
        replace(SETTINGS, min_alignment=margin)


def network(trained=True, **changes):
    torch.manual_seed(5)
    settings = replace(SETTINGS, **changes)
    sizes = {"set_width": settings.set_width, "hidden": settings.hidden}
    made = make_network(settings.layout(3, 12), len(settings.angles), **sizes)
    return stirred(made) if trained else made


def learned(scenario=CLUTTER, **changes):
    return LearnedPolicy(scenario, weights(network(**changes)), replace(SETTINGS, **changes))


def weights(made):
    return {name: value.detach().numpy() for name, value in made.state_dict().items()}


def write(folder):
    """Folder of a checkpoint of a trained network."""
    tables = {"network": weights(network())}
    return checkpoint.write(folder, 3, {"policy": SETTINGS.to_plain()}, tables)


def episode(scenario, teams=6, seed=2, steps=150):
    """Observations (B, n, rows, d) of an episode of the merged-interval rule, until one ends."""
    simulator = Simulator(scenario, teams)
    observations, law = simulator.reset(seed), baselines.make("tangent-merged", scenario)
    for _ in range(steps):
        yield observations
        observations = simulator.step(law(observations, 0.0)).observations


class TestActions:
    def test_choice_zero_equals_tuned_rule(self):
        """Differences arise from the order of summation only."""
        made = network(trained=False)
        with torch.no_grad():
            made.action_net.bias[0] = 10.0
        ours = LearnedPolicy(CLUTTER, weights(made), SETTINGS)
        rule = baselines.make("tangent-merged-tuned", CLUTTER, clearance=0.1, persistence=0.5,
                              min_alignment=0.1, max_turn_rate=3.0)  # fmt: skip
        turned = 0
        for observations in episode(CLUTTER):
            actions = ours(observations, 0.0)
            np.testing.assert_allclose(actions, rule(observations, 0.0), atol=2e-4)
            f = CLUTTER.observation_layout.net_bearing(observations)
            across = f[..., 0] * actions[..., 1] - f[..., 1] * actions[..., 0]
            turned += (np.abs(across) > 0.1).sum()
        assert turned > 100

    @pytest.mark.parametrize("period", [1, 4])
    @pytest.mark.parametrize("changes", [{}, TANK], ids=["heading", "tank"])
    def test_policy_equals_training_environment(self, period, changes):
        """Equal for the network's choices; bitwise with a tank."""
        venv = make_vec(CLUTTER, 6, autoreset_mode=AutoresetMode.SAME_STEP)
        policy = learned(decision_time=0.05 * period, **changes)
        teams = FeatureVectorEnv(venv, policy.settings)
        chosen = network(**changes)
        shown, _ = teams.reset(seed=2)
        simulator = Simulator(CLUTTER, 6)
        observations = simulator.reset(2)
        for _ in range(120 // period):
            seen = torch.as_tensor(shown.reshape(-1, shown.shape[-1]))
            choices = chosen.get_distribution(seen).mode().numpy().reshape(6, -1)
            choices[~shown.any(axis=-1)] = 0
            shown, _, ends, cuts, _ = teams.step(choices)
            assert not (ends | cuts).any()
            for _ in range(period):
                observations = simulator.step(policy(observations, 0.0)).observations
            tolerance = 0.0 if changes else 1e-5  # a heading's speed is limited afterwards
            np.testing.assert_allclose(teams._observed, observations, rtol=0.0, atol=tolerance)
        if changes:
            np.testing.assert_array_equal(teams.controller.steering.levels, policy.levels)
            assert (teams.controller.steering.levels != 1.2).any()

    def test_environments_decide_at_their_own_times(self):
        together = learned(decision_time=0.2)
        alone = [learned(decision_time=0.2) for _ in range(6)]
        starts = np.array([0, 1, 1, 3, 6, 7])
        for step, observations in enumerate(episode(CLUTTER, steps=40)):
            if (begins := starts == step).any():
                together.reset(begins)
            actions = together(observations, 0.0)
            for team in np.flatnonzero(starts <= step):
                own = alone[team](observations[team], 0.0)
                np.testing.assert_allclose(actions[team], own, atol=1e-6)

    def test_tank_policy_promises_no_margin(self):
        """The budget is in units of r D̄, so features of a full tank do not depend on n."""
        for name, unit in (("clutter-12", 0.2 * 3), ("clutter-16-team-8", 0.2 * 7)):
            scenario = scenarios.get(name)
            policy, away = learned(scenario, decision_time=0.2, **TANK), 0
            assert policy.levels is None and policy.min_alignment is None
            policy(np.zeros((2, *Simulator(scenario, 1).reset(0).shape[1:])), 0.0)
            np.testing.assert_allclose(policy.levels, np.full((2, scenario.n_robots), 2 * unit))
            for observations in episode(scenario, steps=60):
                actions = policy(observations, 0.0)
                f = scenario.observation_layout.net_bearing(observations)
                away += (np.sum(f * actions, axis=-1) < -0.1).sum()
            assert away > 20 and (policy.levels >= 0.0).all()


class TestFiles:
    def test_saved_policy_acts_the_same_without_pickle(self, tmp_path, monkeypatch):
        place = write(tmp_path)
        for name in ("load", "loads", "Unpickler"):
            monkeypatch.setattr(pickle, name, None)
        monkeypatch.setattr(torch, "load", None)
        for path in (tmp_path, place):
            loaded, own = learned_policy.load(path, CLUTTER), learned()
            assert loaded.settings == SETTINGS
            for observations in episode(CLUTTER, steps=20):
                actions = loaded(observations, 0.0)
                np.testing.assert_array_equal(actions, own(observations, 0.0))
            assert own.levels is None  # no tank

    @pytest.mark.parametrize(
        ("changes", "message"),
        [
            ({"guarantee": "hope"}, "guarantee is 'hope'; it must be one of"),
            ({"budget": -1.0}, "budget is -1.0"),
            ({"guarantee": "tank"}, "size mismatch"),
            ({"perception": 99}, "perception is 99; this version has"),
            ({"colour": "blue"}, "field 'colour' is missing or unknown"),
            ({"hidden": None}, "is not a policy of this version"),
            ({}, r"action_net\.bias must be finite"),
        ],
    )
    def test_checkpoint_of_other_policy_is_rejected(self, tmp_path, changes, message):
        place = write(tmp_path)
        about, tables = checkpoints.read(place, ["network"])
        if not changes:
            tables["network"]["action_net.bias"][0] = np.nan
        checkpoint.write_folder(place, {"policy": {**about["policy"], **changes}}, tables)
        with pytest.raises(checkpoints.CheckpointError, match=message):
            learned_policy.load(tmp_path, CLUTTER)


def test_command_loads_policy_by_path(tmp_path):
    write(tmp_path)
    name = f"learned:{tmp_path}"
    policies.check_names([name, "bearing-only"])
    assert policies.fitting(CLUTTER, [name]) == [name]
    assert policies.fitting(HEAVY, [name, "random"]) == ["random"]
    made = policies.make(name, CLUTTER)
    assert policies.promised_margin(name, made) == 0.1


LEARNED = shipped.folder("learned")


class TestNames:
    """Any name of its folder selects a learned policy, and any scenario its robots."""

    @pytest.mark.parametrize("made", [str, Path])
    @pytest.mark.parametrize("scenario", ["clutter-8", scenarios.get("clutter-8")])
    def test_load_takes_text_and_names(self, made, scenario):
        found = load(made(LEARNED), scenario)
        assert found.scenario == scenarios.get("clutter-8")

    @pytest.mark.parametrize("name", [f"learned:{shipped.folder('learned')}", LEARNED])
    def test_make_and_robot_policy_take_the_name_that_commands_take(self, name):
        assert isinstance(baselines.make(name, "clutter-8"), LearnedPolicy)
        robot = baselines.RobotPolicy("clutter-8", name)
        same = baselines.RobotPolicy("clutter-8", "learned")
        seen = [[1.0, 0.0], [0.0, 1.0]]
        np.testing.assert_array_equal(robot.act(seen), same.act(seen))
        assert registry.kind_of(f"learned:{name}") == "learned"

    @pytest.mark.parametrize(
        ("name", "options", "message"),
        [
            ("learned:/nowhere", {}, "/nowhere: no such folder; give the folder of a run"),
            (str(LEARNED), {}, "is unknown; a path is written learned:/"),
            ("mine:make", {}, r"is unknown \(commands read MODULE:FUNCTION; .* call mine\.make"),
            (LEARNED, {"clearance": 1.0}, "has no option 'clearance'"),
        ],
    )
    def test_a_name_that_cannot_be_is_refused_with_a_remedy(self, name, options, message):
        with pytest.raises(ValueError, match=message):
            baselines.make(name, "clutter-8", **options)

    def test_what_is_no_path_is_refused(self):
        with pytest.raises(ValueError, match="path is 5; it must be the path of a run"):
            load(5, "clutter-8")

    def test_files_of_a_policy_are_read_by_their_text(self):
        place = str(LEARNED)
        assert checkpoints.find(place) == Path(place)
        assert checkpoints.read(place, ["network"])[0] == checkpoints.describe(place)

    def test_a_learned_policy_takes_the_name_of_a_scenario(self):
        about, tables = checkpoints.read(LEARNED, ["network"])
        settings = PolicySettings.from_plain(about["policy"])
        made = LearnedPolicy("clutter-8", tables["network"], settings)
        assert made.scenario.name == "clutter-8"
