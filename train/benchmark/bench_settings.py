"""The settings of ``rendezvous bench``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ..checks import check_least, check_most
from ..errors import UserError

GROUPS = (
    "one-team",
    "batched",
    "obstacles",
    "wrapped",
    "sensing",
    "learned",
    "adapters",
    "robots",
    "ppo",
    "heading-ppo",
)
_MOST_BEARINGS = 2**31


@dataclass(frozen=True)
class Config:
    """Measure the speed of the environments."""

    json: Path | None = None
    """File for the figures, beside the table."""
    figure: Path | None = None
    """PNG file for the growth of a robot step's time with n and B; measured only if given."""
    only: tuple[str, ...] = ()
    """Groups of rows: one-team, batched, obstacles, wrapped, sensing, learned, adapters, robots,
    ppo, heading-ppo; none is all."""
    robots: tuple[int, ...] = (3, 8, 32)
    """Sizes of teams."""
    num_envs: int = 1024
    """Teams that step together, and slots of the VecEnv."""
    num_threads: int | None = None
    """Most threads a step may use; None is one for each core."""
    repeats: int = 5
    """Measurements of which the median is taken; cases that are compared take turns."""
    seconds: float = 0.3
    """Length of a measurement, s."""
    busy: bool = False
    """Measure again while another process keeps one core busy."""


def check(config: Config) -> None:
    """Refuse settings that cannot be measured.

    Raises:
        UserError: naming the flag, its value and what would be right.
    """
    if unknown := sorted(set(config.only) - set(GROUPS)):
        raise UserError(f"only: {unknown[0]!r} is unknown; known are {', '.join(GROUPS)}")
    check_least(config, robots=2, num_envs=1, num_threads=1, repeats=1)
    check_most(config, robots=2**12, num_envs=2**24, num_threads=2**10, seconds=3600)
    if not config.robots:
        raise UserError("--robots names none; give sizes of teams, 2 or more")
    if (bearings := config.num_envs * max(config.robots) ** 2) > _MOST_BEARINGS:
        raise UserError(
            f"--num-envs times the square of --robots is {bearings}; it must be {_MOST_BEARINGS} "
            "or less, so that memory holds them"
        )
    if not config.seconds > 0:
        raise UserError(f"--seconds is {config.seconds}; it must be positive")
    for path in (config.json, config.figure):
        if path is not None and not path.parent.is_dir():
            raise UserError(f"{path}: there is no folder {path.parent}")
        if path is not None and path.is_dir():
            raise UserError(f"{path}: is a folder; name a file")
