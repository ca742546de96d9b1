"""Collision-free success of policies under sensor errors.

A policy is a name, learned:PATH, or a shipped policy with another clearance in rad: learned@0.4.
"""

import argparse
import dataclasses
import math
from pathlib import Path

import numpy as np

from baselines.learned import checkpoints, learned_policy, shipped
from rendezvous_env import Sensing
from rendezvous_env.scenario import scenarios
from train import policies, results
from train.compare import evaluation as episodes
from train.compare import statistics
from train.figures import figures, style

SENSORS = {
    "exact": Sensing(),
    "noise 0.05": Sensing(noise=0.05),
    "noise 0.1": Sensing(noise=0.1),
    "noise 0.2": Sensing(noise=0.2),
    "bias 0.1": Sensing(bias=0.1),
    "dropout 0.2": Sensing(dropout=0.2),
    "range 15 m": Sensing(range=15.0),
    "view 3π/2": Sensing(field_of_view=1.5 * math.pi),
}
NOISES = {"exact": 0.0, "noise 0.05": 0.05, "noise 0.1": 0.1, "noise 0.2": 0.2}
COLUMNS = (
    "scenario",
    "sensor",
    "policy",
    "episodes",
    "success",
    "collision_free",
    "low",
    "high",
    "time",
)


def make(name, scenario):
    """Policy for a name; see the module docstring."""
    base, _, clearance = name.partition("@")
    policy = policies.make(base, scenario)
    if not clearance:
        return policy
    _, tables = checkpoints.read(shipped.folder(base), ["network"])
    settings = dataclasses.replace(policy.settings, clearance=float(clearance))
    return learned_policy.LearnedPolicy(scenario, tables["network"], settings)


def row(name, label, policy, given):
    """Results of a policy on a scenario with a sensor, as a row of the file."""
    scenario = scenarios.get(name).replace(sensing=SENSORS[label])
    counts = {"episodes": given.episodes, "seed": given.seed}
    played, _ = episodes.play(scenario, lambda: make(policy, scenario), margin=None, **counts)
    limit = scenario.max_steps * scenario.tau
    median, _ = statistics.censored_median(played.time, played.success, limit)
    success, free = played.success.mean(), played.collision_free.mean()
    ends = statistics.fraction_interval(played.collision_free)
    values = (name, label, policy, given.episodes, success, free, *ends, median)
    return dict(zip(COLUMNS, values, strict=True))


@style.styled
def draw(rows, path):
    """Collision-free success against noise, one panel per scenario, 95 % intervals."""
    names = list(dict.fromkeys(row["scenario"] for row in rows))
    figure = style.new_figure(style.COLUMN * len(names), 3.0)
    panels = figure.subplots(1, len(names), sharey=True, squeeze=False)[0]
    for axes, name in zip(panels, names, strict=True):
        for policy in dict.fromkeys(row["policy"] for row in rows):
            mine = [r for r in rows if (r["scenario"], r["policy"]) == (name, policy)]
            mine = [r for r in mine if r["sensor"] in NOISES]
            free, *ends = (
                [100 * r[key] for r in mine] for key in ("collision_free", "low", "high")
            )
            spread = [np.subtract(free, ends[0]), np.subtract(ends[1], free)]
            axes.errorbar(
                [NOISES[r["sensor"]] for r in mine], free, spread, label=policy,
                color=figures.policy_colour(policy), marker=figures.policy_marker(policy),
            )  # fmt: skip
        axes.set(title=name, xlabel="noise / rad")
        axes.grid()
    panels[0].set_ylabel("met without a contact / % of episodes")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=4)
    style.save(figure, path)


parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--scenarios", nargs="+", default=["clutter-8", "clutter-16"])
parser.add_argument("--policies", nargs="+", default=["tangent-merged-tuned", "learned"])
parser.add_argument("--sensors", nargs="+", default=list(SENSORS), choices=list(SENSORS))
parser.add_argument("--episodes", type=int, default=200)
parser.add_argument("--seed", type=int, default=5000)
parser.add_argument("--out", type=Path, default=None, help="a CSV file of all rows")
parser.add_argument("--figure", type=Path, default=None, help="PNG or PDF: success against noise")
given = parser.parse_args()

found = []
for name in given.scenarios:
    print(f"| {name} |", " | ".join(given.sensors), "|")
    print("|---" * (1 + len(given.sensors)) + "|")
    for policy in given.policies:
        own = [row(name, label, policy, given) for label in given.sensors]
        print(
            f"| {policy} |",
            " | ".join(f"{100 * r['collision_free']:.1f}" for r in own),
            "|",
            flush=True,
        )
        found += own
if given.out:
    results.write_csv(given.out, found)
if given.figure:
    draw(found, given.figure)
