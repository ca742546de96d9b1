"""Assumptions of theorems: one predicate each, with a message if it is not met."""

import math
from functools import partial

import numpy as np

from ...graphs.random_graphs import CustomFamily
from ...limits import LARGEST
from ...obstacles.moving import moves
from ...robots.motion import frame_turns
from ...robots.robot_models import RobotModel, constants_of, is_custom
from ...scenario.scenario import Scenario
from ...sensors.sensing import Sensing
from ..gains import gain_range
from ..settings import is_complete
from . import constants as known
from .theorem import ROUNDED, Asked, Assumption, at_least

_LEAST_MOVE, _LEAST_GAIN = 2.0**-40, 2.0**-47
_FAR_OUT_MOVE, _FAR_OUT_GAIN = 2.0**-46, 2.0**-51
_ROUNDED_OFF = 2.0**-52
"""Bound on the rounding of a position relative to the largest coordinate (float64: 2⁻⁵³)."""
_PAID = 2.0**-6  # of r W: maximum gain by rounding in an episode
_WHY_NOT = {
    known.DIRECTED: "V needs mutual links, and here visibility may be one-way",
    known.SWITCHING: (
        "a motion that decreases V on one graph can increase it on the next: on three "
        "alternating paths three robots diverge under law (4) for ε < 0.277"
    ),
    known.PROXIMITY: "robots that move by it may lose each other permanently",
}


def on_graphs(*kinds: str) -> Assumption:
    """Links have one of the given kinds."""

    def holds(scenario: Scenario, asked: Asked) -> str:
        kind = known.kind_of_links(scenario.sensing_graph)
        if kind in kinds:
            return ""
        why = _WHY_NOT[kind] if asked.by != "links" else "theorem R needs mutual visibility"
        instead = "links" if kind == known.PROXIMITY else "gains"
        return (
            f'none: by="{asked.by}" has no theorem on {kind} graphs: {why}; by="{instead}" has one'
        )

    return holds


undirected = on_graphs(known.UNDIRECTED)  # links are mutual and end only by merging
without_range = on_graphs(known.UNDIRECTED, known.DIRECTED, known.SWITCHING)
"""Links do not depend on distance."""
_ANY_LINKS = "none: with require_connected=False a custom family need not connect its robots"


def _any_links(scenario: Scenario) -> bool:
    return isinstance(scenario.sensing_graph, CustomFamily) and not scenario.require_connected


def connected(scenario: Scenario, asked: Asked) -> str:
    """The graph is connected."""
    if _any_links(scenario):
        return _ANY_LINKS
    if len(scenario.sensing_graph.components(scenario.n_robots)) == 1:
        return ""
    return "none: the graph is not connected, at least one robot per component remains (theorem 1)"


def one_leader_at_most(scenario: Scenario, asked: Asked) -> str:
    """At any time some robot is reachable from all others along the current links."""
    if _any_links(scenario):
        return _ANY_LINKS
    if len(groups := known.leaders(scenario)) == 1:
        return ""
    when = " at some time" if known.kind_of_links(scenario.sensing_graph) == known.SWITCHING else ""
    return (
        f"none: robots {' and '.join(map(str, groups))} observe no robot outside their "
        f"group{when}; theorem G needs a robot that all others can always reach"
    )


def known_bodies(scenario: Scenario, asked: Asked) -> str:
    """Each robot is a single integrator or of a model that a theorem of the paper covers.

    The gate and the tanks rely on the turn per step of the built-in models.
    """
    for model in scenario.models:
        covered = model.theorem is not None and (asked.by == "law" or not is_custom(model))
        if not (model.bounded or covered):
            return (
                f"none: no theorem covers {model.name} robots, whose action ({model.action}) is "
                "not their velocity; V may rise at any time" + _without(scenario, model)
            )
    return ""


def _without(scenario: Scenario, model: RobotModel) -> str:
    """Remedy for a mixed team, at the end of a message about one of its models."""
    if not scenario.mixes_models:
        return ""
    turning = "unicycle" if scenario.dim == 2 else "nonholonomic_3d"
    at = scenario.robot_model.index(model.name)
    return f"; robot_model[{at}] must be 'single_integrator' or {turning!r} for a theorem"


