"""Search ε, budget and learning rate of an energy-tank policy with Ray Tune.

Each trial uses one core and is stopped early if its evaluations fall behind. Pass --address for a
cluster and --storage for a folder that all machines share.
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
parser.add_argument("--steps", type=int, default=2_000_000, help="decisions per trial")
parser.add_argument("--num-envs", type=int, default=256)
parser.add_argument("--evaluations", type=int, default=8, help="per trial")
parser.add_argument("--eval-episodes", type=int, default=100, help="episodes per evaluation")
parser.add_argument("--storage", type=Path, default=Path("out/search"))
parser.add_argument("--address", default=None)
given = parser.parse_args()

SEARCHED = {
    "min_alignment": tune.uniform(0.02, 0.3),  # ε of the tank
    "budget": tune.loguniform(0.1, 10.0),  # initial energy, m²/s
    "learning_rate": tune.loguniform(1e-4, 3e-3),
}


def attempt(chosen):
    """One trial, on a worker."""

    def on_update(update, metrics):
        for row in metrics["evaluation"]:
            tune.report(
                {"collision_free_success": row["collision_free_success"], "step": metrics["step"]}
            )

    folder = Path(tune.get_context().get_trial_dir()) / "run"
    settings = ppo.Config(
        **chosen,
        scenario=given.scenario,
        guarantee="tank",
        num_envs=given.num_envs,
        batch_size=2048,
        total_steps=given.steps,
        eval_every=given.steps // given.evaluations,
        eval_episodes=given.eval_episodes,
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
        metric="collision_free_success",
        mode="max",
        num_samples=given.trials,
        scheduler=ASHAScheduler(
            time_attr="step", max_t=given.steps, grace_period=given.steps // given.evaluations
        ),
    ),
    run_config=tune.RunConfig(name=given.scenario, storage_path=str(given.storage.resolve())),
).fit()
best = found.get_best_result(scope="all")  # best evaluation of a trial, not its last
chosen = ", ".join(f"{name} {value:.3g}" for name, value in best.config.items())
print(f"collision-free {best.metrics['collision_free_success']:.0%} with {chosen}: {best.path}/run")
ray.shutdown()
