"""Interrupted ``rendezvous verify``: finished work is kept and not repeated."""

import io
import math
from collections import Counter

import pytest
from conftest import contents
from rich.console import Console

from rendezvous_env.checks import counted
from train import resume
from train.checks import UserError
from train.results import read_csv
from train.verify import claims, verify
from train.verify.claims import BATCH, CLAIMS
from train.verify.falsification import Tally, TrialResult

NAMES = ("lemma-1", "theorem-2", "necessity")
"""Three tasks each."""


@pytest.fixture(autouse=True)
def nothing_is_played(monkeypatch):
    """Result of a batch or a trial as a function of its number."""

    def check(claim, seed, batch, trials, least_margin):
        margin = math.sin(batch + seed) / 3
        return Tally(trials, margin=margin, ratio={claim.name: margin + 0.5}, seconds=0.1)

    monkeypatch.setattr(claims, "check", check)

    def climb(trial):
        return trial, TrialResult(steps=trial.seed, counts=Counter([(f"{trial.by}: A", "granted")]))

    monkeypatch.setattr(verify, "climb", climb)


def config(out, **changes):
    given = {"trials": 2 * BATCH + 5, "claims": NAMES, "jobs": 1, "out": out}
    return verify.Config(**{**given, **changes})


def checked(settings, after=math.inf):
    """Names of finished tasks up to an interrupt, and the output."""
    done, printed, real_look = [], io.StringIO(), verify.look

    def look(task):
        if len(done) == after:
            raise KeyboardInterrupt
        done.append(task.name)
        return real_look(task)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(verify, "look", look)
        verify.run(settings, CLAIMS, Console(file=printed, width=200))
    return done, printed.getvalue()


def stopped(settings, after):
    with pytest.raises(KeyboardInterrupt) as caught:
        checked(settings, after)
    return caught.value


@pytest.mark.parametrize("after", [1, 4, 8])
def test_finished_claims_are_not_repeated(after, tmp_path):
    whole, _ = checked(config(tmp_path / "whole"))
    out = tmp_path / "out"
    notes = stopped(config(out), after).__notes__
    folder = out / "verify.part"
    assert notes == [f"the same command resumes with {counted(after, 'finished task')} in {folder}"]
    done, printed = checked(config(out))
    assert f"resumes with {counted(after, 'finished task')}" in printed
    assert done == whole[after:] and len(whole) == 9
    assert read_csv(out / "verify.csv") == read_csv(tmp_path / "whole/verify.csv")
    assert [path.name for path in out.iterdir()] == ["verify.csv"]


def test_finished_random_scenarios_are_not_repeated(tmp_path):
    settings = {"any": True, "claims": (), "trials": 72}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(verify, "DRAWS", 4)
        whole, printed = checked(config(tmp_path / "whole", **settings))
        stopped(config(tmp_path, **settings), 2)
        done, again = checked(config(tmp_path, **settings))
    assert done == whole[2:] and len(whole) == 3
    assert read_csv(tmp_path / "any.csv") == read_csv(tmp_path / "whole/any.csv")
    assert (
        printed.split(" of 24 environments")[0] in again
        and "72 initial conditions of 12 random scenarios" in again
    )


def test_other_command_or_program_is_rejected(tmp_path, monkeypatch):
    stopped(config(tmp_path), 1)
    before = contents(tmp_path)
    for changes, field in (
        ({"trials": 500}, r"trials \(85, here 500\)"),
        ({"seed": 1}, r"seed \(0, here 1\)"),
        ({"min_alignment": 0.5}, r"min_alignment \(0.3, here 0.5\)"),
        ({"only_batch": 0}, r"only_batch \(null, here 0\)"),
        ({"claims": NAMES[:1]}, "claims"),
        ({}, "source"),
    ):
        if not changes:
            monkeypatch.setattr(resume, "_source", lambda: "changed")
        with pytest.raises(UserError, match=f"an unfinished verification of other {field}") as no:
            checked(config(tmp_path, **changes))
        assert "--overwrite" in str(no.value) and contents(tmp_path) == before
        remedy = "give its command to resume it" if changes else "finish it with that version"
        assert remedy in str(no.value)


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"format_version": 5}, r"format_version \(5, here \d+\)"),
        (
            {"versions": {"numpy": "1.0", "scipy": "2"}},
            r'versions \({"numpy": "1.0"}, here {"numpy": "3"}\)',
        ),
        ({"source": "of then"}, r'source \("of then", here "of now"\)'),
    ],
)
@pytest.mark.parametrize("seed", [0, 1])
def test_run_of_another_version_is_to_be_finished_with_that_version(changes, field, seed, tmp_path):
    """Whether or not the command is the same."""
    now = {"format_version": 7, "versions": {"numpy": "3", "scipy": "2"}, "source": "of now"}
    before = resume.RunCheckpoint(tmp_path / "part", {**now, **changes, "seed": 0}, "test")
    with before.at_work(tmp_path, Console(), fresh=False):
        before.save("one", 1)
    after = resume.RunCheckpoint(tmp_path / "part", {**now, "seed": seed}, "test")
    message = (
        f"an unfinished test of other {field}, started with another version of rendezvous or of "
        "its packages: finish it with that version, --overwrite to discard it"
    )
    with pytest.raises(UserError, match=message), after.at_work(tmp_path, Console(), fresh=False):
        pass
    assert before.load("one") == 1


@pytest.mark.parametrize("first", [None, 0, 2**40])
@pytest.mark.parametrize("numbers", [(40, -0.0, math.nan, 0), (1, -1 / 3, math.inf, 1)])
def test_task_round_trips_bitwise(numbers, first, tmp_path):
    part = resume.RunCheckpoint(tmp_path / "part", {}, "test")
    trials, margin, ratio, violations = numbers
    seen = Tally(trials, 0.1 + 0.2, 7, margin, violations, first, ratio={"one": ratio})
    with part.at_work(tmp_path, Console(), fresh=False):
        part.save("one", seen)
        assert repr(part.load("one")) == repr(seen)
        assert part.load("another") is None


def test_folder_being_removed_can_be_resumed(tmp_path, monkeypatch):
    """The folder is complete or absent."""
    part = resume.RunCheckpoint(tmp_path / "part", {"seed": 1}, "test")
    with part.at_work(tmp_path, Console(), fresh=False):
        part.save("one", {"x": 1})
    for name, stays in (("rename", True), ("rmtree", False)):
        with monkeypatch.context() as patch:
            where = resume.Path if name == "rename" else resume.shutil
            real = getattr(where, name)

            def killed(*given, ignore_errors=False, real=real):
                return real(*given, ignore_errors=True) if ignore_errors else 1 / 0

            patch.setattr(where, name, killed)
            with pytest.raises(ZeroDivisionError):
                part.discard()
        assert part.folder.exists() is stays
    with part.at_work(tmp_path, Console(), fresh=False):
        assert part.load("one") is None
        part.discard()
    assert list(tmp_path.iterdir()) == []
    part.folder.mkdir()  # or a kill before there was a plan
    with part.at_work(tmp_path, Console(), fresh=False):
        assert (part.folder / resume.PLAN).is_file()
