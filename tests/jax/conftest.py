import importlib

import pytest


@pytest.fixture
def rj():
    """``rendezvous_env.jax`` with numbers in float64, as the engine's are, compiled quickly."""
    jax = pytest.importorskip("jax")
    jax.config.update("jax_disable_most_optimizations", True)
    with jax.enable_x64(True):
        yield importlib.import_module("rendezvous_env.jax")
    jax.config.update("jax_disable_most_optimizations", False)
