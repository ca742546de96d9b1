"""A run that several test modules look at."""

import pytest
from training_runs import config

from train.learn import ppo


@pytest.fixture(scope="session")
def whole(tmp_path_factory):
    """Folder of a run that nothing stopped."""
    folder = tmp_path_factory.mktemp("runs") / "whole"
    assert ppo.run(config(folder)).status == 0
    return folder
