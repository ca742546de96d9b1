"""``rendezvous verify``: the theorems of docs/theory.md as a command that can fail."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
from tyro.conf import arg

from rendezvous_env.checks import nearest_word

from ..checks import UserError, check_least, check_most
from ..results import write_csv
from ..resume import Part, claimed, program
from ..tasks import Workers, each
from .cases import BATCH
from .claims import CLAIMS, Claim, Finding, blocks_of, look, worst
from .counterexamples import Tally, any_blocks, look_at_any, rows_of, shrink, write
from .falsification import TEAMS

COLUMNS = (
    *("claim", "trials", "worst_margin", "worst_time_over_bound", "violations"),
    *("seconds", "first_violation"),
)
"""Of verify.csv; the margin is a share (of V(0), of the time limit, of 2 max a), and negative
means violated, rounding aside."""
_BAR = TextColumn("{task.description:16}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
_MOST_WRITTEN = 20
"""Violations of a search that are made small and written."""

FLAG_GROUPS = {"Workers": ("jobs", "on", "address")}


@dataclass(frozen=True)
class Config(Workers):
    """Check every claim of the theory on random teams; exit status 1 if one is violated."""

    trials: int = 1000
    """Teams for each claim, or with --any scenarios."""
    seed: int = 0
    """Other seeds draw other teams."""
    out: Path = Path("out/verify")
    """Folder for verify.csv. Until it is written what is finished lies in OUT/verify.part, and the
    same command goes on with it."""
    min_alignment: float = 0.3
    """Least margin ε that is drawn; waiting times grow with 1/ε²."""
    claims: tuple[str, ...] = ()
    """Names of the claims to check; all if none is given."""
    only_batch: int | None = None
    """Repeat one batch of teams, as a violation's report names it."""
    any: bool = False
    """Try whole scenarios drawn at random instead of claims: ask for every certificate, and hold
    each of its numbers against what adversaries can do. What is violated is made small and written
    to OUT as a TOML file with the choices that repeat it."""
    kinds: int | None = None
    """Most kinds of scenarios for --any: to compile for one takes as long as to play a thousand. If
    None, each 300 scenarios have their own."""
    fresh: Annotated[bool, arg(name="overwrite", aliases=("--fresh",))] = False
    """Throws away what another command has left unfinished in OUT/verify.part."""

    def batches(self) -> list[tuple[int, int]]:
        """(number, teams that count) of each batch to run."""
        if self.only_batch is not None:
            return [(self.only_batch, min(self.trials, BATCH))]
        count = math.ceil(self.trials / BATCH)
        return [(k, min(BATCH, self.trials - k * BATCH)) for k in range(count)]


def check_config(config: Config) -> None:
    """Refuse what cannot be run, by name.

    Raises:
        UserError: naming the flag, its value and what would be right.
    """
    check_least(config, trials=1, seed=0, only_batch=0, kinds=1)
    check_most(config, trials=10**8)
    config.check_workers()
    if not 0 < config.min_alignment < 1:
        raise UserError(
            f"--min-alignment is {config.min_alignment}; it must lie between 0 and 1, exclusive"
        )
    known = [claim.name for claim in CLAIMS]
    for name in config.claims:
        if name not in known:
            near = nearest_word(name, known)
            hint = f"did you mean {near!r}? " if near else ""
            raise UserError(f"claim {name!r} is unknown; {hint}known are {', '.join(known)}")


def run(config: Config, claims: Sequence[Claim] = CLAIMS, console: Console | None = None) -> int:
    """Check the claims, or what certificates promise; print the table, write verify.csv or any.csv;
    the exit status.

    Raises:
        UserError: for an impossible flag, or a folder that cannot be written to.
    """
    check_config(config)
    console = console or Console(width=None if sys.stdout.isatty() else 120)
    chosen = [claim for claim in claims if not config.claims or claim.name in config.claims]
    path = config.out / ("any.csv" if config.any else "verify.csv")
    part = Part(path.with_suffix(".part"), plan_of(config, chosen), "verification")
    with claimed(config.out, ".verify.lock", f"--out {config.out}"):
        with (
            part.at_work(config.out, console, fresh=config.fresh),
            Progress(*_BAR, console=console, transient=True) as bars,
        ):
            if config.any:
                tally = _try_anything(config, part, bars)
                rows = rows_of(tally)
                write_csv(path, list(rows[0]) if rows else ["theorem"], rows)
            else:
                rows = _look_at_all(config, chosen, part, bars)
                write_csv(path, COLUMNS, rows)
            part.discard()
    if config.any:
        return _report_any(config, tally, rows, path, console)
    return _report(rows, chosen, path, console)


