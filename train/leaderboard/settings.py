"""What a leaderboard is to be: its flags, tiers and cells."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

from tyro.conf import arg

from .. import results
from ..checks import UserError, check_least
from ..policies import resolve_scenario
from ..tasks import Workers
from . import registry

Tier = Literal["smoke", "mini", "full"]


class Protocol(NamedTuple):
    """What is the same for all algorithms of a tier."""

    fields: tuple[str, ...]
    seeds: int
    decisions: int
    """Of single robots, in each cell."""
    starts: int
    """Held out, in each cell."""


_FIELDS = (
    "clutter-8", "clutter-16", "clutter-24", "corridor", "rooms", "noisy-8", "unicycle-clutter-16",
)  # fmt: skip
TIERS: dict[Tier, Protocol] = {
    "smoke": Protocol(_FIELDS[:2], 3, 2**14, 50),
    "mini": Protocol(_FIELDS, 5, 2**16, 200),
    "full": Protocol(_FIELDS, 10, 10_000_000, 1000),
}
EXAMPLES = (
    "--tier smoke",
    "--tier mini --algorithms ppo-heading ppo-tank --fields clutter-16 --jobs 8",
    "--repeat results/leaderboard/smoke/cells/ppo-heading/clutter-8-v1-seed-0.json --record",
)
FLAG_GROUPS = {"Output": ("out", "fresh"), "Workers": ("jobs", "on", "address")}


@dataclass(frozen=True)
class Config(Workers):
    """Train and play algorithms × fields × seeds; tables with intervals, and every raw number."""

    tier: Tier = "smoke"
    """How much: smoke (minutes), mini (hours on two cores), full (a cluster)."""
    algorithms: tuple[str, ...] = ()
    """Names of algorithms, which are files in train/leaderboard/algorithms; without any all whose
    libraries are installed."""
    fields: Annotated[tuple[str, ...], arg(aliases=("--scenarios",))] = ()
    """Other fields than the tier's: named scenarios, with or without version."""
    seeds: tuple[int, ...] = ()
    """Other seeds than the tier's, which are 0, 1, and so on."""
    decisions: int | None = None
    """Another budget than the tier's, in decisions of single robots."""
    starts: int | None = None
    """Another number of held-out starts than the tier's."""
    repeat: Path | None = None
    """A results card: its cell is done again, and compared with it bit by bit; status 1 if it
    differs. The other flags are those of the card."""
    record: bool = False
    """Keeps a replay of every run, not of the first seed alone; with --repeat of that run, beside
    its card, if it does not differ."""
    out: Path = Path("out/leaderboard")
    """The folder for cards, tables and figures. Cells that it has are kept, others added. What is
    finished lies in OUT.part until all is, and the same command resumes it."""
    fresh: Annotated[bool, arg(name="overwrite")] = False
    """Throws away what another command has left unfinished in OUT.part."""


class Place(NamedTuple):
    """A cell: what is trained, where, and with which seed."""

    algorithm: str
    field: str
    """With version, without namespace."""
    seed: int
    decisions: int
    """0 of what does not learn."""
    starts: int

    @property
    def name(self) -> str:
        """Of its file."""
        return f"{self.algorithm}/{self.field}-seed-{self.seed}"

    @property
    def command(self) -> str:
        """The command that does this cell alone."""
        words = {"algorithms": self.algorithm, "fields": self.field, "seeds": self.seed}
        words |= {"decisions": self.decisions} if self.decisions else {}
        words |= {"starts": self.starts}
        return "rendezvous leaderboard " + " ".join(f"--{k} {v}" for k, v in words.items())


def plan(config: Config) -> list[Place]:
    """The cells that a configuration asks for, those that fit; a UserError if there are none."""
    check_least(config, seeds=0, decisions=1, starts=1)
    tier = TIERS[config.tier]
    able = tuple(name for name, one in registry.known().items() if not one.missing)
    decisions, starts = config.decisions or tier.decisions, config.starts or tier.starts
    seeds = config.seeds or tuple(range(tier.seeds))
    places = []
    for name in config.algorithms or able:
        algorithm = registry.find(name)
        for given in config.fields or tier.fields:
            scenario = resolve_scenario(given)
            if not (named := results.versioned(scenario)):
                raise UserError(f"--fields {given}: only named scenarios have versions")
            field = named["field"].partition("/")[2]
            if algorithm.fits(scenario):
                own, much = (seeds, decisions) if algorithm.learns else (seeds[:1], 0)
                places += [Place(name, field, seed, much, starts) for seed in own]
    if not places:
        raise UserError("none of these algorithms fits any of these fields")
    if len(set(places)) < len(places):
        raise UserError("an algorithm, a field or a seed is named twice; name each once")
    return places
