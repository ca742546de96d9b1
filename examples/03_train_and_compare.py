"""Train a heading policy, compare it with its initial rule, and write a report.

The default run is too short to learn. Pass --steps 3000000 for a policy like the shipped one.
"""

import argparse
import tempfile
from pathlib import Path

from train import results
from train.compare import compare
from train.learn import ppo

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--steps", type=int, default=200_000)
parser.add_argument("--num-envs", type=int, default=128)
parser.add_argument("--episodes", type=int, default=50)
parser.add_argument("--out", type=Path, default=None, help="folder; a temporary one by default")
given = parser.parse_args()
out = given.out or Path(tempfile.mkdtemp())

ppo.run(
    ppo.Config(
        scenario="clutter-8",
        total_steps=given.steps,
        num_envs=given.num_envs,
        batch_size=2048,
        out=out / "run",
        eval_every=0,
    )
)
learned = f"learned:{out / 'run'}"
compare.run(
    compare.Config(
        scenarios=("clutter-8",),
        policies=("bearing-only", "tangent-merged-tuned", learned),
        episodes=given.episodes,
        out=out / "compare",
        figures=False,
    )
)
for row in results.read_csv(out / "compare" / "results.csv"):
    print(
        f"{row['policy'].split(':')[0]}: collision-free {float(row['collision_free_success']):.0%}"
    )
