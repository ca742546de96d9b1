"""Settings of a training run and quantities derived from them."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from rendezvous_env.baselines.learned.plain_data import read_json
from rendezvous_env.baselines.learned.policy_settings import PolicySettings, memory_of, time_unit
from rendezvous_env.baselines.search.direct_control import check_searches
from rendezvous_env.baselines.steering import can_steer, check_steerable
from tyro.conf import arg

from rendezvous_env.deprecation import renamed_arguments
from rendezvous_env.obstacles.fields import ObstacleField
from rendezvous_env.rewards.terms import RewardWeights
from rendezvous_env.safety.settings import SMALLEST_MARGIN
from rendezvous_env.safety.tank import unit_of_tanks
from rendezvous_env.scenario.scenario import Scenario

from ..checks import Bounds, Flags, UserError, check_unused, flag, format_argument, user_error
from ..policies import resolve_scenario
from .sensing_ranges import Ranges, check_ranges

TRAINING_SEEDS, EVALUATION_SEEDS, MAX_SEED = 2**62, 2**61, 2**29 - 1
"""First seed of training (2⁶² + 2³² s for run seed s), first seed of evaluation (2⁶¹), largest s.

``compare`` counts up from its --seed, which is far smaller, so both sets are disjoint.
"""
CONFIG = "config.json"
"""File name of the settings in the folder of a run."""
_SAMPLED = (
    "noise", "bias", "dropout", "range", "field_of_view", "occlusion", "delay", "min_range",
    "sample_period", "delay_time", "observer_bias", "noise_correlation", "persistence", "outliers",
)  # fmt: skip
"""Fields of Sensing that may have a range, in sampling order."""
_HOW_SAMPLED = ("sensing_chance", "sensing_groups", "sensing_updates")
_PATHS = ("out", "resume", "start_from")

EXAMPLES = (
    "--out runs/heading --total-steps 10000000",
    "--guarantee tank --budget 20 --memory features --out runs/tank",
    "--resume runs/heading",
)
_REWARDS = {
    "progress": 0.5, "time_penalty": 0.1, "collision_penalty": 0.0, "rendezvous_bonus": 1.0
}  # fmt: skip
"""Reward weights used when neither the flags nor the scenario set them."""
_POLICY = tuple(
    field.name for field in fields(PolicySettings) if field.name not in ("decision_time", "budget")
)
_LEARNING = (
    "num_envs", "n_steps", "batch_size", "epochs", "learning_rate", "gamma", "gae_lambda",
    "clip_range", "ent_coef", "prior", "start_from",
)  # fmt: skip
FLAG_GROUPS = {
    "PPO": _LEARNING,
    "Policy": (*_POLICY, "decision_period", "budget", "critic"),
    "Domain randomisation of sensors": (*(f"sensing_{name}" for name in _SAMPLED), *_HOW_SAMPLED),
    "Rewards": (*_REWARDS, "own_progress", "contact_penalty"),
    "Evaluation and machine": (
        "eval_every", "eval_episodes", "eval_scenarios", "checkpoint_every", "tensorboard",
        "num_threads", "device",
    ),
}  # fmt: skip


_RENAMED = {
    "num_teams": "num_envs", "touch_penalty": "contact_penalty", "eval_starts": "eval_episodes"
}  # fmt: skip
"""Deprecated names of settings, in calls and in stored runs."""
FORMER_FLAGS = {flag(former): flag(name) for former, name in _RENAMED.items()}
"""Deprecated flags."""


class DefaultInt(int):
    """Marker for a default value, distinguishable from the same number given explicitly."""


@dataclass(frozen=True)
class Config(Flags):
    """Train a policy with PPO under a safety filter that holds for any network output."""

    scenario: Annotated[str, arg(aliases=("--scenarios",))] = "clutter-24"
    """Name or TOML file of the scenario. Double integrators are not supported."""
    curriculum: Annotated[tuple[int, ...], Bounds(0, 2**10)] = ()
    """Maximum number of obstacles per episode, one value per stage of equal length. Default: the
    scenario's."""
    fewest_obstacles: Annotated[int | None, Bounds(0, 2**10)] = None
    """Minimum number of obstacles per episode of a curriculum. Default: the maximum."""
    total_steps: Annotated[int, Bounds(1, 2**62)] = DefaultInt(3_000_000)
    """Number of decisions of single robots in the run, rounded up to whole updates."""
    seed: Annotated[int, Bounds(0, MAX_SEED)] = 0
    """Seed of weights, exploration and initial conditions, below 2²⁹."""
    out: Path = Path("runs/heading")
    """Folder of the run."""
    resume: Path | None = None
    """Folder of a run to resume. Its stored settings apply, except total-steps, eval-every,
    eval-episodes, checkpoint-every and num-threads if given."""
    start_from: Path | None = None
    """Run or checkpoint that provides the initial weights."""

    set: tuple[str, ...] = ()
    """Overrides of scenario fields, for example n_robots=9 time_limit=60."""

    num_envs: Annotated[int, Bounds(1)] = 256
    """Number of environments simulated in parallel."""
    n_steps: Annotated[int, Bounds(2)] = 16
    """Number of decisions of each robot between updates."""
    batch_size: Annotated[int, Bounds(2, 2**31)] = 2048
    """Number of samples in a gradient step."""
    epochs: Annotated[int, Bounds(1, 2**31)] = 4
    """Number of passes over the samples in an update."""
    learning_rate: Annotated[float, Bounds(0, 1e6, "(]")] = 1e-3
    """Initial learning rate; it decreases linearly to a twentieth."""
    gamma: Annotated[float, Bounds(0, 1)] = 0.995
    """Discount factor per decision."""
    gae_lambda: Annotated[float, Bounds(0, 1)] = 0.95
    """λ of generalised advantage estimation."""
    clip_range: Annotated[float, Bounds(0, ends="(]")] = 0.2
    """Clip range of the probability ratio."""
    ent_coef: float = 0.001
    """Weight of the entropy bonus."""
    prior: float | None = None
    """Initial log-probability advantage of the analytic rule over every other choice. Default: 3
    under the heading filter, where the rule is hard to beat, and 0 under the energy tank."""

    set_width: Annotated[int, Bounds(1, 2**12)] = 32
    """Width of the networks that read one neighbour or one obstacle."""
    hidden: Annotated[tuple[int, ...], Bounds(1, 2**12)] = (64, 64)
    """Widths of the layers that follow, for actor and critic."""
    clearance: Annotated[float, Bounds(0, math.pi, "[)")] = 0.2
    """Angle by which the base controller stays clear of an obstacle edge, rad."""
    persistence: Annotated[float, Bounds(0)] = 0.5
    """Preference of the base controller for the side chosen before."""

    decision_period: Annotated[int, Bounds(1, 10**6)] = 12
    """Action repeat: number of environment steps per decision."""
    min_alignment: Annotated[float, Bounds(SMALLEST_MARGIN, 1, "[)")] = 0.05
    """Minimum alignment ε of the certified heading, or of the energy tank's reference."""
    max_turn_rate: Annotated[float, Bounds(0, ends="(]")] = 100.0
    """Maximum turn rate of the certified heading, rad/s."""
    guarantee: Literal["heading", "tank", "none"] = "heading"
    """Safety filter: certified headings (theorem C), one energy tank per robot (theorem D), or
    none. Without one, unicycles choose speed and turn rate from remembered bearings."""
    budget: Annotated[float, Bounds(0, 1e9)] = 0.0
    """Initial stored energy of each tank, m²/s; the policy stores it in units of r D̄."""
    memory: Literal["none", "features", "recurrent"] = "none"
    """Memory besides the last decisions: none, features of the wall being followed (energy tank
    only), or a recurrent unit."""
    memory_units: Annotated[int, Bounds(1, 2**12)] = 64
    """Size of the recurrent state of each robot."""
    critic: Literal["local", "global"] = "local"
    """Input of the value function: the robot's observation, or the global state as well. The
    global state serves training only; the policy never observes it."""

    sensing_noise: tuple[float, float] | None = None
    """Range of the sampled noise, rad. Without a range, a field of Sensing keeps the scenario's
    value."""
    sensing_bias: tuple[float, float] | None = None
    """Range of the sampled bias, rad."""
    sensing_dropout: tuple[float, float] | None = None
    """Range of the sampled dropout probability."""
    sensing_range: tuple[float, float] | None = None
    """Range of the sampled sensor range, m."""
    sensing_field_of_view: tuple[float, float] | None = None
    """Range of the sampled field of view, rad."""
    sensing_occlusion: tuple[str, ...] = ()
    """Kinds of occlusion to sample from, uniformly."""
    sensing_delay: tuple[int, int] | None = None
    """Range of the sampled delay, steps."""
    sensing_min_range: tuple[float, float] | None = None
    """Range of the sampled blind zone, m."""
    sensing_sample_period: tuple[float, float] | None = None
    """Range of the sampled time between two samples, s."""
    sensing_delay_time: tuple[float, float] | None = None
    """Range of the sampled delay, s."""
    sensing_observer_bias: tuple[float, float] | None = None
    """Range of the sampled bias of each observer, rad."""
    sensing_noise_correlation: tuple[float, float] | None = None
    """Range of the sampled time constant of noise, s."""
    sensing_persistence: tuple[float, float] | None = None
    """Range of the sampled time constant of detection, s."""
    sensing_outliers: tuple[float, float] | None = None
    """Range of the sampled probability of outliers."""
    sensing_chance: float = 0.5
    """Probability that a field with a range is sampled instead of keeping the scenario's value."""
    sensing_groups: Annotated[int, Bounds(1, 2**20)] = 16
    """Number of groups of environments; each group shares one sampled sensor."""
    sensing_updates: Annotated[int, Bounds(1, 2**31)] = 8
    """Number of updates for which a group keeps its sensor. A new sensor starts new episodes."""

    progress: float | None = None
    """Reward for a decrease of V from its initial value to 0. Default of this and the weights
    below: the scenario's if it sets any, else 0.5, 0.1, 0 and 1."""
    own_progress: Annotated[float, Bounds(0)] = 0.0
    """Reward of each robot for the decrease of V by its own motion, from the initial value to 0."""
    time_penalty: float | None = None
    """Cost of an episode that reaches the time limit, spread evenly over its steps."""
    collision_penalty: float | None = None
    """Team cost per robot in contact and environment step."""
    contact_penalty: Annotated[float, Bounds(0)] = 1.0
    """Cost of a robot's first contact in an episode."""
    rendezvous_bonus: float | None = None
    """Team reward at rendezvous."""

    eval_every: Annotated[int, Bounds(0, 2**62)] = DefaultInt(500_000)
    """Number of decisions between evaluations; 0 disables evaluation."""
    eval_episodes: Annotated[int, Bounds(1, 2**32)] = DefaultInt(200)
    """Number of episodes of an evaluation, from held-out initial conditions."""
    eval_scenarios: tuple[str, ...] = ()
    """Evaluation scenarios. Default: the training scenario."""
    checkpoint_every: Annotated[int, Bounds(1, 2**62)] = DefaultInt(500_000)
    """Number of decisions between checkpoints."""
    tensorboard: bool = True
    """Write TensorBoard events in addition to metrics.csv."""
    num_threads: Annotated[int | None, Bounds(1, 2**10)] = None
    """Threads of torch and of the simulator. Default: one per core. With one thread a run is
    bitwise reproducible."""
    device: str = "cpu"
    """Device of the network; small networks are fastest on the CPU."""

    def to_plain(self) -> dict[str, Any]:
        """As plain data."""
        plain = asdict(self)
        return plain | {name: None if plain[name] is None else str(plain[name]) for name in _PATHS}

    @classmethod
    def from_plain(cls, plain: dict[str, Any]) -> Config:
        """The configuration that ``to_plain`` encoded, also in an older version.

        Raises:
            ValueError: if an entry is unknown or has the wrong type.
            UserError: if a value is out of range.
        """
        if not isinstance(plain, dict):
            raise ValueError(f"the configuration is a {type(plain).__name__}, not named fields")
        plain = {_RENAMED.get(name, name): value for name, value in plain.items()}
        if unknown := sorted(set(plain) - {field.name for field in fields(cls)}):
            raise ValueError(f"field {unknown[0]!r} of the configuration is unknown")
        memory = {"memory": memory_of(plain["memory"])} if "memory" in plain else {}
        return cls(**plain | memory)

    @property
    def first_seed(self) -> int:
        """Seed of environment 0."""
        return TRAINING_SEEDS + 2**32 * self.seed

    @property
    def samples_per_update(self) -> int:
        """Robots times decisions between updates."""
        return self.num_envs * self.base_scenario().n_robots * self.n_steps

    def base_scenario(self) -> Scenario:
        """The scenario with this configuration's reward weights.

        Weights that are not given are the scenario's, or ``_REWARDS`` if the scenario has defaults.
        """
        scenario, set_here = self.plain_scenario(), any(x.startswith("reward=") for x in self.set)
        own = set_here or scenario.reward != RewardWeights()
        given = {name: value for name in _REWARDS if (value := getattr(self, name)) is not None}
        weights = ({} if own else _REWARDS) | given
        return scenario.replace(reward=replace(scenario.reward, **weights))

    def plain_scenario(self) -> Scenario:
        """The named scenario with the overrides of --set."""
        return resolve_scenario(self.scenario, self.set)

    def sensing_ranges(self) -> Ranges:
        """Ranges from which sensors are sampled; empty without domain randomisation."""
        given = {name: getattr(self, f"sensing_{name}") for name in _SAMPLED}
        return {name: ends for name, ends in given.items() if ends}

    def stage(self, step: int) -> int:
        """The stage of the curriculum at a step; 0 without one."""
        stages = max(1, len(self.curriculum))
        return min(stages * step // self.total_steps, stages - 1)

    def stage_scenario(self, stage: int) -> Scenario:
        """The scenario of a stage."""
        scenario = self.base_scenario()
        if not self.curriculum:
            return scenario
        if not isinstance(scenario.obstacles, ObstacleField):
            raise UserError(f"--curriculum: {scenario.name} samples no obstacles; omit it")
        most = self.curriculum[stage]
        fewest = most if self.fewest_obstacles is None else min(self.fewest_obstacles, most)
        return scenario.replace(obstacles=replace(scenario.obstacles, count=(fewest, most)))

    def obstacle_slots(self) -> int:
        """Most obstacles of any stage."""
        stages = range(max(1, len(self.curriculum)))
        return max(self.stage_scenario(k).observation_layout.obstacle_slots for k in stages)

    def policy_settings(self) -> PolicySettings:
        """Settings of the trained policy."""
        scenario = self.base_scenario()
        unit = time_unit(scenario) if self.guarantee == "none" else 1.0
        return PolicySettings(
            **{name: getattr(self, name) for name in _POLICY},
            decision_time=self.decision_period * scenario.tau / unit,
            budget=self.budget / unit_of_tanks(scenario),
        )


_MOST_SAMPLES = 2**31
MAY_CHANGE = ("total_steps", "eval_every", "eval_episodes", "checkpoint_every", "num_threads")
"""Fields that a resumed run may change."""


Config.__init__ = renamed_arguments(**_RENAMED)(Config.__init__)  # type: ignore[method-assign]


def check(config: Config) -> None:
    """Validate combinations of settings; a UserError names the flag and the remedy."""
    _check_unused(config)
    with user_error("", ValueError):
        _check_scenarios(config)


def _check_unused(config: Config) -> None:
    """Refuse a flag that has no effect without another one."""
    ranges = config.sensing_ranges()
    with user_error("--sensing-… samples sensors: ", ValueError):
        check_ranges(ranges, config.sensing_chance)
    if ranges and config.sensing_groups > config.num_envs:
        raise UserError(
            f"--sensing-groups is {config.sensing_groups}; it must be {config.num_envs} or less, "
            "as --num-envs"
        )
    unused = {}
    if config.guarantee != "tank":
        unused["budget"] = "headings have none: add --guarantee tank"
        if config.memory == "features":
            unused["memory"] = unused["budget"]
    if config.guarantee == "none":
        filtered = "no filter uses it: omit --guarantee none"
        unused |= dict.fromkeys(("clearance", "persistence", "min_alignment"), filtered)
        unused["max_turn_rate"] = filtered
    if config.memory != "recurrent":
        unused["memory_units"] = "there are none without --memory recurrent"
    if not ranges:
        why = "no sensors are sampled: add a range, as --sensing-noise"
        unused |= dict.fromkeys(_HOW_SAMPLED, why)
    check_unused(config, unused)


def _check_scenarios(config: Config) -> None:
    base = config.base_scenario()
    if not can_steer(base):
        raise UserError(
            f"--scenario {config.scenario}: has {base.model.name} robots; train supports "
            "single_integrator, unicycle and nonholonomic_3d. For a custom learner use "
            "rendezvous_env.training_env(scenario, guarantee=None)"
        )
    if config.critic == "global" and base.dim == 3:
        raise UserError(
            f"--critic is global; --scenario {config.scenario} is 3-D, and the global state "
            "supports planar scenarios only"
        )
    if (samples := config.samples_per_update) > _MOST_SAMPLES:
        raise UserError(
            f"--num-envs times robots times --n-steps is {samples}; it must be "
            f"{_MOST_SAMPLES} or less"
        )
    for scenario in (base, *map(resolve_scenario, config.eval_scenarios)):
        check_steerable(scenario)
        if config.guarantee == "none":
            check_searches(scenario)
    config.obstacle_slots()


def read_config(folder: Path) -> Config:
    """Settings of the run to resume; a UserError if the folder holds none."""
    path = folder / CONFIG
    try:
        return Config.from_plain(read_json(path))
    except (OSError, ValueError, UserError) as error:
        what = f"{path}: {getattr(error, 'strerror', None) or error}"
        raise UserError(f"--resume {folder}: it contains no run to resume: {what}") from error


def resumed(config: Config, stored: Config) -> Config:
    """The stored settings of a run, with changes of ``MAY_CHANGE``; a UserError for another one."""
    default, folder, changed = Config(), config.resume or config.out, {}
    if config.out.resolve() not in (default.out.resolve(), folder.resolve()):
        raise UserError(f"--out is {config.out}; {folder} resumes in its own folder: omit it")
    for name in (field.name for field in fields(Config)):
        given, kept = getattr(config, name), getattr(stored, name)
        if name in MAY_CHANGE:
            changed[name] = kept if given is None or isinstance(given, DefaultInt) else given
        elif name not in ("out", "resume") and given not in (getattr(default, name), kept):
            raise UserError(
                f"{flag(name)} is {format_argument(given)}; {folder} was trained with "
                f"{format_argument(kept)}: omit it, or begin a new run"
            )
    return replace(stored, **changed, out=folder, resume=None)


def same_run(one: Config, other: Config) -> bool:
    """True if two settings differ in nothing but ``MAY_CHANGE`` and folders."""
    default = Config()
    free = {name: getattr(default, name) for name in (*MAY_CHANGE, "out", "resume")}
    return replace(one, **free) == replace(other, **free)
