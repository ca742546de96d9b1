"""``rendezvous verify``: search for violations of theorems and certificates."""

import itertools
import math
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

from rich.box import SIMPLE_HEAD
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
from tyro.conf import arg

from rendezvous_env.checks import counted

from .. import policies
from ..checks import Bounds, check_unused, unknown_name
from ..console import Console
from ..results import write_csv
from ..resume import RunCheckpoint, program
from ..tasks import Workers, parallel_map
from . import claims as cases
from . import policy_search
from .claims import BATCH, CLAIMS, Claim
from .falsification import TEAMS, Tally, climb, shrink, write
from .monitors import NUMBERS
from .random_scenarios import DRAWS, STARTS, trials_of

_BAR = TextColumn("{task.description:16}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
_MOST_TASKS = 256  # of a claim
_SHOWN = "trials", "worst_margin", "worst_time_over_bound", "violations"
"""Printed columns of verify.csv."""
_DRAWS = 10  # initial conditions per task of a search for counterexamples
_MOST_WRITTEN = 20  # maximum number of violations of a search to shrink and write

EXAMPLES = (
    "--claims theorem-2 --trials 100000",
    "--random-scenarios --trials 3000",
    "--policy my_policies:make --scenario ring-12",
)
FLAG_GROUPS = {
    "Policies of your own": ("policy", "search", "scenario", "set"),
    "Workers": ("jobs", "on", "address"),
}


@dataclass(frozen=True)
class Config(Workers):
    """Check every claim of the theory on random environments, or search for counterexamples.

    The exit status is 1 if a claim is violated or a counterexample of the policy is found.
    """

    trials: Annotated[int, Bounds(1, 10**8)] = 1000
    """Environments for each claim; initial conditions with --random-scenarios or --policy."""
    seed: Annotated[int, Bounds(0)] = 0
    """Seed of the random environments."""
    out: Path = Path("out/verify")
    """Folder for verify.csv. Finished results are in OUT/verify.part until then, and the same
    command resumes."""
    min_alignment: Annotated[float, Bounds(0, 1, "()")] = 0.3
    """Smallest sampled minimum alignment ε; run time grows with 1/ε²."""
    claims: tuple[str, ...] = ()
    """Names of the claims to check. Default: all."""
    only_batch: Annotated[int | None, Bounds(0)] = None
    """Repeat a single batch, as named in the report of a violation."""
    any: Annotated[bool, arg(name="random-scenarios", aliases=("--any",))] = False
    """Check random scenarios instead of claims: request every certificate and test each of its
    bounds against adversaries. A violation is shrunk and written to OUT as a TOML file with the
    actions that repeat it."""
    kinds: Annotated[int | None, Bounds(1)] = None
    """Maximum number of kinds of scenarios for --random-scenarios, since each kind is compiled.
    Default: one per 300 scenarios."""
    policy: str | None = None
    """Search for counterexamples of this policy instead of claims: its name, learned:PATH, or
    MODULE:FUNCTION. Initial conditions, graphs and weights are varied until V rises, the convex
    hull grows, or robots make no progress. The simplest of each is written to OUT as a TOML file,
    with the choices that repeat it."""
    search: tuple[Literal["rise", "growth", "deadlock"], ...] = ("rise", "growth", "deadlock")
    """Violations to search for with --policy: increases of V and growth of the convex hull in steps
    without a merge or contact, and deadlocks. Certified headings and tanks prevent increases of V,
    but not growth of the hull."""
    scenario: Annotated[str, arg(aliases=("--scenarios",))] = "fig3"
    """Scenario of --policy: its name, or the path of a TOML file."""
    set: tuple[str, ...] = ()
    """With --policy, overrides of scenario fields, for example n_robots=9 time_limit=60."""
    fresh: Annotated[bool, arg(name="overwrite", aliases=("--fresh",))] = False
    """Discard the unfinished results of another command in OUT/verify.part."""


class WorkUnit(NamedTuple):
    """Independent unit of work: batches of a claim, or random scenarios."""

    name: str  # of its cell
    group: str  # the claim, or "scenarios"
    looks: tuple[Callable[[], Tally], ...]


def check_config(config: Config) -> None:
    """Validate the settings; a UserError names flag, value and remedy."""
    unused = {"kinds": "add --random-scenarios"}
    if config.policy is None:
        unused |= dict.fromkeys(("scenario", "search", "set"), "add --policy")
    if config.any or config.policy is not None:
        which = "--random-scenarios" if config.any else "--policy"
        why = f"{which} checks no claims: omit it"
        unused |= dict.fromkeys(("claims", "only_batch", "min_alignment"), why)
    if config.any:
        del unused["kinds"]
        words = "--random-scenarios checks certificates, which do not depend on a policy: omit it"
        unused |= {"policy": words}
    check_unused(config, unused)
    known = [claim.name for claim in CLAIMS]
    for name in config.claims:
        if name not in known:
            raise unknown_name("claim", name, known)


def run(config: Config, claims: Sequence[Claim] = CLAIMS, console: Console | None = None) -> int:
    """Check claims or certificates, print the table and write verify.csv or any.csv.

    Returns:
        Exit status: 1 if there is a violation.

    Raises:
        UserError: for invalid flags or a folder that is not writable.
    """
    check_config(config)
    console = console or Console(width=None if sys.stdout.isatty() else 120)
    if config.policy is not None:
        return _run_search(config, config.policy, console)
    if config.any:
        return _run_random_scenarios(config, console)
    chosen = [claim for claim in claims if not config.claims or claim.name in config.claims]
    return _run_claims(config, chosen, console)


def _run_claims(config: Config, claims: Sequence[Claim], console: Console) -> int:
    """Check claims, and print those that are violated."""
    path, plan = config.out / "verify.csv", {"claims": [claim.name for claim in claims]}

    def rows_of(tallies: Mapping[str, Tally]) -> list[dict[str, Any]]:
        return [claim_row(claim, config, tallies[claim.name]) for claim in claims]

    tallies, rows = _finish(config, path, plan, _tasks_of_claims(config, claims), rows_of, console)
    shown = [
        {"claim": claim.name, "quantity": claim.statement, **{k: row[k] for k in _SHOWN}}
        for claim, row in zip(claims, rows, strict=True)
    ]
    console.print(table_of("Claims of the theory, checked numerically", shown))
    for row in rows:
        if row["violations"]:
            repeat = f"to repeat the first time:\n  {row['first_violation']}"
            console.print(f"{row['claim']} is violated; {repeat}", soft_wrap=True)
    total = Tally()
    for tally in tallies.values():
        total.join(tally)
    return _conclude(total, counted(total.violations, "violation"), path, console)


def _run_random_scenarios(config: Config, console: Console) -> int:
    """Test certificates of random scenarios, and write the violations."""
    path = config.out / "any.csv"
    tallies, rows = _finish(config, path, {}, _tasks_of_any(config), _rows_of_theorems, console)
    total = tallies["scenarios"]
    title = f"Certificates of {_searched(total)}"
    console.print(table_of(title, rows))
    for one in _write_found(config, total):
        console.print(one, soft_wrap=True)
    found = counted(total.violations, "violation")
    return _conclude(total, f"{found}, {_steps_of(total)}", path, console)


def _rows_of_theorems(tallies: Mapping[str, Tally]) -> list[dict[str, Any]]:
    return theorem_rows(tallies["scenarios"])


def _conclude(total: Tally, found: str, path: Path, console: Console) -> int:
    """Print the last line; returns the exit status."""
    console.print(f"{found} in {total.seconds:.0f} s of work; {path}", soft_wrap=True)
    return int(total.violations > 0)


def _finish(
    config: Config,
    path: Path,
    plan: Mapping[str, Any],
    tasks: Sequence[WorkUnit],
    rows_of: Callable[[Mapping[str, Tally]], list[dict[str, Any]]],
    console: Console,
) -> tuple[dict[str, Tally], list[dict[str, Any]]]:
    """Run the unfinished tasks, and write the rows of all tallies."""
    asked = ("trials", "seed", "min_alignment", "only_batch", "any", "kinds", "policy", "search")
    plan = program() | {name: getattr(config, name) for name in asked} | dict(plan)
    part = RunCheckpoint(path.with_suffix(".part"), plan, "verification")
    tallies = {task.group: Tally() for task in tasks}
    with (
        part.at_work(config.out, console, fresh=config.fresh),
        Progress(*_BAR, console=console, transient=True) as progress,
    ):
        count = config.trials if config.only_batch is None else min(config.trials, BATCH)
        bars = {group: progress.add_task(group, total=count) for group in tallies}
        for task, found, _ in part.finish(tasks, lambda left: parallel_map(look, left, config)):
            tallies[task.group].join(found)
            progress.advance(bars[task.group], found.trials)
        rows = rows_of(tallies)
        write_csv(path, rows, None if rows else ["theorem"])
        part.discard()
    return tallies, rows


def _run_search(config: Config, policy: str, console: Console) -> int:
    """Search for counterexamples of a policy; print what was found, and write the simplest."""
    policies.check_names([policy])
    scenario = policies.resolve_scenario(config.scenario, config.set)
    policies.tried(policy, scenario)
    count = math.ceil(config.trials / STARTS)
    parts = [range(k, min(k + _DRAWS, count)) for k in range(0, count, _DRAWS)]
    tasks = []
    for part in parts:
        given = policy, scenario, config.seed
        looks = (partial(policy_search.search, *given, k, config.search) for k in part)
        tasks.append(WorkUnit(f"policy-{part[0]:07d}", "scenarios", tuple(looks)))

    def rows_of(tallies: Mapping[str, Tally]) -> list[dict[str, Any]]:
        return policy_search.rows_of(tallies["scenarios"], config.search)

    source = {"scenario": scenario.to_plain(), "source": policies.source_digest(policy)}
    path = config.out / "policy.csv"
    tallies, rows = _finish(config, path, source, tasks, rows_of, console)
    tally = tallies["scenarios"]
    console.print(table_of(f"{_searched(tally)} under {policy}", rows))
    for number, trial, played in policy_search.first_of_each(tally):
        small, played = shrink(trial, played)
        file = write(config.out, f"policy-{config.seed}-{number}", small, played)
        console.print(
            f"{policy_search.words_of(played.violation)}, {small.scenario.n_robots} robots: "
            f"{file}; to see it: rendezvous render --scenario {file} --policy {policy}",
            soft_wrap=True,
        )
    found = counted(tally.violations, "counterexample")
    return _conclude(tally, f"{found}, {_steps_of(tally)}", path, console)


def _searched(tally: Tally) -> str:
    """Numbers of initial conditions and scenarios that a search has played, as text."""
    starts = counted(tally.trials, "initial condition")
    return f"{starts} of {counted(tally.trials // STARTS, 'random scenario')}"


def _steps_of(tally: Tally) -> str:
    return f"{counted(tally.steps, 'step')} of {TEAMS} environments"


def look(task: WorkUnit) -> Tally:
    """Run a task."""
    tally = Tally()
    for one in task.looks:
        tally.join(one())
    return tally


def _tasks_of_claims(config: Config, claims: Sequence[Claim]) -> list[WorkUnit]:
    """Tasks of the claims, as batches with the number of environments that count."""
    count = math.ceil(config.trials / BATCH)
    batches = [(k, min(BATCH, config.trials - k * BATCH)) for k in range(count)]
    if config.only_batch is not None:
        batches = [(config.only_batch, min(config.trials, BATCH))]
    size = math.ceil(len(batches) / _MOST_TASKS)
    parts = [batches[k : k + size] for k in range(0, len(batches), size)]
    tasks = []
    for claim, part in itertools.product(claims, parts):
        check = partial(cases.check, claim, config.seed, least_margin=config.min_alignment)
        looks = tuple(partial(check, number, count) for number, count in part)
        tasks.append(WorkUnit(f"{claim.name}-{part[0][0]:07d}", claim.name, looks))
    return tasks


def _tasks_of_any(config: Config) -> list[WorkUnit]:
    """Tasks of random scenarios, each of one kind, with a maximum number of kinds."""
    draws = math.ceil(config.trials / STARTS)
    parts = [range(k, min(k + DRAWS, draws)) for k in range(0, draws, DRAWS)]
    kinds, tasks = config.kinds or len(parts), []
    for k, part in enumerate(parts):
        looks = tuple(partial(_try_all, config.seed, number, k % kinds) for number in part)
        tasks.append(WorkUnit(f"any-{k:07d}", "scenarios", looks))
    return tasks


def _try_all(seed: int, number: int, kind: int) -> Tally:
    """Run the trials of one sampled scenario."""
    began, tally = time.perf_counter(), Tally(trials=STARTS)
    for drawn in trials_of(seed, number, kind):
        trial, played = climb(drawn)
        tally.join(played)
        if played.violation is not None:
            tally.found.append((number, trial, played))
    tally.seconds = time.perf_counter() - began
    return tally


def claim_row(claim: Claim, config: Config, tally: Tally) -> dict[str, Any]:
    """Result row of a claim.

    The margin is relative (to V(0), the time limit or 2 max a); a negative one is a violation apart
    from rounding.
    """
    repeat = (
        f"rendezvous verify --claims {claim.name} --seed {config.seed} --only-batch {tally.first} "
        f"--min-alignment {config.min_alignment}"
    )
    return {
        "claim": claim.name,
        "trials": tally.trials,
        "worst_margin": tally.margin,
        "worst_time_over_bound": tally.ratio.get(claim.name, math.nan),
        "violations": tally.violations,
        "seconds": round(tally.seconds, 3),
        "first_violation": "" if tally.first is None else repeat,
    }


def theorem_rows(tally: Tally) -> list[dict[str, Any]]:
    """Result rows by theorem: counts of certificates, checks and violations."""
    return [
        {
            "theorem": name,
            **{what: tally.counts[name, what] for what in ("granted", *NUMBERS)},
            "worst_time_over_bound": tally.ratio.get(name, math.nan),
            "violations": tally.counts[name, "violations"],
        }
        for name in sorted({name for name, _ in tally.counts})
    ]


def _write_found(config: Config, tally: Tally) -> Iterator[str]:
    """Shrink and write violations; returns a message for each."""
    tally.found.sort(key=lambda found: found[0])
    for number, trial, played in tally.found[:_MOST_WRITTEN]:
        small, played = shrink(trial, played)
        file = write(config.out, f"any-{config.seed}-{number}-{trial.by}", small, played)
        yield f"scenario {number}: {played.violation}; {file}"


def table_of(title: str, rows: Sequence[dict[str, Any]]) -> Table:
    """Table of rows, numbers right-aligned, violations in red."""
    table = Table(title=title, box=SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
    for name, value in rows[0].items() if rows else ():
        words = isinstance(value, str) and name in ("claim", "quantity", "theorem")
        # one word per line, to leave space for names
        table.add_column(name.replace("_", "\n"), justify="left" if words else "right")
    for row in rows:
        style = "bold red" if row["violations"] else None
        shown = [f"{v + 0.0:.3g}" if isinstance(v, float) else str(v) for v in row.values()]
        table.add_row(*["" if one == "nan" else one for one in shown], style=style)
    return table
