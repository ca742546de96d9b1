"""Settings of a comparison and the resulting jobs."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from rendezvous_env import baselines
from rendezvous_env.scenario import scenarios as named_scenarios
from rendezvous_env.scenario.scenario import Scenario
from rendezvous_env.suggestions import closest_match

from .. import policies, results
from ..checks import Bounds, UserError
from ..tasks import Workers
from . import sweep as levels
from .evaluation import starts_of
from .out_folder import part_of

_CLUTTER = ("4", "8", "12", "16", "24", "16-team-3", "16-team-8", "16-team-16", "16-team-32", "32")
DEFAULT_SCENARIOS = (
    *("fig3", "fig4", "duo", "swarm-20", "ring-12", "tree-12", "random-10"),
    *("unicycle-6", "uav-6", "cloud-8"),
    *(f"clutter-{name}" for name in _CLUTTER),
    *("trap", "corridor", "rooms"),
)

_STARTS, _KEPT = 100, 3
_LONGEST_NAME = 200
"""Maximum length of a scenario name, bytes; figure files are named after scenarios."""
_LARGE = 8
"""Number of robots above which scenarios with obstacles get fewer initial conditions."""

EXAMPLES = (
    "",
    "--scenario clutter-8 trap --policies tangent-merged learned --episodes 200",
    "--scenario fig3 --set n_robots=9 time_limit=60",
    "--scenario clutter-8 --sensing noise=0,0.1,0.2 --against tangent-merged",
)
FLAG_GROUPS = {
    "Output": ("out", "fresh", "keep", "details", "json", "figures", "pdf"),
    "Workers": ("jobs", "on", "address"),
}


@dataclass(frozen=True)
class Config(Workers):
    """Compare policies on the same initial conditions and under the same speed limit."""

    scenarios: Annotated[tuple[str, ...], arg(aliases=("--scenario",))] = DEFAULT_SCENARIOS
    """Names of scenarios, or paths of TOML files; in Python also Scenario objects."""
    policies: Annotated[tuple[str, ...], arg(aliases=("--policy",))] = ()
    """Names of policies, learned:PATH of a run, or module:function of a custom one: a function of a
    scenario that returns a policy, or None where it does not fit. With LABEL=NAME, tables, figures
    and the report use LABEL. Default: every policy that fits, except oracles and those without
    observations. If scenarios are not named either, policies without a chance are skipped: laws
    of the literature in scenarios with obstacles, which they do not sense, and policies for
    imperfect sensors in scenarios with exact ones."""
    episodes: Annotated[int | None, Bounds(1)] = None
    """Number of initial conditions per scenario. Default: 100; with obstacles and more than eight
    robots, 800 divided by their number. A scenario with given initial positions is run once."""
    seed: Annotated[int, Bounds(0)] = 0
    """First seed: initial condition k of every scenario has seed SEED + k for all policies."""
    out: Path = Path("out/compare")
    """Folder for tables, trajectories and figures; an existing one is replaced at the end. Finished
    results are in OUT.part until then, and the same command resumes."""
    fresh: Annotated[bool, arg(name="overwrite", aliases=("--fresh",))] = False
    """Discard the unfinished results of another command in OUT.part."""
    keep: Annotated[int | None, Bounds(0), arg(name="keep-trajectories", aliases=("--keep",))] = (
        None
    )
    """Number of recorded trajectories per job. Default: 3. If none of them fails, the first failure
    is recorded as well."""
    sensing: tuple[str, ...] = ()
    """Sensor fields and levels to sweep, one field at a time, for example noise=0,0.1,0.2
    range=none,4,2. The level none is the exact sensor."""
    set: tuple[str, ...] = ()
    """Overrides of scenario fields, for example n_robots=9 time_limit=60."""
    ceiling: Annotated[int, Bounds(0), arg(name="oracle-runs", aliases=("--ceiling",))] = 0
    """Number of randomised runs of law (4) per initial condition. Their best is a hindsight
    estimate for heading policies; a planner with the map gives an upper bound. 0 disables both."""
    details: bool = False
    """Print times, path lengths and margins of every policy as well; results.csv always has
    them."""
    against: str | None = None
    """Reference policy for paired differences with intervals, printed and in paired.csv."""
    json: Path | None = None
    """File for a JSON summary."""
    figures: bool = True
    """Draw figures."""
    pdf: bool = False
    """Write each figure as PDF as well."""

    def sweeps(self) -> list[levels.Sweep]:
        """Scenarios at the levels of the sensor sweeps."""
        return levels.sweeps(_resolve(self), self.sensing)

    def count(self, scenario: Scenario) -> int:
        """Number of distinct initial conditions of a scenario."""
        asked = _fewer(_STARTS, scenario) if self.episodes is None else self.episodes
        return starts_of(scenario, asked)

    def kept(self, scenario: Scenario) -> int:
        """Number of recorded episodes."""
        return _fewer(_KEPT, scenario) if self.keep is None else self.keep


def _fewer(usual: int, scenario: Scenario) -> int:
    """Default number, reduced for many robots among obstacles."""
    large = scenario.obstacles and scenario.n_robots > _LARGE
    return max(1, usual * _LARGE // scenario.n_robots) if large else usual


@dataclass(frozen=True)
class Job:
    """One policy, by the name that makes it, on one scenario."""

    scenario: Scenario
    policy: str
    label: str = ""
    """Label in tables, figures and the report, if different from the name."""

    @property
    def name(self) -> str:
        """The label, or the policy's name."""
        return self.label or self.policy


