"""``rendezvous export``: equality of file and policy for any number of rows."""

import json
import pickle
import sys
from functools import partial
from types import SimpleNamespace

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from inference_network import make_network, stirred
from parameters import first_fast, needed, slow
from stable_baselines3 import PPO, SAC

import baselines
import rendezvous_env as rv
from baselines import RobotPolicy
from baselines.learned import checkpoints, shipped
from baselines.learned.learned_policy import load
from baselines.learned.numpy_actor import NumpyActor
from baselines.learned.onnx_network import DIGEST_KEY, SETTINGS_KEY, OnnxNetwork, digest_of
from baselines.learned.policy_settings import PolicySettings
from rendezvous_env.adapters.sb3 import RobotVecEnv
from rendezvous_env.vector import training_env
from train import cli, export, policies, standalone, trained_onnx
from train.compare import playing
from train.compare.settings import Config, Job
from train.learn.recurrent import RecurrentNetwork

CLUTTER = rv.scenarios.get("clutter-12")
WIDTHS = {"set_width": 8, "hidden": (16,)}
RECURRENT = PolicySettings(
    **WIDTHS, clearance=0.1, persistence=0.5, min_alignment=0.1, max_turn_rate=3.0,
    decision_time=0.2, guarantee="tank", memory="recurrent", memory_units=5,
)  # fmt: skip


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """The shipped policies as files."""
    folder = tmp_path_factory.mktemp("exported")
    for name in shipped.NAMES:
        words = ["export", "--policy", name, "--out", str(folder / f"{name}.onnx")]
        assert cli.main([*words, "--checks", "2000"]) == 0
    return folder


def shipped_network(name):
    about, tables = checkpoints.read(shipped.folder(name), ["network"])
    return tables["network"], PolicySettings.from_plain(about["policy"])


BEFORE_DIGEST = DIGEST_KEY.encode() + b'\x12\x42"'


def signed(content):
    """A file with a valid digest and arbitrary content."""
    before, found, after = content.partition(BEFORE_DIGEST)
    blank = before + BEFORE_DIGEST + (after if found else b"0" * 64 + b'"')
    end = len(before + BEFORE_DIGEST)
    return blank[:end] + digest_of(blank).encode() + blank[end + 64 :]


def refused(path, content, message):
    """A robot rejects the current content of a file."""
    path.write_bytes(content)
    with pytest.raises(checkpoints.CheckpointError, match=message):
        RobotPolicy(CLUTTER, path)


class TestNetwork:
    @pytest.mark.parametrize("name", first_fast(shipped.NAMES))
    def test_onnx_runtime_matches_network_choices(self, exported, name):
        """Without code of this project: inputs by name, and an argmax."""
        session = onnxruntime.InferenceSession(exported / f"{name}.onnx")
        weights, settings = shipped_network(name)
        random, choices = np.random.default_rng(1), set()
        for robots, slots in ((1, (3, 12)), (7999, (3, 12)), (1500, (31, 24)), (500, (1, 0))):
            layout = settings.layout(*slots)
            shown = export.drawn_tables(layout, robots, random)
            wanted = NumpyActor(weights, settings, layout).preferences(shown)
            (found,) = session.run(["preferences"], layout.split(shown)._asdict())
            np.testing.assert_allclose(found, wanted, atol=2e-5 * np.abs(wanted).max())
            best = np.sort(wanted, axis=-1)
            sure = best[:, -1] - best[:, -2] > 1e-3
            assert (found.argmax(-1) == wanted.argmax(-1))[sure].all() and sure.mean() > 0.9
            choices |= set(wanted.argmax(-1).tolist())
        assert len(choices) > 4

    def test_recurrent_state_passes_through_onnx(self, tmp_path):
        path, layout = tmp_path / "recurrent.onnx", RECURRENT.layout(3, 12)
        own, choices = {"units": RECURRENT.units}, len(RECURRENT.angles)
        made = stirred(make_network(layout, choices, RecurrentNetwork, own, **WIDTHS))
        weights = {name: array.numpy() for name, array in made.state_dict().items()}
        random = np.random.default_rng(3)
        onnx.save(export.model_of(weights, RECURRENT), path)
        networks = NumpyActor(weights, RECURRENT, layout), OnnxNetwork(path)
        networks[1].layout = layout
        hidden = np.zeros((2, 50, RECURRENT.units), dtype=np.float32)
        for _ in range(5):
            shown = export.drawn_tables(layout, 50, random)
            pairs = zip(networks, hidden, strict=True)
            wanted, found = (network.preferences(shown, own) for network, own in pairs)
            np.testing.assert_allclose(found, wanted, rtol=1e-4, atol=1e-4)
            np.testing.assert_allclose(hidden[1], hidden[0], atol=1e-5)
        assert np.abs(hidden[0]).max() > 0.3

    def test_onnx_metadata_describes_network(self, exported):
        found = onnx.load(exported / "learned-tank.onnx")
        about = {entry.key: json.loads(entry.value) for entry in found.metadata_props}
        _, settings = shipped_network("learned-tank")
        assert PolicySettings.from_plain(about[SETTINGS_KEY]) == settings
        assert about["angles"] == settings.angles.tolist()


