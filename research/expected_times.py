"""Bounds on mean times against measured ones, for random scenarios with missed detections.

    python research/expected_times.py --granted 1000

The scenarios are those of ``rendezvous verify --random-scenarios`` whose sensor misses neighbours
by chance alone, with a detection probability of 0.3 or more. Each granted one is repeated 48 times.
"""

import argparse
import math
from collections import defaultdict

import numpy as np

import rendezvous_env as rv
from rendezvous_env import baselines
from rendezvous_env.safety.theorems import mean_time
from rendezvous_env.safety.theorems.assumptions import departs_by_chance
from rendezvous_env.safety.theorems.constants import kind_of_links
from rendezvous_env.safety.theorems.theorem import LAW
from train.verify.random_scenarios import trials_of

REPEATED, LEAST, LONGEST = 48, 0.3, 20_000
"""Repeats, smallest detection probability, and number of steps after which a mean is given up."""
by_chance = departs_by_chance("noise")


def mean_time_of(scenario: rv.Scenario, seed: int) -> float:
    """Mean rendezvous time under law (1), s; NaN if not all repeats meet in ``LONGEST`` steps."""
    scenario = scenario.replace(time_limit=(LONGEST + 1) * scenario.tau)
    env = rv.make_vec(scenario, num_envs=REPEATED, autoreset_mode="Disabled", num_threads=1)
    law, simulator = baselines.make("bearing-only", scenario), env.simulator
    observations, _ = env.reset(seed=seed)
    met = np.full(REPEATED, math.nan)
    for _ in range(LONGEST):
        observations, *_ = env.step(law(observations, simulator.time))
        alone = np.isnan(met) & (simulator.active.sum(axis=1) == 1)
        met[alone] = simulator.time[alone]
        if not np.isnan(met).any():
            break
    return float(met.mean())


def main() -> None:
    """Print share granted and quartiles of the bound over the measured mean, by kind."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--granted", type=int, default=1000, help="number of scenarios")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    ratios, refused, number = defaultdict[str, list[float]](list), defaultdict[str, int](int), -1
    while len(ratios["all"]) < arguments.granted:
        number += 1
        trial = trials_of(arguments.seed, number)[0]
        scenario = trial.scenario
        if not scenario.model.bounded or by_chance(scenario, LAW):
            continue
        seen = mean_time.detection_of(scenario)
        if seen.least < LEAST:
            continue
        kinds = [
            "all",
            kind_of_links(scenario.sensing_graph),
            "Markov" if seen.kept > 0.0 else "independent",
        ]
        kinds += ["held rows"] * (seen.longest > scenario.tau)
        bound = rv.certificate(scenario).expected_time_bound
        if math.isinf(bound):
            for kind in kinds:
                refused[kind] += 1
            continue
        mean = mean_time_of(scenario, trial.seed)
        if bound < mean:
            print(f"number {number}: mean {mean:.4g} s, bound {bound:.4g} s", flush=True)
        for kind in kinds:
            ratios[kind].append(bound / mean)
    for kind, found in ratios.items():
        share = len(found) / (len(found) + refused[kind])
        low, middle, high = np.nanquantile(found, (0.25, 0.5, 0.75))
        print(
            f"{kind:12s} granted {len(found)} ({share:.0%}), bound over mean: median {middle:.3g} "
            f"({low:.3g} to {high:.3g}), least {np.nanmin(found):.3g}, without a mean "
            f"{np.isnan(found).sum()}"
        )


if __name__ == "__main__":
    main()
