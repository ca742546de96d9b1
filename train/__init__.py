"""Everything that learns or compares: commands, evaluation, training, pictures."""

from importlib import import_module
from typing import Any

_SHORT = {
    "compare": f"{__name__}.compare.compare",
    "learned_policy": "rendezvous_env.baselines.learned.learned_policy",
    "ppo": f"{__name__}.learn.ppo",
    "sb3_vec_env": "rendezvous_env.adapters.sb3",
}
"""Modules under the names by which programs of version 0.1 know them."""


def __getattr__(name: str) -> Any:
    """Import a module of ``_SHORT`` when it is asked for; some of them load torch."""
    if name in _SHORT:
        return import_module(_SHORT[name])
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