class TestPolicy:
    @pytest.mark.parametrize(
        ("name", "field"),
        [("learned", "clutter-12"), ("learned-tank", "clutter-12"),
         slow("learned-tank", "clutter-3d-32"), needed("learned-tank", "uav-clutter-16")],
    )  # fmt: skip
    def test_exported_policy_moves_as_original(self, name, field, tmp_path):
        """The file contains only the network, without planes, features and tanks."""
        path, scenario = tmp_path / "x.onnx", rv.scenarios.get(field).replace(time_limit=8.0)
        words = ["export", "--policy", name, "--out", str(path), "--checks", "100"]
        assert cli.main([*words, "--scenario", field]) == 0
        own, other = (
            rv.rollout(scenario, policies.make(one, scenario), seed=4, num_envs=3).positions
            for one in (name, f"learned:{path}")
        )
        np.testing.assert_allclose(other, own, atol=1e-4)
        assert np.ptp(own, axis=0).max() > 1.0
        robot, same = RobotPolicy(scenario, path), RobotPolicy(scenario, name)
        for *seen, told in standalone.drawn_ticks(scenario, 40):
            np.testing.assert_allclose(robot.act(*seen, **told), same.act(*seen, **told), atol=1e-6)

    def test_compare_identifies_exported_file_by_content(self, exported, tmp_path):
        def known(path):
            jobs = [Job(CLUTTER, f"learned:{path}")]
            return list(playing.plan_of(jobs, Config())["weights"].values())

        copy, one = tmp_path / "copy.onnx", known(exported / "learned.onnx")
        copy.write_bytes((exported / "learned.onnx").read_bytes())
        assert known(copy) == one
        copy.write_bytes((exported / "learned-tank.onnx").read_bytes())
        assert known(copy) != one

    def test_exported_policy_resumes_bitwise_from_pickle(self, exported):
        robot, seen = RobotPolicy(CLUTTER, exported / "learned.onnx"), [[0.6, 0.8], [0.8, -0.6]]
        robot.act(seen, [[[0.0, 1.0], [0.6, 0.8]]])
        other = pickle.loads(pickle.dumps(robot))
        for _ in range(20):
            np.testing.assert_array_equal(robot.act(seen), other.act(seen))


