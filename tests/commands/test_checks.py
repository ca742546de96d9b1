"""No setting of any command takes what means nothing, and what is refused changes nothing."""

import dataclasses
from importlib import import_module
from pathlib import Path

import pytest

from baselines.learned.plain_data import check_types
from train import cli
from train.checks import UserError, check_fields

MODULES = {name: import_module(f"train.{module}") for name, (module, _) in cli.COMMANDS.items()}
FLOATS = [
    (name, field.name, "tuple" in str(field.type))
    for name, module in MODULES.items()
    for field in dataclasses.fields(module.Config)
    if "float" in str(field.type)
]


def refused(words, capsys):
    """The one line that a command says."""
    assert cli.main(words) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "Traceback" not in said
    return said


@pytest.mark.parametrize("value", ["nan", "inf", "-inf"])
@pytest.mark.parametrize(("command", "field", "pair"), FLOATS)
def test_numbers_are_finite(command, field, pair, value, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    flag = "--" + field.replace("_", "-")
    words = [flag, "0", value] if pair else [f"{flag}={value}"]
    assert f"{flag} is {value}; it must be" in refused([command, *words], capsys)
    assert list(tmp_path.iterdir()) == []


def test_every_command_with_numbers_was_tried():
    assert {name for name, *_ in FLOATS} == {"train", "verify", "render", "bench"}
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
def test_names_that_no_file_can_have(command, name, message, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    words = [command, *(["fig3"] if command == "reproduce" else []), PATHS[command], name]
    assert message in refused([word for word in words if word], capsys)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["compare", "--scenarios", "a" * 300 + ".toml"], "it is too long for a file"),
        (["compare", "--policies", "learned:" + "a" * 300], "File name too long"),
        (["train", "--scenario", "a" * 300 + ".toml"], "it is too long for a file"),
        (["render", "--policy", "learned:" + "a" * 300], "File name too long"),
        (["compare", "--out", "a" * 253], "File name too long"),
    ],
)
def test_long_names_elsewhere(words, message, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert message in refused(words, capsys)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["train", "--num-threads", "0"], "--num-threads is 0; it must be 1 or more"),
        (["train", "--hidden", "8", "0"], "--hidden is 0; it must be 1 or more"),
        (["train", "--clearance", "4"], "--clearance is 4.0; it must be an angle in [0, π) rad"),
        (["train", "--persistence", "-1"], "--persistence is -1.0; it must be 0 or more"),
        (["train", "--set-width", "1000000"], "--set-width is 1000000; it must be 4096 or less"),
        (["train", "--num-teams", "10000000000"], "it must be 2147483648 or less"),
        (["train", "--device", "abacus"], "--device is 'abacus'"),
        (["verify", "--trials", str(10**12)], "it must be 100000000 or less"),
        (["bench", "--repeats", "0"], "--repeats is 0; it must be 1 or more"),
        (["bench", "--robots", "3", "1"], "--robots is 1; it must be 2 or more"),
        (["bench", "--seconds", "0"], "--seconds is 0.0; it must be positive"),
        (["bench", "--num-threads", "0"], "--num-threads is 0; it must be 1 or more"),
        (["reproduce", "fig3", "--seed", str(2**63)], "it must be 9223372036854775807 or less"),
    ],
)
def test_impossible_numbers(words, message, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert message in refused(words, capsys)
    assert list(tmp_path.iterdir()) == []


@dataclasses.dataclass(frozen=True)
class Settings:
    numbers: tuple[float, ...] = ()
    place: Path | None = None


def test_fields_of_any_dataclass():
    check_fields(Settings((1.0, 2.0), Path("x")))
    with pytest.raises(UserError, match="--numbers is nan; it must be a finite number"):
        check_fields(Settings((1.0, float("nan"))))


def test_types_of_plain_data():
    check_types({"a": [1, 2], "b": 3}, {"a": list[int], "b": float})
    with pytest.raises(ValueError, match=r"a is \[1, '2'\]; it must be of type list\[int\]"):
        check_types({"a": [1, "2"]}, {"a": list[int]})
