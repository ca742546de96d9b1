"""Damaged result folders and runs, and senseless command lines: one line each, nothing changed.

The damage is drawn anew for every case, the same in every run of the tests. Some of it is sealed
again, as if ``compare`` or ``train`` had written it, so that what lies behind the digests is tried.
"""

import dataclasses
import json
import shutil
import warnings
from collections import defaultdict
from contextlib import suppress
from importlib import import_module
from types import SimpleNamespace
from typing import NamedTuple

import pytest
from conftest import contents
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from baselines.learned import checkpoints, learned_policy, plain_data
from train import cli, results
from train.compare import compare
from train.learn import ppo


def cases(fast, slow):
    """How many cases a test tries by default, and how many under the marker ``slow``."""
    return pytest.mark.parametrize("count", [fast, pytest.param(slow, marks=pytest.mark.slow)])


def tried(count, *strategies):
    """Call a function with so many drawn cases."""

    def run(check):
        limits = settings(max_examples=count, suppress_health_check=list(HealthCheck))
        limits(given(*strategies)(check))()

    return run


def lay(folder, files):
    """Make a folder hold just these files; the folder."""
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
    """Exit status of a command; if it refuses, in one line, it has changed nothing."""
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


class Damage(NamedTuple):
    """What is done to one of several files."""

    file: int
    kind: str
    where: float
    some: bytes
    plain: object
    cell: str
    sealed: bool

    def hurt(self, name, content):
        """The content of a file, damaged; None: the file is a folder now."""
        if self.kind == "folder":
            return None
        if self.kind == "inside":
            with suppress(ValueError, TypeError, IndexError, RecursionError):  # hurt before
                return self._inside(name, content)
        at = min(int(self.where * len(content)), max(len(content) - 1, 0))
        return BYTES.get(self.kind, BYTES["flip"])(content or b"\0", at, self.some)

    def _inside(self, name, content):
        """As its kind of file allows: what is in it is wrong, and the file itself is right."""
        if name.endswith(".json"):
            plain = json.loads(content)
            self._put(plain)
            return json.dumps(plain).encode()
        if name.endswith(".csv"):
            lines = [line.split(",") for line in content.decode().splitlines()]
            line = lines[int(self.where * len(lines))]
            line[self.some[0] % len(line)] = self.cell
            return "\n".join(",".join(line) for line in lines).encode() + b"\n"
        return content + self.some

    def _put(self, plain):
        """Put something else somewhere into plain data."""
        path, place = list(self.some), plain
        while True:
            keys = list(place) if isinstance(place, dict) else list(range(len(place)))
            if not keys:
                return
            key = keys[(path.pop() if path else 0) % len(keys)]
            if not path or not isinstance(place[key], dict | list):
                place[key] = self.plain
                return
            place = place[key]


def damages(files):
    """Of one of so many files."""
    return st.builds(
        Damage,
        st.integers(0, files - 1),
        st.sampled_from(["inside", "inside", "inside", "folder", *BYTES]),
        st.floats(0, 1, exclude_max=True),
        st.binary(min_size=1, max_size=8),
        PLAIN,
        st.sampled_from(CELLS),
        st.booleans(),
    )


def hurt(files, found):
    """Files after one damage upon the other."""
    files, names = dict(files), sorted(files)
    for damage in found:
        name = names[damage.file]
        if files[name] is not None:
            files[name] = damage.hurt(name, files[name])
    return files


_NONE_ANY_MORE = (ValueError, TypeError, AttributeError, LookupError, OSError, RecursionError)
"""What a damaged description raises where it is to be sealed."""


@pytest.fixture(scope="module")
def compared_files(tmp_path_factory, reseal):
    """Files of a small comparison with an obstacle and a figure."""
    out = tmp_path_factory.mktemp("fuzz") / "out"
    given = {"scenarios": ("fig4",), "policies": ("bearing-only", "zero"), "episodes": 2, "keep": 1}
    assert compare.run(compare.Config(**given, figures=False, out=out)) == 0
    (out / "success.png").write_bytes(b"a picture")
    reseal(out, files=[path.name for path in out.iterdir() if path.name != "run.json"])
    return contents(out)


@cases(60, 250)
def test_damaged_result_folders(count, compared_files, reseal, tmp_path, capsys):
    @tried(count, st.lists(damages(len(compared_files)), min_size=1, max_size=2))
    def _(found):
        files = hurt(compared_files, found)
        lay(tmp_path / "out", files)
        if found[0].sealed:
            with suppress(*_NONE_ANY_MORE):
                reseal(tmp_path / "out")
        with warnings.catch_warnings(action="ignore"):  # of NumPy, at what nobody has measured
            status = said_by(["report", tmp_path / "out"], tmp_path, capsys)
        if files != compared_files and not found[0].sealed:
            assert status == 2


TINY = {
    "scenario": "clutter-4", "num_teams": 2, "n_steps": 4, "batch_size": 16, "epochs": 1,
    "total_steps": 64, "set_width": 4, "hidden": (4,), "eval_every": 0, "checkpoint_every": 32,
    "tensorboard": False, "num_threads": 1,
}  # fmt: skip


@pytest.fixture(scope="module")
def run_files(tmp_path_factory):
    """Files of a run that is finished, so that to go on with it takes no time."""
    folder = tmp_path_factory.mktemp("fuzz") / "run"
    assert ppo.run(ppo.Config(**TINY, out=folder)).status == 0
    return {name: content for name, content in contents(folder).items() if content is not None}


