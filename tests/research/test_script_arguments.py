"""Scripts of research say what is wrong with their arguments."""

import runpy
import signal
import subprocess
import sys
import time

import pytest
from conftest import ROOT


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("claims.py gains gians", "claim gians is unknown; known are gains, "),
        ("claims.py --trials 0", "--trials must be 1 or more"),
        ("claims.py --seed -1", "--seed 0 or more"),
        ("training_search.py --every 0", "--every is 0; it must be 1 or more"),
        ("growth.py", "name a PNG"),
        ("packing.py many", "SEEDS is 'many'; it must be a whole number, 1 or more"),
        ("packing.py 0", "SEEDS is '0'"),
    ],
)
def test_a_wrong_argument_is_one_line(words, said, monkeypatch, capsys):
    script, *arguments = words.split()
    monkeypatch.setattr(sys, "argv", [script, *arguments])
    with pytest.raises(SystemExit) as end:
        runpy.run_path(str(ROOT / "research" / script), run_name="__main__")
    out, err = capsys.readouterr()
    assert not out
    assert said in err if end.value.code == 2 else said in end.value.code


def test_a_search_that_is_stopped_goes_on_with_no_other_run(tmp_path):
    """Nor tells a row of the run that was stopped."""
    words = "research/training_search.py --tried small-batch --seeds 0 1".split()
    command = [sys.executable, ROOT / words[0], *words[1:], "--out", tmp_path / "runs"]
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, text=True) as search:
        metrics = tmp_path / "runs" / "small-batch-0" / "metrics.csv"
        while not (metrics.exists() and metrics.read_text().count("\n") > 1):
            assert search.poll() is None
            time.sleep(0.1)
        search.send_signal(signal.SIGINT)
        said, _ = search.communicate(timeout=60)
    assert search.returncode == 130 and "small-batch, seed" not in said
    assert not (tmp_path / "runs" / "small-batch-1").exists()