def plan_of(config: Config, claims: Sequence[Claim]) -> dict[str, Any]:
    """All that the numbers of a verification depend on, as plain data."""
    asked = ("trials", "seed", "min_alignment", "only_batch", "any", "kinds")
    return {
        **program(),
        **{name: getattr(config, name) for name in asked},
        "claims": [claim.name for claim in claims],
    }


# ---- claims --------------------------------------------------------------------------------------


def _look_at_all(
    config: Config, claims: Sequence[Claim], part: Part, progress: Progress
) -> list[dict[str, Any]]:
    """Check what is not finished, under a progress bar for each claim; the rows of verify.csv."""
    batches, asked = config.batches(), (config.seed, config.min_alignment)
    total = sum(count for _, count in batches)
    bars = {claim.name: progress.add_task(claim.name, total=total) for claim in claims}
    blocks = [block for claim in claims for block in blocks_of(claim, batches, *asked)]
    seen: dict[str, Finding] = {}
    for block, one, _ in part.finish(blocks, lambda left: each(look, left, config)):
        seen[block.name] = one
        progress.advance(bars[block.claim.name], one.trials)
    return [
        row_of(claim, config, worst([seen[one.name] for one in blocks if one.claim is claim]))
        for claim in claims
    ]


def row_of(claim: Claim, config: Config, found: Finding) -> dict[str, Any]:
    """What all blocks say of a claim, by COLUMNS."""
    repeat = (
        f"rendezvous verify --claims {claim.name} --seed {config.seed} --only-batch {found.first} "
        f"--min-alignment {config.min_alignment}"
    )
    return {
        "claim": claim.name,
        "trials": found.trials,
        "worst_margin": found.margin,
        "worst_time_over_bound": found.time_over_bound,
        "violations": found.violations,
        "seconds": round(found.seconds, 3),
        "first_violation": "" if found.first is None else repeat,
    }


def _report(
    rows: Sequence[dict[str, Any]], claims: Sequence[Claim], path: Path, console: Console
) -> int:
    """Print the table and what is violated; the exit status."""
    shown = [
        {
            "claim": row["claim"],
            "what is checked": claim.statement,
            "trials": row["trials"],
            "worst margin": f"{row['worst_margin'] + 0.0:.2g}",
            "worst T/bound": row["worst_time_over_bound"],
            "violations": row["violations"],
        }
        for row, claim in zip(rows, claims, strict=True)
    ]
    console.print(table_of("What was proved, measured", shown))
    for row in rows:
        if row["violations"]:
            console.print(f"{row['claim']} is violated; to repeat the first time:")
            console.print(f"  {row['first_violation']}", soft_wrap=True)
    seconds, total = (sum(row[name] for row in rows) for name in ("seconds", "violations"))
    console.print(f"{total} violations in {seconds:.0f} s of work; {path}", soft_wrap=True)
    return int(total > 0)


def table_of(title: str, rows: Sequence[dict[str, Any]]) -> Table:
    """Rows as they are printed, numbers to the right; red where something is violated."""
    table = Table(title=title)
    for name, value in rows[0].items() if rows else ():
        words = isinstance(value, str) and name in ("claim", "what is checked", "theorem")
        table.add_column(name.replace("_", " "), justify="left" if words else "right")
    for row in rows:
        style = "bold red" if row["violations"] else None
        shown = [f"{v:.3f}" if isinstance(v, float) else str(v) for v in row.values()]
        table.add_row(*["" if one == "nan" else one for one in shown], style=style)
    return table


# ---- certificates of random scenarios ------------------------------------------------------------


def _try_anything(config: Config, part: Part, progress: Progress) -> Tally:
    """Play what is not finished."""
    tally, bar = Tally(), progress.add_task("scenarios", total=config.trials)
    blocks = any_blocks(config.trials, config.seed, config.kinds)
    for _, one, _ in part.finish(blocks, lambda left: each(look_at_any, left, config)):
        tally.join(one)
        progress.advance(bar, one.trials)
    tally.violations.sort(key=lambda found: found[0])
    return tally


def _report_any(
    config: Config, tally: Tally, rows: Sequence[dict[str, Any]], path: Path, console: Console
) -> int:
    """Print how often each theorem was granted and checked, make what is violated small and write
    it; the exit status.
    """
    console.print(table_of(f"Certificates of {tally.trials} random scenarios, tried", rows))
    for number, trial, played in tally.violations[:_MOST_WRITTEN]:
        small, played = shrink(trial, played)
        file = write(config.out, f"any-{config.seed}-{number}-{trial.by}", small, played)
        console.print(f"scenario {number}: {played.violation}; {file}", soft_wrap=True)
    console.print(
        f"{len(tally.violations)} violations, {tally.steps} steps of {TEAMS} teams in "
        f"{tally.seconds:.0f} s of work; {path}",
        soft_wrap=True,
    )
    return int(bool(tally.violations))
