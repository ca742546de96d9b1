"""Record of executed kernels, used by ``make test-kernels``."""

import os
import subprocess
import sys

import kernel_coverage
import pytest
from conftest import ROOT

from rendezvous_env.compilation import compiled

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not compiled(), reason="nothing is compiled"),
]


def test_kernels_are_found_in_every_package():
    found = kernel_coverage.kernels()
    assert {name.partition(".")[0] for name in found} == set(kernel_coverage.PACKAGES)
    assert kernel_coverage.missing(set(found)) == []
    assert kernel_coverage.missing(set()) == sorted(found)


@pytest.mark.nightly
def test_run_fails_and_names_kernels_that_never_ran():
    test = "tests/learn/test_networks.py::test_pooling_kernels_match_torch"
    words = ["-m", "pytest", "-q", "--every-kernel", "-n", "2", test]
    environment = os.environ | {"NUMBA_BOUNDSCHECK": "1", "NUMBA_OPT": "1"}
    done = subprocess.run(
        [sys.executable, *words],
        capture_output=True, text=True, cwd=ROOT, env=environment, timeout=900,
    )  # fmt: skip
    assert done.returncode == 1, done.stderr
    assert "4 passed in" in done.stdout  # names of kernels may hold "failed"
    lost = [line.split()[-1] for line in done.stdout.splitlines() if "never ran: " in line]
    assert "train.learn.sets.pool" not in lost
    assert any(name.startswith("rendezvous_env.physics.") for name in lost)
