"""PPO for headings; a run can be interrupted at any time and resumed."""

from ..checks import check_installed
from .log import OnUpdate, Result
from .settings import EVALUATION_SEEDS, Config, check

__all__ = ["EVALUATION_SEEDS", "Config", "Result", "check", "run"]


def run(config: Config, on_update: OnUpdate | None = None) -> Result:
    """Start or resume a training run.

    Args:
        config: settings of the run.
        on_update: callback after each update with its number and metrics: the row of metrics.csv
            and, under "evaluation", the rows of evaluation.csv if one was due. Returning True ends
            the run with a checkpoint.

    Returns:
        Folder, steps, last metrics, last and best evaluation.

    Raises:
        UserError: for an impossible setting, a run that cannot be resumed, or a folder or disk that
            cannot be written.
    """
    check(config)
    check_installed("training", "train", "torch", "stable_baselines3")
    from . import trainer

    return trainer.run(config, on_update)
