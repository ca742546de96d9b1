"""The claims of theorems N1 and N1', and of unbiased noise: undirected graphs, held inputs
(guarantees 11).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from continuous_time import turned, unit
from numpy.typing import ArrayLike, NDArray
from tank_claims import draw_timed, nothing_rises_above, tanked

from rendezvous_env import Scenario, Sensing, Simulator
from rendezvous_env.safety.theorems.noise import (
    error_of_share,
    expected_time_bound,
    forgiven_share,
    heading_time_bound,
    law_time_bound,
    mean_cosine,
    most_wrong,
    scatter,
)
from rendezvous_env.safety.theorems.tank import tank_time_bound
from rendezvous_env.trajectory import Policy, Step
from train.verify.adversaries import Steered, across, adversary, by_name
from train.verify.cases import BATCH, Case, draw_case
from train.verify.claim import (
    Array,
    Claim,
    anything,
    falls,
    keeps,
    meets,
    meets_on_average,
    rounding,
)

KINDS = ("against", "spinning", "anyhow", "switching", "outward")
_SWITCHING = 7
"""Steps after which errors turn round."""
_ROUNDED = 1.0 - 1e-6
"""Share of an error that is still none too much after rounding to float32."""


class Misled:
    """A policy behind a sensor whose bearings are turned: away from f, to one side, anyhow, or to
    changing sides; "outward" away from the middle of what is seen, for each robot its own kind.

    Args:
        scenario: whose robots they are.
        policy: what acts on what is seen.
        error: η, rad.
        random: draws the kinds.
    """

    def __init__(
        self, scenario: Scenario, policy: Policy, error: float, random: np.random.Generator
    ) -> None:
        self.policy, self._scenario, self._random = policy, scenario, random
        self._error, self._step = error * _ROUNDED, 0
        kinds = random.integers(len(KINDS), size=(BATCH, scenario.n_robots, 1, 1))
        alike = random.random(BATCH) < 0.5
        kinds[alike] = kinds[alike, :1]
        self._kinds, self._axis = kinds, random.normal(size=(BATCH, scenario.n_robots, 1, 3))

    def watch(self, teams: object) -> None:
        """Let the policy look at these teams, if it does."""
        if hasattr(self.policy, "watch"):
            self.policy.watch(teams)

    def __call__(self, observations: NDArray[np.float32], time: ArrayLike) -> NDArray[np.float32]:
        """What the policy does when it sees the turned rows."""
        seen, layout = observations.copy(), self._scenario.observation_layout
        rows = observations[..., layout.neighbours, :].astype(np.float64)
        lengths = np.linalg.norm(rows, axis=-1, keepdims=True)
        wrong = turned(unit(rows), self._towards(rows), self._error)
        seen[..., layout.neighbours, :] = lengths * wrong
        self._step += 1
        return self.policy(seen, np.asarray(time))

    def _towards(self, rows: Array) -> Array:
        """Directions of the shape of the rows."""
        against = -np.broadcast_to(rows.sum(axis=-2, keepdims=True), rows.shape)
        side = across(unit(rows), np.broadcast_to(self._axis, (*rows.shape[:-1], 3)))
        outward = -np.broadcast_to(unit(rows).sum(axis=-2, keepdims=True), rows.shape)
        there = -1.0 if self._step // _SWITCHING % 2 else 1.0
        anyhow = self._random.normal(size=rows.shape)
        return np.asarray(np.choose(self._kinds, (against, side, anyhow, there * side, outward)))


def misled_law_1(case: Case, num_envs: int, random: np.random.Generator) -> Policy:
    """Law (1) on wrong bearings."""
    law = by_name("bearing-only")(case, num_envs, random)
    return Misled(case.scenario, law, case.error, random)


def misled_headings(case: Case, num_envs: int, random: np.random.Generator) -> Policy:
    """All adversaries under headings that allow for errors, on wrong bearings."""
    scenario = case.scenario
    chooser = adversary(scenario, num_envs, random)
    careful = Steered(
        scenario,
        num_envs,
        chooser,
        decision_period=int(random.choice([1, 1, 5])),
        min_alignment=case.margin,
        max_turn_rate=float(random.uniform(1.0, 10.0)),
        frame=str(random.choice(["net_bearing", "local"])),
        bearing_error=case.error,
    )
    return Misled(scenario, careful, case.error, random)


def misled_tanks(case: Case, num_envs: int, random: np.random.Generator) -> Policy:
    """All wishes under a tank that allows for errors, on wrong bearings."""
    return Misled(case.scenario, tanked(case, num_envs, random), case.error, random)


_STEPS = (0.3, 1.0)
"""τ over the certified step."""
_ERRORS = (0.3, 0.95)
"""ρ over what is forgiven."""
_NOISE = (0.1, 0.6)
"""Standard deviation of the angles, rad."""
_NOISY_STEPS = (0.2, 0.7)
"""θ over what is beaten."""


def _draw_slow(random: np.random.Generator, batch: int, least_margin: float) -> Case:
    return draw_case(random, batch, least_margin, step_factors=_STEPS, speed_limits=False)


def draw_wrong(random: np.random.Generator, batch: int, least_margin: float) -> Case:
    """Errors that law (1) bears."""
    case = _draw_slow(random, batch, least_margin)
    return _with_error(case, random.uniform(*_ERRORS))


def draw_wrong_headings(random: np.random.Generator, batch: int, least_margin: float) -> Case:
    """Errors that certified headings bear."""
    case = _draw_slow(random, batch, least_margin)
    return _with_error(case, random.uniform(0.2, 0.8) * float(forgiven_share(case.margin)))


def draw_wrong_tanks(random: np.random.Generator, batch: int, least_margin: float) -> Case:
    """Errors that an energy tank bears; it has no dead zone."""
    case = draw_timed(random, batch, least_margin)
    return _with_error(case, random.uniform(0.1, 0.7) * float(forgiven_share(case.margin, 0.0)))


def _with_error(case: Case, rho: float) -> Case:
    """The same with the error of a given ρ."""
    return dataclasses.replace(case, error=error_of_share(case.scenario, rho))


def draw_noisy(random: np.random.Generator, batch: int, least_margin: float) -> Case:
    """Noise, and a step that beats it."""
    scenario = draw_case(random, batch, least_margin, speed_limits=False).scenario
    noise = random.uniform(*_NOISE)
    gamma = float(mean_cosine(noise))
    nu = float(scatter(scenario, gamma))
    theta = min(random.uniform(*_NOISY_STEPS) * 2.0 * gamma / (gamma**2 + nu), 1.0)
    step = theta * scenario.merge_radius / (2.0 * scenario.max_degree)
    return Case(scenario.replace(sensing=Sensing(noise=noise), time_step=step), 1.0)


def bound_wrong(case: Case, teams: Simulator) -> Array:
    """Of theorem N1, s."""
    return law_time_bound(case.scenario, teams.lyapunov(), case.error)


def bound_wrong_headings(case: Case, teams: Simulator) -> Array:
    """Of theorem N1', s."""
    return heading_time_bound(case.scenario, teams.lyapunov(), case.error, case.margin)