def velocity_inputs(scenario: Scenario, asked: Asked) -> str:
    """The action is the velocity."""
    others = [model for model in scenario.models if not model.bounded]
    if not all(model.theorem for model in others):
        return known_bodies(scenario, asked)
    if not others:
        return ""
    model = others[0]
    if asked.by == "tank":
        no_time = f"none: no time bound is proven for {model.name} robots under a tank"
        return no_time + _even_so(scenario, asked, "; theorem D still keeps V bounded")
    return (
        f"none: theorems G and R are for robots whose action is their velocity, and that of "
        f"{model.name} robots is {model.action}"
    )


def frames_stay(scenario: Scenario, asked: Asked) -> str:
    """Local frames are fixed, so delayed bearings refer to the current frame."""
    if scenario.events.turns_frames:
        return (
            f"none: local frames turn ({scenario.events}), and bearings or commands of the past "
            "refer to the frame of that time"
        )
    if not frame_turns(type(constants_of(scenario))):
        return ""
    return (
        f"none: frames of {scenario.model.name} robots turn, and delayed bearings refer to an "
        "earlier frame"
    )


def robots_turn(scenario: Scenario, asked: Asked) -> str:
    """Some robot is of one of the paper's nonholonomic models."""
    turning = any(not model.bounded for model in scenario.models)
    return "" if turning else "none: theorems 3 and 4 are for robots that turn"


def no_obstacles(scenario: Scenario, asked: Asked) -> str:
    """There are no obstacles, or robots pass through them."""
    if not scenario.obstacles or scenario.obstacle_contact == "ignore":
        return ""
    if asked.by == "links":
        return "none: obstacles deflect robots, and links may grow longer"
    rest = {
        "heading": "; with certified headings V still never rises between merges in a step without "
        "a contact",
        "tank": "; theorem D still keeps V bounded in motion without a contact, but no time is "
        "proven",
        "gains": "; no theorem covers gains with obstacles",
    }
    held_back = "none: an obstacle can block a robot permanently (theory 6)"
    return held_back + _even_so(scenario, asked, rest.get(asked.by, ""))


def merges_everywhere(scenario: Scenario, asked: Asked) -> str:
    """Neighbours within r merge, even through obstacles: links are r long or more."""
    if scenario.merges_through:
        return ""
    return (
        "none: with merge_through_obstacles=False robots on both sides of an obstacle may be "
        "nearer than r, where V can increase"
    )


def departs_in(scenario: Scenario, *names: str) -> bool:
    """True if the sensor is exact apart from the given fields."""
    own, exact = scenario.sensing, vars(Sensing()).items()
    return all(getattr(own, name) == value for name, value in exact if name not in names)


def only_late(scenario: Scenario, asked: Asked) -> str:
    """A delay, the same for all robots or not, is the only imperfection."""
    names = "delay", "delay_time"
    late = any(scenario.sensing.largest(name) > 0 for name in names)
    if late and departs_in(scenario, *names) and asked.error == 0.0:
        return ""
    otherwise = "theorem E1 is for bearings that are only delayed"
    return f"none: {otherwise} ({scenario.sensing.departures()})"


_CHANCE = "dropout", "detection", "persistence", "sample_period"
"""Fields of ``Sensing`` under which every neighbour is eventually detected."""


def departs_by_chance(*more: str) -> Assumption:
    """Neighbours are missed only at random, and rows may be held; the fields ``more`` may be set.

    All rows are refreshed together. With "noise" among the fields, it is white and of one level.
    """

    def holds(scenario: Scenario, asked: Asked) -> str:
        sensing = scenario.sensing
        if departs_in(scenario, *_CHANCE, *more) and not sensing.exact and asked.error == 0.0:
            for name in ("noise", "sample_period"):
                if own := sensing.list_given(name):
                    needs = "the theorems on the mean time need one for all robots"
                    return f"none: sensing.{name} is {own}; {needs}"
            return ""
        return f"none: the mean time is known for random detection only ({sensing.departures()})"

    return holds


