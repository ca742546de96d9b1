"""Claims of docs/theory.md as experiments: random environments, a policy, monitored quantities."""

import math
import time
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rendezvous_env import Scenario, Simulator, baselines, graphs
from rendezvous_env.safety.heading import flexible_velocity
from rendezvous_env.safety.theorems.constants import merge_rise_allowance
from rendezvous_env.safety.theorems.descent import time_bound

from .falsification import Policy, Tally, begin
from .monitors import Monitor, across, unit
from .random_initial_conditions import log_uniform
from .random_scenarios import Trial

Array = NDArray[np.float64]
Random = np.random.Generator

BATCH = 40  # environments per batch, which share all but initial state, weights and adversaries
SIZES = (2, 3, 5, 8)
FAMILIES = ("complete", "path", "cycle", "star", "random_tree", "erdos_renyi")
PATIENCE = 500.0
"""Time limit for nonholonomic robots, whose time bounds are too large to simulate, s."""


def draw_team(
    random: Random,
    batch: int,
    least_margin: float,
    *,
    by: str = "heading",
    dims: tuple[int, ...] = (2, 3),
    sizes: tuple[int, ...] = SIZES,
    families: tuple[str, ...] = FAMILIES,
    step_factors: tuple[float, float] | None = None,
    turning: bool = False,
    mixed: bool = False,
) -> Trial:
    """Random environments that differ in initial condition, weights and frames.

    Team sizes alternate; ``step_factors`` are values of τ over the certified step. Nonholonomic
    robots use the models of the paper. In ``mixed`` teams some of them are single integrators, and
    each robot has a speed limit of its own.
    """
    n, dim = sizes[batch % len(sizes)], int(random.choice(dims))
    fields: dict[str, Any] = {}
    if turning:
        model = "unicycle" if dim == 2 else "nonholonomic_3d"
        fields = {"robot_model": model, "max_turn_rate": float(random.uniform(1.0, 6.0))}
    if mixed:
        points = random.permutation(n)[: random.integers(1, n)]
        fields["robot_model"] = ["single_integrator" if i in points else model for i in range(n)]
    family = str(random.choice(families))
    scenario = Scenario(
        n_robots=n,
        dim=dim,
        graph=_graph(random, family, n),
        merge_radius=random.uniform(0.1, 0.3),
        spawn_size=random.uniform(2.0, 4.0),
        local_frames=random.choice(["random", "random", "global"]).item(),
        require_connected=family != "two trees",
        **fields,
    )
    if step_factors is not None:
        step = random.uniform(*step_factors) * scenario.certified_step
        scenario = scenario.replace(time_step=step, allow_long_step=True)
    if mixed:
        speeds = random.uniform(0.5, 1.0, n) * scenario.max_degree
        scenario = scenario.replace(max_speed=speeds.tolist())
    elif not turning and random.random() < 1 / 3:
        scenario = scenario.replace(max_speed=random.uniform(0.5, 1.0) * scenario.max_degree)
    starts: tuple[Scenario, ...] = ()
    if random.random() < 0.25:  # all robots of a team on one line, in any order
        gaps = random.uniform(2.0, 6.0, (BATCH, n)) * scenario.merge_radius
        places = random.permuted(np.cumsum(gaps, axis=-1), axis=-1)
        line = unit(random.normal(size=(BATCH, 1, dim)))
        starts = tuple(scenario.replace(start_positions=p) for p in places[..., None] * line)
    arguments = {"min_alignment": float(random.uniform(least_margin, max(least_margin, 0.9)))}
    frame = "local"
    if by == "heading":
        turn_rates = (1.0, 10.0) if turning else (0.2, 50.0)
        arguments["max_turn_rate"] = log_uniform(random, *turn_rates)
        frame = str(random.choice(["net_bearing", "local"]))
    return Trial(scenario, by, arguments, frame, 1, int(random.integers(2**40)), starts=starts)


