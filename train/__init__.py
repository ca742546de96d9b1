"""Command line, evaluation, training, reports and figures."""

from importlib import import_module
from typing import Any

_SHORT = {
    "compare": f"{__name__}.compare.compare",
    "learned_policy": "rendezvous_env.baselines.learned.learned_policy",
    "ppo": f"{__name__}.learn.ppo",
    "sb3_vec_env": "rendezvous_env.adapters.sb3",
}
"""Module names of version 0.1 and their current locations."""


def __getattr__(name: str) -> Any:
    """Import a module of ``_SHORT`` on first access; some of them load torch."""
    if name in _SHORT:
        return import_module(_SHORT[name])
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
