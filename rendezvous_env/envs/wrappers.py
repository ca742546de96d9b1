"""Guarantee wrappers for PettingZoo: a safety filter with action repeat."""

from collections.abc import Mapping
from copy import deepcopy
from typing import Any

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray
from pettingzoo.utils.env import ParallelEnv
from pettingzoo.utils.wrappers import BaseParallelWrapper

from ..checks import check_action
from .agents import Infos, Observations, SpacesByName, StepReturn, check_robots
from .guarantee import FilterWrapperMixin, GainSettings, HeadingSettings, LinkSettings, TankSettings
from .parallel_env import RendezvousParallelEnv
from .spaces import maybe_flatten
from .vector_env import RendezvousVectorEnv


class GuaranteeWrapper(FilterWrapperMixin, SpacesByName[Box], BaseParallelWrapper):
    """Safety filter with action repeat: the filter maps policy actions to base actions.

    Observations are the filter's view of the rows, and actions are its inputs. Infos add the
    filter's diagnostics of the last base step; ``contact`` and costs cover the whole agent step.

    Args:
        env: a rendezvous parallel environment, wrapped or not. Wrappers beneath must not change
            observations, actions or spaces. They must step once per step and not reset. Each step
            is compared with the base environment; a wrapper that changes it is rejected. Exempt are
            models of sensors or actuators, with the class attribute ``part_of_world = True``.
        safety_filter: a filter for one environment of this scenario, its class, or its name:
            "heading", "tank", "gains", "links" or a registered one (``register_filter``).
        decision_period: number of base steps per agent step; the filter computes an action in each.
            Rewards are summed. A robot that merges during an agent step ends with its last
            observation.
        **settings: of a filter given by class or name. All four have ``frame``, the frame of
            observations and actions: "net_bearing" (x along f_i, single integrators only) or
            "local".

    Raises:
        TypeError: for another type of environment, an environment with a safety filter, a wrapper
            that changes its spaces, or an unknown setting.
        ValueError: for an invalid argument; the message gives its value and a remedy.
    """

    _base: RendezvousParallelEnv
    _wraps = ParallelEnv, RendezvousParallelEnv
    _wanted = (
        "a PettingZoo parallel environment from parallel_env (for a vector environment "
        "use rendezvous_env.vector.{})"
    )

    @staticmethod
    def _spaces_of(layer: Any, base: RendezvousParallelEnv) -> Any:
        return [
            (layer.observation_space(name), layer.action_space(name))
            for name in base.possible_agents
        ]

    @staticmethod
    def _vector_env_of(base: RendezvousParallelEnv) -> RendezvousVectorEnv:
        return base.vector_env

    def _make_spaces(self, observations: Box, choices: Box) -> None:
        metadata, names = self._base.metadata, self._base.possible_agents
        self.metadata = metadata | {"render_fps": metadata["render_fps"] / self.decision_period}
        self.observation_spaces = {name: deepcopy(observations) for name in names}
        self.action_spaces = {
            name: Box(choices.low[own], choices.high[own], dtype=np.float32)
            for name, own in zip(names, self.filter.choice_mask, strict=True)
        }

    @property
    def max_cycles(self) -> int:
        """Time limit in steps of the base environment; may be set at any time."""
        return self._base.max_cycles

    @max_cycles.setter
    def max_cycles(self, value: int) -> None:
        self._base.max_cycles = value

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, Infos]:
        """Start an episode and reset the filter."""
        observations, infos = self.env.reset(seed=seed, options=options)
        self.filter.forget()
        self._remember(observations)
        if self._checks_passage:
            self._check_passage(None, self._observed, ...)
        self._note_seen()
        self._add_diagnostics(infos)
        return self._view(observations), infos

    def step(self, actions: Mapping[str, Any]) -> StepReturn:
        """Apply the actions of ``agents`` for ``decision_period`` steps.

        Errors are those of ``RendezvousParallelEnv.step``.
        """
        self._check_seen()
        if not self.agents and isinstance(actions, Mapping) and not actions:
            return {}, {}, {}, {}, {}
        simulator = self._base.simulator
        check_robots(actions, self.agents, simulator.merged_into[0])
        self.filter.hold(self._choices(actions))
        returned: StepReturn = {}, dict.fromkeys(self.agents, 0.0), {}, {}, {}
        observations, rewards, terminations, truncations, infos = returned
        for _ in range(self.decision_period):
            table, acting = self.filter.apply(self._observed)[0], simulator.active
            chosen = {name: table[self._base.index(name)].copy() for name in self.agents}
            rows, reward, terminated, truncated, new_infos = self._step_beneath(chosen)
            self._remember(rows)
            if self._checks_passage:
                self._check_passage(table[None], self._observed, acting)
            if self.filter.uses_feedback:
                contact = self._base.vector_env.outcome.contact  # wrappers may change infos
                self.filter.update(contact, simulator.copy_of_merged())
            self._add_diagnostics(new_infos)
            for name, info in new_infos.items():
                rewards[name] += reward[name]
                before = infos.get(name, {})  # wrappers may omit infos
                info["contact"] = info.get("contact", False) or before.get("contact", False)
                for key in simulator.costs:
                    info[key] += before.get(key, 0.0)
            infos |= new_infos
            terminations |= terminated
            truncations |= truncated
            observations |= rows
            if not self.agents:
                break
        self._note_seen()
        return self._view(observations), *returned[1:]

    def _choices(self, actions: Mapping[str, Any]) -> NDArray[np.float64]:
        """Choices by agent as (1, n, k), padded with zeros; a ValueError names a wrong one."""
        choices, mask = np.zeros((1, *self.filter.choice_mask.shape)), self.filter.choice_mask
        for name, action in actions.items():
            own = mask[self._base.index(name)]
            check_action(name, action, int(own.sum()))
            choices[0, self._base.index(name), own] = action
        return choices

    def _add_diagnostics(self, infos: Infos) -> None:
        """Add the filter's diagnostics of the last step."""
        found = {key: values[0].tolist() for key, values in self.filter.diagnostics.items()}
        for name, info in infos.items():
            i = self._base.index(name)
            info.update({key: values[i] for key, values in found.items()})

    def _remember(self, observations: Observations) -> None:
        """Store the current observations, zero for merged robots."""
        shape = self._observed.shape[2:]
        rows = {name: seen.reshape(shape) for name, seen in observations.items()}
        self._observed = self._table(rows, shape, np.float32)

    def _table(
        self, values: Mapping[str, Any], shape: tuple[int, ...], dtype: type[Any]
    ) -> NDArray[Any]:
        """Values by agent as (1, n, ...), zero for other robots."""
        table = np.zeros((1, self._base.scenario.n_robots, *shape), dtype=dtype)
        for name, value in values.items():
            table[0, self._base.index(name)] = value
        return table

    def _view(self, observations: Observations) -> Observations:
        """Observations of the policy."""
        seen = maybe_flatten(self.filter.observe(self._observed)[0], self._base.flatten)
        return {name: seen[self._base.index(name)].copy() for name in observations}


