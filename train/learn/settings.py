"""The settings of a training run, and what follows from them."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from rendezvous_env.baselines.learned.plain_data import read_json
from rendezvous_env.baselines.learned.policy_settings import PolicySettings, memory_of
from rendezvous_env.baselines.steering import can_steer, check_steerable
from tyro.conf import arg

from rendezvous_env.obstacles.fields import ObstacleField
from rendezvous_env.rewards.terms import RewardWeights
from rendezvous_env.safety.settings import SMALLEST_MARGIN
from rendezvous_env.safety.tank import unit_of_tanks
from rendezvous_env.scenario.scenario import Scenario

from ..checks import Bounds, Flags, UserError, check_unused, flag, user_error, written
from ..policies import resolve_scenario
from .sensing_ranges import Ranges, check_ranges

TRAINING_SEEDS, EVALUATION_SEEDS, MOST_SEED = 2**62, 2**61, 2**29 - 1
"""Of first starts: training with seed s has 2⁶² + 2³² s, evaluation 2⁶¹. ``compare`` counts up from
its --seed, which is far below: no policy is judged on starts that it was trained on. And the most
that s can be.
"""
CONFIG = "config.json"
"""The settings of a run, in its folder."""
_SAMPLED = ("noise", "bias", "dropout", "range", "field_of_view", "occlusion", "delay")
"""Fields of Sensing that may have a range, in the order in which they are drawn."""
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
"""What teams are paid where neither flags nor the scenario say it."""
_POLICY = tuple(
    field.name for field in fields(PolicySettings) if field.name not in ("decision_time", "budget")
)
_LEARNING = (
    "num_teams", "n_steps", "batch_size", "epochs", "learning_rate", "gamma", "gae_lambda",
    "clip_range", "ent_coef", "prior", "start_from",
)  # fmt: skip
FLAG_GROUPS = {
    "PPO": _LEARNING,
    "Policy": (*_POLICY, "decision_period", "budget", "critic"),
    "Sensors that are sampled": (*(f"sensing_{name}" for name in _SAMPLED), *_HOW_SAMPLED),
    "Rewards": (*_REWARDS, "touch_penalty"),
    "Evaluation and machine": (
        "eval_every", "eval_starts", "eval_scenarios", "checkpoint_every", "tensorboard",
        "num_threads", "device",
    ),
}  # fmt: skip


class Unsaid(int):
    """A default that nobody has given, not even as the same number."""


@dataclass(frozen=True)
class Config(Flags):
    """Train a policy; the team keeps its guarantee whatever the network says."""

    scenario: Annotated[str, arg(aliases=("--scenarios",))] = "clutter-24"
    """A scenario's name or TOML file; its robots are anything but double integrators."""
    curriculum: Annotated[tuple[int, ...], Bounds(0, 2**10)] = ()
    """The most obstacles of an episode, in stages of equal length; without it the scenario's."""
    fewest_obstacles: Annotated[int | None, Bounds(0, 2**10)] = None
    """The fewest obstacles of an episode with a curriculum; without it always the most."""
    total_steps: Annotated[int, Bounds(1, 2**62)] = Unsaid(3_000_000)
    """How many decisions of single robots the run takes, in whole updates."""
    seed: Annotated[int, Bounds(0, MOST_SEED)] = 0
    """The seed of weights, exploration and starts, below 2²⁹."""
    out: Path = Path("runs/heading")
    """The folder of the run."""
    resume: Path | None = None
    """The folder of a run to resume. Its own settings hold, except total-steps, eval-every,
    eval-starts, checkpoint-every and num-threads where they are given."""
    start_from: Path | None = None
    """A run or checkpoint whose weights the training begins with."""

    set: tuple[str, ...] = ()
    """Other values for fields of the scenario, as in n_robots=9 time_limit=60."""

    num_teams: Annotated[int, Bounds(1)] = 256
    """How many environments are simulated at once."""
    n_steps: Annotated[int, Bounds(2)] = 16
    """How many decisions each robot takes between updates."""
    batch_size: Annotated[int, Bounds(2, 2**31)] = 2048
    """How many samples a gradient step has."""
    epochs: Annotated[int, Bounds(1, 2**31)] = 4
    """How often an update passes over its samples."""
    learning_rate: Annotated[float, Bounds(0, 1e6, "(]")] = 1e-3
    """The learning rate at the start; it falls linearly to a twentieth."""
    gamma: Annotated[float, Bounds(0, 1)] = 0.995
    """The discount for each decision."""
    gae_lambda: Annotated[float, Bounds(0, 1)] = 0.95
    """λ of the generalised advantages."""
    clip_range: Annotated[float, Bounds(0, ends="(]")] = 0.2
    """By how much the probability ratio may leave 1."""
    ent_coef: float = 0.001
    """The weight of the entropy."""
    prior: float | None = None
    """How much likelier the analytic rule is than any other choice at the start, as a logarithm: 3
    if nothing is said under headings, where it is hard to beat; with a tank 0."""

    set_width: Annotated[int, Bounds(1, 2**12)] = 32
    """The width of the networks that read one neighbour or one obstacle."""
    hidden: Annotated[tuple[int, ...], Bounds(1, 2**12)] = (64, 64)
    """The widths of the layers behind them, for actor and critic."""
    clearance: Annotated[float, Bounds(0, math.pi, "[)")] = 0.2
    """The angle by which the guide stays clear of an edge, rad."""
    persistence: Annotated[float, Bounds(0)] = 0.5
    """How firmly the guide commits to a side."""

    decision_period: Annotated[int, Bounds(1, 10**6)] = 12
    """For how many base steps a choice is held."""
    min_alignment: Annotated[float, Bounds(SMALLEST_MARGIN, 1, "[)")] = 0.05
    """The alignment margin ε of the certified heading, or of what a tank owes."""
    max_turn_rate: Annotated[float, Bounds(0, ends="(]")] = 100.0
    """The most that the certified heading turns, rad/s."""
    guarantee: Literal["heading", "tank"] = "heading"
    """Which guarantee holds: certified headings (theorem C), or an energy tank for each robot
    (theorem D)."""
    budget: Annotated[float, Bounds(0, 1e9)] = 0.0
    """The level of each tank at the start, m²/s; the policy keeps it in units of r D̄."""
    memory: Literal["none", "features", "recurrent"] = "none"
    """What robots remember beside the last decisions: nothing; with a tank, features of the wall
    that they are at; whatever a recurrent unit learns to keep."""
    memory_units: Annotated[int, Bounds(1, 2**12)] = 64
    """How many numbers the recurrent unit keeps for each robot."""
    critic: Literal["local", "global"] = "local"
    """What values are estimated from: what the robot is shown, or the state of the whole team too.
    That is privileged, and for training only: the policy never sees it."""

    sensing_noise: tuple[float, float] | None = None
    """The least and most noise of a sensor that is sampled, rad. This and the other ranges are of
    the fields of Sensing; without one the scenario's holds."""
    sensing_bias: tuple[float, float] | None = None
    """The least and most bias, rad."""
    sensing_dropout: tuple[float, float] | None = None
    """The least and most chance of dropout."""
    sensing_range: tuple[float, float] | None = None
    """The least and most range, m."""
    sensing_field_of_view: tuple[float, float] | None = None
    """The least and most field of view, rad."""
    sensing_occlusion: tuple[str, ...] = ()
    """The kinds of occlusion, all as likely."""
    sensing_delay: tuple[int, int] | None = None
    """The least and most delay, steps."""
    sensing_chance: float = 0.5
    """The chance that a sensor departs from the scenario's in a field that has a range."""
    sensing_groups: Annotated[int, Bounds(1, 2**20)] = 16
    """How many groups of environments have a sensor each, where sensors are sampled."""
    sensing_updates: Annotated[int, Bounds(1, 2**31)] = 8
    """For how many updates a group keeps its sensor; with the next one it begins new episodes."""

    progress: float | None = None
    """The reward for V falling from its first value to 0; without this weight, or one of those
    below, the scenario's if its reward is not the default, else 0.5, 0.1, 0 and 1."""
    time_penalty: float | None = None
    """What an episode costs that lasts to the time limit, paid evenly."""
    collision_penalty: float | None = None
    """What the team pays for each robot in contact, in each base step."""
    touch_penalty: Annotated[float, Bounds(0)] = 1.0
    """What a robot pays for its first contact."""
    rendezvous_bonus: float | None = None
    """What the team earns when all have met."""

    eval_every: Annotated[int, Bounds(0, 2**62)] = Unsaid(500_000)
    """How many decisions lie between evaluations; with 0 there is none."""
    eval_starts: Annotated[int, Bounds(1, 2**32)] = Unsaid(200)
    """How many held-out starts an evaluation has."""
    eval_scenarios: tuple[str, ...] = ()
    """The scenarios to evaluate on; without any it is the one that is trained on."""
    checkpoint_every: Annotated[int, Bounds(1, 2**62)] = Unsaid(500_000)
    """How many decisions lie between checkpoints."""
    tensorboard: bool = True
    """Writes events for TensorBoard beside metrics.csv."""
    num_threads: Annotated[int | None, Bounds(1, 2**10)] = None
    """The threads of torch and of the simulator: one for each core if nothing is said. On one
    thread a run repeats bit by bit."""
    device: str = "cpu"
    """Where the network is; small networks are fastest on the CPU."""

    def to_plain(self) -> dict[str, Any]:
        """As plain data."""
        plain = asdict(self)
        return plain | {name: None if plain[name] is None else str(plain[name]) for name in _PATHS}

    @classmethod
    def from_plain(cls, plain: dict[str, Any]) -> Config:
        """What ``to_plain`` gave, in an older version too; a ValueError or UserError for anything
        else.
        """
        if not isinstance(plain, dict):
            raise ValueError(f"the configuration is a {type(plain).__name__}, not named fields")
        if unknown := sorted(set(plain) - {field.name for field in fields(cls)}):
            raise ValueError(f"field {unknown[0]!r} of the configuration is unknown")
        memory = {"memory": memory_of(plain["memory"])} if "memory" in plain else {}
        return cls(**plain | memory)

    @property
    def first_seed(self) -> int:
        """That of team 0."""
        return TRAINING_SEEDS + 2**32 * self.seed

    @property
    def samples_per_update(self) -> int:
        """Robots times decisions between updates."""
        return self.num_teams * self.base_scenario().n_robots * self.n_steps

    def base_scenario(self) -> Scenario:
        """The scenario with this configuration's rewards: the weights that are given, and its own
        for the others, or ``_REWARDS`` where nobody said what its own are.
        """
        scenario, set_here = self.plain_scenario(), any(x.startswith("reward=") for x in self.set)
        own = set_here or scenario.reward != RewardWeights()
        given = {name: value for name in _REWARDS if (value := getattr(self, name)) is not None}
        weights = ({} if own else _REWARDS) | given
        return scenario.replace(reward=replace(scenario.reward, **weights))

    def plain_scenario(self) -> Scenario:
        """The scenario as it is named, with what --set says."""
        return resolve_scenario(self.scenario, self.set)

    def sensing_ranges(self) -> Ranges:
        """What sensors are sampled from; empty if teams have the scenario's."""
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
            raise UserError(f"--curriculum: {scenario.name} draws no obstacles; leave it out")
        most = self.curriculum[stage]
        fewest = most if self.fewest_obstacles is None else min(self.fewest_obstacles, most)
        return scenario.replace(obstacles=replace(scenario.obstacles, count=(fewest, most)))

    def obstacle_slots(self) -> int:
        """Most obstacles of any stage."""
        stages = range(max(1, len(self.curriculum)))
        return max(self.stage_scenario(k).observation_layout.obstacle_slots for k in stages)

    def policy_settings(self) -> PolicySettings:
        """Those of the trained policy."""
        scenario = self.base_scenario()
        return PolicySettings(
            **{name: getattr(self, name) for name in _POLICY},
            decision_time=self.decision_period * scenario.tau,
            budget=self.budget / unit_of_tanks(scenario),
        )


