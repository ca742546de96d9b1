"""Certificates: theorem, numbers, or the reason why there is none."""

import math
import re
import tracemalloc

import numpy as np
import pytest

import baselines
import rendezvous_env as rv
from rendezvous_env import Capsule, Disc, Scenario, Sensing, Simulator, certificate, graphs, rollout
from rendezvous_env.safety.theorems.constants import (
    kind_of_links,
    largest_lyapunov,
    largest_size,
    leaders,
    min_degrees,
)
from rendezvous_env.safety.theorems.gains import kappa
from rendezvous_env.safety.theorems.theorem import CHOICES
from rendezvous_env.scenario import scenarios
from rendezvous_env.vector import GuaranteeWrapper

WALL = (Disc((0.0, 0.0), 1.0),)
LONG_STEP = {"time_step": 0.3, "allow_long_step": True}
LONG = Scenario(**LONG_STEP)
PIECES = Scenario(graph=graphs.from_edges([(0, 1)], 5), require_connected=False)
SQUARE = ((0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (0.0, 4.0))
PURSUIT = Scenario(n_robots=4, graph=graphs.directed_cycle(), start_positions=SQUARE)
LED = Scenario(graph=graphs.directed([(1, 0), (2, 1), (3, 1, 2.0)]), n_robots=4)
SWITCHING = PURSUIT.replace(graph=graphs.switching(["path", "star"], dwell=1.0))
NEAR = Scenario(n_robots=4, graph=graphs.proximity(), sensing=Sensing(range=6.0))
SPARSE = Scenario(n_robots=60, graph=graphs.erdos_renyi(0.06), spawn_size=12.0)
BEHIND = Scenario(sensing=Sensing(occlusion="robots"))
graphs.family("two-pairs", lambda n, random: [(0, 1), (2, 3)])
APART = Scenario(n_robots=4, graph="two-pairs", require_connected=False)
MARGINS = {"law": 1.0, "heading": 0.3, "tank": 0.3, "gains": 1.0, "links": 1.0}
close = pytest.approx


def alone(scenario, by, **settings):
    """A team with the filter of a guarantee, for manual steps, and its simulator."""
    env = GuaranteeWrapper(rv.make_vec(scenario, num_envs=1), by, **{"frame": "local"} | settings)
    env.reset(seed=0)
    return env, env.unwrapped.simulator


@pytest.mark.parametrize(
    ("scenario", "margin", "finite", "words"),
    [
        (Scenario(), 1.0, True, "theorems 1 and G"),
        (Scenario(), 0.1, True, "theorems 2 and C"),
        (Scenario(dim=3), 1.0, True, "theorems 1 and G"),
        (Scenario(robot_model="unicycle"), 1.0, False, "theorem 3"),
        (Scenario(robot_model="nonholonomic_3d", dim=3), 1.0, False, "theorem 4"),
        (Scenario(obstacles=WALL, obstacle_contact="ignore"), 1.0, True, "theorems 1 and G"),
        (LONG, 0.1, True, "scaled to the long step"),
        (LED, 1.0, True, "theorem G: law (1)"),
        (SPARSE, 1.0, True, "velocities scaled"),
    ],
)
def test_certificate_is_granted(scenario, margin, finite, words):
    found = certificate(scenario, margin)
    assert found.guaranteed and math.isfinite(found.time_bound) is finite
    assert words in found.theorem
    assert found.by == ("law" if margin == 1 else "heading")
    assert found.min_alignment == found.margin == margin and found.dead_zone == scenario.dead_zone
    assert found.certified_step == scenario.certified_step
    assert found.bottleneck_weight == scenario.bottleneck_weight


@pytest.mark.parametrize(
    ("by", "scenario", "words"),
    [
        ("law", Scenario(obstacles=WALL), "an obstacle can block a robot"),
        ("heading", Scenario(obstacles=WALL), "certified headings V still never rises"),
        ("gains", Scenario(obstacles=WALL), "no theorem covers gains with obstacles"),
        ("links", Scenario(obstacles=WALL), "obstacles deflect robots"),
        ("law", LONG, "for unscaled law .1.: the step"),
        ("law", SPARSE.replace(time_step=SPARSE.tau, allow_long_step=True), "for unscaled law .1."),
        ("law", PIECES, "the graph is not connected"),
        ("links", PURSUIT, ".*has no theorem on directed graphs"),
        ("links", SWITCHING, ".*has no theorem on switching graphs"),
        ("heading", BEHIND, "can be invisible"),
        ("tank", BEHIND, "can be invisible"),
        ("gains", BEHIND.replace(graph="path"), "can be invisible"),
        ("gains", Scenario(sensing=Sensing(range=3.0)), "can be invisible"),
        ("gains", Scenario(sensing=Sensing(dropout=0.1)), "can be invisible"),
        ("links", Scenario(sensing=Sensing(field_of_view=3.0)), "field_of_view is 3 rad"),
        ("links", BEHIND, "occlusion is 'robots'"),
        ("links", Scenario(sensing=Sensing(dropout=0.2)), "dropout is 0.2"),
        ("links", NEAR.replace(require_connected=False), ".*others are given or may be sampled"),
        ("law", NEAR, ".*lose each other permanently"),
        ("law", PURSUIT.replace(**LONG_STEP, max_speed=0.1), ".*overshoot its"),
        ("gains", NEAR, ".*lose each other permanently"),
        ("law", Scenario(meeting="pack", body_radius=0.05), "theorems are about merging"),
        *[(by, APART, ".*need not connect") for by in CHOICES],
        *[
            (by, Scenario(**changes), words)
            for by in ("gains", "links")
            for changes, words in (
                ({"robot_model": "unicycle"}, ".*whose action is their velocity"),
                ({"robot_model": "double_integrator"}, "no theorem covers double_integrator"),
                ({"sensing": Sensing(delay=2)}, ".*delayed"),
                ({"sensing": Sensing(noise=0.1)}, ".*noise = 0.1"),
            )
        ],
    ],
)
def test_certificate_is_refused_with_reason(by, scenario, words):
    found = certificate(scenario, MARGINS[by], by=by)
    assert not found.guaranteed and math.isinf(found.time_bound)
    assert re.match(f"none.*{words}", found.theorem)


@pytest.mark.parametrize(
    ("push", "words"),
    [("push", "obstacles move and push robots"), ("stop", "obstacles move and stop at robots")],
)
def test_message_about_moving_obstacles_states_their_effect(push, words):
    car = rv.Moving(rv.Disc((0, 0), 0.6), velocity=(0.5, 0))
    found = certificate(Scenario(obstacles=[car], obstacle_push=push), 0.5, by="tank")
    assert not found.guaranteed and found.theorem.startswith(f"none: {words}")


def test_message_about_a_long_step_rounds_the_certified_step_down():
    scenario = Scenario(n_robots=4, time_step=1.0, allow_long_step=True)  # r/(2D̄) = 1/30 s
    assert "longer than the certified 0.0333333 s;" in certificate(scenario).theorem


def test_tank_bounds_v_without_time_bound():
    v0, w = 20 * 10 * math.sqrt(2), 10
    for scenario, places, words in (
        (Scenario(robot_model="unicycle"), 2, "no time bound is proven for unicycle robots"),
        (Scenario(obstacles=WALL), 3, "theorem D still keeps V bounded"),
    ):
        found = certificate(scenario, 0.5, by="tank", budget=3.0)
        assert not found.guaranteed and found.time_bound == np.inf
        assert found.theorem.startswith("none") and words in found.theorem
        assert found.lyapunov_bound == close(v0 + places * 4 * 0.2 * w + 15)
    for scenario in (Scenario(robot_model="double_integrator"), PIECES):
        assert certificate(scenario, 0.5, by="tank").lyapunov_bound == np.inf


@pytest.mark.parametrize("name", ["fig3", "duo", "ring-12", "tree-12", "cloud-8", "random-10"])
def test_bound_covers_every_initial_condition(name):
    scenario = scenarios.get(name)
    sim = Simulator(scenario, 200)
    sim.reset(0)
    assert largest_lyapunov(scenario) >= sim.lyapunov().max()  # with which all bounds grow
    assert largest_size(scenario) * (1 + 1e-9) >= sim.size().max()
    assert certificate(scenario).hull_bound * (1 + 1e-9) >= sim.size().max()


@pytest.mark.parametrize("graph", ["cycle", "complete"])
def test_certificates_scale_with_edges(graph):
    """Formerly 31 s and 4.8 GB; a matrix over all robots alone takes 0.8 GB."""
    team = Scenario(n_robots=10_000, graph=graph, spawn_size=1000.0)
    tracemalloc.start()
    for by in ("law", "heading", "tank", "gains"):
        assert certificate(team, MARGINS[by], by=by).guaranteed
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 100e6


def test_kinds_of_links_and_leaders():
    kinds = {
        "undirected": Scenario(), "directed": PURSUIT, "switching": SWITCHING, "proximity": NEAR,
    }  # fmt: skip
    for kind, scenario in kinds.items():
        assert kind_of_links(scenario.sensing_graph) == kind
        assert leaders(scenario) == [list(range(scenario.n_robots))]
    assert kind_of_links(LED.sensing_graph) == "directed" and leaders(LED) == [[0]]
    turns = graphs.switching(["path", LED.sensing_graph])
    assert leaders(Scenario(n_robots=4, graph=turns)) == [[0]]


@pytest.mark.parametrize("scenario", [PURSUIT, SWITCHING, NEAR])
@pytest.mark.parametrize("by", ["heading", "tank"])
def test_directed_graphs_exclude_law_4_and_tank(scenario, by):
    found = certificate(scenario, 0.5, by=by)
    assert not found.guaranteed and found.theorem.startswith(f'none: by="{by}" has no theorem')
    assert math.isinf(found.time_bound) and math.isinf(found.lyapunov_bound)
    instead = "links" if scenario is NEAR else "gains"
    assert found.theorem.endswith(f'by="{instead}" has one')
    assert certificate(scenario, by=instead).guaranteed
    assert ("three robots diverge" in found.theorem) == (scenario is SWITCHING)


def test_cyclic_pursuit_is_covered_by_g_and_n():
    found = certificate(PURSUIT)
    assert found.guaranteed and found.theorem.startswith("theorem G: law (1)")
    assert found.continuous_time_bound == close(16 / (2 * float(kappa(4))))
    held = math.asin(2 * PURSUIT.tau / PURSUIT.merge_radius)
    assert found.tolerated_bearing_error == close(max(0.0, math.pi / 4 - held))
    wrong = certificate(PURSUIT.replace(time_step=0.01), bearing_error=0.5)
    assert wrong.guaranteed and wrong.theorem.startswith("theorem N: law (1)")
    assert certificate(LED).tolerated_bearing_error == 0.0
    assert not certificate(LED, by="gains", bearing_error=0.01).guaranteed


def test_switching_graphs_are_covered():
    for by in ("law", "gains"):
        found = certificate(SWITCHING, by=by)
        assert found.guaranteed and "theorem G" in found.theorem
        assert found.continuous_time_bound == close(16 / (2 * float(kappa(4))))
        assert found.hull_bound == close(16 + 3 * 2 * math.pi * 0.2)
    pieces = graphs.switching([graphs.from_edges([(0, 1), (2, 3)]), "path"])
    found = certificate(SWITCHING.replace(graph=pieces), by="gains")
    assert not found.guaranteed and "[0, 1] and [2, 3] observe no robot outside" in found.theorem
    assert "at some time" in found.theorem and found.hull_bound > 16


def test_links_beside_obstacles_must_be_shorter_by_r_per_merge():
    """tests/verify/test_injected_faults.py simulates a certificate for midpoints."""
    start, discs = ((-0.402, 0.0), (-0.201, 0.0), (0.0, 0.0)), (-0.3015, -0.1005)
    passed = Scenario(
        n_robots=4, graph=graphs.proximity(), sensing=Sensing(range=3.0), obstacle_contact="ignore",
        obstacles=tuple(Disc((x, 0.0), 0.06) for x in discs),
    )  # fmt: skip
    for longest, kept in ((2.699999, False), (2.399999, True)):
        found = certificate(passed.replace(start_positions=(*start, (longest, 0.0))), by="links")
        assert found.guaranteed == kept
        assert kept or "range − (n − 1) r with obstacles" in found.theorem
    drawn = passed.replace(obstacles=(Disc((0.0, 0.0), 0.5),))
    assert not certificate(drawn, by="links").guaranteed
    assert certificate(drawn.replace(obstacles=()), by="links").guaranteed


def test_hull_bound_allows_growth_for_starts_within_r():
    """Some robots merge at once and rest, while others move past them."""
    near = [(0.0, 0.0), (0.0, 0.002), (2.0, 0.0), (2.0, 0.002)]
    team = Scenario(n_robots=4, graph="complete", start_positions=near)
    assert certificate(team, by="gains").hull_bound == close(4.004 + 2 * math.pi * 0.2)


@pytest.mark.parametrize("model", ["unicycle", "nonholonomic_3d"])
def test_nonholonomic_robots_need_gate(model):
    """The paper's laws have no certificate for held inputs; the gate cannot overshoot."""
    scenario = Scenario(robot_model=model, dim=2 if model == "unicycle" else 3)
    law = certificate(scenario)
    assert law.continuous_time_only and "in continuous time" in law.theorem and not law.promises
    slow = scenario.replace(time_step=1e-7, graph=graphs.complete(1e-6))
    assert certificate(slow).continuous_time_only  # of steps that rounding swallows nothing is said
    gated = certificate(scenario, 0.3)
    assert gated.guaranteed and gated.theorem.startswith("theorem T")
    assert set(gated.promises) == {"time", "lyapunov"}
    for by in ("heading", "tank"):  # with wrong bearings V stays bounded
        wrong = certificate(scenario, 0.3, by=by, bearing_error=0.01)
        assert not wrong.guaranteed and wrong.theorem.startswith("none")
        assert math.isfinite(wrong.lyapunov_bound)
    small = scenario.replace(n_robots=2, spawn_size=1.0)
    slow = certificate(small.replace(max_turn_rate=0.1), 0.3).time_bound
    assert certificate(small, 0.3).time_bound < slow < math.inf


def test_theorem_n_tolerates_more_for_equal_degrees():
    """With a step for which a held bearing has an error of a fifth of π/n."""
    team = Scenario(n_robots=6, graph="cycle")
    gain = float(min_degrees(team).max())
    step = team.merge_radius / (2 * gain) * math.sin(0.2 * math.pi / 6)
    team = team.replace(time_step=step)
    assert certificate(team).tolerated_bearing_error == close(0.8 * math.pi / 6)
    wrong = certificate(team, bearing_error=0.7 * math.pi / 6)
    assert wrong.guaranteed and wrong.theorem.startswith("theorem N:")
    assert not certificate(team, bearing_error=0.81 * math.pi / 6).guaranteed


def test_bounded_sensor_errors_count():
    team, eta = Scenario(sensing=Sensing(error=0.01, sectors=400)), 0.01 + math.pi / 400
    for by, margin in (("law", 1.0), ("heading", 0.9), ("tank", 0.9), ("links", 1.0)):
        found = certificate(team, margin, by=by)
        assert found.bearing_error == close(eta) and found.guaranteed
        given = certificate(team.replace(sensing=Sensing()), margin, by=by, bearing_error=eta)
        assert given.time_bound == close(found.time_bound)
        more = certificate(team, margin, by=by, bearing_error=0.03)
        assert more.bearing_error == 0.03 and more.time_bound > found.time_bound


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("by", CHOICES)
@pytest.mark.parametrize(
    ("sensing", "error"), [(Sensing(error=1.8), 1.8), (Sensing(sectors=2, error=3.0), math.pi)]
)
def test_errors_above_right_angle_are_refused(sensing, error, by, dim):
    """Angles are at most π, although sums of errors and sectors may exceed it.

    A tank with a margin for π/2 rad lets V increase by more than its energy, so wrappers reject
    larger errors.
    """
    team = Scenario(n_robots=4, dim=dim, sensing=sensing)
    found = certificate(team, MARGINS[by], by=by)
    assert not found.guaranteed and math.isinf(found.time_bound)
    assert found.bearing_error == close(error)
    if by in ("heading", "tank", "links"):
        assert not found.promises and "wrappers accept at most" in found.theorem
        assert certificate(team.replace(sensing=Sensing(error=1.5)), MARGINS[by], by=by).promises


@pytest.mark.parametrize("delay", [1, 3])
def test_small_delays_are_certified(delay):
    """After a merge robots act on earlier observations, which the bound includes."""
    team = Scenario(sensing=Sensing(delay=delay), time_limit=100.0)
    oldest = team.merge_radius / (2 * team.max_degree)
    young = team.replace(time_step=oldest / (delay + 1))
    found = certificate(young)
    assert found.guaranteed and found.theorem.startswith("theorem E1")
    law = rollout(young, baselines.make("bearing-only", young), 0, num_envs=8)
    assert (law.rendezvous_time <= found.time_bound).all()
    old = certificate(team)
    assert not old.guaranteed and "at most r/(2D̄)" in old.theorem
    assert not certificate(young.replace(sensing=Sensing(delay=delay, dropout=0.1))).guaranteed
    for by in ("heading", "tank", "gains", "links"):
        assert "delayed" in certificate(young, MARGINS[by], by=by).theorem


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"by": "gain"}, "by is 'gain'; it must be one of 'law', 'heading', 'tank', 'gains'"),
        ({"by": "law", "min_alignment": 0.5}, "min_alignment is 0.5; it must be exactly 1 with by"),
        ({"by": "heading"}, "min_alignment is 1.0; it must be less than 1 with by"),
        ({"by": "tank", "min_alignment": 1.5}, "min_alignment is 1.5"),
        ({"by": "tank", "budget": -1.0}, "budget is -1.0; it must be finite and at least 0"),
        ({"by": "tank", "budget": math.nan}, "budget is nan"),
        ({"budget": 1.0}, 'budget is 1.0; it must be 0 with by="law": only a tank has one'),
        ({"by": "tank", "min_gain": 1.0}, "min_gain is 1.0; it must be None with by"),
        ({"by": "links", "max_gain": 1.0}, "max_gain is 1.0; it must be None with by"),
        ({"by": "gains", "min_gain": -1.0}, "min_gain is -1.0; it must be a positive"),
        ({"by": "gains", "share": 0.2}, "share is 0.2; it must be 0.5 with by"),
        ({"by": "links", "share": 0.0}, r"share is 0.0; it must be in \(0, 1\], and at least"),
        ({"by": "links", "share": 1e-18}, "share is 1e-18; it must be .* at least 1e-06"),
        ({"bearing_error": 2.0}, "bearing_error is 2.0; it must be"),
        *[({"min_alignment": least}, "at least 1e-06") for least in (1e-200, 5e-324, 0.99e-6)],
    ],
)
def test_inconsistent_arguments_are_rejected(given, message):
    with pytest.raises(ValueError, match=message):
        certificate(Scenario(), **given)


