"""All claims as experiments that can fail: draw a case, run it, judge it; and the tasks of it."""

from __future__ import annotations

import math
import time
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from .cases import BATCH
from .claim import Claim, Finding, measure, worst
from .paper_claims import PAPER

CLAIMS: tuple[Claim, ...] = PAPER


def check(claim: Claim, seed: int, batch: int, trials: int, least_margin: float) -> Finding:
    """Run one batch of a claim; the same arguments give the same finding.

    Args:
        claim: what to check.
        seed: of the whole run.
        batch: number of the batch.
        trials: how many of its BATCH teams to count.
        least_margin: smallest ε to draw.
    """
    random = np.random.default_rng([seed, zlib.crc32(claim.name.encode()), batch])
    case = claim.draw(random, batch, least_margin)
    policy = claim.law(case, BATCH, random)
    start_seed = int(random.integers(2**40))
    record = measure(claim, case, policy, start_seed)
    verdicts = [judge(record) for judge in claim.judges]
    held = np.logical_and.reduce([ok for _, ok in verdicts])[:trials]
    ratio = np.max((record.times / record.limit)[:trials]) if claim.timed else math.nan
    margin = float(np.min(verdicts[0][0][:trials]))
    return Finding(len(held), margin, float(ratio), int(np.sum(~held)))


_MOST = 256
"""Tasks of a claim."""


@dataclass(frozen=True)
class Block:
    """Some batches of one claim, a task of its own."""

    claim: Claim
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
    claim: Claim, batches: Sequence[tuple[int, int]], seed: int, min_alignment: float
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