_MOST_SAMPLES = 2**31
MAY_CHANGE = ("total_steps", "eval_every", "eval_starts", "checkpoint_every", "num_threads")
"""Fields that a resumed run may change."""


def check(config: Config) -> None:
    """Refuse settings that do not go together with a UserError that names the flag and what would
    be right.
    """
    _check_unused(config)
    with user_error("", ValueError):
        _check_scenarios(config)


def _check_unused(config: Config) -> None:
    """Refuse a flag that means nothing without another one."""
    ranges = config.sensing_ranges()
    with user_error("--sensing-… draws sensors: ", ValueError):
        check_ranges(ranges, config.sensing_chance)
    if ranges and config.sensing_groups > config.num_teams:
        raise UserError(
            f"--sensing-groups is {config.sensing_groups}; it must be {config.num_teams} or less, "
            "as --num-teams"
        )
    unused = {}
    if config.guarantee == "heading":
        unused["budget"] = "headings have none: add --guarantee tank"
        if config.memory == "features":
            unused["memory"] = unused["budget"]
    if config.memory != "recurrent":
        unused["memory_units"] = "there are none without --memory recurrent"
    if not ranges:
        why = "no sensors are drawn: add a range, as --sensing-noise"
        unused |= dict.fromkeys(_HOW_SAMPLED, why)
    check_unused(config, unused)


