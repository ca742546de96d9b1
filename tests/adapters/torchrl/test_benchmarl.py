"""BenchMARL algorithms on scenarios as tasks, evaluated on held-out initial conditions."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("benchmarl.experiment")

from benchmarl import algorithms
from benchmarl.experiment import Experiment, ExperimentConfig
from benchmarl.models import MlpConfig
from torchrl.envs.utils import check_env_specs

import rendezvous_env as rv
from rendezvous_env.adapters.benchmarl import HeldOut, RendezvousTask
from rendezvous_env.adapters.torchrl import GROUP

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::UserWarning")
TEAMS, FRAMES = 8, 80


class Watched(HeldOut):
    """Callback that stores the first observation."""

    starts = ()

    def on_evaluation_end(self, rollouts):
        super().on_evaluation_end(rollouts)
        seen = torch.stack([each[GROUP, "observation"][0] for each in rollouts])
        self.starts = (*self.starts, seen)


def experiment(algorithm, folder, *callbacks, scenario="duo", iterations=1, **choices):
    """Small experiment, evaluated after the first and after the last iteration."""
    config = ExperimentConfig.get_from_yaml()
    config.save_folder, config.loggers, config.render = folder, [], False
    config.max_n_iters, config.max_n_frames = iterations, None
    config.evaluation_interval, config.evaluation_episodes = iterations * FRAMES, 6
    for kind in ("on_policy", "off_policy"):
        setattr(config, f"{kind}_collected_frames_per_batch", FRAMES)
        setattr(config, f"{kind}_n_envs_per_worker", TEAMS)
    config.on_policy_n_minibatch_iters, config.on_policy_minibatch_size = 1, FRAMES
    config.off_policy_n_optimizer_steps, config.off_policy_train_batch_size = 1, FRAMES
    config.off_policy_memory_size = 1000
    model = MlpConfig.get_from_yaml()
    model.num_cells = [16]
    return Experiment(
        task=RendezvousTask(scenario, choices),
        algorithm_config=algorithm.get_from_yaml(),
        model_config=model,
        seed=0,
        config=config,
        callbacks=list(callbacks),
    )


@pytest.mark.parametrize(
    ("algorithm", "continuous", "choices"),
    [
        ("Mappo", True, {"return_state": True}),
        ("Ippo", True, {"guarantee": "tank"}),
        ("Masac", True, {}),
        ("Qmix", False, {}),
        ("Vdn", False, {"guarantee": "tank"}),
    ],
)
def test_algorithm_runs(algorithm, continuous, choices, tmp_path):
    run = experiment(getattr(algorithms, f"{algorithm}Config"), tmp_path, HeldOut(), **choices)
    before = [each.clone() for each in run.losses[GROUP].parameters()]
    run.run()
    assert run.continuous_actions is continuous and run.total_frames == FRAMES
    after = list(run.losses[GROUP].parameters())
    assert any(not torch.equal(old, new) for old, new in zip(before, after, strict=True))


def test_evaluation_uses_fixed_heldout_seeds(tmp_path):
    held_out = Watched(seed=500)
    run = experiment(algorithms.IppoConfig, tmp_path, held_out, iterations=2)
    run.run()
    first, last = held_out.starts
    torch.testing.assert_close(first, last, rtol=0, atol=0)
    own = run.task.make(6, seed=500).reset()[GROUP, "observation"]
    torch.testing.assert_close(first, own, rtol=0, atol=0)
    assert [found.frames for found in held_out.evaluations] == [FRAMES, 2 * FRAMES]


def test_evaluation_reports_success_and_time(tmp_path):
    """The rollout ends with the first rendezvous, so only one team has met."""
    held_out = HeldOut()
    run = experiment(algorithms.IppoConfig, tmp_path, held_out)
    env = run.task.make(6, seed=held_out.seed)
    ahead = torch.zeros(env.full_action_spec[GROUP, "action"].shape)
    aim = lambda tensordict: tensordict.set((GROUP, "action"), ahead)  # noqa: E731
    with torch.no_grad():
        data = env.rollout(env.max_steps, aim)
    held_out.on_evaluation_end(list(data.unbind(0)))
    found = held_out.evaluations[0]
    ended = data["next", "terminated"].any(dim=1)[:, 0].numpy()
    assert 0 < ended.sum() and found.met == found.collision_free == ended.sum() / 6
    data["next", "contacts"][:] = 1
    held_out.on_evaluation_end(list(data.unbind(0)))
    assert held_out.evaluations[1].collision_free == 0.0 < held_out.evaluations[1].met
    assert env.simulator.time[~ended] == pytest.approx(data.shape[1] * env.seconds_per_step)
    times = np.where(ended, data.shape[1] * env.seconds_per_step, np.inf)
    assert found.median_time == np.median(times)


def test_task_properties_follow_scenario():
    assert RendezvousTask("clutter-8").supports_discrete_actions()
    assert RendezvousTask("uav-6").supports_discrete_actions()
    bare = {"scenario": rv.scenarios.get("uav-6"), "learning_preset": False}
    flying = RendezvousTask("anything", bare)
    assert not flying.supports_discrete_actions() and flying.supports_continuous_actions()
    env = flying.get_env_fun(3, True, 0, "cpu")()
    check_env_specs(env)
    assert flying.max_steps(env) == env.max_steps and env.batch_size == (3,)
    assert flying.state_spec(env) is flying.info_spec(env) is None
    shown = flying.observation_spec(env)
    assert list(shown.keys(True, True)) == [(GROUP, "observation")]
    assert shown[GROUP].shape == (6,)
    costly = RendezvousTask("clutter-4", {"costs": ("rise",)})
    told = costly.info_spec(costly.get_env_fun(2, True, 0, "cpu")())
    assert set(told.keys(True, True)) == {(GROUP, "info", key) for key in ("cost", "cost_rise")}
    with pytest.raises(ValueError, match="config has 'seed'"):
        RendezvousTask("duo", {"seed": 1})
