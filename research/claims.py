"""What is proven in continuous time, of late bearings and of wrong ones, tried on random teams.

    python research/claims.py --trials 1000 --seed 0 gains stale links

``rendezvous verify --any`` tries what certificates promise in the environment itself. Here is what
goes beyond them: gains of an adversary on graphs of an adversary, bearings of any age, errors that
turn as they like, pursuit, bodies, the ledger of a tank step by step. Exit status 1 if a claim is
violated.
"""

from __future__ import annotations

import argparse
import math
import sys
import zlib
from collections.abc import Sequence

import numpy as np
from continuous_time_claims import CONTINUOUS_TIME, ContinuousTimeClaim
from continuous_time_claims import check as check_in_continuous_time
from delay_claims import DELAY
from hull_claims import HULL
from link_claims import LINKS
from tank_claims import TANK
from wrong_bearing_claims import WRONG_BEARINGS

from train.verify.cases import BATCH
from train.verify.claim import Claim, Finding, worst
from train.verify.claims import check as check_in_environment

CLAIMS = (*CONTINUOUS_TIME, *DELAY, *LINKS, *WRONG_BEARINGS, *HULL, *TANK)


def check(
    claim: Claim | ContinuousTimeClaim, seed: int, batch: int, trials: int, least_margin: float
) -> Finding:
    """Run one batch of a claim; arguments as ``train.verify.claims.check``."""
    if isinstance(claim, Claim):
        return check_in_environment(claim, seed, batch, trials, least_margin)
    random = np.random.default_rng([seed, zlib.crc32(claim.name.encode()), batch])
    return check_in_continuous_time(claim, random, batch, trials, least_margin)


def main(argv: Sequence[str] | None = None) -> int:
    """Check the claims, a line for each; the exit status."""
    parser = argparse.ArgumentParser(description="Try claims that no certificate makes.")
    parser.add_argument("claims", nargs="*", metavar="CLAIM", help="names; all without any")
    parser.add_argument("--trials", type=int, default=BATCH, help="teams for each claim")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args(argv)
    violations = 0
    for claim in CLAIMS:
        if given.claims and claim.name not in given.claims:
            continue
        batches = range(math.ceil(given.trials / BATCH))
        counts = [min(BATCH, given.trials - k * BATCH) for k in batches]
        found = worst([check(claim, given.seed, k, counts[k], 0.3) for k in batches])
        violations += found.violations
        print(
            f"{claim.name:16} {found.trials:6} teams  {found.violations} violations  "
            f"T/bound {found.time_over_bound:.3f}  {claim.statement}"
        )
    return int(violations > 0)


if __name__ == "__main__":
    sys.exit(main())
