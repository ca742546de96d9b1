"""A training run, started anew or from a checkpoint."""

import copy
import math
import time
from collections.abc import Mapping
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from rendezvous_env.baselines.learned import checkpoints
from rendezvous_env.baselines.learned.checkpoints import CheckpointError
from rendezvous_env.baselines.learned.learned_policy import LearnedPolicy
from rich.progress import Progress
from stable_baselines3.common.logger import Logger

from rendezvous_env.adapters.sb3_logging import episode_numbers
from rendezvous_env.checks import counted
from rendezvous_env.engine.threads import available_cores

from .. import interrupts, results
from ..checks import UserError, user_error
from ..compare import statistics
from ..compare.evaluation import play
from ..compare.tables import number
from ..console import Console
from ..policies import resolve_scenario
from ..resume import claimed
from . import checkpoint
from .checkpoint import STATE_FILES, flatten, tensors, unflatten
from .environments import TimedRobotVecEnv, make_environments
from .log import (
    EVALUATION,
    METRICS,
    OnUpdate,
    Result,
    Table,
    read_evaluations,
    with_former_names,
)
from .recurrent import learner_of
from .settings import CONFIG, EVALUATION_SEEDS, Config, read_config

_DOES_NOT_FIT = (
    KeyError, TypeError, ValueError, RuntimeError, IndexError, AttributeError, OverflowError,
)  # fmt: skip
"""Errors raised when arrays of another run are loaded."""
_LEAST_RATE = 0.05
"""Fraction of the learning rate at the end of the run."""
SAME_NAME = (
    "n_steps", "batch_size", "gamma", "gae_lambda", "clip_range", "ent_coef", "seed", "device",
)  # fmt: skip
"""Settings with the same name in PPO."""
_LOSSES = {"policy_loss": "policy_gradient_loss"} | {
    name: name
    for name in ("value_loss", "approx_kl", "explained_variance", "clip_fraction", "learning_rate")
}
"""Columns of metrics.csv logged by stable-baselines3, with its names."""

Snapshot = tuple[dict[str, Any], dict[str, Any]]
"""Description and arrays of a checkpoint."""


