"""``rendezvous warmup``, and the word about compilation."""

from __future__ import annotations

import pytest
from conftest import run_python

from rendezvous_env import compilation, kernel_cache
from train import cli


def test_it_readies_the_scenarios_asked_for(capsys):
    assert cli.main(["warmup", "--scenarios", "duo", "ring-12"]) == 0
    assert "2 scenarios are ready" in capsys.readouterr().out


@pytest.mark.skipif(not compilation.compiled(), reason="nothing is compiled")
@pytest.mark.parametrize(("seconds", "said"), [(2.5, 1), (1.5, 0)])
def test_long_compilation_is_announced_once(seconds, said, monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(kernel_cache, "_folder", lambda: tmp_path)  # else it may be found there
    clock = iter(range(100))
    compilation._say_once.cache_clear()
    monkeypatch.setattr(compilation.time, "monotonic", lambda: seconds * next(clock))

    @compilation.kernel
    def thrice(x):
        return 3 * x

    assert thrice(2) == 6 and thrice(2.0) == 6.0
    assert capsys.readouterr().err.count("rendezvous warmup") == said


@pytest.mark.slow
def test_a_cold_first_step_says_that_it_compiles(tmp_path):
    code = (
        "import rendezvous_env as rv; env = rv.parallel_env('duo'); env.reset(seed=0);"
        "env.step({a: env.action_space(a).sample() for a in env.agents})"
    )
    cold = {"NUMBA_CACHE_DIR": str(tmp_path)}
    first, second = (run_python(tmp_path, "-c", code, **cold).stderr for _ in range(2))
    assert first.count("rendezvous warmup") == 1 and first.count("\n") == 1
    assert second == ""