def _mean_time(scenario: Scenario, asked: Asked) -> str:
    """Remark on the mean time of law (1) for a message: where it is, or why there is none."""
    if asked.by != "law" or not scenario.activation.synchronous or scenario.events.kinds:
        return ""
    if not departs_by_chance("noise")(scenario, asked):
        return "; see expected_time_bound for the mean time of law (1)"
    exact = vars(Sensing())
    hides = ("range", "min_range", "field_of_view", "view_falloff", "occlusion")
    if out := [name for name in hides if getattr(scenario.sensing, name) != exact[name]]:
        return f"; the mean time is unbounded, since {out[0]} can hide a neighbour permanently"
    return ""


def bounded_errors(scenario: Scenario, asked: Asked) -> str:
    """Bearings are current, with a bounded error."""
    sensing = scenario.sensing
    if sensing.custom:
        return f"none: no theorem covers custom sensors ({sensing.departures()})"
    if sensing.noise or sensing.bias or sensing.observer_bias or sensing.outliers:
        return (
            "none: the theorems hold for exact bearings, or errors up to a bound, and this "
            f"sensor's have none ({sensing.departures()})"
        ) + _mean_time(scenario, asked)
    if sensing.sample_period:
        return (
            "none: this theorem holds for current bearings, and this sensor's are held between "
            f"samples ({sensing.departures()}); theorem E1 covers a constant delay"
        ) + _mean_time(scenario, asked)
    if sensing.delay or sensing.delay_time:
        return (
            "none: this theorem holds for current bearings, and this sensor's are delayed "
            f"({sensing.departures()}); theorem E1 covers law (1) with exact delayed bearings"
        )
    if asked.by in ("heading", "tank", "links") and asked.error > math.pi / 2.0:
        return (
            f"none: bearings may err by {asked.error:.4g} rad, and wrappers accept at most π/2 rad"
        )
    return ""


def all_neighbours_visible(scenario: Scenario, asked: Asked) -> str:
    """No neighbour row is ever missing."""
    if departs_in(scenario, "error", "sectors"):
        return ""
    return (
        f"none: neighbours can be invisible ({scenario.sensing.departures()}); a theorem needs "
        "all of them"
    ) + _mean_time(scenario, asked)


def nearest_always_visible(scenario: Scenario) -> bool:
    """True if only occlusion hides robots, so the nearest is always visible (guarantees 13)."""
    among = partial(scenario.sensing.among, "occlusion", scenario.n_robots)
    hidden = bool(among("none", "robots").all() and among("robots").any())
    alone = hidden and scenario.model.bounded and departs_in(scenario, "occlusion", "error")
    return alone and is_complete(scenario)


def some_neighbour_visible(scenario: Scenario, asked: Asked) -> str:
    """All neighbours are visible, or at least the nearest of all other robots."""
    return "" if nearest_always_visible(scenario) else all_neighbours_visible(scenario, asked)


def exact_bearings(scenario: Scenario, asked: Asked) -> str:
    """Bearings are exact."""
    if asked.error == 0.0:
        return ""
    if not scenario.model.bounded:
        stays = "; V still never rises between merges" * (asked.by == "heading")
        stays = _even_so(scenario, asked, stays)
        return f"none: theorems T, 3 and 4 are for exact bearings{stays}"
    return (
        f"none: bearings may err by {asked.error:.4g} rad, and this theorem is for exact ones: "
        "theorem N needs equal sums of gains, and a visible neighbour of every robot"
    )


def certified_or_scaled(scenario: Scenario, asked: Asked) -> str:
    """τ ≤ r/(2D̄), or velocities are scaled by r/(2 D_i τ) (theory 4)."""
    if not known.long_step(scenario) or scenario.scales_velocity:
        return ""
    return (
        f"none for unscaled law (1): the step {scenario.tau:.6g} s is longer than the "
        f"certified {at_least(scenario.certified_step, 6)} s; certified headings scale the "
        "velocity and are covered"
    )