class HeadingVectorWrapper(HeadingSettings, GuaranteeWrapper):
    """Actions are heading vectors h_i, executed by law (4), with guaranteed rendezvous.

        ṗ_i = h_i h_iᵀ f_i                                              (Zhao & Zheng, eq. 4)

    ``certified_heading`` (theorem C) maps the raw vector of any policy to h_i. The guarantee is for
    fixed, connected, undirected graphs, bearing errors of at most ``bearing_error``, and no
    obstacles: any policy meets within the certificate's time bound. Other graphs and sensors are
    accepted without this guarantee; see ``certificate``. Velocities are scaled by r/(2 D_i τ) if
    the step is longer than certified (theory 4). Nonholonomic robots choose turn rates, limited by
    the gate of theory 3, and drive with v = mᵀf.

    * Actions: ``Box(−1, 1, (d,))``, a raw vector in the observed frame; only its direction is
      used. For nonholonomic robots ``Box(−1, 1, (1,))`` or ``(2,)``: turn rates in units of
      ``max_turn_rate``. In mixed teams each robot has the space of its model; arrays of vector
      environments are padded, see ``SafetyFilter.choice_mask``.
    * Observations: the base environment's rows. With ``frame="net_bearing"`` (single integrators) x
      is along f_i, so that any network is rotation-equivariant: exactly in 2-D; in 3-D the second
      axis comes from the row with the longest part across f_i. While ‖f_i‖ < δ the last frame is
      kept.
    * Infos: ``alignment`` = |h_iᵀf_i|/‖f_i‖ (NaN where f_i = 0, and at a reset) and
      ``lyapunov_rate`` = −2 (h_iᵀf_i)², m²/s², with a ``bearing_error`` −2 h_iᵀf_i max(0, h_iᵀf_i −
      e_i): of velocities before scaling to the step or the speed limit.

    Args:
        env: this, ``frame``, ``decision_period`` and errors as in ``GuaranteeWrapper``.
        min_alignment: ε, in (0, 1).
        max_turn_rate: ω_max, rad/s; for nonholonomic robots the scenario's limit holds too.
        certified: False uses the raw vector as h_i, without any guarantee.
        bearing_error: η, rad: V never increases between merges for bearing errors up to η. The
            speed along h_i is then max(0, h_iᵀf_i − e_i), e_i = 2 sin(η/2) D_i (theorem N1').
    """


