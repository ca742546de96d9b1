"""``rendezvous train``: one run, or one run per seed."""

from contextlib import closing, redirect_stdout
from dataclasses import dataclass, fields, replace
from pathlib import Path

from rendezvous_env.baselines.learned import shipped

from rendezvous_env.checks import counted

from .. import policies, results
from ..checks import UserError, check_unused, format_argument
from ..compare.playing import TOGETHER, make_ready
from ..compare.settings import Job
from ..console import Console
from ..tasks import Workers, parallel_map
from . import ppo
from .settings import CONFIG, check, read_config, same_run
from .settings import EXAMPLES as EXAMPLES
from .settings import FLAG_GROUPS as SETTINGS_GROUPS
from .settings import FORMER_FLAGS as FORMER_FLAGS
from .settings import Config as Settings

FLAG_GROUPS = {"Several seeds": ("seeds", "jobs", "on", "address"), **SETTINGS_GROUPS}


@dataclass(frozen=True)
class Config(Settings, Workers):
    """Train a policy with PPO under a safety filter that holds for any network output."""

    seeds: tuple[int, ...] = ()
    """Seeds of several runs, written to OUT/seed-0 and so on. Each run uses one thread and is
    bitwise reproducible. After an interrupt, the same command resumes all runs. The worker flags
    apply to this option; a Ray cluster must share OUT with this machine."""


def run(config: Config) -> int:
    """Start or resume training, see ``ppo.run``; a UserError also for inconsistent seeds."""
    settings = Settings(**{field.name: getattr(config, field.name) for field in fields(Settings)})
    if not config.seeds:
        return ppo.run(settings).status
    runs = runs_of(settings, config.seeds)
    results.prepare_folder(settings.out)
    console = Console(soft_wrap=True)
    console.print(f"{counted(len(runs), 'run')}; {_log_of(runs[0])} and so on have the output")
    try:
        with closing(parallel_map(_train, runs, config, _stays_here, long=True)) as found:
            for number, status in found:
                if status:
                    return status
                console.print(f"{runs[number].out}: done")
    except KeyboardInterrupt as error:
        error.add_note("the same command resumes from the last checkpoint of each run")
        raise
    return 0


def runs_of(settings: Settings, seeds: tuple[int, ...]) -> list[Settings]:
    """Settings of one run per seed; runs that exist are resumed.

    Raises:
        UserError: for a repeated seed, a flag of single runs, or a folder with other settings.
    """
    if len(set(seeds)) < len(seeds):
        raise UserError(f"--seeds {format_argument(seeds)}: name each once")
    check_unused(settings, dict.fromkeys(("seed", "resume"), "--seeds determines the runs"))
    runs = []
    for seed in seeds:
        threads, out = settings.num_threads or 1, settings.out / f"seed-{seed}"
        one = replace(settings, seed=seed, out=out, num_threads=threads)
        check(one)
        if (out / CONFIG).exists():
            if not same_run(one, read_config(out)):
                raise UserError(f"{out} contains a run of other settings; choose another --out")
            one = replace(one, resume=out)
        runs.append(one)
    return runs


def _log_of(settings: Settings) -> Path:
    """Path of the text output of a run."""
    return settings.out.with_name(f"{settings.out.name}.txt")


def _stays_here(settings: Settings) -> bool:
    """True if a run needs objects registered in this process."""
    others = map(policies.resolve_scenario, settings.eval_scenarios)
    return any(map(policies.registered, (settings.base_scenario(), *others)))


def _train(settings: Settings) -> int:
    """Train one run with its output redirected to a file; returns the exit status."""
    scenario = settings.base_scenario()
    with _log_of(settings).open("a", encoding="utf-8") as log, redirect_stdout(log):
        for name in policies.fitting(scenario, shipped.NAMES):  # they need the same kernels
            make_ready(Job(scenario, name), TOGETHER)
        return ppo.run(settings).status
