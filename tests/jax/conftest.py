import importlib

import pytest


@pytest.fixture
def rj():
    """``rendezvous_env.jax`` with numbers in float64, as the engine's are."""
    jax = pytest.importorskip("jax")
    # jax_disable_most_optimizations would compile faster, but computes other numbers
    with jax.enable_x64(True):
        yield importlib.import_module("rendezvous_env.jax")
