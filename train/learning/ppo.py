"""``rendezvous train``: PPO learns headings; it can be stopped at any moment and resumed."""

from __future__ import annotations

import importlib.util

from ..errors import UserError
from .settings import EVALUATION_SEEDS, Config
from .settings_checks import check

__all__ = ["EVALUATION_SEEDS", "Config", "check", "run"]


def run(config: Config) -> int:
    """Train, or go on training.

    Returns:
        Exit status: 0 when all steps are done, 128 + the signal's number when it was stopped.

    Raises:
        UserError: for an impossible setting, a run that cannot be resumed, or a folder or disk that
            cannot be written.
    """
    check(config)
    _require_extra()
    from . import training_run

    return training_run.run(config)


def _require_extra() -> None:
    for package in ("torch", "stable_baselines3"):
        if importlib.util.find_spec(package) is None:
            raise UserError(f"training needs {package}; pip install 'rendezvous-env[train]'")