def plan(config: Config) -> list[Job]:
    """Jobs of a configuration; a UserError if it is invalid."""
    episodes = config.episodes or _STARTS
    if config.seed + episodes > 2**63:
        raise UserError(f"--seed is {config.seed}; with {episodes} episodes it is too large")
    labels = policies.labels_of(config.policies)
    policies.check_names(list(labels))
    scenarios = _resolve(config)
    if swept := levels.sweeps(scenarios, config.sensing):
        scenarios = list(dict.fromkeys(one for sweep in swept for one in sweep.scenarios))
        _check_names(scenarios)
    jobs: list[Job] = []
    for scenario in scenarios:
        brief = config.scenarios == DEFAULT_SCENARIOS
        fitting = policies.fitting(scenario, list(labels), brief=brief)
        if not fitting:
            known = ", ".join(baselines.names(scenario))
            raise UserError(f"none of the named policies fits {scenario.name}; these do: {known}")
        jobs += [Job(scenario, name, labels.get(name, "")) for name in fitting]
    played = list(dict.fromkeys(job.name for job in jobs))
    if config.against is not None and config.against not in played:
        near = closest_match(config.against, played, after=" ")
        raise UserError(
            f"--against {config.against!r} is not compared; {near}these are: {', '.join(played)}"
        )
    if config.json is not None:
        path, out = (Path(os.path.realpath(one)) for one in (config.json, config.out))
        if {out, part_of(out)} & {path, *path.parents}:
            raise UserError(f"--json {config.json}: is in OUT or OUT.part; choose another folder")
        results.prepare_file(config.json, "--json")
    return jobs


def _resolve(config: Config) -> list[Scenario]:
    if not config.scenarios:
        raise UserError("--scenarios is empty; known are " + ", ".join(named_scenarios.names()))
    resolved = [policies.resolve_scenario(name, config.set) for name in config.scenarios]
    _check_names(resolved)
    return resolved


def _check_names(scenarios: list[Scenario]) -> None:
    names = [scenario.name for scenario in scenarios]
    for name in names:
        if "/" in name or os.sep in name:
            raise UserError(f"scenario name {name!r} would name a folder; remove the slash")
        if (size := len(name.encode())) > _LONGEST_NAME:
            what = f"scenario name {name[:20]}… has {size} bytes; names of figures take"
            raise UserError(f"{what} {_LONGEST_NAME}: give a shorter one")
        if names.count(name) > 1:
            raise UserError(f"two scenarios have the name {name!r}; their results would be mixed")