class Trainer:
    """Network, optimizer, environment and log of a run."""

    def __init__(self, config: Config) -> None:
        self.config = config
        self.settings = config.policy_settings()
        self.stage = 0
        self.robots = TimedRobotVecEnv(make_environments(config, 0))
        algorithm, network, arguments = learner_of(config, self.robots.vector_env)

        def learning_rate(_: float) -> float:  # the model needs it in its constructor, too
            done = self.model.num_timesteps / config.total_steps if hasattr(self, "model") else 0.0
            return config.learning_rate * max(1.0 - done, _LEAST_RATE)

        self.model: Any = algorithm(
            network,
            self.robots,
            learning_rate=learning_rate,
            n_epochs=config.epochs,
            stats_window_size=10**6,
            **{name: getattr(config, name) for name in SAME_NAME},
            policy_kwargs=arguments,
        )
        self.model.set_logger(Logger(None, []))
        self._seconds = self._environment_seconds = self._wall_before = 0.0
        self._began = time.perf_counter()

    def begin(self) -> int:
        """Start at step 0 and write an initial checkpoint."""
        if (path := self.config.start_from) is not None:
            _, tables = checkpoints.read(checkpoints.find(path), ["network"])
            with user_error(f"--start-from {path}: another network: ", RuntimeError):
                self.model.policy.load_state_dict(tensors(tables["network"]))
        self._reset_robots()
        self._open_log(0)
        self.save(self.snapshot())
        return 0

    def _reset_robots(self) -> None:
        self.robots.seed(self.config.first_seed + 2**24 * self.stage)
        self.model._last_obs = self.robots.reset()
        self.model._last_episode_starts = np.ones(self.robots.num_envs, dtype=np.bool_)

    def _enter_stage(self, stage: int) -> None:
        self.stage, self.robots = stage, TimedRobotVecEnv(make_environments(self.config, stage))
        self.model.set_env(self.robots, force_reset=False)

    def _open_log(self, step: int) -> None:
        out = self.config.out
        self._metrics = Table(out / "metrics.csv", METRICS, step)
        self._evaluations = Table(out / "evaluation.csv", EVALUATION, step)
        results.write_json(out / CONFIG, self.config.to_plain())  # no errors from here on
        self._metrics.begin()
        self._evaluations.begin()
        self.events = None
        if self.config.tensorboard:
            from torch.utils.tensorboard import SummaryWriter

            self.events = SummaryWriter(str(out / "tensorboard"), purge_step=step + 1)

    def _tell(self, table: Table, kind: str, row: Mapping[str, Any]) -> None:
        table.add(row)
        for name, value in row.items():
            if self.events and isinstance(value, int | float) and not math.isnan(value):
                self.events.add_scalar(f"{kind}/{name}", value, row["step"])

    def restore(self, place: Path) -> int:
        """Restore a checkpoint; returns its step."""
        about, tables = checkpoints.read(place, STATE_FILES)
        model = self.model
        try:
            if about["stage"] != self.stage:
                self._enter_stage(about["stage"])
            model.policy.load_state_dict(tensors(tables["network"]))
            optimizer, kept = model.policy.optimizer, unflatten(tables["optimizer"])
            moments = {int(number): tensors(arrays) for number, arrays in kept.items()}
            optimizer.load_state_dict(optimizer.state_dict() | {"state": moments})
            state = unflatten(tables["state"])
            if isinstance(state.get("robots"), dict):  # runs of older versions have none
                state["robots"].setdefault("told", np.zeros(self.robots.slots.batch_size, np.int64))
            checkpoint.check_fits(state, self.robots, model.policy)
            self.robots.set_state(state["robots"])
            model._last_obs = state["last_observations"]
            model._last_episode_starts = state["last_episode_starts"]
            model.set_memory(state)
            checkpoint.restore_random(state["random"])
            model.num_timesteps, model._n_updates = about["step"], about["updates"]
            self._wall_before = about["wall_s"]
        except _DOES_NOT_FIT as error:
            raise CheckpointError(f"{place}: does not fit this run: {error}") from error
        self._open_log(about["step"])
        return int(about["step"])

    def save(self, state: Snapshot) -> Path:
        """Write a snapshot as a checkpoint; older checkpoints remain if this fails."""
        description, tables = state
        return checkpoint.write(self.config.out, description["step"], description, tables)

    def snapshot(self) -> Snapshot:
        """Contents of a checkpoint, independent of later steps."""
        model = self.model
        state = {
            "robots": self.robots.get_state(),
            "last_observations": model._last_obs,
            "last_episode_starts": model._last_episode_starts,
            "random": checkpoint.random_state(),
            **model.get_memory(),
        }
        description = {
            "step": model.num_timesteps,
            "updates": model._n_updates,
            "stage": self.stage,
            "wall_s": self._wall(),
            "written": datetime.now(UTC).isoformat(timespec="seconds"),
            "policy": self.settings.to_plain(),
            "config": self.config.to_plain(),
            "scenario": self.config.base_scenario().to_plain(),
            "provenance": results.provenance(("torch", "stable-baselines3", "safetensors")),
        }
        tables = {  # as STATE_FILES says
            "network": self._weights(),
            "optimizer": flatten(model.policy.optimizer.state_dict()["state"]),
            "state": flatten(state),
        }
        return description, copy.deepcopy(tables)

    def update(self) -> int:
        """Collect one rollout and update; returns the steps done so far."""
        model, config = self.model, self.config
        if (stage := config.stage(model.num_timesteps)) != self.stage:
            self._enter_stage(stage)
            self._reset_robots()
        begun, seen = self.robots.renew_sensors(model._n_updates // config.epochs)
        model._last_obs[begun], model._last_episode_starts[begun] = seen, True
        began, robots = time.perf_counter(), self.robots
        robots.seconds, robots.alignment, robots.aligned = 0.0, 0.0, 0
        model.learn(config.samples_per_update, log_interval=None, reset_num_timesteps=False)
        self._took = time.perf_counter() - began
        self._seconds += self._took
        self._environment_seconds += robots.seconds
        if not all(torch.isfinite(weights).all() for weights in model.policy.parameters()):
            raise UserError(
                f"training diverged: weights are not finite after step {model.num_timesteps}; use "
                f"a --learning-rate below {config.learning_rate}"
            )
        return int(model.num_timesteps)

    def report(self) -> dict[str, Any]:
        """Row of metrics.csv for the last update."""
        model, robots, took = self.model, self.robots, self._took
        told = {key.removeprefix("train/"): v for key, v in model.logger.name_to_value.items()}
        model.logger.dump(model.num_timesteps)
        row = {
            "step": model.num_timesteps,
            "update": model._n_updates // self.config.epochs,
            "stage": self.stage,
            **episode_numbers(list(model.ep_info_buffer)),
            "alignment": robots.alignment / max(robots.aligned, 1),
            "entropy": -told["entropy_loss"],
            **{column: told[name] for column, name in _LOSSES.items()},
            "wall_s": self._wall(),
            "steps_per_s": self.config.samples_per_update / took,
            "environment_share": robots.seconds / took,
        }
        row = {key: value.item() if hasattr(value, "item") else value for key, value in row.items()}
        model.ep_info_buffer.clear()
        model.ep_success_buffer.clear()
        self._tell(self._metrics, "train", row)
        return row

    def evaluate(self) -> list[dict[str, Any]]:
        """Rows of evaluation.csv: the deterministic policy on held-out initial conditions."""
        config, settings, weights = self.config, self.settings, self._weights()
        scenarios = [resolve_scenario(name) for name in config.eval_scenarios]
        rows = []
        for scenario in scenarios or [config.plain_scenario()]:
            episodes, _ = play(
                scenario,
                partial(LearnedPolicy, scenario, weights, settings),
                margin=None if scenario.model.nonholonomic else settings.promised_margin,
                episodes=config.eval_episodes,
                seed=EVALUATION_SEEDS,
            )
            numbers = statistics.summarise(scenario, "learned", episodes)
            rows.append({"step": self.model.num_timesteps, **numbers})
            self._tell(self._evaluations, f"evaluation-{scenario.name}", rows[-1])
        return rows

    def _weights(self) -> dict[str, NDArray[Any]]:
        return flatten(self.model.policy.state_dict())

    def speed(self) -> str:
        """Environment time since this process started or resumed the run."""
        if not self._seconds:
            return "the run was already complete"
        share = 100.0 * self._environment_seconds / self._seconds
        return (
            f"{share:.0f} % of the time in the environment; the remaining {100.0 - share:.0f} % "
            "are PPO itself"
        )

    def _wall(self) -> float:
        """Total wall-clock time of the run, s, over all resumptions."""
        return self._wall_before + time.perf_counter() - self._began


def run(config: Config, on_update: OnUpdate | None = None) -> Result:
    """Start or resume a run and train to its end; see ``ppo.run``."""
    console = Console(soft_wrap=True)
    threads, numbers = torch.get_num_threads(), torch.get_default_dtype()
    folder = config.resume or config.out
    try:
        if config.resume is not None:
            read_config(folder)  # before anything is created
        elif checkpoints.candidates(folder):
            raise UserError(f"--out {folder} contains a run; --resume it, or choose another folder")
        with interrupts.raised("train"), claimed(folder, ".lock", str(folder)):
            config, place = checkpoint.where_to_begin(config, console)
            _check_device(config.device)
            torch.set_num_threads(config.num_threads or available_cores())
            torch.set_default_dtype(torch.float32)
            if (least := config.samples_per_update) > config.total_steps:
                console.print(
                    f"one update is {least:,} decisions (--num-envs × robots × --n-steps), more "
                    f"than --total-steps {config.total_steps:,}: the run ends after the first one"
                )
            training = Trainer(config)
            step = training.restore(place) if place else training.begin()
            return _loop(training, step, console, on_update)
    except CheckpointError as error:
        raise UserError(str(error)) from error
    except OSError as error:
        raise UserError(checkpoint.write_failure(folder, error)) from error
    finally:
        torch.set_num_threads(threads)
        torch.set_default_dtype(numbers)


def _check_device(device: str) -> None:
    try:
        torch.empty(0, device=device)
    except (RuntimeError, AssertionError, NotImplementedError) as error:
        said = str(error).partition("\n")[0]
        raise UserError(f"--device is {device!r}: {said}; cpu is always available") from error


def _loop(training: Trainer, step: int, console: Console, on_update: OnUpdate | None) -> Result:
    """Train until the end, a signal or ``on_update`` stops the run, and save the last state."""
    config, kept = training.config, training.snapshot()
    metrics: dict[str, Any] = {}
    status, stopped, saved = 0, False, True
    try:
        with Progress(console=console, transient=True) as progress:
            bar = progress.add_task("", total=config.total_steps, completed=step)
            while step < config.total_steps and not stopped:
                before, step = step, training.update()
                row = training.report()
                progress.update(bar, completed=step, description=_line(row))
                last, evaluation = step >= config.total_steps, []
                if config.eval_every and (last or _crosses(config.eval_every, before, step)):
                    evaluation = training.evaluate()
                    for result in evaluation:
                        console.print(_evaluation_line(result), style="bold")
                kept, metrics, saved = training.snapshot(), with_former_names(row), False
                if last or _crosses(config.checkpoint_every, before, step):
                    place, saved = training.save(kept), True
                    console.print(f"{_line(row)} · {place.name}")
                if on_update is not None:
                    told = with_former_names(row)
                    told["evaluation"] = [with_former_names(one) for one in evaluation]
                    stopped = on_update(row["update"], told) is True
    except KeyboardInterrupt as error:
        training.save(kept)  # rows of later steps are removed on resumption
        step = kept[0]["step"]
        resume = f"rendezvous train --resume {config.out}"
        console.print(f"stopped at step {step:,}; resume with {resume}")
        status = interrupts.status_of(error)
    else:
        if not saved:
            training.save(kept)
        said = "stopped by on_update" if stopped else "done"
        console.print(f"{said}: {step:,} steps; {training.speed()}")
    finally:
        if training.events:
            training.events.close()
    evaluations = read_evaluations(config.out / "evaluation.csv", step)
    return Result(config.out, status, stopped, step, metrics, evaluations)


def _crosses(every: int, before: int, step: int) -> bool:
    return step // every > before // every


def _line(row: Mapping[str, Any]) -> str:
    if not row["episodes"]:
        return f"step {row['step'] / 1e6:.2f} M · no episode has ended in this update"
    return (
        f"step {row['step'] / 1e6:.2f} M · met {100 * row['success']:.0f} % · collision-free "
        f"{100 * row['collision_free_success']:.0f} % · {number(row['median_time'], '.1f')} s · "
        f"alignment {row['alignment']:.2f} · {row['steps_per_s']:.0f} steps/s"
    )


def _evaluation_line(row: Mapping[str, Any]) -> str:
    names = ("collision_free_success", "collision_free_low", "collision_free_high")
    clean, low, high = (number(100 * row[name], ".1f") for name in names)
    return (
        f"{row['scenario']} met {100 * row['success']:.1f} % · collision-free {clean} "
        f"[{low}, {high}] % · median {row['median_time']:.2f} s · "
        f"alignment ≥ {number(row['min_alignment'], '.3f')} · "
        f"{counted(row['episodes'], 'held-out initial condition')}"
    )
