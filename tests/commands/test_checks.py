"""Validation of command settings: invalid values are rejected without side effects."""

import dataclasses
import math
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from baselines.learned.plain_data import check_types
from train import cli
from train.checks import UserError
from train.compare import compare
from train.learn import ppo

MODULES = {name: import_module(f"train.{module}") for name, (module, _) in cli.COMMANDS.items()}
FLOATS = [
    (name, field.name, "tuple" in str(field.type))
    for name, module in MODULES.items()
    for field in dataclasses.fields(module.Config)
    if "float" in str(field.type)
]


@pytest.mark.parametrize("value", ["nan", "inf", "-inf"])
@pytest.mark.parametrize(("command", "field", "pair"), FLOATS)
def test_numbers_must_be_finite(command, field, pair, value, one_line, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    flag = "--" + field.replace("_", "-")
    words = ["fit", "log"] if command == "sensor" else []
    words += [flag, "0", value] if pair else [f"{flag}={value}"]
    assert f"{flag} is {value}; it must be" in one_line(command, *words)
    assert list(tmp_path.iterdir()) == []


def test_numeric_flags_are_covered_for_every_command():
    assert {name for name, *_ in FLOATS} == {"train", "verify", "render", "bench", "sensor"}
    assert len(FLOATS) >= 18


PATHS = {
    "compare": "--out", "train": "--out", "render": "--out", "reproduce": "--out",
    "verify": "--out", "bench": "--json", "report": "",
}  # fmt: skip


@pytest.mark.parametrize("command", PATHS)
@pytest.mark.parametrize(
    ("name", "message"),
    [("a" * 300, "has 300 bytes; a name may have 255"), ("a\0b", "NUL"), ("a\udcff", "UTF-8")],
)
def test_invalid_file_names_are_rejected(command, name, message, one_line, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    words = [command, *(["fig3"] if command == "reproduce" else []), PATHS[command], name]
    assert message in one_line(*filter(None, words))
    assert list(tmp_path.iterdir()) == []


MISTAKES = {
    "compare --scenarios fig5": "did you mean 'fig4'",
    "compare --scenarios no-such.toml": "no-such.toml",
    "compare --scenarios": "is empty",
    "compare --scenarios duo duo": "two scenarios",
    "compare --policies zero random zero": "policy 'zero' is named twice; name each once",
    "compare --policies bearing-onyl": "did you mean 'bearing-only'",
    "compare --scenarios duo --policies unicycle": "none of the named policies fits duo",
    "compare --episodes 0": "--episodes is 0",
    f"compare --seed {2**63}": "too large",
    "compare --oracle-runs -1": "--oracle-runs is -1",
    "compare --scenario duo --set n_robots": "--set n_robots: write FIELD=VALUE",
    "compare --scenario duo --set n_robots=3 n_robots=4": "n_robots is named twice",
    "compare --scenario duo --set robots=9": "--set robots=9: scenario has no field 'robots'; did",
    f"compare --scenario duo --set name={'ε' * 101}": "has 202 bytes; names of figures take 200",
    "compare --scenario duo --set n_robots=0": "--set n_robots=0: n_robots",
    f"compare --scenarios {'a' * 300}.toml": "it is too long for a path",
    f"compare --policies learned:{'a' * 300}": "File name too long",
    f"compare --out {'a' * 253}": "File name too long",
    "compare --scenarios duo --out /dev/null/out": "cannot write there",
    "compare --scenarios duo --set n_robots=30 spawn_size=0.5": "no room for initial positions",
    "compare --jobs 0": "--jobs is 0; it must be 1 or more",
    "compare --address auto": "--address is auto; only --backend ray has one",
    "compare --scenario fig4 --against tangent-mergd": "did you mean 'tangent-merged'",
    "compare --scenario fig4 --against unicycle": "--against 'unicycle' is not compared",
    "compare --scenario fig4 --json out/compare/x.json": "is in OUT or OUT.part",
    "compare --scenario fig4 --json out/compare.part/x.json": "is in OUT or OUT.part",
    "compare --scenario fig4 --json .": "is a folder",
    "compare --scenario duo --sensing noice=0,1": "is unknown; did you mean 'noise'",
    "compare --scenario duo --sensing noise": "name two or more levels, as in noise=0,0.1",
    "compare --scenario duo --sensing noise=0,1 noise=0,2": "noise is named twice",
    "compare --scenario duo --sensing noise=0.10001,0.10002": "two scenarios have the name 'duo-no",
    "compare --scenario duo --sensing noise=0,-1": "--sensing noise=-1: sensing.noise is -1",
    "train --num-threads 0": "--num-threads is 0; it must be 1 or more",
    f"train --clearance {math.pi}": f"it must be less than {math.pi}",
    "train --persistence -1": "--persistence is -1.0; it must be 0 or more",
    "train --num-envs 10000000000": "it must be 2147483648 or less",
    "train --device abacus": "--device is 'abacus'",
    "train --seeds 1 1": "--seeds 1 1: name each once",
    "train --seeds 0 3 --seed 2": "--seed is 2; --seeds determines the runs",
    "train --seeds 0 -1": "--seed is -1",
    "train --set robot_model=double_integrator": "training_env(scenario, guarantee=None)",
    "train --scenario clutter-3d --critic global": "the global state supports",
    "train --scenario fig4 --curriculum 3": "fig4 samples no obstacles",
    "train --gamma 1.5": "--gamma is 1.5; it must be 1 or less",
    f"train --seed {2**29}": "it must be 536870911 or less",
    "train --budget 3": "--budget is 3.0; headings have none: add --guarantee tank",
    "train --memory features": "--memory is features; headings have none: add --guarantee",
    "train --memory-units 9": "--memory-units is 9; there are none without --memory",
    "train --guarantee tank --budget -1": "--budget is -1.0; it must be 0 or more",
    "train --start-from nowhere": "nowhere: no such folder",
    "train --sensing-noise -0.1 0.2": "sensing.noise is -0.1; it must be a finite",
    "train --sensing-noise 0.2 0.1": "sensing.noise is from 0.2 to 0.1; it must be LOW",
    "train --sensing-occlusion fog": "sensing.occlusion is 'fog'; it must be one of",
    "train --sensing-noise 0 1 --sensing-chance 2": "chance is 2.0; it must be",
    "train --sensing-noise 0 1 --num-envs 8 --sensing-groups 9": "it must be 8 or less",
    "train --sensing-updates 3": "--sensing-updates is 3; no sensors are sampled",
    f"verify --trials {10**12}": "it must be 100000000 or less",
    "verify --only-batch -2": "--only-batch is -2",
    "verify --min-alignment 1": "--min-alignment is 1.0; it must be less than 1",
    "verify --any --only-batch 3": (
        "--only-batch is 3; --random-scenarios checks no claims: omit it"
    ),
    "verify --any --claims lemma-1 bound-A": (
        "--claims is lemma-1 bound-A; --random-scenarios checks no claims"
    ),
    "verify --kinds 3": "--kinds is 3; add --random-scenarios",
    "verify --claims bound-D": "claim 'bound-D' is unknown; did you mean 'bound-",
    "bench --only btached": "btached",
    "bench --json /dev/null/bench.json": "--json /dev/null/bench.json: cannot write there",
    "bench --json .": "is a folder; name a file",
    "bench --robots 3 1": "--robots is 1; it must be 2 or more",
    "bench --seconds 0": "--seconds is 0.0; it must be more than 0",
    f"reproduce fig3 --seed {2**63}": "it must be 9223372036854775807 or less",
    "reproduce fig3 --page page.md": "--page is page.md; fig3 has no table",
    "reproduce fig3 --policy unicycle": "does not fit",
    "export --policy tangent": "--policy tangent: is scripted and has no network",
    "export --policy learnt": "policy 'learnt' is unknown; did you mean 'learned'?",
    "export --policy learned:nowhere": "nowhere: no such folder",
    "export --out policy.pt": "--out policy.pt: unknown ending; it must be .onnx",
    "render --out a.avi": "unknown ending '.avi'; known are .gif, .mp4, .png, .pdf",
    "render --scenario uav-6 --policy tangent-merged": "does not fit nonholonomic_3d",
    "render --fps 0": "--fps is 0; it must be 1 or more",
    "render --size 10": "--size is 10; it must be 120 or more",
    "render --speed 0": "--speed is 0.0; it must be 0.001 or more",
    "warmup --scenarios duoo": "scenario 'duoo' is unknown; did you mean 'duo'?",
}


@pytest.mark.parametrize("words", MISTAKES)
def test_mistakes_are_one_line_and_change_nothing(words, one_line, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert MISTAKES[words] in one_line(*words.split())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("words", "missing", "extra"),
    [
        ("train", "stable_baselines3", "train"),
        ("export", "onnx", "export"),
        ("export", "onnxruntime", "export"),
        ("compare --backend ray", "ray", "ray"),
        ("render --out a.mp4", "imageio_ffmpeg", "render"),
        ("render --out a.gif", "PIL", "render"),
        ("render --out a.gif", "pygame", "render"),
    ],
)
def test_missing_packages_are_named(words, missing, extra, one_line, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, missing, None)
    assert f" needs {missing}; pip install 'rendezvous-env[{extra}]'" in one_line(*words.split())
    assert list(tmp_path.iterdir()) == []


def test_plain_data_types_are_validated():
    check_types({"a": [1, 2], "b": 3}, {"a": list[int], "b": float})
    with pytest.raises(ValueError, match=r"a is \[1, '2'\]; it must be of type list\[int\]"):
        check_types({"a": [1, "2"]}, {"a": list[int]})
    with pytest.raises(ValueError, match="a is True; it must be of type"):
        check_types({"a": True}, {"a": int | None})


def test_strings_and_lists_convert_to_paths_and_tuples():
    made = compare.Config(out="a/b", json="c.json", scenarios=["duo"])
    assert made == compare.Config(out=Path("a/b"), json=Path("c.json"), scenarios=("duo",))
    made = ppo.Config(out="a", resume="b", start_from=None, curriculum=[1, 2])
    assert made == ppo.Config(out=Path("a"), resume=Path("b"), curriculum=(1, 2))


@pytest.mark.parametrize(
    ("command", "settings", "message"),
    [
        (compare, {"on": "nope"}, "on is 'nope'; it must be of type"),
        (compare, {"ceiling": 1.5}, "ceiling is 1.5; it must be of type int"),
        (compare, {"episodes": np.int64(2)}, "episodes is .*2.*; it must be of"),
        (compare, {"out": 5}, "out is 5; it must be of type Path"),
        (ppo, {"out": "a", "resume": 7}, "resume is 7; it must be of type"),
        (ppo, {"hidden": (64, "64")}, r"hidden is \(64, '64'\); it must be of type"),
    ],
)
def test_config_in_python_is_validated(command, settings, message):
    with pytest.raises(UserError, match=message):
        command.Config(**settings)