def test_text_begins_with_result():
    """Summary in three lines: guarantee, further guarantees, time bound and time limit."""
    first, second, third = str(certificate("ring-12")).splitlines()
    assert first.startswith("ring-12 under law (1): theorems 1 and G")
    assert "V never exceeds" in second and "bearings may err by up to" in second
    assert third.startswith("Bound 73.92 s, limit 60 s: the guarantee says nothing about")
    assert "within the limit" in str(certificate("duo"))
    assert "No rendezvous" in str(certificate("fig4")) and "none:" in str(certificate("fig4"))
    assert "in continuous time only, without a bound" in str(certificate("unicycle-6"))


def test_v_bound_beside_obstacles_excludes_contacts():
    """Headings with the minimum alignment let two robots slide outward along slanted walls."""
    walls = [Capsule(((1.0, -1.0), (-3.0, 5.0)), 0.1), Capsule(((3.0, 1.0), (7.0, -5.0)), 0.1)]
    start = {"n_robots": 2, "start_positions": ((0.0, 0.0), (4.0, 0.0)), "local_frames": "global"}
    scenario = Scenario(**start, obstacles=walls)
    env, simulator = alone(scenario, "heading", min_alignment=0.3)
    for _ in range(100):
        x, y = np.diff(simulator.positions[0], axis=0)[0]
        env.step([[[-y, x], [y, -x]]])
    found = certificate(scenario, 0.3)
    assert simulator.lyapunov()[0] > found.lyapunov_bound
    assert found.contact_possible and "m²/s in motion without contact\n" in str(found)
    through = certificate(scenario.replace(obstacle_contact="ignore"), 0.3)
    assert not through.contact_possible and "without contact" not in str(through)