def bound_wrong_tanks(case: Case, teams: Simulator) -> Array:
    """Of theorem D with bearing errors, s."""
    return tank_time_bound(
        case.scenario,
        teams.lyapunov(),
        min_alignment=case.margin,
        budget=case.budget,
        bearing_error=case.error,
    )


def bound_noisy(case: Case, teams: Simulator) -> Array:
    """On the mean time with unbiased noise, s."""
    return expected_time_bound(case.scenario, teams.lyapunov())


def rises_by_errors_only(teams: Simulator, case: Case) -> Callable[[Step], Array]:
    """By how much more than τ Σ(‖f_i‖² − e_i²) V falls in a step, over V(0); in a step with a merge
    it may rise by Σ e_i² up to there.
    """
    scenario, start = case.scenario, teams.lyapunov()
    layout = scenario.observation_layout

    def look(step: Step) -> Array:
        f, degree = layout.net_bearing(step.observations), layout.degree(step.observations)
        forgiven = most_wrong(degree, case.error) ** 2
        promised = scenario.tau * np.sum(np.sum(f**2, axis=-1) - forgiven, axis=-1)
        out = step.outcome
        calm = out.lyapunov_after_merge == out.lyapunov_before_merge
        promised = np.where(calm, promised, np.minimum(promised, 0.0))
        slack = step.lyapunov - out.lyapunov_before_merge - promised
        return np.asarray((slack + rounding(scenario, step.lyapunov)) / start)

    return look


def by_its_square(scenario: Scenario, step: Step) -> Array:
    """V falls by τ Σ ‖u_i‖² with what robots do, whatever they see, m²/s."""
    return np.asarray(scenario.tau * np.sum(step.actions.astype(np.float64) ** 2, axis=(-2, -1)))


WRONG_BEARINGS = (
    Claim(
        "wrong-law-1",
        "law (1), bearings off by η, ρ < 1: V falls by τ Σ(‖f‖² − e²) in every step, T ≤ N1",
        draw_wrong,
        misled_law_1,
        bound_wrong,
        (meets, keeps),
        anything,
        timed=True,
        watch=rises_by_errors_only,
    ),
    Claim(
        "wrong-headings",
        "any policy, headings certified against what is seen: V never rises, T ≤ N1'",
        draw_wrong_headings,
        misled_headings,
        bound_wrong_headings,
        (meets, falls),
        by_its_square,
        timed=True,
    ),
    Claim(
        "wrong-tank",
        "any wishes under a tank that allows for η: V ≤ V(0) + ΣB until a merge, T ≤ D with errors",
        draw_wrong_tanks,
        misled_tanks,
        bound_wrong_tanks,
        (meets, keeps),
        anything,
        timed=True,
        watch=nothing_rises_above,
    ),
    Claim(
        "noise",
        "law (1), unbiased noise, θ < 2γ/(γ² + ν): the mean of T is within its bound by 3 s.e.",
        draw_noisy,
        by_name("bearing-only"),
        bound_noisy,
        (meets_on_average,),
        anything,
        timed=True,
        patience=3.0,
    ),
)