def sign(folder):
    """Make the descriptions of checkpoints fit their files again, where they still are some."""
    for place in (folder / "checkpoints").glob("step-*"):
        path = place / checkpoints.DESCRIPTION
        with suppress(*_NONE_ANY_MORE):
            about = json.loads(path.read_text())
            for name in about["files"]:
                about["files"][name] = results.entry(place / name)
            about["sha256"] = plain_data.digest_of_rest(about)
            path.write_text(json.dumps(about))


class TestRuns:
    @cases(25, 100)
    def test_damaged_files(self, count, run_files, tmp_path, capsys):
        folder = tmp_path / "run"

        @tried(count, st.lists(damages(len(run_files)), min_size=1, max_size=2))
        def _(found):
            lay(folder, hurt(run_files, found))
            if found[0].sealed:
                sign(folder)
            said_by(["train", "--resume", folder], tmp_path, capsys)

    @cases(40, 200)
    def test_damaged_policies(self, count, run_files, tmp_path, capsys):
        """What ``learned:PATH`` reads."""
        place = checkpoints.find(lay(tmp_path / "run", run_files))
        whole = contents(place)
        names = ["checkpoint.json", "network.safetensors"]

        @tried(count, damages(len(names)))
        def _(damage):
            files = dict(whole)
            files[names[damage.file]] = damage.hurt(names[damage.file], files[names[damage.file]])
            lay(place, files)
            if damage.sealed:
                sign(tmp_path / "run")
            words = ["--scenario", "fig4", "--policy", f"learned:{place}", "--out", "x.txt"]
            assert said_by(["render", *words], tmp_path, capsys) == 2
            try:
                learned_policy.load(place, learned_policy.Scenario(n_robots=2))
            except checkpoints.CheckpointError as error:
                assert str(place) in str(error)
            else:
                assert damage.sealed or meant(files) == meant(whole)


def meant(files):
    """Files by what they say: a damage may put into a description what stood there already."""
    return files | {"checkpoint.json": json.loads(files["checkpoint.json"])}


NUMBERS = ("-1", "0", "1", "2", "3", "0.5", "nan", "inf", "-inf", "1e400", str(10**12), "9" * 5000)
NAMES = (
    "duo", "fig4", "clutter-4", "uav-6", "zero", "bearing-only", "learned", "learned:nowhere", "no",
    "", "\0", "\udcff", "a" * 300, "a" * 300 + ".toml", "no.toml", "folder.toml", "bytes.toml",
    "words.toml", "-", "--", "folder", "file", "file/x", "x.gif", "x.png", "folder/x.pdf", "None",
    "fig3", "one-team", "A", "[bold]", "%s{}",
)  # fmt: skip
COMMANDS = {name: import_module(f"train.{module}") for name, (module, _) in cli.COMMANDS.items()}


@st.composite
def command_lines(draw):
    """A command with flags that it has, or nearly, and values that may fit."""
    command = draw(st.sampled_from(sorted(COMMANDS)))
    fields = dataclasses.fields(COMMANDS[command].Config)
    words = [command]
    if command == "reproduce":
        words.append(draw(st.sampled_from(["fig3", "fig4", "fig5"])))
    for field in draw(st.lists(st.sampled_from(fields), max_size=3)):
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
    """Commands stop where their settings have been accepted and work would begin."""
    from train.bench import bench
    from train.figures import render, style
    from train.leaderboard import command as leaderboard
    from train.learn import trainer
    from train.verify import falsification, verify

    nothing = compare.Found([], [], [], [], [])
    monkeypatch.setattr(compare, "_play", lambda *given: (nothing, 0.0))
    monkeypatch.setattr(compare, "description", lambda *given: defaultdict(str))
    for name in ("write", "_draw", "_show", "write_summary"):
        monkeypatch.setattr(compare, name, lambda *given: [])
    monkeypatch.setattr(trainer, "_loop", lambda *given: SimpleNamespace(status=0))
    monkeypatch.setattr(bench, "_compared", lambda *given: iter(()))
    monkeypatch.setattr(bench, "_bytes_per_team", lambda *given: (0, 0))
    monkeypatch.setattr("train.bench.warmup.make_ready", lambda *given: None)
    monkeypatch.setattr(render, "_write_video", lambda *given: None)
    monkeypatch.setattr(style, "save", lambda *given: None)
    fine = falsification.Tally(trials=1, margin=1.0)
    monkeypatch.setattr(verify, "look", lambda task: fine)
    monkeypatch.setattr(leaderboard, "play_all", lambda *given: (defaultdict(dict), 0.0))
    monkeypatch.setattr(leaderboard, "write", lambda *given: None)


@cases(150, 300)
def test_command_lines(count, no_work, tmp_path, capsys, monkeypatch):
    work = tmp_path / "work"
    work.mkdir()
    monkeypatch.chdir(work)
    accepted = set()

    @tried(count, command_lines())
    def _(words):
        for path in work.iterdir():
            shutil.rmtree(path) if path.is_dir() else path.unlink()
        (work / "file").write_text("")
        (work / "bytes.toml").write_bytes(b"\xff\xfe\0")
        (work / "words.toml").write_text("n_robots = [[[[")
        (work / "folder.toml").mkdir()
        (work / "folder").mkdir()
        if said_by(words, work, capsys) == 0:
            accepted.add(words[0])

    commands = "compare", "train", "verify", "render", "bench", "reproduce", "leaderboard"
    assert accepted >= set(commands)