class TestErrors:
    def test_export_rejects_exported_file(self, exported, one_line):
        said = one_line("export", "--policy", f"learned:{exported / 'learned.onnx'}")
        assert "learned.onnx: is exported already" in said

    @pytest.mark.parametrize(
        ("words", "message"),
        [
            (["--scenario", "mixed-8", "--robot", "99"], "--robot 99: robot is 99; it must be an"),
            (["--robot", "8"], "--robot 8: robot is 8; it must be an integer"),
            (["--scenario", "mixed-8"], "scenario has a list of robot_model; a RobotPolicy needs"),
            (["--scenario", "double.toml"], "a RobotPolicy steers single"),
        ],
    )
    def test_onnx_export_rejects_robots_without_this_policy(
        self, words, message, one_line, tmp_path, monkeypatch
    ):
        monkeypatch.chdir(tmp_path)
        (tmp_path / "double.toml").write_text('robot_model = "double_integrator"')
        assert message in one_line("export", "--out", "x.onnx", *words)
        assert [path.name for path in tmp_path.iterdir()] == ["double.toml"]

    @pytest.mark.parametrize("robot", [0, 7])
    def test_onnx_file_of_a_robot_of_a_mixed_team_is_that_of_its_model(self, robot, tmp_path):
        """In this team robots 0 to 3 are holonomic, the others unicycles."""
        mixed = rv.scenarios.get("mixed-8")
        paths = tmp_path / "mixed.onnx", tmp_path / "uniform.onnx"
        alone = "unicycle-6" if mixed.of_robot(robot).model.nonholonomic else "clutter-8"
        for path, words in zip(paths, (["mixed-8", "--robot", str(robot)], [alone]), strict=True):
            words = ["export", "--out", str(path), "--checks", "10", "--scenario", *words]
            assert cli.main(words) == 0
        assert paths[0].read_bytes() == paths[1].read_bytes()

    def test_export_keeps_old_file_if_check_fails(self, monkeypatch, one_line, tmp_path):
        path, made = tmp_path / "policy.onnx", export.model_of
        path.write_bytes(before := f"before, {SETTINGS_KEY}".encode())

        def wrong(weights, settings):
            bias = weights["action_net.bias"] + np.arange(len(settings.angles))
            return made({**weights, "action_net.bias": bias}, settings)

        monkeypatch.setattr(export, "model_of", wrong)
        said = one_line("export", "--out", path, "--checks", "10")
        assert "the file differs from the policy by" in said
        assert path.read_bytes() == before and len(list(tmp_path.iterdir())) == 1

    @pytest.mark.parametrize(("flag", "name"), [("--out", "x.onnx"), ("--standalone", "x.py")])
    def test_export_replaces_only_own_files(self, flag, name, one_line, tmp_path):
        path = tmp_path / name
        path.write_bytes(b"a network of somebody's")
        said = one_line("export", flag, path)
        assert f"{flag} {path}: exists, and was not written by this command" in said
        assert path.read_bytes() == b"a network of somebody's"
        path.unlink()
        for policy in ("learned", "learned-tank"):
            words = ["export", "--policy", policy, flag, str(path), "--checks", "10"]
            assert cli.main(words) == 0
        assert path.stat().st_size > 1000

    def test_damaged_onnx_file_is_rejected(self, exported, tmp_path):
        """Any byte of the file, and each byte of the digest and its key."""
        content, path = (exported / "learned.onnx").read_bytes(), tmp_path / "x.onnx"
        first, random = content.index(BEFORE_DIGEST), np.random.default_rng(1)
        own = range(first - 2, first + len(BEFORE_DIGEST) + 65)
        for k in (*own, *random.integers(0, len(content), 40)):
            damaged = content[:k] + bytes([content[k] ^ 1]) + content[k + 1 :]
            refused(path, damaged, r"x\.onnx: .*digest")
        model = onnx.load(exported / "learned.onnx")
        keys = [entry.key for entry in model.metadata_props]
        del model.metadata_props[keys.index(DIGEST_KEY)]
        refused(path, model.SerializeToString(), r"x\.onnx: has no digest")

    def test_files_that_are_not_policies_are_named(self, exported, tmp_path):
        path = tmp_path / "x.onnx"
        with pytest.raises(checkpoints.CheckpointError, match=r"x\.onnx: cannot be read"):
            load(path, CLUTTER)
        refused(path, signed(b"nothing of the kind"), r"x\.onnx: is not an ONNX model")
        model = onnx.load(exported / "learned.onnx")
        place = [entry.key for entry in model.metadata_props].index(SETTINGS_KEY)
        plain = json.loads(model.metadata_props[place].value)
        model.metadata_props[place].value = json.dumps(plain | {"perception": 1})
        refused(path, signed(model.SerializeToString()), r"x\.onnx: .*perception is 1")
        del model.metadata_props[place]
        missing = r"metadata has no 'rendezvous_policy'"
        refused(path, signed(model.SerializeToString()), missing)

    def test_missing_onnx_runtime_is_named(self, exported, monkeypatch):
        monkeypatch.setitem(sys.modules, "onnxruntime", None)
        with pytest.raises(checkpoints.CheckpointError, match=r"needs onnxruntime: pip .*\[export"):
            load(exported / "learned.onnx", CLUTTER)


SIZE, BARE = 8, {"learning_preset": False, "guarantee": None}


