"""All claims as experiments that can fail: draw a case, run it, judge it.

A file of claims is one tuple of them, named in CLAIMS.
"""

from __future__ import annotations

import math
import zlib

import numpy as np

from .cases import BATCH
from .claim import Claim, Finding
from .error_claims import ERRORS
from .flow_claim import FlowClaim, check_flow
from .flow_claims import FLOW
from .link_claims import LINKS
from .measuring import measure
from .size_claims import SIZE
from .stale_claims import STALE
from .tank_claims import TANK
from .theory_claims import THEORY

AnyClaim = Claim | FlowClaim
CLAIMS: tuple[AnyClaim, ...] = (*THEORY, *SIZE, *TANK, *FLOW, *STALE, *ERRORS, *LINKS)


def check(claim: AnyClaim, seed: int, batch: int, trials: int, least_margin: float) -> Finding:
    """Run one batch of a claim; the same arguments give the same finding.

    Args:
        claim: what to check.
        seed: of the whole run.
        batch: number of the batch.
        trials: how many of its BATCH teams to count.
        least_margin: smallest ε to draw.
    """
    random = np.random.default_rng([seed, zlib.crc32(claim.name.encode()), batch])
    if isinstance(claim, FlowClaim):
        return check_flow(claim, random, batch, trials, least_margin)
    case = claim.draw(random, batch, least_margin)
    policy = claim.law(case, BATCH, random)
    start_seed = int(random.integers(2**40))
    record = measure(claim, case, policy, start_seed)
    verdicts = [judge(record) for judge in claim.judges]
    held = np.logical_and.reduce([ok for _, ok in verdicts])[:trials]
    ratio = np.max((record.times / record.limit)[:trials]) if claim.timed else math.nan
    margin = float(np.min(verdicts[0][0][:trials]))
    return Finding(len(held), margin, float(ratio), int(np.sum(~held)))