def test_mean_time_under_noise_is_reported():
    found = certificate(Scenario(sensing=Sensing(noise=0.1)))
    said = re.search("mean time to rendezvous never exceeds (.+) s", str(found))
    assert 1.001 * found.expected_time_bound > float(said[1]) >= found.expected_time_bound
    assert "There are no other" not in str(found)


def test_printed_bounds_are_conservative():
    """Bounds are rounded up, and tolerated errors down."""
    found = certificate("ring-12")
    said = re.findall(r"(?:exceeds|up to|Bound) ([\d.]+)", str(found))
    lyapunov, hull, error, bound = map(float, said)
    assert bound >= found.time_bound and hull >= found.hull_bound
    assert lyapunov >= found.lyapunov_bound and error < found.tolerated_bearing_error
    assert certificate("ring-12", bearing_error=error).guaranteed
    more = certificate("ring-12", bearing_error=0.1669)  # by N1 alone: theorem N bears none here
    assert not more.guaranteed and "tolerate less than 0.1668 rad" in more.theorem


def test_old_field_names_warn():
    found = certificate(Scenario())
    for old, new in (
        ("held_time_bound", "time_bound"),
        ("bearing_error_borne", "tolerated_bearing_error"),
        ("touches_obstacles", "contact_possible"),
        ("continuous_time", "continuous_time_only"),
    ):
        with pytest.warns(DeprecationWarning, match=new):
            assert getattr(found, old) == getattr(found, new)