def network_policy(scenario, **arguments):
    """A torch module as a policy, on raw observations."""
    size = training_env(scenario, 1, **arguments).single_observation_space.shape[1]
    torch.manual_seed(0)
    layers = torch.nn.Linear(size, SIZE), torch.nn.Tanh(), torch.nn.Linear(SIZE, 2)
    return baselines.TrainedPolicy(scenario, torch.nn.Sequential(*layers), **arguments)


def bare_network(scenario):
    return network_policy(scenario, **BARE)


def under_headings(scenario):
    return network_policy(scenario, learning_preset=False)


def plain_function(scenario):
    return baselines.TrainedPolicy(scenario, lambda seen: seen[:, :2], **BARE)


class TestModels:
    """A custom model as a self-contained file."""

    @pytest.fixture
    def write(self, tmp_path):
        def written(function):
            path = tmp_path / f"{function}.onnx"
            words = ["--policy", f"{__name__}:{function}", "--scenario", CLUTTER.name]
            assert cli.main(["export", *words, "--out", str(path), "--checks", "600"]) == 0
            return path

        return written

    @pytest.mark.parametrize("made", [bare_network, under_headings])
    def test_a_torch_module_acts_from_its_file_as_in_python(self, write, made):
        path = write(made.__name__)
        own, file = made(CLUTTER), baselines.make(path, CLUTTER)
        simulator = rv.Simulator(CLUTTER, 3)
        seen = simulator.reset(0)
        for _ in range(5):
            one, other = own(seen, simulator.time), file(seen, simulator.time)
            np.testing.assert_allclose(one, other, atol=1e-5)
            seen = simulator.step(one).observations
        assert np.abs(one).max() > 0.01
        robot = RobotPolicy(CLUTTER, path)
        assert np.isfinite(robot.act([[1.0, 0.0]])).all()

    def test_the_runtime_alone_runs_it(self, write):
        session = onnxruntime.InferenceSession(write("bare_network"))
        (given,), (found,) = session.get_inputs(), session.get_outputs()
        assert (given.name, found.name) == ("observation", "action")
        seen = np.ones((5, given.shape[1]), np.float32)
        wanted = bare_network(CLUTTER).choices(seen)
        np.testing.assert_allclose(session.run(None, {"observation": seen})[0], wanted, atol=1e-6)

    @pytest.mark.parametrize(("algorithm", "discrete"), [(PPO, False), (PPO, True), (SAC, False)])
    def test_a_model_of_stable_baselines3_is_exported(self, algorithm, discrete, tmp_path):
        robots = RobotVecEnv(training_env("clutter-8", 2, discrete=discrete))
        policy_of = algorithm("MlpPolicy", robots, seed=0, device="cpu")
        made = baselines.TrainedPolicy("clutter-8", policy_of.predict, discrete=discrete)
        path = tmp_path / "model.onnx"
        path.write_bytes(trained_onnx.content_of(made))
        written = baselines.make(path, "clutter-8")
        assert trained_onnx.compare(made, written, 300) < 1e-4
        assert written.arguments == {"discrete": discrete}

    def test_compare_returns_nan_for_a_file_that_returns_nan(self):
        made, written = (
            SimpleNamespace(observation_shape=(3,), choices=partial(np.full_like, fill_value=value))
            for value in (0.0, np.nan)
        )
        assert np.isnan(trained_onnx.compare(made, written, 5))

    def test_a_file_is_refused_once_it_has_changed_or_where_it_does_not_fit(self, write):
        path = write("bare_network")
        with pytest.raises(
            ValueError, match="onnx was trained for observations of shape"
        ) as caught:
            baselines.make(path, rv.Scenario(n_robots=3, name="small"))
        assert "in 'small' it gets (4,), with neighbour_slots = 2" in str(caught.value)
        content = bytearray(path.read_bytes())
        content[len(content) // 2] ^= 1
        path.write_bytes(content)
        with pytest.raises(checkpoints.CheckpointError, match="its content was changed"):
            baselines.make(path, CLUTTER)

    def test_what_is_no_model_is_refused_with_a_remedy(self, one_line, tmp_path):
        words = ["export", "--out", tmp_path / "x.onnx", "--policy"]
        said = one_line(*words, f"{__name__}:plain_function")
        assert "the model is a function; an ONNX file is made of a model of stable-bas" in said
        assert "--standalone robot.py" in one_line(*words, "bearing-only")