def _graph(random: Random, family: str, n: int) -> Any:
    """Graph of a family, or two disjoint trees: a tree in random order without one edge."""
    if family == "two trees":
        order = random.permutation(n).tolist()
        edges = [
            (order[k], order[int(random.integers(k))], random.uniform(0.5, 2.0))
            for k in range(1, n)
        ]
        edges.pop(int(random.integers(n - 1)))
        return graphs.from_edges(edges, n)
    weight = (random.uniform(0.5, 1.0), random.uniform(1.0, 2.0))
    chance = (random.uniform(0.2, 0.8),) if family == "erdos_renyi" else ()
    return getattr(graphs, family if n > 2 or family != "cycle" else "path")(*chance, weight)


def bound_a(trial: Trial, teams: Simulator, margin: float = 1.0) -> Array:
    """Time bound of theorem A, s."""
    return time_bound(trial.scenario, teams.lyapunov(), min_alignment=margin)


def bound_c(trial: Trial, teams: Simulator) -> Array:
    """Time bound of theorems B and C, s."""
    return bound_a(trial, teams, trial.arguments["min_alignment"])


def bound_of_pieces(trial: Trial, teams: Simulator) -> Array:
    """Time bound for each component of a disconnected graph, s, by the proof of theorem A."""
    scenario = trial.scenario
    above = teams.lyapunov() + merge_rise_allowance(scenario)
    slowed = max(1.0, scenario.max_degree / scenario.min_speed_limit)
    return slowed * 2.0 * scenario.n_robots * above / (8.0 * scenario.bottleneck_weight**2)


def patience(trial: Trial, teams: Simulator) -> Array:
    """``PATIENCE``, without a theorem."""
    return np.full(teams.num_envs, PATIENCE)


def cosine_or_not(trial: Trial, random: Random) -> Policy:
    """Unicycles under (7) with (8), or with ω = cos t."""
    law = baselines.make(str(random.choice(["unicycle", "unicycle-cosine"])), trial.scenario)
    return lambda seen, now: law(seen, now.time)


def at_fixed_angle(trial: Trial, random: Random) -> Policy:
    """Law (4) with hᵀf = ε‖f‖ throughout, each robot to its own side."""
    scenario, epsilon = trial.scenario, trial.arguments["min_alignment"]
    axis = random.normal(size=(BATCH, scenario.n_robots, scenario.dim))
    side = random.choice([-1.0, 1.0], size=(BATCH, scenario.n_robots, 1))

    def policy(seen: Any, now: Any) -> Array:
        f = scenario.observation_layout.net_bearing(seen)
        h = epsilon * unit(f) + side * math.sqrt(1 - epsilon**2) * unit(across(f, axis))
        return flexible_velocity(f, h)

    return policy


@dataclass(frozen=True)
class Claim:
    """One row of the table."""

    name: str
    statement: str
    draw: Callable[[Random, int, float], Trial]
    """(random generator, batch index, minimum ε) → trial with shared settings and policy."""
    bound: Callable[[Trial, Simulator], Array]
    """(trial, environments at reset) → time limits (B,), s."""
    numbers: tuple[str, ...]
    """Monitored quantities of monitors.NUMBERS; the margin of the first is reported, and any
    violation counts. The limit of "time" is ``bound``, all others are 0."""
    law: Callable[[Trial, Random], Policy] | None = None
    """Policy; None is law (1), the paper's law of nonholonomic robots, or adversaries under
    certified headings."""


_law_1 = partial(draw_team, by="law")
_pieces = partial(draw_team, by="law", sizes=(3, 5, 8), families=("two trees",))
_unicycles = partial(draw_team, by="law", dims=(2,), turning=True)
_space = partial(draw_team, by="law", dims=(3,), turning=True)
_turning = partial(draw_team, turning=True)
_mixed = partial(draw_team, turning=True, mixed=True)
_long_steps = partial(draw_team, step_factors=(4.0, 10.0))
_trees = partial(draw_team, sizes=(8,), families=("random_tree",))  # whose merges increase V