def within_neighbours(scenario: Scenario, asked: Asked) -> str:
    """τ D̄ ≤ r: no robot can overshoot its neighbours in a step.

    A speed limit does not help, since it has no effect where bearings nearly cancel.
    """
    beyond = scenario.max_degree * scenario.tau > scenario.merge_radius * (1 + 1e-12)
    if asked.by == "gains" or not beyond or scenario.scales_velocity:
        return ""
    return (
        f"none for unscaled law (1): in a step of {scenario.tau:.4g} s a robot may overshoot its "
        "neighbours; gains do not"
    )


def rows_for_all(scenario: Scenario, asked: Asked) -> str:
    """The number of neighbours never exceeds the number of rows."""
    slots = scenario.observation_layout.neighbour_slots
    if slots >= scenario.sensing_graph.most_neighbours(scenario.n_robots):
        return ""  # the default rows, without a search of all links
    if slots >= (most := known.max_neighbours(scenario)):
        return ""
    return (
        f"none: merged robots may have up to {most} neighbours, and an episode ends with an error "
        f"where one has more than neighbour_slots = {slots}; give the scenario {most}"
    )


def _largest_coordinate(scenario: Scenario) -> float:
    """Largest coordinate of an initial condition, m."""
    starts = scenario.start_positions
    return max(scenario.spawn_edges) / 2.0 if starts is None else float(np.abs(starts).max())


def outlasts_rounding(scenario: Scenario, asked: Asked, spare: float = 1.0) -> str:
    """Rounding of positions takes at most the fraction 2⁻⁵ of the guaranteed progress.

    A step at the guaranteed minimum speed, τ s a* λ ε or τ c, moves robots by at least 2⁻⁴⁰ of
    their largest coordinate. It brings them nearer, by ε times that, by at least k 2⁻⁴⁷. Under
    headings and tanks k = a* max_m m/c_m, as Σ‖f_i‖² ≥ 2a* Σ‖f_i‖/k, else k = 2. If the heaviest
    links may be out of sight, the lightest weight replaces a*.

    Tanks may separate robots as far as V allows, V ≥ 2a* of it, or 2(m−1)a* if levels follow V.
    Headings at the minimum alignment may move a team sideways by its size over ε before rendezvous.
    Under links, which moves Δ shorten by ‖Δ‖²/r, the factor is √(r/‖Δ‖). There 2⁻⁴⁶ is sufficient,
    and k 2⁻⁵¹ except for tanks: such teams gain twice the guaranteed amount.

    If errors leave ``spare``, a number, rad, of the tolerated error, robots come nearer by that
    share of a step. A team of two may then move sideways by its inverse.
    """
    starts, margin = scenario.start_positions, min(asked.min_alignment, spare)
    straight = margin if scenario.n_robots == 2 else asked.min_alignment
    largest = _largest_coordinate(scenario)
    apart = max(scenario.spawn_edges) if starts is None else float(np.ptp(starts, axis=0).max())
    unseen = nearest_always_visible(scenario) or (
        asked.by == "links" and scenario.sensing.range is not None
    )
    speed = known.lightest_link(scenario) if unseen else scenario.bottleneck_weight
    if asked.by == "tank":
        budget = min(asked.budget, LARGEST)
        most, each = known.tank_bounds(scenario, budget, asked.observes_merges)
        apart += (most if each is None else each) / (2.0 * speed)
    if asked.by == "gains":
        speed = gain_range(scenario, asked.min_gain, asked.max_gain)[0]
    unhurried = scenario.merge_radius / (2.0 * scenario.tau)
    if asked.by in ("law", "heading", "tank"):  # robots with most neighbours are slowest (theory 4)
        speed *= unhurried / max(unhurried, scenario.max_degree)
    speed = min(speed, scenario.min_speed_limit, unhurried)
    moved = scenario.tau * speed * asked.min_alignment
    k = 2.0
    if asked.by in ("heading", "tank"):
        slowness = known.robots_left(scenario) / known.min_degrees(scenario)
        k = scenario.bottleneck_weight * float(slowness.max())
    needed = max(_LEAST_MOVE, k * _LEAST_GAIN / margin) * largest
    gained = _LEAST_GAIN if asked.by == "tank" else _FAR_OUT_GAIN
    rate, far = max(_FAR_OUT_MOVE, k * gained / margin), largest + apart / straight
    if asked.by == "links":  # where moved = rate * far
        moved *= asked.share
        far = (apart / straight) ** (2.0 / 3.0) * (scenario.merge_radius / rate) ** (1.0 / 3.0)
    if needed <= moved < rate * far:
        largest, needed = far, rate * far
    if moved >= needed:
        return ""
    return (
        f"none: a step may move robots by as little as {moved:.3g} m, below the rounding error of "
        f"coordinates of {largest:.4g} m; it must be {needed:.3g} m or more: make time_step, or "
        f"the weights of links, larger, or the world {'or errors ' * (spare < 1.0)}smaller"
    )


