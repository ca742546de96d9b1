"""Which settings of ``rendezvous train`` need the fewest decisions to meet without a touch.

python research/training_search.py --seeds 0 1 --decisions 1500000 --tried shipped small
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

from train.learn import ppo

COMMON: dict[str, Any] = {
    "scenario": "clutter-24", "guarantee": "tank", "budget": 20.0, "prior": 1.5, "ent_coef": 0.003,
    "gamma": 0.995, "eval_starts": 200, "tensorboard": False,
}  # fmt: skip
_SMALL: dict[str, Any] = {
    "memory": "features", "num_teams": 256, "batch_size": 4096, "hidden": (64, 64),
}  # fmt: skip
TRIED: dict[str, dict[str, Any]] = {
    "shipped": {"memory": "features"},
    "small": _SMALL,
    "small-free": _SMALL | {"prior": 0.0, "ent_coef": 0.001},
    "small-steep": _SMALL | {"prior": 0.0, "ent_coef": 0.001, "learning_rate": 2e-3},
    "wide-free": _SMALL | {"prior": 0.0, "ent_coef": 0.001, "hidden": (128, 128)},
    "recurrent-free": _SMALL | {"prior": 0.0, "ent_coef": 0.001, "memory": "recurrent"},
}
"""Settings by the name that the table gives them."""


def search(config: ppo.Config, share: float) -> str:
    """A row of the table: when held-out starts reached the share, and what they ended with."""
    began, reached = time.process_time(), "never"

    def on_update(update: int, metrics: dict[str, Any]) -> bool:
        nonlocal reached
        met = any(row["clean_success"] >= share for row in metrics["evaluation"])
        if met:
            taken = time.process_time() - began
            reached = f"{metrics['step'] / 1e6:.2f} M, {taken:.0f} s of processor time"
        return met

    result = ppo.run(config, on_update)
    best, final = (100 * rows[0]["clean_success"] for rows in (result.best, result.final))
    return f"{reached} | best {best:.1f} %, last {final:.1f} % at {result.steps / 1e6:.2f} M"


def main() -> None:
    """Run the search that the command line asks for, row by row."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tried", nargs="+", choices=TRIED, default=list(TRIED))
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1])
    parser.add_argument("--decisions", type=int, default=3_000_000)
    parser.add_argument("--every", type=int, default=250_000, help="decisions between evaluations")
    parser.add_argument("--share", type=float, default=0.98, help="of starts met without a touch")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("runs/search"))
    asked = parser.parse_args()
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
