"""PettingZoo parallel environment: a vector environment with B = 1, agents by name."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from pettingzoo.utils.env import ParallelEnv

from ..engine.memory import RENDEZVOUS, RUNNING
from ..scenario.scenario import Scenario
from ..simulator import Simulator
from .agents import BaseParallelEnv, LastRobotInfo, RobotInfo, StepReturn, table_of
from .spaces import maybe_flatten
from .vector_env import RendezvousVectorEnv


class RendezvousParallelEnv(BaseParallelEnv[Box], ParallelEnv[str, NDArray[np.float32], Any]):
    """Bearing-only multi-robot rendezvous.

    ``n`` robots move in the plane or in 3-D. Each robot observes bearings to its neighbours and to
    the edges of nearby obstacles, in its own frame, without distances. Neighbours within
    ``merge_radius`` merge into one robot. Rendezvous is reached when one robot is left. After Zhao
    and Zheng, *Flexible Bearing-Only Rendezvous Control of Mobile Robots* (2017).

    Agents are ``robot_0`` … ``robot_{n-1}``. When robots i < j merge, ``robot_i`` survives and
    ``robot_j`` terminates. With ``on_merge="follow"`` it stays instead, with zero observations and
    without effect, and receives the team reward.

    ## Action space

    ``Box(a,)``, float32, in the robot's own frame; symmetric bounds. In mixed teams each agent has
    the space of its model.

    | robot model       | action         | unit       | bound |
    |-------------------|----------------|------------|--------------------------------------------|
    | single integrator | velocity (d,)  | m/s        | v_max; norm limited, direction preserved |
    | double integrator | accel. (d,)    | m/s²       | a_max (norm); speed limited to v_max |
    | unicycle          | v, ω           | m/s, rad/s | v_max, turn limit; each clipped |
    | nonholonomic 3-D  | v, ω_α, ω_β    | m/s, rad/s | v_max, 10× turn limit, turn limit; clipped |

    v_max is ``max_speed`` and the turn limit ``max_turn_rate``; the default of both is D̄, the
    maximum degree of a robot. On sparse graphs of 48 or more single integrators v_max defaults to
    the smaller ``scenario.step_degree``. a_max is ``max_acceleration``, default v_max per 0.25 s.
    Actions are held over a step τ (zero-order hold) and integrated exactly.

    ## Observation space

    ``Box(rows, d)``, float32; each row is a direction in the robot's frame, absent rows are zero.

    | rows                   | content                                                 | length |
    |------------------------|---------------------------------------------------------|--------|
    | K                      | a_ij g_ij to the neighbours in index order; sum: f_i    | a_ij   |
    | M × 2 (2-D), × 8 (3-D) | bearings to edges of obstacles in ``obstacle_range``    | 1      |
    | 1 (3-D nonholonomic)   | direction of gravity, (−sin β, 0, −cos β)               | 1      |
    | 1 (double integrator)  | velocity of the robot, m/s                              | speed  |

    K is the maximum number of neighbours in an episode, merges included: 2 on a path or cycle, n −
    1 in general. With K = n − 1 each other robot has its own row; with fewer rows, present
    neighbours come first. A smaller ``neighbour_slots`` may be given. In 2-D the rows of an
    obstacle are its counter-clockwise and clockwise edges; in 3-D eight boundary rays of its cone.
    Frames are random fixed rotations for single and double integrators, and the body frame (x =
    heading, y = left) for other models. ``scenario.observation_layout`` names the rows. With
    ``flatten`` the space is ``Box(rows·d,)``.

    ## Reward

    Every robot receives the team reward, a sum of these terms:

    * plus progress (V_t − V_{t+1})/V_0, whose sum is at most 1;
    * minus ``time_penalty``·τ/time limit;
    * minus ``collision_penalty`` per robot in contact;
    * minus ``clearance_penalty``·max(0, 1 − clearance/``obstacle_range``) per robot, by default 0;
    * plus ``rendezvous_bonus`` at rendezvous.

    With the default weights the return is at most 2. On a fixed graph without
    ``clearance_penalty``, the reward of a step with m merges is at least (theory 5)

        −w₁ (2 v_max τ A + 2 r D̄ m)/V_0 − w₂/N − w₃ n,       A = Σ_ij a_ij,

    with weights w₁, w₂, w₃ in the order above and N steps in an episode. On a directed graph r A
    replaces 2 r D̄; v_max is the ``speed_limit`` of a custom robot model. The terms with v_max and
    w₃ are 0 under ``HeadingVectorWrapper`` on undirected graphs with exact bearings. For this,
    linked robots start at least r apart, and there are no contacts.

    ## Initial condition and end

    Sampled from the seed: positions uniform in a box of ``spawn_size``, neighbours at least 2r
    apart, clear of obstacles; frames and yaw uniform, pitch within ±45°. ``reset(options=…)``
    accepts any part: "positions" (n, d), "headings" (n,) or (n, 2), "frames" (n, d, d), "weights"
    (n, n), "obstacles". Termination: rendezvous; for a merged robot, once, with the team reward and
    a zero observation. Truncation: the time limit, ``max_cycles`` steps.

    ## Infos

    The same keys in every step and after a reset:

    | key | |
    |---|---|
    | merged_into | index of the surviving robot; its own index while active |
    | contact | whether the robot had a contact in this step |
    | clearance | distance to the nearest obstacle, m; inf without obstacles |
    | success | whether rendezvous is reached |
    | time | time since the start of the episode, s |
    | contacts | number of contacts of the team so far, per robot and step |
    | path_length | total path length of the team so far, m |
    | lyapunov | V, m²/s |
    | cost, cost_NAME | with ``Scenario.costs``: cost of the step for this robot |
    | activated | with ``Scenario.activation``: whether the robot took a new command |
    | crashed, blind, adversarial | with such ``Scenario.events``: whether the robot is |

    ``info["summary"]``, which is not a key, returns success to lyapunov as a dict. ``state()`` is
    the privileged global state for centralised critics; ``simulator`` holds it in SI units.

    ## Pictures

    ``render_mode="rgb_array"``: ``render()`` gives a picture (600, 600, 3) uint8; no screen is
    needed. ``"human"``: a window that follows every step in real time; space pauses, the right
    arrow or s makes one step, escape or q closes it while the episode continues. Both need the
    extra ``render``. ``metadata["render_fps"]`` is 1/τ: real time.

    Version history: v0, the first version.
    """

    metadata = BaseParallelEnv.metadata | {"name": "rendezvous_v0"}
    _left_out = ("robot_rewards", "active")

    def __init__(
        self,
        scenario: Scenario,
        render_mode: str | None = None,
        max_cycles: int | None = None,
        flatten: bool = False,
    ) -> None:
        simulator = Simulator(scenario)
        if max_cycles is not None:
            simulator.set_max_steps(max_cycles)
        mode = AutoresetMode.DISABLED
        super().__init__(RendezvousVectorEnv(simulator, mode, render_mode, flatten))
        self.flatten = flatten
        self._indices = {name: i for i, name in enumerate(self.possible_agents)}

    @property
    def max_cycles(self) -> int:
        """Time limit in steps; may be set at any time."""
        return self.simulator.max_steps

    @max_cycles.setter
    def max_cycles(self, value: int) -> None:
        self.simulator.set_max_steps(value)

    def step(self, actions: Mapping[str, Any]) -> StepReturn:
        """Advance by one step τ with an action for each agent in ``agents``.

        Returns dicts by agent name, for the agents at the start of the step.

        Raises:
            KeyError: for a missing, unknown or merged agent; the state is unchanged.
            ValueError: for an action of the wrong shape, or one that is not finite; likewise.
            RuntimeError: before the first reset.
        """
        if self._is_over(actions):
            return {}, {}, {}, {}, {}
        simulator, alive = self.simulator, self.agents
        outcome = self.vector_env.advance(table_of(actions, alive, simulator))
        status, statistics = outcome.status.item(0), simulator.first_episode_statistics(outcome)
        over, met = status != RUNNING, status == RENDEZVOUS
        table = maybe_flatten(outcome.observations[0], self.flatten)
        (earned,), (active,) = outcome.robot_rewards.tolist(), outcome.active.tolist()
        (into,), (contact,) = simulator.copy_of_merged().tolist(), outcome.contact.tolist()
        (clearance,) = outcome.clearance.tolist()
        # all keys at once, so that the copies for robots are not resized
        common = statistics | {"merged_into": 0, "contact": False, "clearance": 0.0}
        removed, kind = self.scenario.on_merge == "remove", LastRobotInfo if over else RobotInfo
        returned: StepReturn = {}, {}, {}, {}, {}
        observations, rewards, ends, cuts, infos = returned
        gone = () if len(alive) == len(active) else {*self.possible_agents}.difference(alive)
        # not strict, which would be slower
        numbers = earned, active, into, contact, clearance
        robots = zip(self.possible_agents, table, *numbers, strict=False)
        for name, rows, reward, on_its_own, survivor, touched, distance in robots:
            if name in gone:
                continue
            observations[name], rewards[name] = rows, reward
            ends[name] = ended = met or (removed and not on_its_own)
            cuts[name] = over and not ended
            infos[name] = info = kind(common)  # copies: half the time of one loop
            info["merged_into"], info["contact"], info["clearance"] = survivor, touched, distance
        for key, values in (simulator.costs | simulator.conditions).items():
            for name, told in infos.items():
                told[key] = values[0].item(self._indices[name])
        self.agents = [] if over else [name for name in alive if not ends[name]]
        return returned

    def index(self, name: str) -> int:
        """Index of a robot by its agent name."""
        return self._indices[name]