class EnergyTankWrapper(TankSettings, GuaranteeWrapper):
    """Actions are desired velocities; energy tanks limit the increase of V.

        A_i ← A_i + G_i(Δ_i),   G_i(Δ) = 2 f_i·Δ − (2/r) D_i ‖Δ‖² − ε² τ s_i ‖f_i‖²  (guarantees 8)

    The desired velocity is executed while A_i + G_i ≥ 0, even opposite to f_i. Otherwise law (4)
    moves the robot along that direction, projected onto the cap |hᵀf_i| ≥ ε‖f_i‖ (along f_i if it
    is zero), which fills the tank. On a fixed, connected, undirected graph, with bearing errors of
    at most ``bearing_error``, V ≤ V(0) + n·budget until the first merge. Without obstacles
    rendezvous then occurs in finite time for any policy (theorem D). Other graphs and sensors are
    accepted without this guarantee; see ``certificate``. In a step with contact the tank is updated
    by min(0, G_i), so the bound on V holds for motion without contacts. After a merge, the
    surviving robot has the sum of both tanks; on complete graphs of equal weights without
    obstacles, all stored energies also shrink at a merge (guarantees 8).

    * Actions: ``Box(−1, 1, (d,))``, the desired velocity in units of v_max, in the observed frame,
      limited to v_max. For other robot models the base action in units of its bounds. For
      nonholonomic robots G_i has no term ε², and there is no time bound; with an empty tank they
      drive with v = s mᵀf and turn through the gate of theory 3.
    * Observations: as ``HeadingVectorWrapper``. ``observe_level`` appends a row (A_i/(r D̄), 0, …),
      the robot's stored energy in units of twice the maximum gain of a step. A robot computes it
      from its own past without a sensor.

    | infos | |
    |---|---|
    | tank | stored energy A_i after the step, m²/s; 0 for a merged robot |
    | carried_out | whether the desired velocity was executed instead of law (4) |
    | alignment | |h_iᵀf_i|/‖f_i‖, h_i the direction of motion or the body axis; NaN without any |
    | lyapunov_rate | −2 f_iᵀΔ_i/τ, m²/s²: positive if V increases |

    Args:
        env: this, ``frame``, ``decision_period`` and errors as in ``GuaranteeWrapper``.
        budget: B_i, initial stored energy of each robot, m²/s.
        min_alignment: ε, in (0, 1), which determines the time bound.
        observe_level: whether robots observe their stored energy.
        bearing_error: η, rad: guarantees hold for bearing errors up to η; each step is charged the
            maximum effect of such errors.
    """


class GainWrapper(GainSettings, GuaranteeWrapper):
    """Actions are weights of neighbours; robots move along the weighted sum of bearings.

        v_i = Σ_j c_ij g_ij,   c_ij ∝ w_j a_ij,   min_gain ≤ Σ_j c_ij ≤ max_gain    (theorem G)

    With exact bearings, without obstacles and while linked robots are at least r apart, the convex
    hull does not grow on any graph: directed, switching, or never connected at one time. While
    every robot has a visible neighbour, rendezvous occurs in finite time. V may increase.

    * Actions: ``Box(0, 1, (K,))``, a weight for each neighbour row, in observed order. Absent rows
      are ignored; if all other weights are zero, they are set equal. All gains of a robot are then
      scaled by a common factor. Observations as under ``HeadingVectorWrapper``.
    * Infos: ``gain`` = Σ_j c_ij, m/s, 0 for a robot without visible neighbours. ``alignment`` =
      |h_iᵀf_i|/‖f_i‖, h_i the direction of motion, NaN if there is none. ``lyapunov_rate`` = −2
      f_iᵀv_i, m²/s², positive if V increases.

    Args:
        env: this, ``frame``, ``decision_period`` and errors as in ``GuaranteeWrapper``; the robots'
            action must be their velocity.
        min_gain: m/s, or a list with one for each robot; None is a*. The time bound is inversely
            proportional to the least.
        max_gain: m/s, likewise; None is D̄. At most r/τ: with longer steps a robot may leave the
            hull. At r/τ itself there is no time bound.
    """


class LinkKeepingWrapper(LinkSettings, GuaranteeWrapper):
    """Actions are desired velocities, projected onto those that maintain connectivity.

        v_i = λ min(d_i, r/(2τ), v_max) q_i + (1 − λ) P(desired)    (theorem R c, guarantees 12)

    P is the projection onto velocities for which no visible link grows, provided that all robots
    use the same constraint. q_i is the point of least norm in the convex hull of the robot's
    bearings.

    The guarantee assumes a limited sensing range, linked robots that start at least r apart, and
    motion without contacts. A link of at most range − (n − 1) r/2 is then lost only by a merge.
    Beside obstacles that robots pass through, the limit is range − (n − 1) r. If such links connect
    the robots initially, rendezvous occurs in finite time for any policy.

    Actions as under ``EnergyTankWrapper``, observations as under ``HeadingVectorWrapper``, infos
    ``alignment`` and ``lyapunov_rate`` as under ``GainWrapper``. The rate is never positive for
    bearing errors up to ``bearing_error``.

    Args:
        env: this, ``frame``, ``decision_period`` and errors as in ``GuaranteeWrapper``. The robots'
            action must be their velocity. Visibility must be mutual and limited only by distance:
            no field of view, dropout or occlusion.
        share: λ, in [10⁻⁶, 1], velocity share of the connectivity-maintaining law. The time bound
            is inversely proportional to it.
        bearing_error: η, rad: links are maintained for bearing errors up to η. For η < π/(2n)
            rendezvous is guaranteed (theorem R d).

    Raises:
        ValueError: if links cannot be maintained in this scenario, with the reason.
    """