def errors_outlasted(scenario: Scenario, asked: Asked, tolerated: float) -> str:
    """As ``outlasts_rounding``, for errors slightly below the tolerated one, rad."""
    spare = tolerated - asked.error
    return outlasts_rounding(scenario, asked, spare) if asked.error and spare > ROUNDED else ""


def rounding_pays_little(scenario: Scenario, asked: Asked) -> str:
    """Rounding cannot fill the tanks of nonholonomic robots by more than 2⁻⁶ r W in an episode.

    G has no term ε² for them, so rounded displacements add up to 4 W 2⁻⁵² of the largest coordinate
    per step.
    """
    if scenario.model.bounded:
        return ""
    steps = scenario.max_steps
    largest = _largest_coordinate(scenario) + steps * scenario.tau * scenario.speed_limit
    if 4.0 * steps * _ROUNDED_OFF * largest <= _PAID * scenario.merge_radius:
        return ""
    return (
        f"none: in {steps} steps rounding may add too much stored energy, at coordinates of up to "
        f"{largest:.4g} m: make time_limit shorter or the world smaller"
    )


def _even_so(scenario: Scenario, asked: Asked, words: str) -> str:
    """Message about V under headings or a tank, unless rounding invalidates its bound."""
    if asked.by not in ("heading", "tank"):
        return words
    if merges_everywhere(scenario, asked):
        return ""
    pays = rounding_pays_little(scenario, asked) if asked.by == "tank" else ""
    return "" if pays or outlasts_rounding(scenario, asked) else words


def still_obstacles(scenario: Scenario, asked: Asked) -> str:
    """Obstacles do not move, or robots pass through them."""
    if not moves(scenario.obstacles) or scenario.obstacle_contact == "ignore":
        return ""
    found = "push robots, which may increase V and break links; no theorem covers it"
    if scenario.obstacle_push == "stop":
        found = "stop at robots; no theorem covers moving obstacles in contact with robots"
    return f"none: obstacles move and {found}: make them still, or obstacle_contact 'ignore'"


IN_STEPS = (rows_for_all, outlasts_rounding)
"""Assumptions of every rendezvous guarantee in sampled time."""
JOINED = (without_range, connected, one_leader_at_most, velocity_inputs, *IN_STEPS)
"""Assumptions of theorems about L: all robots but one leader always have a visible neighbour."""
TEAM = (undirected, connected, velocity_inputs, *IN_STEPS)
"""Assumptions about permanent links."""
LASTING_LINKS = (
    undirected,
    connected,
    known_bodies,
    bounded_errors,
    all_neighbours_visible,
    still_obstacles,
)
"""Assumptions of theorems about V."""
KEPT = (*LASTING_LINKS, merges_everywhere, outlasts_rounding)
"""Assumptions of bounds on V or V + ΣA, including rounding."""
UNHINDERED = (*LASTING_LINKS, no_obstacles, velocity_inputs, *IN_STEPS)
"""Assumptions of time bounds from V."""
TURNING = (*LASTING_LINKS, no_obstacles, robots_turn, exact_bearings, rows_for_all)
"""Assumptions for nonholonomic robots."""
