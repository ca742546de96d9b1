"""Any algorithm of BenchMARL on a scenario, evaluated on held-out initial conditions.

Algorithms with discrete actions (QMIX, VDN) choose among the angles of the shipped policy.
"""

import argparse
import tempfile
from pathlib import Path

import torch
from benchmarl import algorithms
from benchmarl.experiment import Experiment, ExperimentConfig
from benchmarl.models import MlpConfig

from rendezvous_env.adapters.benchmarl import HeldOut, RendezvousTask

CONFIGS = {
    "ippo": algorithms.IppoConfig,
    "mappo": algorithms.MappoConfig,
    "masac": algorithms.MasacConfig,
    "qmix": algorithms.QmixConfig,
    "vdn": algorithms.VdnConfig,
}

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--scenario", default="clutter-8")
parser.add_argument("--guarantee", default="heading", choices=["heading", "tank"])
parser.add_argument("--algorithm", default="mappo", choices=CONFIGS)
parser.add_argument("--updates", type=int, default=30)
parser.add_argument("--num-envs", type=int, default=128)
parser.add_argument("--steps", type=int, default=16)
parser.add_argument("--held-out", type=int, default=200)
parser.add_argument("--seed", type=int, default=0)
parser.add_argument("--out", type=Path, default=None, help="folder; a temporary one by default")
given = parser.parse_args()
torch.set_num_threads(1)  # the networks are small

frames = given.num_envs * given.steps
config = ExperimentConfig.get_from_yaml()
config.save_folder = given.out or Path(tempfile.mkdtemp())
config.loggers, config.render = [], False
config.lr = 1e-3
config.max_n_iters, config.max_n_frames = given.updates, None
config.evaluation_interval = given.updates * frames
config.evaluation_episodes = given.held_out
for kind in ("on_policy", "off_policy"):
    setattr(config, f"{kind}_collected_frames_per_batch", frames)
    setattr(config, f"{kind}_n_envs_per_worker", given.num_envs)
config.on_policy_n_minibatch_iters, config.on_policy_minibatch_size = 4, frames // 8
config.off_policy_n_optimizer_steps, config.off_policy_train_batch_size = 32, frames // 8
config.off_policy_memory_size = 100_000
model = MlpConfig.get_from_yaml()
model.num_cells = [64, 64]

held_out = HeldOut()
experiment = Experiment(
    task=RendezvousTask(given.scenario, {"guarantee": given.guarantee}),
    algorithm_config=CONFIGS[given.algorithm].get_from_yaml(),
    model_config=model,
    seed=given.seed,
    config=config,
    callbacks=[held_out],
)
experiment.evaluate()
experiment.run()
first, *_, last = held_out.evaluations
for moment, found in (("before", first), ("after", last)):
    print(f"{moment}: {found.met:.1%} met, {found.collision_free:.1%} collision-free, ", end="")
    print(f"median {found.median_time:.2f} s")
