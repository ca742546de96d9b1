"""The tasks of a verification: some batches of a claim, and what they say."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import astuple, dataclass
from typing import NamedTuple

import numpy as np

from ..unfinished import Part
from .claim import Finding, worst
from .claims import AnyClaim, check

_MOST = 256
"""Tasks of a claim."""


@dataclass(frozen=True)
class Block:
    """Some batches of one claim, a task of its own."""

    claim: AnyClaim
    batches: tuple[tuple[int, int], ...]
    """Numbers, and teams that count."""
    seed: int
    min_alignment: float

    @property
    def name(self) -> str:
        """Of its cell."""
        return f"{self.claim.name}-{self.batches[0][0]:07d}"


class Seen(NamedTuple):
    """What a block says."""

    finding: Finding
    seconds: float
    first: int | None
    """Number of the first batch with a violation."""


def blocks_of(
    claim: AnyClaim, batches: Sequence[tuple[int, int]], seed: int, min_alignment: float
) -> list[Block]:
    """The batches of a claim, cut into tasks."""
    size = math.ceil(len(batches) / _MOST)
    return [
        Block(claim, tuple(batches[k : k + size]), seed, min_alignment)
        for k in range(0, len(batches), size)
    ]


def look(block: Block) -> Seen:
    """Check the batches of a block."""
    began = time.perf_counter()
    findings = [
        check(block.claim, block.seed, batch, trials, block.min_alignment)
        for batch, trials in block.batches
    ]
    numbers = (batch for batch, _ in block.batches)
    violated = zip(numbers, findings, strict=True)
    first = next((batch for batch, finding in violated if finding.violations), None)
    return Seen(worst(findings), time.perf_counter() - began, first)


def save(part: Part, name: str, seen: Seen) -> None:
    """Keep what a block says."""
    first = [] if seen.first is None else [seen.first]
    part.save(name, {"finding": astuple(seen.finding), "seconds": seen.seconds, "first": first})


def load(part: Part, name: str) -> Seen | None:
    """What a block says; None if it is not finished, or cannot be read."""
    arrays = part.load(name)
    if arrays is None:
        return None
    trials, margin, time_over_bound, violations = arrays["finding"].tolist()
    finding = Finding(int(trials), margin, time_over_bound, int(violations))
    first = arrays["first"].astype(np.int64).tolist()
    return Seen(finding, float(arrays["seconds"]), first[0] if first else None)
