"""Smoke tests of the framework scripts, for installed frameworks."""

import json
from importlib.util import find_spec
from pathlib import Path

import pytest
from conftest import run_python
from parameters import marked
from run_table import FRAMEWORKS

HERE = Path(__file__).parent
SMALL = {  # by the rarest module that each needs
    "numpy": ("numpy_es.py", "--generations", "1", "--pairs", "2", "--num-envs", "2"),
    "stable_baselines3": ("sb3_ppo.py", "--frames", "2048", "--num-envs", "8"),
    "optax": ("jax_pg.py", "--updates", "1", "--num-envs", "4"),
    "tianshou": ("tianshou_ppo.py", "--epochs", "1", "--num-envs", "4"),
    "agilerl": ("agilerl_ippo.py", "--updates", "1", "--num-envs", "4"),
    "skrl": ("skrl_ppo.py", "--steps", "32", "--num-envs", "4"),
}


INSTALLED = [module for module in SMALL if find_spec(module)]


@pytest.mark.slow
@pytest.mark.parametrize("needed", marked(INSTALLED, slow={*INSTALLED} - {"numpy"}))
def test_framework_script_runs(needed):
    assert {framework.script for framework in FRAMEWORKS.values()} == {s[0] for s in SMALL.values()}
    said = run_python(HERE, *SMALL[needed], "--episodes", "2").stdout
    found = json.loads(said.splitlines()[-1])
    assert found["frames_per_second"] > 0 and found["training_frames"] > 0
    assert {found["before"], found["after"]} <= {0.0, 0.5, 1.0} and found["training_seconds"] > 0
