"""Numerical checks of continuous-time theorems on random teams.

    python research/claims.py --trials 1000 --seed 0 gains stale links

``rendezvous verify --random-scenarios`` validates certificates in the environment. This script
covers more general claims: adversarial edge weights and graphs, delayed bearings, bearing errors,
and headings in a cone. Exit status 1 if a claim is violated.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence

from continuous_time_claims import CONTINUOUS_TIME, check
from delay_claims import DELAY
from link_claims import LINKS

from train.verify.claims import BATCH
from train.verify.falsification import Tally

CLAIMS = (*CONTINUOUS_TIME, *DELAY, *LINKS)


def main(argv: Sequence[str] | None = None) -> int:
    """Check the claims and print a line for each; returns the exit status."""
    parser = argparse.ArgumentParser(description="Try claims that no certificate makes.")
    parser.add_argument("claims", nargs="*", metavar="CLAIM", help="names; all without any")
    parser.add_argument("--trials", type=int, default=BATCH, help="teams for each claim")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args(argv)
    known = [claim.name for claim in CLAIMS]
    if unknown := ", ".join(sorted({*given.claims} - {*known})):
        parser.error(f"claim {unknown} is unknown; known are {', '.join(known)}")
    if given.trials < 1 or given.seed < 0:
        parser.error("--trials must be 1 or more, --seed 0 or more")
    violations = 0
    for claim in CLAIMS:
        if given.claims and claim.name not in given.claims:
            continue
        batches = range(math.ceil(given.trials / BATCH))
        counts = [min(BATCH, given.trials - k * BATCH) for k in batches]
        found = Tally()
        for k in batches:
            found.join(check(claim, given.seed, k, counts[k]))
        violations += found.violations
        print(
            f"{claim.name:16} {found.trials:6} teams  {found.violations} violations  "
            f"T/bound {found.ratio.get(claim.name, math.nan):.3f}  {claim.statement}"
        )
    return int(violations > 0)


if __name__ == "__main__":
    sys.exit(main())
