"""Scripts of research say what is wrong with their arguments."""

import subprocess
import sys

import pytest
from conftest import ROOT


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("claims.py gains gians", "claim gians is unknown; known are gains, "),
        ("claims.py --trials 0", "--trials must be 1 or more"),
        ("claims.py --seed -1", "--seed 0 or more"),
        ("growth.py", "name a PNG"),
        ("packing.py many", "SEEDS is 'many'; it must be a whole number, 1 or more"),
        ("packing.py 0", "SEEDS is '0'"),
    ],
)
def test_a_wrong_argument_is_one_line(words, said, tmp_path):
    script, *arguments = words.split()
    command = [sys.executable, ROOT / "research" / script, *arguments]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert done.returncode in (1, 2) and not done.stdout
    assert said in done.stderr and "Traceback" not in done.stderr
