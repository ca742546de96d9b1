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
from .agents import LastRobotInfo, RobotInfo, StepReturn, TeamByName, table_of
from .spaces import as_told
from .vector_env import RendezvousVectorEnv


class RendezvousParallelEnv(TeamByName[Box], ParallelEnv[str, NDArray[np.float32], Any]):
    """Robots that see only directions must all meet.

    ``n`` robots move in the plane or in 3-D. Each one sees in which direction its neighbours and
    the edges of near obstacles lie, in its own frame, and never how far. Neighbours that come
    within ``merge_radius`` become one robot; when one is left, the team has met. After Zhao and
    Zheng, *Flexible Bearing-Only Rendezvous Control of Mobile Robots* (2017).

    Agents are ``robot_0`` … ``robot_{n-1}``. When robots i < j merge, ``robot_i`` goes on and
    ``robot_j`` ends; with ``on_merge="follow"`` it stays instead, with zero observations and
    without effect, and earns the team reward.

    ## Action space

    ``Box(a,)``, float32, in the robot's own frame; symmetric bounds, the same for all robots.

    | robot model       | numbers        | unit       | bound |
    |-------------------|----------------|------------|--------------------------------------------|
    | single integrator | velocity (d,)  | m/s        | v_max; norm limited, direction kept |
    | double integrator | accel. (d,)    | m/s²       | a_max, direction kept; speed within v_max |
    | unicycle          | v, ω           | m/s, rad/s | v_max, turn limit; each clipped |
    | nonholonomic 3-D  | v, ω_α, ω_β    | m/s, rad/s | v_max, 10× turn limit, turn limit; clipped |

    v_max is ``max_speed``, the turn limit ``max_turn_rate``; None of either is D̄, the largest sum
    of gains that a robot can have; v_max of 48 single integrators or more on a sparse graph is then
    ``scenario.step_degree``, which is less. a_max is ``max_acceleration``; None is v_max per
    0.25 s. Inputs are held over a step τ and integrated exactly.

    ## Observation space

    ``Box(rows, d)``, float32, one row a direction in the robot's own frame; an absent row is zero.

    | rows                   | what                                                    | length |
    |------------------------|---------------------------------------------------------|--------|
    | K                      | a_ij g_ij to the neighbours in index order; sum: f_i    | a_ij   |
    | M × 2 (2-D), × 8 (3-D) | silhouette bearings of obstacles in ``obstacle_range``  | 1      |
    | 1 (3-D nonholonomic)   | direction of gravity, (−sin β, 0, −cos β)               | 1      |
    | 1 (double integrator)  | its own velocity, m/s                                   | speed  |

    K is the most neighbours that a robot can have in an episode, merges included: 2 on a path or
    cycle, n − 1 in general, where each other robot has its own row; with fewer the neighbours that
    are there stand first. A smaller ``neighbour_slots`` may be given. In 2-D an obstacle's rows are
    its counter-clockwise and clockwise edge; in 3-D the rays of its cone at 8 azimuths. Frames are
    a random fixed rotation for each single and double integrator, the body frame (x = heading,
    y = left) for the other models. ``scenario.observation_layout`` names the rows; with ``flatten``
    they stand one after another, ``Box(rows·d,)``.

    ## Reward

    Every robot gets the team reward: progress (V_t − V_{t+1})/V_0, which adds up to at most 1,
    minus ``time_penalty``·τ/time limit, minus ``collision_penalty`` for each robot in contact,
    minus ``clearance_penalty``·max(0, 1 − clearance/``obstacle_range``) for each robot (its weight
    is 0 unless given), plus ``rendezvous_bonus`` when all have met. With the default weights an
    episode earns at most 2. On a graph that stays as it is, with A = Σ_ij a_ij, the weights w₁, w₂,
    w₃ in the order above and no ``clearance_penalty``, a step with m merges, of N in an episode,
    earns at least −w₁ (2 v_max τ A + 2 r D̄ m)/V_0 − w₂/N − w₃ n (theory 5), with r A for 2 r D̄ on
    a directed graph, v_max the ``speed_limit`` of a robot model of one's own. The terms of v_max
    and w₃ are 0 under ``HeadingVectorWrapper`` on undirected graphs, with exact bearings, linked
    robots that start r or more apart, and no contacts.

    ## Start and end

    Drawn from the seed: uniform in a box of edge ``spawn_size``, neighbours at least 2r apart,
    clear of obstacles; frames and yaw uniform, pitch within ±45°. ``reset(options=…)`` takes any
    part as given: "positions" (n, d), "headings" (n,) or (n, 2), "frames" (n, d, d), "weights" (n,
    n), "obstacles". Terminated: all robots have met; a merged-away robot, once, with the team
    reward and a zero observation. Truncated: the time limit, ``max_cycles`` steps.

    ## Infos

    The same numbers in every step, at the start too:

    | key | |
    |---|---|
    | merged_into | index of the robot that it is now part of; its own while it is on its own |
    | contact | whether it touched an obstacle in this step |
    | clearance | m to the nearest obstacle, inf without any |
    | success | whether all robots of the team have met |
    | time | s since the start of the episode |
    | contacts | of the team so far, one for each robot and step |
    | path_length | way of all robots of the team together so far, m |
    | lyapunov | V, m²/s |
    | cost, cost_NAME | with ``Scenario.costs``: what the step cost this robot |

    ``info["summary"]``, which is none of the keys, reads success to lyapunov once more.
    ``state()`` is the privileged global state for centralised critics; ``simulator`` holds it in SI
    units.

    ## Pictures

    ``render_mode="rgb_array"``: ``render()`` gives a picture (600, 600, 3) uint8; no screen is
    needed. ``"human"``: a window that follows every step in real time; space pauses, the right
    arrow or s makes one step, escape or q closes it and the episode goes on unseen. Both need the
    extra ``render``. ``metadata["render_fps"]`` is 1/τ: real time.

    Version history: v0, the first version.
    """

    metadata = TeamByName.metadata | {"name": "rendezvous_v0"}
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
        outcome = self.teams.advance(table_of(actions, alive, simulator))
        status, statistics = outcome.status.item(0), simulator.first_episode_statistics(outcome)
        over, met = status != RUNNING, status == RENDEZVOUS
        table = as_told(outcome.observations[0], self.flatten)
        (earned,), (active,) = outcome.robot_rewards.tolist(), outcome.active.tolist()
        (into,), (contact,) = simulator.merged_into.tolist(), outcome.contact.tolist()
        (clearance,) = outcome.clearance.tolist()
        removed, kind = self.scenario.on_merge == "remove", LastRobotInfo if over else RobotInfo
        returned: StepReturn = {}, {}, {}, {}, {}
        observations, rewards, ends, cuts, infos = returned
        gone = () if len(alive) == len(active) else {*self.possible_agents}.difference(alive)
        # not strict: the end of an array is found by an error
        numbers = earned, active, into, contact, clearance
        robots = zip(self.possible_agents, table, *numbers, strict=False)
        for name, rows, reward, on_its_own, survivor, touched, distance in robots:
            if name in gone:
                continue
            observations[name], rewards[name] = rows, reward
            ends[name] = ended = met or (removed and not on_its_own)
            cuts[name] = over and not ended
            infos[name] = info = kind(statistics)  # then one by one: half as long as at once
            info["merged_into"], info["contact"], info["clearance"] = survivor, touched, distance
        for key, values in simulator.costs.items():
            for name, told in infos.items():
                told[key] = values[0].item(self._indices[name])
        self.agents = [] if over else [name for name in alive if not ends[name]]
        return returned

    def index(self, name: str) -> int:
        """Index of a robot by its agent name."""
        return self._indices[name]