CLAIMS = (
    Claim("lemma-1", "Σ‖f‖ ≥ 2 max a", _law_1, bound_a, ("lemma",)),
    Claim("theorem-1", "law (1): V falls by τ Σ‖f‖² in every step, connected teams meet",
          _law_1, bound_a, ("law_descent", "time")),
    Claim("necessity", "law (1): a disconnected graph leaves one robot for each piece",
          _pieces, bound_of_pieces, ("pieces", "time")),
    Claim("theorem-2",
          "any policy under certified headings: V never rises between merges, all meet",
          draw_team, bound_c, ("descent", "time")),
    Claim("theorem-3", "unicycles meet under (7) with (8) or ω = cos t",
          _unicycles, patience, ("time",), cosine_or_not),
    Claim("theorem-4", "3-D nonholonomic robots meet under (12), (17)",
          _space, patience, ("time",)),
    Claim("bound-A", "law (1): T ≤ A", _law_1, bound_a, ("time",)),
    Claim("bound-B", "headings at a fixed angle to f: T ≤ B",
          _law_1, bound_c, ("time", "descent"), at_fixed_angle),
    Claim("bound-C", "any policy under certified headings: T ≤ C", draw_team, bound_c, ("time",)),
    Claim("gate", "any turn rates through the gate: V never rises between merges, all meet",
          _turning, patience, ("time", "descent")),
    Claim("mixed-teams",
          "headings and turn rates of mixed teams: V never rises between merges, all meet",
          _mixed, patience, ("time", "descent")),
    Claim("certified-step", "τ = r/(2D̄), law (4): V falls by τ Σ(hᵀf)² in every step",
          _law_1, bound_c, ("descent",), at_fixed_angle),
    Claim("local-scaling",
          "4 to 10 times that step, scaled: V never rises between merges, all meet",
          _long_steps, bound_c, ("descent", "time")),
    Claim("merge-rise", "V rises at a merge by at most r max(0, D_i + D_j − 4 a_ij)",
          _trees, bound_c, ("merge_rise",)),
)  # fmt: skip


def check(claim: Claim, seed: int, batch: int, trials: int, least_margin: float) -> Tally:
    """Run one batch of a claim with margins ε of at least ``least_margin``.

    Each environment runs until rendezvous, its time limit or a violation; ``trials`` of them count.
    """
    began = time.perf_counter()
    random = np.random.default_rng([seed, zlib.crc32(claim.name.encode()), batch])
    trial = claim.draw(random, batch, least_margin)
    wrapped, seen, policy = begin(trial, 0.0, BATCH)
    policy = policy if claim.law is None else claim.law(trial, random)
    teams = wrapped.unwrapped.simulator
    limit = claim.bound(trial, teams)
    kept = {name: np.zeros(BATCH) for name in claim.numbers if name != "time"}
    watch = Monitor(wrapped.unwrapped, kept, 1, 0.0)
    # one more step: a bound lies within a step
    teams.set_max_steps(math.ceil(limit.max() / watch.held) + 1)
    wrong = np.zeros(BATCH, dtype=np.bool_)
    while (np.isinf(watch.met) & ~teams.ended & ~wrong).any():
        seen, *_, infos = wrapped.step(np.asarray(policy(seen, watch.now), dtype=np.float32))
        wrong |= watch.look(infos)[0]
    if "time" in claim.numbers:
        wrong |= watch.met > limit
    late = watch.met / limit
    margins = 1.0 - late if claim.numbers[0] == "time" else -watch.closeness[claim.numbers[0]]
    return Tally(
        trials=trials,
        margin=float(margins[:trials].min()),
        ratio={} if claim.bound is patience else {claim.name: float(late[:trials].max())},
        violations=int(wrong[:trials].sum()),
        first=batch if wrong[:trials].any() else None,
        seconds=time.perf_counter() - began,
    )
