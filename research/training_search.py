"""Search for training settings that need the fewest decisions for collision-free rendezvous.

python research/training_search.py --seeds 0 1 2 --tried default shipped
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import Any

from train.checks import UserError
from train.learn import ppo

COMMON: dict[str, Any] = {
    "scenario": "clutter-24", "guarantee": "tank", "budget": 20.0, "memory": "features",
    "eval_episodes": 500, "tensorboard": False,
}  # fmt: skip
_SHIPPED: dict[str, Any] = {
    "num_envs": 1024, "n_steps": 32, "batch_size": 8192, "hidden": (128, 128), "prior": 1.5,
    "ent_coef": 0.003,
}  # fmt: skip
_LONG = {"n_steps": 32, "batch_size": 4096}
TRIED: dict[str, dict[str, Any]] = {
    "default": {},
    "shipped": _SHIPPED,
    "long": _LONG,
    "long-prior": _LONG | {"prior": 1.5, "ent_coef": 0.003},
    "small-batch": {"batch_size": 1024},
    "prior": {"prior": 1.0},
    "heading": {"guarantee": "heading", "budget": 0.0, "memory": "none"},
    "recurrent": {"memory": "recurrent"},
}
"""Candidate settings, by their name in the table."""


def search(config: ppo.Config, share: float) -> str:
    """Row of the table: decisions until held-out success reached the level, and final success.

    A SystemExit reports a run that is invalid or ended by a signal.
    """
    began, reached = time.process_time(), "never"

    def on_update(update: int, metrics: dict[str, Any]) -> bool:
        nonlocal reached
        met = any(row["collision_free_success"] >= share for row in metrics["evaluation"])
        if met:
            taken = time.process_time() - began
            by_clock = f"{metrics['wall_s']:.0f} s by the clock"
            reached = f"{metrics['step'] / 1e6:.2f} M, {taken:.0f} s of processor time, {by_clock}"
        return met

    try:
        result = ppo.run(config, on_update)
    except UserError as error:
        sys.exit(str(error))
    if result.status:
        sys.exit(result.status)
    best, final = (100 * rows[0]["collision_free_success"] for rows in (result.best, result.final))
    return f"{reached} | best {best:.1f} %, last {final:.1f} % at {result.steps / 1e6:.2f} M"


def main() -> None:
    """Run the search given on the command line, row by row."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tried", nargs="+", choices=TRIED, default=list(TRIED))
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2])
    parser.add_argument("--decisions", type=int, default=3_000_000)
    parser.add_argument("--every", type=int, default=250_000, help="decisions between evaluations")
    parser.add_argument("--share", type=float, default=0.98, help="of starts met without a touch")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("runs/search"))
    asked = parser.parse_args()
    if asked.every < 1:
        parser.error(f"--every is {asked.every}; it must be 1 or more")
    rows = []
    for name in asked.tried:
        for seed in asked.seeds:
            config = ppo.Config(
                out=asked.out / f"{name}-{seed}",
                seed=seed,
                total_steps=asked.decisions,
                eval_every=asked.every,
                num_threads=asked.threads,
                **COMMON | TRIED[name],
            )
            rows.append(f"{name}, seed {seed} | {search(config, asked.share)}")
            print("\n".join(rows), flush=True)


if __name__ == "__main__":
    main()
