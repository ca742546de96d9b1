"""Former names of arguments and attributes."""

import copy
import pickle

import pytest

import baselines
import rendezvous_env as rv
from baselines import observation_builder, policy, robot_sight
from rendezvous_env.deprecation import RenamedKeys, renamed_arguments, renamed_attribute
from rendezvous_env.envs import training
from train import compare
from train.leaderboard import command
from train.learn.settings import Config

NUM_ENVS = pytest.warns(DeprecationWarning, match="num_teams is called num_envs now")
PENALTY = pytest.warns(DeprecationWarning, match="touch_penalty is called contact_penalty now")


class Wheel:
    radius = 0.1
    size = renamed_attribute("size", "radius")

    @renamed_arguments(size="radius")
    def __init__(self, radius: float = 0.1) -> None:
        self.radius = radius


def test_renamed_argument_is_passed_with_a_warning():
    with pytest.warns(DeprecationWarning, match="^size is called radius now$") as warned:
        assert Wheel(size=0.3).radius == 0.3
    assert warned[0].filename == __file__


def test_renamed_argument_is_refused_beside_its_new_name():
    with pytest.raises(TypeError, match="size is the former name of radius; give one of them"):
        Wheel(radius=0.1, size=0.2)


def test_renamed_attribute_reads_the_new_one():
    with pytest.warns(DeprecationWarning, match="^Wheel.size is called radius now$") as warned:
        assert Wheel(0.5).size == 0.5
    assert warned[0].filename == __file__


def test_renamed_keys_read_the_new_ones():
    row = RenamedKeys({"radius": 0.2}, {"size": "radius", "age": "years"})
    for read in (
        lambda: row["size"],
        lambda: row.get("size"),
        lambda: row.copy()["size"],
        lambda: copy.deepcopy(row)["size"],
        lambda: pickle.loads(pickle.dumps(row))["size"],
        lambda: (row | {"other": 1})["size"],
        lambda: ({"other": 1} | row)["size"],
        lambda: ("size" in row) * 0.2,
        lambda: row.setdefault("size", 9),
        lambda: row.copy().pop("size", None),
    ):
        with pytest.warns(DeprecationWarning, match="^'size' is called 'radius' now$") as warned:
            assert read() == 0.2
        assert warned[0].filename == __file__
    assert row.get("age", 3) == 3 and row.get("other") is None and row == {"radius": 0.2}
    assert (
        "age" not in row and row.copy().pop("age", 3) == 3 and row.copy().setdefault("age") is None
    )
    for use in (lambda: row["other"], lambda: row["age"], lambda: row.pop("age")):
        with pytest.raises(KeyError, match=r"other|age"):
            use()
    with pytest.warns(DeprecationWarning, match="^'size' is called 'radius' now$") as warned:
        del row["size"]
    assert not row and warned[0].filename == __file__


def test_unions_of_renamed_keys_prefer_the_right_operand():
    row = RenamedKeys({"radius": 0.2}, {"size": "radius"})
    assert row | {"radius": 1} == {"radius": 1} and {"radius": 1} | row == {"radius": 0.2}
    with pytest.raises(TypeError):
        _ = row | 3


def test_training_env_accepts_touch_penalty():
    with PENALTY:
        envs = rv.vector.training_env("duo", 2, touch_penalty=0.25, learning_preset=False)
    assert envs.contact_penalty == 0.25
    with pytest.warns(DeprecationWarning, match="TrainingVectorEnv.touch_penalty is called"):
        assert envs.touch_penalty == 0.25
    with PENALTY:
        assert rv.training_env("duo", touch_penalty=0.25).vector_env.contact_penalty == 0.25


def test_make_robots_accepts_num_teams():
    make_robots = pytest.importorskip("rendezvous_env.adapters.sb3").make_robots
    with NUM_ENVS:
        assert make_robots("duo", num_teams=3).num_envs == 6


def test_config_accepts_former_names_in_calls_and_in_stored_runs():
    with NUM_ENVS, PENALTY:
        config = Config(num_teams=7, touch_penalty=0.5)
    assert config == Config(num_envs=7, contact_penalty=0.5)
    stored = config.to_plain()
    stored["num_teams"] = stored.pop("num_envs")
    stored["touch_penalty"] = stored.pop("contact_penalty")
    assert Config.from_plain(stored) == config
    with pytest.warns(DeprecationWarning, match="eval_starts is called eval_episodes now"):
        config = Config(eval_starts=7)
    assert config == Config(eval_episodes=7)
    stored = config.to_plain()
    stored["eval_starts"] = stored.pop("eval_episodes")
    assert Config.from_plain(stored) == config


