"""Which settings of a training run are refused, and which a resumed run may change."""

from __future__ import annotations

import math
from dataclasses import fields, replace
from typing import get_args, get_type_hints

from baselines.learned.robots import check_readable
from rendezvous_env.experiment import scenarios as named_scenarios

from ..checks import check_fields, check_least, check_most, flag
from ..errors import UserError
from .settings import Config

_MOST = {
    "set_width": 2**12, "hidden": 2**12, "decision_period": 10**6, "eval_starts": 2**32,
    "num_threads": 2**10, "total_steps": 2**62, "checkpoint_every": 2**62, "eval_every": 2**62,
    "learning_rate": 1e6, "epochs": 2**31, "batch_size": 2**31, "curriculum": 2**10,
    "fewest_obstacles": 2**10, "budget": 1e9, "memory_units": 2**12,
    "sensing_groups": 2**20, "sensing_updates": 2**31,
}  # fmt: skip
_MOST_SAMPLES = 2**31
MAY_CHANGE = ("total_steps", "eval_every", "eval_starts", "checkpoint_every", "num_threads")
"""Fields that a resumed run may change; with any other it would be another run."""


def check(config: Config) -> None:
    """Refuse settings that cannot be.

    Raises:
        UserError: naming the flag, its value and what would be right.
    """
    least = {
        "total_steps": 1, "seed": 0, "num_teams": 1, "n_steps": 2, "batch_size": 2, "epochs": 1,
        "set_width": 1, "decision_period": 1, "eval_every": 0, "eval_starts": 1,
        "checkpoint_every": 1, "touch_penalty": 0, "num_threads": 1, "hidden": 1, "persistence": 0,
        "budget": 0, "memory_units": 1, "sensing_groups": 1, "sensing_updates": 1,
    }  # fmt: skip
    check_fields(config)
    check_least(config, **least)
    check_most(config, **_MOST)
    _check_words(config)
    _check_guarantee(config)
    _check_sensing(config)
    for name in ("gamma", "gae_lambda"):
        if not 0 <= getattr(config, name) <= 1:
            raise UserError(f"{flag(name)} is {getattr(config, name)}; it must be in [0, 1]")
    for name in ("learning_rate", "clip_range", "max_turn_rate"):
        if not 0 < getattr(config, name) < float("inf"):
            raise UserError(f"{flag(name)} is {getattr(config, name)}; it must be positive")
    if not 0 <= config.clearance < math.pi:
        raise UserError(f"--clearance is {config.clearance}; it must be an angle in [0, π) rad")
    if config.seed >= 2**29:
        raise UserError(f"--seed is {config.seed}; it must be below 2^29")
    if any(count < 0 for count in (*config.curriculum, config.fewest_obstacles or 0)):
        raise UserError("--curriculum and --fewest-obstacles count obstacles; they must be ≥ 0")
    try:
        if (samples := config.samples_per_update) > _MOST_SAMPLES:
            raise UserError(
                f"--num-teams times robots times --n-steps is {samples}; it must be "
                f"{_MOST_SAMPLES} or less"
            )
        for scenario in (
            config.base_scenario(),
            *map(named_scenarios.resolve, config.eval_scenarios),
        ):
            check_readable(scenario)
        config.obstacle_slots()
    except (ValueError, OSError) as error:
        raise UserError(str(error)) from error


def _check_guarantee(config: Config) -> None:
    if not 0 < config.min_alignment < 1:
        raise UserError(f"--min-alignment is {config.min_alignment}; it must be in (0, 1)")
    of_tanks = {"budget": config.budget > 0, "memory": config.memory == "features"}
    for name, given in of_tanks.items() if config.guarantee == "heading" else ():
        if given:
            value = getattr(config, name)
            raise UserError(f"{flag(name)} is {value}; headings have none: add --guarantee tank")
    if config.memory != "recurrent" and config.memory_units != Config.memory_units:
        units = config.memory_units
        raise UserError(f"--memory-units is {units}; there are none without --memory recurrent")


def _check_sensing(config: Config) -> None:
    try:
        drawn = bool(config.sensing_ranges())
    except ValueError as error:
        raise UserError(f"--sensing-… draws sensors: {error}") from error
    if drawn and config.sensing_groups > config.num_teams:
        raise UserError(
            f"--sensing-groups is {config.sensing_groups}; it must be {config.num_teams} or less, "
            "as --num-teams"
        )
    for name in () if drawn else ("sensing_chance", "sensing_groups", "sensing_updates"):
        if (value := getattr(config, name)) != getattr(Config, name):
            raise UserError(
                f"{flag(name)} is {value}; no sensors are drawn: add a range, as --sensing-noise"
            )


def _check_words(config: Config) -> None:
    hints = get_type_hints(Config)
    for name in ("guarantee", "memory", "critic"):
        if (value := getattr(config, name)) not in (words := get_args(hints[name])):
            raise UserError(f"{flag(name)} is {value!r}; it must be one of {', '.join(words)}")


def resumed(config: Config, stored: Config) -> Config:
    """The settings of a resumed run: those stored, with what may be changed on the command line.

    Raises:
        UserError: for a flag that would make it another run.
    """
    default, folder, changed = Config(), config.resume or config.out, {}
    for name in (field.name for field in fields(Config)):
        given = getattr(config, name)
        if name in ("out", "resume") or given in (getattr(default, name), getattr(stored, name)):
            continue
        if name not in MAY_CHANGE:
            raise UserError(
                f"{flag(name)} is {given}; {folder} was trained with "
                f"{getattr(stored, name)}: leave it out, or begin a new run"
            )
        changed[name] = given
    return replace(stored, **changed, out=folder, resume=None)


def same_run(one: Config, other: Config) -> bool:
    """Whether two settings differ in nothing but what a resumed run may change."""
    free = (*MAY_CHANGE, "out", "resume")
    names = [field.name for field in fields(Config) if field.name not in free]
    return all(getattr(one, name) == getattr(other, name) for name in names)