def _check_scenarios(config: Config) -> None:
    base = config.base_scenario()
    if not can_steer(base):
        raise UserError(
            f"--scenario {config.scenario}: has {base.robot_model} robots; train teaches "
            "single_integrator, unicycle and nonholonomic_3d. For a learner of your own "
            "rendezvous_env.training_env(scenario, guarantee=None) makes these"
        )
    if config.critic == "global" and base.dim == 3:
        raise UserError(
            f"--critic is global; --scenario {config.scenario} is in space, and the global state "
            "is written for the plane alone"
        )
    if (samples := config.samples_per_update) > _MOST_SAMPLES:
        raise UserError(
            f"--num-teams times robots times --n-steps is {samples}; it must be "
            f"{_MOST_SAMPLES} or less"
        )
    for scenario in (base, *map(resolve_scenario, config.eval_scenarios)):
        check_steerable(scenario)
    config.obstacle_slots()


def read_config(folder: Path) -> Config:
    """The settings of the run to resume; a UserError if there is none."""
    path = folder / CONFIG
    try:
        return Config.from_plain(read_json(path))
    except (OSError, ValueError, UserError) as error:
        what = f"{path}: {getattr(error, 'strerror', None) or error}"
        raise UserError(f"--resume {folder}: it holds no run that can go on: {what}") from error


def resumed(config: Config, stored: Config) -> Config:
    """The stored settings of a run, with changes of ``MAY_CHANGE``; a UserError for another one."""
    default, folder, changed = Config(), config.resume or config.out, {}
    if config.out.resolve() not in (default.out.resolve(), folder.resolve()):
        raise UserError(f"--out is {config.out}; {folder} goes on in its own folder: leave it out")
    for name in (field.name for field in fields(Config)):
        given, kept = getattr(config, name), getattr(stored, name)
        if name in MAY_CHANGE:
            changed[name] = kept if given is None or isinstance(given, Unsaid) else given
        elif name not in ("out", "resume") and given not in (getattr(default, name), kept):
            raise UserError(
                f"{flag(name)} is {written(given)}; {folder} was trained with {written(kept)}: "
                "leave it out, or begin a new run"
            )
    return replace(stored, **changed, out=folder, resume=None)


def same_run(one: Config, other: Config) -> bool:
    """Whether two settings differ in nothing but ``MAY_CHANGE`` and folders."""
    default = Config()
    free = {name: getattr(default, name) for name in (*MAY_CHANGE, "out", "resume")}
    return replace(one, **free) == replace(other, **free)
