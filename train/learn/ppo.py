"""PPO learns headings; a run can be stopped at any moment and resumed."""

from ..checks import check_installed
from .log import OnUpdate, Result
from .settings import EVALUATION_SEEDS, Config, check

__all__ = ["EVALUATION_SEEDS", "Config", "Result", "check", "run"]


def run(config: Config, on_update: OnUpdate | None = None) -> Result:
    """Train, or go on training.

    Args:
        config: of the run.
        on_update: called after each update with its number and its metrics: the row of metrics.csv,
            and under "evaluation" the rows of evaluation.csv if one was due. If it returns True,
            the run ends with a checkpoint, as if all steps were done.

    Returns:
        Folder, steps, the last metrics, the last and the best evaluation.

    Raises:
        UserError: for an impossible setting, a run that cannot be resumed, or a folder or disk that
            cannot be written.
    """
    check(config)
    check_installed("training", "train", "torch", "stable_baselines3")
    from . import trainer

    return trainer.run(config, on_update)
