"""What an interrupted ``rendezvous verify`` has finished is kept, and not done again."""

import csv
import io
import math

import pytest
from rich.console import Console

from train import resume
from train.checks import UserError
from train.verify import verify
from train.verify.claims import BATCH, CLAIMS
from train.verify.falsification import Tally

NAMES = ("lemma-1", "theorem-2", "necessity")
"""Three blocks each."""


def config(out, **changes):
    given = {"trials": 2 * BATCH + 5, "claims": NAMES, "jobs": 1, "out": out}
    return verify.Config(**{**given, **changes})


def checked(settings, after=math.inf):
    """Names of the blocks that are looked at until the next one is interrupted, and what is
    printed.
    """
    done, printed = [], io.StringIO()

    def look(task):
        if len(done) == after:
            raise KeyboardInterrupt
        done.append(task.name)
        return task.look()

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(verify, "look", look)
        verify.run(settings, CLAIMS, Console(file=printed, width=200))
    return done, printed.getvalue()


def stopped(settings, after):
    with pytest.raises(KeyboardInterrupt) as caught:
        checked(settings, after)
    return caught.value


def rows(folder):
    """Those of verify.csv, but for the time they took."""
    with (folder / "verify.csv").open(newline="", encoding="utf-8") as file:
        return [{**row, "seconds": ""} for row in csv.DictReader(file)]


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Rows of a verification that nothing stopped, and the names of its claims."""
    out = tmp_path_factory.mktemp("whole")
    done, _ = checked(config(out))
    return rows(out), done


@pytest.mark.parametrize("after", [1, 4, 8])
def test_what_is_finished_is_not_done_again(after, whole, tmp_path):
    notes = stopped(config(tmp_path), after).__notes__
    assert notes == [f"{after} finished tasks lie in {tmp_path / 'verify.part'}; "
                     "the same command resumes"]  # fmt: skip
    done, printed = checked(config(tmp_path))
    assert f"resumes with {after} finished tasks" in printed
    assert done == whole[1][after:] and len(whole[1]) == 9
    assert rows(tmp_path) == whole[0]
    assert [path.name for path in tmp_path.iterdir()] == ["verify.csv"]


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"trials": 500}, r"trials \(85, here 500\)"),
        ({"seed": 1}, r"seed \(0, here 1\)"),
        ({"min_alignment": 0.5}, r"min_alignment \(0.3, here 0.5\)"),
        ({"only_batch": 0}, r"only_batch \(null, here 0\)"),
        ({"claims": NAMES[:1]}, "claims"),
    ],
)
def test_another_command_is_refused(changes, field, tmp_path):
    stopped(config(tmp_path), 1)
    before = contents(tmp_path)
    with pytest.raises(UserError, match=f"an unfinished verification of other {field}") as caught:
        checked(config(tmp_path, **changes))
    assert "--overwrite" in str(caught.value) and contents(tmp_path) == before


def test_so_is_another_program(tmp_path, monkeypatch):
    stopped(config(tmp_path), 1)
    monkeypatch.setattr(resume, "_source", lambda: "changed")
    with pytest.raises(UserError, match="of other source"):
        checked(config(tmp_path))


@pytest.mark.parametrize("first", [None, 0, 2**40])
@pytest.mark.parametrize("numbers", [(40, -0.0, math.nan, 0), (1, -1 / 3, math.inf, 1)])
def test_a_block_reads_back_bit_by_bit(numbers, first, tmp_path):
    part = resume.Part(tmp_path / "part", {}, "test")
    part.begin(tmp_path, fresh=False)
    trials, margin, ratio, violations = numbers
    seen = Tally(trials, 0.1 + 0.2, 7, margin, violations, first, ratio={"one": ratio})
    part.save("one", seen)
    assert repr(part.load("one")) == repr(seen)
    assert part.load("another") is None


def test_a_folder_on_its_way_out_can_still_be_gone_on_with(tmp_path, monkeypatch):
    """Of files in any order the plan goes last."""
    part = resume.Part(tmp_path / "part", {"seed": 1}, "test")
    part.begin(tmp_path, fresh=False)
    part.save("one", {"x": 1})
    (part.folder / "table.csv").touch()
    with monkeypatch.context() as patch:
        patch.setattr(resume.Path, "unlink", lambda path: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            part.discard()
    part.begin(tmp_path, fresh=False)
    part.discard()
    part.folder.mkdir()  # or a kill before there was a plan
    part.begin(tmp_path, fresh=False)
    assert (part.folder / resume.PLAN).is_file()
