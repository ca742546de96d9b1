"""Fuzzing of damaged folders and command lines: one-line errors without side effects.

The damage is random but equal in every test run. Some damaged files get valid digests, as if
``compare`` or ``train`` had written them, which tests the checks behind the digests.
"""

import dataclasses
import json
import shutil
import warnings
from collections import defaultdict
from contextlib import suppress
from importlib import import_module
from types import SimpleNamespace

import pytest
from conftest import contents
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from baselines.learned import checkpoints, learned_policy, plain_data
from train import cli, results
from train.compare import compare
from train.learn import ppo

pytestmark = pytest.mark.slow


def tried(count, *strategies):
    """Call a function with a number of random cases."""

    def run(check):
        limits = settings(max_examples=count, suppress_health_check=list(HealthCheck))
        limits(given(*strategies)(check))()

    return run


def lay(folder, files):
    """Fill a folder with exactly these files; returns the folder."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    for name, content in files.items():
        path = folder / name
        if content is None:
            path.mkdir(parents=True, exist_ok=True)
        else:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
    return folder


def said_by(words, folder, capsys):
    """Exit status of a command; a rejection has one line and no side effect."""
    before = contents(folder)
    try:
        status = cli.main([str(word) for word in words])
    except SystemExit as end:  # of the reader of the command line
        assert end.code in (0, 2)
        status = end.code
        capsys.readouterr()
    else:
        said = capsys.readouterr().err
        if status:
            assert status == 2 and said.count("\n") == 1 and said.startswith("rendezvous ")
            assert len(said) < 2000
    assert not status or contents(folder) == before
    return status


BYTES = {
    "cut": lambda content, at, some: content[:at],
    "flip": lambda content, at, some: (
        content[:at] + bytes([content[at] ^ (some[0] or 1)]) + content[at + 1 :]
    ),
    "insert": lambda content, at, some: content[:at] + some + content[at:],
    "overwrite": lambda content, at, some: content[:at] + some + content[at + len(some) :],
    "replace": lambda content, at, some: some,
    "repeat": lambda content, at, some: content + content,
    "nested": lambda content, at, some: b"[" * 100_000,
}
CELLS = ("", "nan", "-inf", "1e999", "4.0", "-1", "1_0", "٣", '"', "\0", "a,b", "9" * 5000, "zero")
WORDS = st.sampled_from(["", "duo", "zero", "results.csv", "../x", "nan", "\ud800", "x" * 300])
PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**20), 10**20) | st.floats() | WORDS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(WORDS, inner, max_size=3),
    max_leaves=5,
)


def places(plain):
    """Positions of replaceable values in plain data: containers and keys."""
    keys = plain if isinstance(plain, dict) else range(len(plain) if isinstance(plain, list) else 0)
    for key in keys:
        yield plain, key
        yield from places(plain[key])


def spoilt(draw, name, content):
    """Wrong content in a valid file format."""
    if name.endswith(".json"):
        plain = json.loads(content)
        place, key = draw(st.sampled_from([*places(plain)]))
        place[key] = draw(PLAIN)
        return json.dumps(plain).encode()
    lines = [line.split(",") for line in content.decode().splitlines()]
    line = draw(st.sampled_from(lines))
    line[draw(st.integers(0, len(line) - 1))] = draw(st.sampled_from(CELLS))
    return "\n".join(map(",".join, lines)).encode() + b"\n"


@st.composite
def damaged(draw, files):
    """Files with one replaced by a folder (None), other bytes, or other data."""
    name = draw(st.sampled_from(sorted(name for name in files if files[name] is not None)))
    kind = draw(st.sampled_from(["inside", "inside", "inside", "folder", *BYTES]))
    if kind == "folder":
        return files | {name: None}
    content, some = files[name] or b"\0", draw(st.binary(min_size=1, max_size=8))
    if kind == "inside" and name.endswith((".json", ".csv")):
        with suppress(ValueError, TypeError, RecursionError):  # where it was damaged before
            return files | {name: spoilt(draw, name, content)}
    at = draw(st.integers(0, len(content) - 1))
    return files | {name: BYTES.get(kind, BYTES["insert"])(content, at, some)}


def often(files):
    """Files with one damage, or two."""
    return damaged(files) | damaged(files).flatmap(damaged)


_NONE_ANY_MORE = (ValueError, TypeError, AttributeError, LookupError, OSError, RecursionError)
"""Errors of a damaged description when its digest is renewed."""


@pytest.fixture(scope="module")
def compared_files(compared):
    return {k: content for k, content in contents(compared).items() if k != "report.html"}


def test_report_rejects_damaged_result_folders(compared_files, reseal, tmp_path, capsys):
    @tried(100, often(compared_files), st.booleans())
    def _(files, sealed):
        lay(tmp_path / "out", files)
        if sealed:
            with suppress(*_NONE_ANY_MORE):
                reseal(tmp_path / "out")
        with warnings.catch_warnings(action="ignore"):  # of NumPy, at what nobody has measured
            status = said_by(["report", tmp_path / "out"], tmp_path, capsys)
        if files != compared_files and not sealed:
            assert status == 2


TINY = {
    "scenario": "clutter-4", "num_envs": 2, "n_steps": 4, "batch_size": 16, "epochs": 1,
    "total_steps": 64, "set_width": 4, "hidden": (4,), "eval_every": 0, "checkpoint_every": 32,
    "tensorboard": False, "num_threads": 1,
}  # fmt: skip


@pytest.fixture(scope="module")
def run_files(tmp_path_factory):
    """Files of a finished run, so that resuming takes no time."""
    folder = tmp_path_factory.mktemp("fuzz") / "run"
    assert ppo.run(ppo.Config(**TINY, out=folder)).status == 0
    return {name: content for name, content in contents(folder).items() if content is not None}


def sign(folder):
    """Renew the digests in the descriptions of checkpoints, if they are still valid JSON."""
    for place in (folder / "checkpoints").glob("step-*"):
        path = place / checkpoints.DESCRIPTION
        with suppress(*_NONE_ANY_MORE):
            about = json.loads(path.read_text())
            for name in about["files"]:
                about["files"][name] = results.entry(place / name)
            about["sha256"] = plain_data.digest_of_rest(about)
            path.write_text(json.dumps(about))


class TestRuns:
    def test_resume_rejects_damaged_files(self, run_files, tmp_path, capsys):
        folder = tmp_path / "run"

        @tried(40, often(run_files), st.booleans())
        def _(files, sealed):
            lay(folder, files)
            if sealed:
                sign(folder)
            said_by(["train", "--resume", folder], tmp_path, capsys)

    def test_load_rejects_damaged_policies(self, run_files, tmp_path, capsys):
        """Files read by ``learned:PATH``."""
        place = checkpoints.find(lay(tmp_path / "run", run_files))
        whole = contents(place)
        read = {name: whole[name] for name in ("checkpoint.json", "network.safetensors")}

        @tried(200, damaged(read), st.booleans())
        def _(found, sealed):
            files = whole | found
            lay(place, files)
            if sealed:
                sign(tmp_path / "run")
            words = ["--scenario", "fig4", "--policy", f"learned:{place}", "--out", "x.txt"]
            assert said_by(["render", *words], tmp_path, capsys) == 2
            try:
                learned_policy.load(place, learned_policy.Scenario(n_robots=2))
            except checkpoints.CheckpointError as error:
                assert str(place) in str(error)
            else:
                assert sealed or meant(files) == meant(whole)


def meant(files):
    """Files by content, since a damage may replace a value by an equal one."""
    return files | {"checkpoint.json": json.loads(files["checkpoint.json"])}


NUMBERS = ("-1", "0", "1", "2", "3", "0.5", "nan", "inf", "-inf", "1e400", str(10**12), "9" * 5000)
NAMES = (
    "duo", "fig4", "clutter-4", "uav-6", "zero", "bearing-only", "learned", "learned:nowhere", "no",
    "", "\0", "\udcff", "a" * 300, "a" * 300 + ".toml", "no.toml", "folder.toml", "bytes.toml",
    "words.toml", "-", "--", "folder", "file", "file/x", "x.gif", "x.png", "folder/x.pdf", "None",
    "fig3", "one-team", "A", "[bold]", "%s{}",
)  # fmt: skip
WITHOUT_FLAGS = {"reproduce": ["fig3"], "play": ["duo"]}
"""What commands need at least."""
COMMANDS = {name: import_module(f"train.{module}") for name, (module, _) in cli.COMMANDS.items()}


@st.composite
def command_lines(draw):
    """A command with mostly valid flags and values."""
    command = draw(st.sampled_from(sorted(COMMANDS)))
    given = dataclasses.fields(COMMANDS[command].Config)
    fields = [field for field in given if "Positional" not in str(field.type)]
    words = [command]
    if command == "reproduce":
        words.append(draw(st.sampled_from(["fig3", "fig4"])))
    if command == "play":
        words.append(draw(st.sampled_from(["duo", "clutter-4"])))
    for field in draw(st.lists(st.sampled_from(fields or given), max_size=3)):
        number = any(kind in str(field.type) for kind in ("int", "float"))
        values = st.sampled_from(NUMBERS if number else NAMES)
        if draw(st.integers(0, 9)) == 0:
            values = st.sampled_from(NUMBERS + NAMES) | st.text(max_size=5)
        count = draw(st.integers(0, 2)) if "tuple" in str(field.type) else 1
        negation = "no-" if str(field.type) == "bool" and draw(st.booleans()) else ""
        words.append(f"--{negation}{field.name.replace('_', '-')}")
        words += [] if str(field.type) == "bool" else [draw(values) for _ in range(count)]
    return words


@pytest.fixture
def no_work(monkeypatch):
    """Commands stop after validation, before their work."""
    from train.bench import bench
    from train.figures import play, render, style
    from train.leaderboard import command as leaderboard
    from train.learn import trainer
    from train.verify import falsification, verify

    nothing = compare.ComparisonResult([], [], [], [], [])
    monkeypatch.setattr(compare, "_play", lambda *given: (nothing, 0.0))
    monkeypatch.setattr(compare, "description", lambda *given: defaultdict(str))
    for name in ("write", "_draw", "_show", "write_summary"):
        monkeypatch.setattr(compare, name, lambda *given: [])
    monkeypatch.setattr(trainer, "_loop", lambda *given: SimpleNamespace(status=0))
    monkeypatch.setattr(bench, "_compared", lambda *given: iter(()))
    monkeypatch.setattr(bench, "_bytes_per_team", lambda *given: (0, 0))
    monkeypatch.setattr("train.bench.warmup.make_ready", lambda *given: None)
    monkeypatch.setattr(render, "_write_video", lambda *given: None)
    monkeypatch.setattr(play, "_play", lambda *given: 0)
    monkeypatch.setattr(style, "save", lambda *given: None)
    fine = falsification.Tally(trials=1, margin=1.0)
    monkeypatch.setattr(verify, "look", lambda task: fine)
    monkeypatch.setattr(leaderboard, "play_all", lambda *given: (defaultdict(dict), 0.0))
    monkeypatch.setattr(leaderboard, "write", lambda *given: None)


def test_invalid_command_lines_are_one_line(no_work, tmp_path, capsys, monkeypatch):
    odd = {"file": b"", "bytes.toml": b"\xff\xfe\0", "words.toml": b"n_robots = [[[["}
    odd |= dict.fromkeys(("folder.toml", "folder"))
    accepted = set()

    @tried(160, command_lines())
    def _(words):
        monkeypatch.chdir(work := lay(tmp_path / "work", odd))
        if said_by(words, work, capsys) == 0:
            accepted.add(words[0])

    names = "compare train verify render bench reproduce leaderboard play"
    assert len(accepted) > 5
    work = lay(tmp_path / "plain", odd)
    monkeypatch.chdir(work)
    for name in set(names.split()) - accepted:  # which chance drew with invalid flags only
        assert said_by([name, *WITHOUT_FLAGS.get(name, ())], work, capsys) == 0
