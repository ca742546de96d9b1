"""Search ε, budget and learning rate of a policy under an energy tank with Ray Tune.

Trials run side by side, a core each; one that falls behind is stopped by its evaluations. Give
--address for a cluster, and --storage for a folder that all its machines share.
"""

import argparse
from pathlib import Path

import ray
from ray import tune
from ray.tune.schedulers import ASHAScheduler

from train.learn import ppo

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--scenario", default="clutter-16")
parser.add_argument("--trials", type=int, default=32)
parser.add_argument("--steps", type=int, default=2_000_000, help="decisions in a trial")
parser.add_argument("--teams", type=int, default=256)
parser.add_argument("--evaluations", type=int, default=8, help="in a trial")
parser.add_argument("--starts", type=int, default=100, help="of an evaluation")
parser.add_argument("--storage", type=Path, default=Path("out/search"))
parser.add_argument("--address", default=None)
given = parser.parse_args()

SEARCHED = {
    "min_alignment": tune.uniform(0.02, 0.3),  # ε: what a tank owes
    "budget": tune.loguniform(0.1, 10.0),  # of a tank at the start, m²/s
    "learning_rate": tune.loguniform(1e-4, 3e-3),
}


def attempt(chosen):
    """One trial, on a worker."""

    def on_update(update, metrics):
        for row in metrics["evaluation"]:
            tune.report({"clean_success": row["clean_success"], "step": metrics["step"]})

    folder = Path(tune.get_context().get_trial_dir()) / "run"
    settings = ppo.Config(
        **chosen,
        scenario=given.scenario,
        guarantee="tank",
        num_teams=given.teams,
        batch_size=2048,
        total_steps=given.steps,
        eval_every=given.steps // given.evaluations,
        eval_starts=given.starts,
        tensorboard=False,
        num_threads=1,
        out=folder,
    )
    ppo.run(settings, on_update)


ray.init(given.address or "local", include_dashboard=False)
found = tune.Tuner(
    tune.with_resources(attempt, {"cpu": 1}),
    param_space=SEARCHED,
    tune_config=tune.TuneConfig(
        metric="clean_success",
        mode="max",
        num_samples=given.trials,
        scheduler=ASHAScheduler(
            time_attr="step", max_t=given.steps, grace_period=given.steps // given.evaluations
        ),
    ),
    run_config=tune.RunConfig(name=given.scenario, storage_path=str(given.storage.resolve())),
).fit()
best = found.get_best_result(scope="all")  # the best evaluation of a trial, not its last
chosen = ", ".join(f"{name} {value:.3g}" for name, value in best.config.items())
print(f"cleanly {best.metrics['clean_success']:.0%} with {chosen}: {best.path}/run")
ray.shutdown()