def test_leaderboard_accepts_starts():
    with pytest.warns(DeprecationWarning, match="starts is called episodes now"):
        assert command.Config(starts=7) == command.Config(episodes=7)


def test_former_name_of_observation_batch_warns():
    with pytest.warns(DeprecationWarning, match="rv.Seen is called rv.ObservationBatch now"):
        assert rv.Seen is rv.ObservationBatch
    with pytest.raises(AttributeError, match="has no attribute 'Nothing'"):
        _ = rv.Nothing


def test_former_names_of_classes_warn_and_load_from_pickles():
    with pytest.warns(DeprecationWarning, match="^TrainingTeams is called TrainingVectorEnv now$"):
        assert training.TrainingTeams is training.TrainingVectorEnv
    stored = b"crendezvous_env.envs.training\nTrainingTeams\n."
    with pytest.warns(DeprecationWarning, match="TrainingVectorEnv"):
        assert pickle.loads(stored) is training.TrainingVectorEnv
    with pytest.warns(DeprecationWarning, match="baselines.observation_builder.ObservationBuilder"):
        assert robot_sight.RobotSight is observation_builder.ObservationBuilder
    with pytest.warns(DeprecationWarning, match="baselines.observation_builder.min_cost_slots"):
        assert robot_sight.min_cost_slots is observation_builder.min_cost_slots
    for module in (training, robot_sight):
        with pytest.raises(AttributeError, match="has no attribute 'Nothing'"):
            _ = module.Nothing


def test_former_names_of_vector_environments_warn():
    env, given = rv.training_env("duo"), pytest.warns(DeprecationWarning, match="^teams is called")
    with pytest.warns(DeprecationWarning, match="TrainingParallelEnv.teams is called vector_env"):
        assert env.teams is env.vector_env
    with pytest.warns(DeprecationWarning, match="TrainingVectorEnv.teams is called unwrapped"):
        assert env.vector_env.teams is env.vector_env.unwrapped
    with given:
        assert type(env)(teams=env.vector_env).vector_env is env.vector_env
    slots_of = pytest.importorskip("rendezvous_env.adapters.slots").RobotSlots
    with given:
        slots = slots_of(teams=rv.vector.training_env("duo", 3))
    with pytest.warns(DeprecationWarning, match="RobotSlots.num_teams is called batch_size"):
        assert slots.num_teams == slots.batch_size == 3
    with pytest.warns(DeprecationWarning, match="RobotSlots.teams is called vector_env"):
        assert slots.teams is slots.vector_env


FORMER_POLICIES = {
    "tangent-joined": "tangent-merged",
    "tangent-joined-certified": "tangent-merged-certified",
    "tangent-joined-tuned": "tangent-merged-tuned",
    "tank-joined": "tank-merged",
}


@pytest.mark.parametrize(("old", "new"), FORMER_POLICIES.items())
def test_former_policy_names_make_the_same_policy(old, new):
    said = f"policy '{old}' is called '{new}' now"
    with pytest.warns(DeprecationWarning, match=f"^{said}$") as warned:
        made = baselines.make(old, "clutter-8")
    assert warned[0].filename == __file__ and type(made) is type(baselines.make(new, "clutter-8"))
    assert old not in baselines.names() and new in baselines.names()
    for read in (policy.kind_of, policy.about, policy.builder_of, policy.on_request):
        assert read(old) == read(new)
    with pytest.warns(DeprecationWarning, match=said):
        config = compare.Config(policies=(f"mine={old}", "learned"), against=old)
    assert config == compare.Config(policies=(f"mine={new}", "learned"), against=new)


def test_user_policy_may_have_a_former_name(monkeypatch):
    monkeypatch.setattr(policy, "_registry", policy._registry.copy())
    with pytest.raises(KeyError):
        policy.about("tangent-joined-own")
    policy.register("tank-joined", lambda scenario: True)(lambda scenario: len)
    assert policy.current_name("tank-joined") == "tank-joined"
    assert baselines.make("tank-joined", "duo") is len


def test_former_name_of_rows_per_obstacle_warns():
    layout = rv.scenarios.get("clutter-8").observation_layout
    with pytest.warns(DeprecationWarning, match="silhouette_points is called rows_per_obstacle"):
        assert layout.silhouette_points == layout.rows_per_obstacle == 2
