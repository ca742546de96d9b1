"""The settings of a training run, and what follows from them."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_type_hints

from baselines.learned.plain_data import check_types
from rendezvous_env.experiment import scenarios as named_scenarios
from rendezvous_env.experiment.obstacles import ObstacleField
from rendezvous_env.experiment.rewards import RewardWeights
from rendezvous_env.experiment.scenario import Scenario

from ..errors import UserError
from .sensing_ranges import SensingRanges

if TYPE_CHECKING:
    from baselines.learned.learned_policy import PolicySettings

TRAINING_SEEDS, EVALUATION_SEEDS = 2**62, 2**61
"""Of the first start: of training with seed s it is 2⁶² + 2³² s, of evaluation 2⁶¹. ``compare``
counts up from its --seed, which is far below, so no policy is judged on starts it was trained on.
"""

_SENSING = (
    "sensing_noise", "sensing_bias", "sensing_dropout", "sensing_range", "sensing_field_of_view",
    "sensing_occlusion", "sensing_delay", "sensing_chance",
)  # fmt: skip
"""Fields that say from what sensors are drawn."""
_LATER = (
    "guarantee", "budget", "memory", "memory_units", "critic", *_SENSING, "sensing_groups",
    "sensing_updates",
)  # fmt: skip
"""Fields that runs of earlier versions have not written."""


@dataclass(frozen=True)
class Config:
    """Train a policy; the team keeps its guarantee whatever the network says."""

    scenario: str = "clutter-24"
    """Name of a scenario, or path of a TOML file; single integrators in the plane."""
    curriculum: tuple[int, ...] = ()
    """Most obstacles of an episode, in stages of equal length; none keeps the scenario's."""
    fewest_obstacles: int | None = None
    """With a curriculum: each episode has this many up to the most; None always the most."""
    total_steps: int = 10_000_000
    """Decisions of single robots."""
    seed: int = 0
    """Of weights, exploration and starts, below 2²⁹."""
    out: Path = Path("runs/heading")
    """Folder of the run."""
    resume: Path | None = None
    """Folder of a run to go on with. Its own settings hold, except total-steps, eval-every,
    eval-starts, checkpoint-every and num-threads where they are given."""
    start_from: Path | None = None
    """Run or checkpoint whose weights to begin with."""

    num_teams: int = 1024
    """Teams that are simulated at once."""
    n_steps: int = 32
    """Decisions of each robot between updates."""
    batch_size: int = 8192
    """Samples in a gradient step."""
    epochs: int = 4
    """Passes over the samples of an update."""
    learning_rate: float = 1e-3
    """At the start; it falls linearly to a twentieth."""
    gamma: float = 0.99
    """Discount for each decision."""
    gae_lambda: float = 0.95
    """Of generalised advantages."""
    clip_range: float = 0.2
    """Of the probability ratio."""
    ent_coef: float = 0.0
    """Weight of the entropy."""
    prior: float = 3.0
    """How much likelier the analytic rule is than any other choice at the start, as a logarithm."""

    set_width: int = 32
    """Of the networks that read one neighbour or one obstacle."""
    hidden: tuple[int, ...] = (128, 128)
    """Widths of the layers behind them, for actor and critic."""
    clearance: float = 0.2
    """By which the guide stays clear of an edge, rad."""
    persistence: float = 0.5
    """How firmly the guide stands by a side."""

    decision_period: int = 12
    """Base steps for which a choice is held."""
    min_alignment: float = 0.05
    """ε of the certified heading, or of what a tank owes."""
    max_turn_rate: float = 100.0
    """Of the certified heading, rad/s."""
    guarantee: Literal["heading", "tank"] = "heading"
    """Certified headings (theorem C), or an energy tank for each robot (theorem D)."""
    budget: float = 0.0
    """Level of each tank at the start, m²/s. The policy keeps it in units of r D̄, for other
    teams."""
    memory: Literal["none", "features", "recurrent"] = "none"
    """What robots remember beside the last decisions: nothing; with a tank, features of the wall
    that they are at; whatever a recurrent unit learns to keep."""
    memory_units: int = 64
    """Numbers that the recurrent unit keeps for each robot."""
    critic: Literal["local", "global"] = "local"
    """What values are estimated from: what the robot is shown, or the state of the whole team too.
    That is privileged, and for training only: the policy never sees it."""

    sensing_noise: tuple[float, float] | None = None
    """Least and most noise of a sensor that is drawn, rad; this and the other ranges are of the
    fields of Sensing. None leaves what the scenario says."""
    sensing_bias: tuple[float, float] | None = None
    """The same for the bias, rad."""
    sensing_dropout: tuple[float, float] | None = None
    """The same for the chance of dropout."""
    sensing_range: tuple[float, float] | None = None
    """The same for the range, m."""
    sensing_field_of_view: tuple[float, float] | None = None
    """The same for the field of view, rad."""
    sensing_occlusion: tuple[str, ...] = ()
    """Kinds of occlusion, all as likely."""
    sensing_delay: tuple[int, int] | None = None
    """Least and most delay, steps."""
    sensing_chance: float = 0.5
    """Chance that a sensor departs from the scenario's in a field that has a range."""
    sensing_groups: int = 16
    """Groups of teams that have a sensor each, where sensors are drawn."""
    sensing_updates: int = 8
    """Updates for which a group keeps its sensor; with the next one it begins new episodes."""

    progress: float = 0.5
    """Reward for V falling from its first value to 0."""
    time_penalty: float = 0.1
    """Paid evenly over the time limit."""
    collision_penalty: float = 0.0
    """Paid by the team for each robot in contact, in each base step."""
    touch_penalty: float = 1.0
    """Paid by a robot for its first contact."""
    rendezvous_bonus: float = 1.0
    """Earned by the team."""

    eval_every: int = 1_000_000
    """Steps between evaluations; 0 is never."""
    eval_starts: int = 200
    """Held-out starts of an evaluation."""
    eval_scenarios: tuple[str, ...] = ()
    """Scenarios to evaluate on; none is the one that is trained on."""
    checkpoint_every: int = 500_000
    """Steps between checkpoints."""
    tensorboard: bool = True
    """Whether to write events for TensorBoard beside metrics.csv."""
    num_threads: int | None = None
    """Of torch and of the simulator; None is one for each core. On one thread a run repeats bit by
    bit."""
    device: str = "cpu"
    """Of the network; small networks are fastest on the CPU."""

    def to_plain(self) -> dict[str, Any]:
        """As plain data."""
        return {
            key: str(value) if isinstance(value, Path) else value
            for key, value in asdict(self).items()
        }

    @classmethod
    def from_plain(cls, plain: dict[str, Any]) -> Config:
        """What ``to_plain`` gave.

        Raises:
            ValueError: for a missing or unknown field, or one of a wrong type. Fields that
                came later may be missing.
        """
        if not isinstance(plain, dict):
            raise ValueError(f"the configuration is a {type(plain).__name__}, not named fields")
        from baselines.learned.policy_settings import memory_of

        plain = {name: getattr(cls, name) for name in _LATER} | plain
        plain["memory"] = memory_of(plain["memory"])
        if wrong := sorted(set(plain) ^ {field.name for field in fields(cls)}):
            raise ValueError(f"field {wrong[0]!r} of the configuration is missing or unknown")
        paths = ("out", "resume", "start_from")
        read = {
            key: tuple(value)
            if isinstance(value, list)
            else Path(value)
            if key in paths and isinstance(value, str)
            else value
            for key, value in plain.items()
        }
        check_types(read, get_type_hints(cls))
        return cls(**read)

    @property
    def first_seed(self) -> int:
        """Of the starts of team 0."""
        return TRAINING_SEEDS + 2**32 * self.seed

    @property
    def samples_per_update(self) -> int:
        """Robots times decisions between updates."""
        return self.num_teams * self.base_scenario().n_robots * self.n_steps

    def base_scenario(self) -> Scenario:
        """The scenario with this configuration's rewards."""
        rewards = RewardWeights(
            progress=self.progress,
            time_penalty=self.time_penalty,
            collision_penalty=self.collision_penalty,
            rendezvous_bonus=self.rendezvous_bonus,
        )
        return named_scenarios.resolve(self.scenario).replace(reward=rewards)

    def sensing_ranges(self) -> SensingRanges:
        """From what the sensors of the teams are drawn; false if they are the scenario's.

        Raises:
            ValueError: naming the field of a range that no sensor can have.
        """
        return SensingRanges(**{k.removeprefix("sensing_"): getattr(self, k) for k in _SENSING})

    def stage(self, step: int) -> int:
        """Which stage of the curriculum a step belongs to; 0 without one."""
        stages = max(1, len(self.curriculum))
        return min(stages * step // self.total_steps, stages - 1)

    def stage_scenario(self, stage: int) -> Scenario:
        """What is trained in a stage."""
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
        """What the policy is, once it is trained."""
        from baselines.learned.learned_policy import PolicySettings
        from rendezvous_env.guarantee.energy_tank import unit_of_tanks

        scenario = self.base_scenario()
        return PolicySettings(
            set_width=self.set_width,
            hidden=self.hidden,
            clearance=self.clearance,
            persistence=self.persistence,
            min_alignment=self.min_alignment,
            max_turn_rate=self.max_turn_rate,
            decision_time=self.decision_period * scenario.tau,
            guarantee=self.guarantee,
            budget=self.budget / unit_of_tanks(scenario),
            memory=self.memory,
            memory_units=self.memory_units,
        )
