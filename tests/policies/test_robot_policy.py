"""Single-robot policy: compared with a batch, and in asynchronous teams."""

import numpy as np
import pytest
from conftest import LAWS
from geometry import along
from parameters import first_fast, needed, slow
from robot_actions import neighbour_reading
from scipy.optimize import linear_sum_assignment

import baselines
import rendezvous_env as rv
from baselines import RobotPolicy
from baselines.observation_builder import ObservationBuilder, min_cost_slots
from rendezvous_env.engine.memory import RENDEZVOUS, RUNNING
from rendezvous_env.trajectory import run

CLUTTER = rv.scenarios.get("clutter-12")
TURNING = CLUTTER.replace(robot_model="unicycle", max_turn_rate=1.5)
ALL_ALONG = 500
"""Number of steps of an episode."""
OPPOSITE = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]] * 4)
"""Rays that enclose no direction."""


def measured(rows, layout, random):
    """Arguments of ``act`` from a row of a batch, in random order.

    Edges and rays start anywhere and have any orientation.
    """
    seen = layout.split(rows)
    neighbours = seen.neighbours[seen.neighbours.any(axis=-1)]
    obstacles = random.permutation(seen.obstacles[seen.obstacles.any(axis=(1, 2))])
    points = layout.rows_per_obstacle
    obstacles = [np.roll(one, random.integers(points), axis=0) for one in obstacles]
    told = {} if seen.gravity is None else {"gravity": seen.gravity}
    if layout.dim == 2:
        random.shuffle(neighbours)
        told["weights"] = np.linalg.norm(neighbours.astype(float), axis=-1)
        neighbours = neighbours / told["weights"][:, None]
    else:
        obstacles = [one[:: random.choice([-1, 1])] for one in obstacles]
    return {"bearings": neighbours, "obstacles": obstacles, **told}


IN_THE_PLANE = (
    ("bearing-only", CLUTTER), ("tangent-merged", CLUTTER), ("tangent-merged-tuned", CLUTTER),
    ("learned", CLUTTER), ("learned-tank", CLUTTER), ("learned-tank", TURNING),
    ("unicycle", "unicycle-6"), ("unicycle-cosine", "unicycle-6"),
)  # fmt: skip
UNICYCLES = (
    ("tangent-merged", "unicycle-clutter-8"),
    ("tangent-merged-tuned", "unicycle-clutter-24-slow"),
)
IN_SPACE = (
    ("learned-tank", "uav-clutter-16"), ("learned-tank", "clutter-3d-32"),
    ("learned-tank", "window-3d"), ("learned", "clutter-3d-32"),
    ("tangent-merged", "clutter-3d-32"), ("tangent-merged", "uav-clutter-16"),
    ("tangent-merged-tuned", "clutter-3d-96"), ("tangent-merged-tuned", "uav-clutter-16"),
    ("nonholonomic-3d", "uav-6"),
)  # fmt: skip


@pytest.mark.parametrize(
    ("name", "scenario"),
    [
        *IN_THE_PLANE[:4],
        *(needed(*case[0]) for case in (UNICYCLES, IN_SPACE)),
        *(slow(*case) for case in (*IN_THE_PLANE[4:], *UNICYCLES[1:], *IN_SPACE[1:])),
    ],
)
def test_robot_policy_equals_batch(name, scenario):
    """In 3-D up to float32 rounding, in whole episodes; in the plane also up to summation order."""
    if isinstance(scenario, str):
        scenario = rv.scenarios.get(scenario)
    simulator, random = rv.Simulator(scenario), np.random.default_rng(0)
    robots = [RobotPolicy(scenario, name) for _ in range(scenario.n_robots)]
    space, layout, moved, passed = scenario.dim == 3, scenario.observation_layout, 0, 0
    batch = baselines.make(name, scenario)
    for count, step in enumerate(run(simulator, batch, simulator.reset(3))):
        if count == ALL_ALONG and not space:
            break
        for i, robot in enumerate(robots):
            rows = step.observations[0, i]
            if space and not rows.any():  # it has merged away
                continue
            seen = measured(rows, layout, random)
            action = robot.act(**seen, dt=scenario.tau)
            wanted, sums = step.actions[0, i], 2e-6 * (not space)
            np.testing.assert_allclose(action, wanted, rtol=1.2e-7 * space, atol=sums)
            speed = action[0] if scenario.model.nonholonomic else np.linalg.norm(action)
            assert speed <= scenario.speed_limit  # in float64
            assert robot.time == pytest.approx(count * scenario.tau)
            moved += np.linalg.norm(action) > 0.1
            passed += len(seen["obstacles"]) > 1
    assert count > 80 and moved > 200
    if space:
        assert simulator.status[0] == RENDEZVOUS
        assert passed > 100 or not scenario.obstacles or (name == "learned-tank" and passed > 3)


SPACE = {"robot_model": ["single_integrator", "nonholonomic_3d"] * 2, "max_speed": [0.4, 1, 1, 1]}


@pytest.mark.parametrize(
    "scenario", ["mixed-8", slow(rv.Scenario(n_robots=4, dim=3, **SPACE))], ids=["plane", "space"]
)
def test_robots_of_a_mixed_team_act_as_in_the_team(scenario):
    """Each by its index, under the law of its model, with its own limits."""
    scenario = rv.scenarios.resolve(scenario)
    robots = [RobotPolicy(scenario, "by-model", robot=i) for i in range(scenario.n_robots)]
    simulator, layout, moved = rv.Simulator(scenario), scenario.observation_layout, 0
    team = baselines.make("by-model", scenario)
    for step in run(simulator, team, simulator.reset(3)):
        seen = layout.split(step.observations[0].astype(float))
        for i, robot in enumerate(robots):
            senses_gravity = robot.scenario.observation_layout.senses_gravity
            if (reading := neighbour_reading(seen, i, senses_gravity)) is None:
                continue
            bearings, told = reading
            action = robot.act(bearings, dt=scenario.tau, **told)
            np.testing.assert_allclose(action, step.actions[0, i], atol=3e-6)
            assert (np.abs(action) <= scenario.robot_bounds[i]).all()
            moved += abs(action[0]) > 0.1
    assert moved > 100 and simulator.status[0] == RENDEZVOUS


S, U, N = "single_integrator", "unicycle", "nonholonomic_3d"
TEAMS = {
    "unicycles last": rv.Scenario(n_robots=5, robot_model=[S, S, S, U, U], merge_radius=0.3),
    "unicycle first": rv.Scenario(
        n_robots=4, robot_model=[U, S, S, U], max_speed=[1.0, 0.5, 1.0, 0.7], merge_radius=0.3
    ),
    "3-D": rv.Scenario(n_robots=4, dim=3, robot_model=[S, N, S, N], max_turn_rate=2.0),
    "speeds": rv.Scenario(n_robots=4, max_speed=[0.5, 0.5, 1.0, 2.0]),
    "turn rates": rv.Scenario(n_robots=3, robot_model=U, max_turn_rate=[0.5, 1.0, 2.0]),
    "3-D rates": rv.Scenario(
        n_robots=3, dim=3, robot_model=N, max_turn_rate=[0.5, 1.0, 2.0], max_speed=[0.5, 1.0, 2.0]
    ),
}


def across(scenario, size):
    """Choices with a part along f and one across, of a filter with this many numbers."""

    def choose(observations):
        f = scenario.observation_layout.net_bearing(observations)
        return np.tanh(0.4 * f + 0.6 * np.roll(f, 1, axis=-1))[..., :size]

    return choose


def filtered(kind, scenario):
    """Policy of a team: a filter around ``across``, the law of each model, or a learned one."""
    if kind == "law":
        return baselines.make("by-model" if scenario.mixes_models else "bearing-only", scenario)
    if kind not in ("heading", "tank"):
        return baselines.make(kind, scenario)
    size = scenario.dim - (kind == "heading" and scenario.nonholonomic_robots.all())
    if kind == "heading":
        return baselines.HeadingPolicy(scenario, across(scenario, size), decision_period=2)
    size = scenario.action_size
    return baselines.TankPolicy(scenario, across(scenario, size), budget=0.1)


def assert_robots_act_as_team(scenario, robots, team, steps=60):
    """Compare each robot's command with the action of the whole team, along an episode."""
    simulator, layout, moved = rv.Simulator(scenario), scenario.observation_layout, 0
    sizes = scenario.action_mask.sum(axis=-1)
    for count, step in enumerate(run(simulator, team, simulator.reset(3))):
        if count == steps:
            break
        seen = layout.split(step.observations[0].astype(float))
        for i, robot in enumerate(robots):
            senses_gravity = robot.scenario.observation_layout.senses_gravity
            if (reading := neighbour_reading(seen, i, senses_gravity)) is None:
                continue
            bearings, told = reading
            action = robot.act(bearings, dt=scenario.tau, **told)
            np.testing.assert_allclose(action, step.actions[0, i, : sizes[i]], atol=2e-6)
            moved += np.linalg.norm(action)
    assert moved > 20


@pytest.mark.parametrize(
    ("kind", "team"),
    [
        *(
            needed(kind, team) if team.startswith("3-D") else (kind, team)
            for kind in ("heading", "tank")
            for team in TEAMS
        ),
        *(("law", team) for team in ("unicycles last", "unicycle first", "speeds")),
        *(slow(kind, "3-D rates") for kind in ("learned", "learned-tank")),
        *((kind, "speeds") for kind in ("learned", "learned-tank")),
        *((kind, "turn rates") for kind in ("learned", "learned-tank", "unicycle")),
        slow("law", "3-D"),
    ],
)
def test_robots_of_a_teams_policy_act_as_in_the_team(kind, team):
    """Given as an object, each robot by its index."""
    scenario = TEAMS[team]
    robots = [
        RobotPolicy(scenario, filtered(kind, scenario), robot=i) for i in range(scenario.n_robots)
    ]
    assert_robots_act_as_team(scenario, robots, filtered(kind, scenario))


@pytest.mark.parametrize("name", ["learned", "learned-tank"])
@pytest.mark.parametrize("team", ["speeds", "turn rates", "3-D rates"])
def test_named_policy_of_robots_with_own_limits_acts_as_in_the_team(name, team):
    scenario = TEAMS[team]
    robots = [RobotPolicy(scenario, name, robot=i) for i in range(scenario.n_robots)]
    assert_robots_act_as_team(scenario, robots, baselines.make(name, scenario))


def test_a_function_gets_the_slot_of_its_robot():
    def by_index(observations, time):
        speeds = 0.1 * (1.0 + np.arange(observations.shape[-3]))
        return np.stack([speeds, 0.0 * speeds], axis=-1)[np.newaxis]

    scenario = TEAMS["unicycles last"]
    for i in range(5):
        action = RobotPolicy(scenario, by_index, robot=i).act([[0.6, 0.8], [1.0, 0.0]])
        np.testing.assert_allclose(action, [0.1 * (i + 1), 0.0])


def test_policy_of_one_robots_scenario_is_accepted_for_it_alone():
    scenario = TEAMS["unicycle first"]
    own = filtered("heading", scenario.of_robot(3))
    found = RobotPolicy(scenario, own, robot=3).act(along(40, 50))
    alone = RobotPolicy(scenario.of_robot(3), filtered("heading", scenario.of_robot(3)))
    np.testing.assert_array_equal(found, alone.act(along(40, 50)))
    with pytest.raises(ValueError, match=r"controls a unicycle, the robot is a single_integrator"):
        RobotPolicy(scenario, own, robot=1)
    fast = TEAMS["speeds"].of_robot(3)
    with pytest.raises(ValueError, match=r"has the limits \[2.0, 2.0\], the robot \[0.5, 0.5\]"):
        RobotPolicy(TEAMS["speeds"], filtered("heading", fast), robot=0)
    with pytest.raises(ValueError, match=r"list of robot_model; pass the scenario of the policy"):
        RobotPolicy(scenario.of_robot(3), filtered("heading", scenario))
    with pytest.raises(ValueError, match=r"policy is for \(5, 2, 4, 0\) robots, .* \(4, 2, 3, 0\)"):
        RobotPolicy(scenario, filtered("heading", TEAMS["unicycles last"]), robot=0)


def test_robot_policy_needs_the_index_of_a_robot_with_limits_of_its_own():
    with pytest.raises(ValueError, match="pass robot=i"):
        RobotPolicy("mixed-8", "by-model")
    with pytest.raises(ValueError, match="robot is 8; it must be an integer, 0 or more, at most 7"):
        RobotPolicy("mixed-8", "by-model", robot=8)
    with pytest.raises(ValueError, match="double_integrator robots"):
        heavy = rv.Scenario(n_robots=2, robot_model=["unicycle", "double_integrator"])
        RobotPolicy(heavy, "by-model", robot=1)
    learned = RobotPolicy("mixed-8", "learned", robot=7)
    assert learned.scenario.robot_model == "unicycle" and learned.scenario.speed_limit == 0.5


@pytest.mark.parametrize(
    ("policy", "scenario"),
    [
        *(
            ("bearing-only", "clutter-12"),
            ("learned-tank", "clutter-12"),
            ("unicycle", "unicycle-6"),
        ),
        ("learned-tank", "uav-clutter-16"),
        (lambda seen, now: np.zeros((1, 12, 2), np.float32), "clutter-12"),
    ],
)
def test_actions_are_float64_that_messages_of_robots_can_hold(policy, scenario):
    if callable(policy):
        policy.reset = lambda: None
    robot = RobotPolicy(scenario, policy)
    layout = robot.scenario.observation_layout
    told = {"gravity": [0.0, 0.0, -1.0]} if layout.senses_gravity else {}
    action = robot.act([np.eye(layout.dim)[0]], **told)
    assert action.dtype == np.float64
    assert all(isinstance(value, float) for value in action)  # what a message field must be


@pytest.mark.parametrize("name", first_fast(["learned", "tangent-merged-tuned", "learned-tank"]))
def test_asynchronous_team_keeps_margin_and_meets(name):
    """Each robot ticks 10 to 50 ms after its last tick, and holds its velocity."""
    field = rv.scenarios.get("clutter-8")
    world = field.replace(time_step=0.01)
    layout, random = world.observation_layout, np.random.default_rng(1)
    robots = [RobotPolicy(field, name) for _ in range(field.n_robots)]
    margin = getattr(robots[0].policy, "min_alignment", None)
    simulator = rv.Simulator(world)
    seen, now = simulator.reset(5), 0
    due, last = np.zeros(field.n_robots, int), np.zeros(field.n_robots, int)
    held, ticks = np.zeros((1, field.n_robots, 2), np.float32), 0
    first = simulator.lyapunov()
    while simulator.status[0] == RUNNING:
        for i in np.flatnonzero(due <= now):
            dt = 0.01 * (now - last[i]) if now else None
            held[0, i] = robots[i].act(**measured(seen[0, i], layout, random), dt=dt)
            last[i], due[i], ticks = now, now + random.integers(1, 6), ticks + 1
            f, speed = layout.net_bearing(seen[0, i]), np.hypot(*held[0, i])
            if margin and speed > 0 and np.hypot(*f) > 2 * field.dead_zone:
                assert abs(f @ held[0, i]) >= (margin - 1e-4) * np.hypot(*f) * speed
        seen, now = simulator.step(held).observations, now + 1
    assert simulator.status[0] == RENDEZVOUS and ticks > 500
    assert simulator.lyapunov()[0] < 1e-9 < first


class TestTime:
    def test_heading_turn_is_limited_by_elapsed_time(self):
        for dt in (0.02, 0.05):
            robot = RobotPolicy(CLUTTER, "tangent-merged-certified", max_turn_rate=1.0)
            before = robot.act(along(0))
            after = robot.act(along(60), dt=dt)
            turned = np.arctan2(after[1], after[0]) - np.arctan2(before[1], before[0])
            assert turned == pytest.approx(dt, abs=1e-5)

    def test_network_observes_rates(self):
        """A rotation rate of 1 rad/s does not depend on the tick rate."""
        rates = []
        for dt in (0.02, 0.05):
            robot, shown = RobotPolicy(CLUTTER), []
            robot.act(along(0), [along(40, 60)], dt=dt)
            controller, time = robot.policy._controller, 0.0
            show = controller.show

            def watched(*seen, show=show, shown=shown):
                shown.append(show(*seen))
                return shown[-1]

            controller.show = watched
            while not shown:
                time += dt
                turn = np.degrees(time)
                robot.act(along(0), [along(40 + turn, 60 + turn)], dt=dt)
            obstacles = controller.perception.layout.split(shown[0][0, 0]).obstacles
            rates.append(obstacles[obstacles.any(axis=-1)][0, 4:])
        np.testing.assert_allclose(rates, 1.0, atol=1e-4)

    def test_reset_restarts_policy(self):
        robot = RobotPolicy(CLUTTER, "tangent-merged-certified", max_turn_rate=1.0)
        fresh = robot.act(along(50))
        robot.act(along(0), dt=1.0)
        robot.reset()
        np.testing.assert_array_equal(robot.act(along(50)), fresh)
        assert robot.time == 0.0

    def test_truncated_step_earns_proportionally(self):
        tank = RobotPolicy(CLUTTER, "learned-tank").policy
        rows = np.zeros((1, CLUTTER.n_robots, *CLUTTER.observation_layout.shape), np.float32)
        rows[0, 0, :2] = along(0, 30)
        tank(rows, 0.0)
        steering = tank._controller.steering
        full, begun = tank.levels[0, 0], steering.budget
        steering.settle(0.25)
        assert full != begun
        assert tank.levels[0, 0] == pytest.approx(begun + 0.25 * (full - begun), rel=1e-12)
        steering.settle(0.25)
        assert tank.levels[0, 0] == pytest.approx(begun + 0.25 * (full - begun), rel=1e-12)


class TestObservationBuilder:
    A, B, C = along(40, 20), along(80, 60), along(-100, -120)

    def shown(self, *looks):
        """Obstacle slots after each tick of a robot among some obstacles."""
        builder = ObservationBuilder(layout := CLUTTER.observation_layout, 3.0)
        return [layout.split(builder.rows(along(0), look, None)).obstacles for look in looks]

    def test_obstacles_keep_slots(self):
        one, two = self.shown([self.A, self.B], [self.C, along(83, 62), along(44, 23)])
        place = [np.argmin(np.abs(one - edges).sum(axis=(1, 2))) for edges in (self.A, self.B)]
        np.testing.assert_allclose(two[place], [along(44, 23), along(83, 62)], atol=1e-6)
        assert two.any(axis=(1, 2)).sum() == 3

    def test_vanished_obstacle_frees_slot_later(self):
        """A newly visible obstacle has no rotation rate from the previous one in its slot."""
        one, two = self.shown([self.A], [self.C])
        assert not (one.any(axis=(1, 2)) & two.any(axis=(1, 2))).any()

    def test_no_visible_neighbour_means_rest(self):
        assert RobotPolicy(CLUTTER).act([], [along(10, -10)]).tolist() == [0.0, 0.0]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"bearings": [[1.0, 0.0], [0.6, 0.6]]}, r"bearings\[1\] is \[0\.6, 0\.6\]; .* a unit vec"),
        ({"bearings": [[np.nan, 0.0]]}, r"bearings\[0\] is \[nan, 0\.0\]; .* a unit vec"),
        ({"bearings": [1.0, 0.0]}, r"bearings have shape \(2,\); they must be \(…, 2\)"),
        ({"bearings": along(0, 1, 2, 3)}, r"bearings are of 4 .*at most 3.*neighbour_slots"),
        ({"bearings": "east"}, "bearings is 'east'"),
        ({"obstacles": [along(0, 1)] * 13}, r"obstacles are of 13 .*at most 12.*obstacle_slots"),
        ({"obstacles": [along(0, 1) * 2]}, r"obstacles\[0, 0\] is \[2\.0, 0\.0\]; .* a unit vec"),
        ({"obstacles": along(0, 1)}, r"obstacles have shape \(2, 2\); they must be \(…, 2, 2\)"),
        ({"dt": -0.1}, r"dt is -0\.1; it must be a positive"),
        ({"weights": [1.0, 2.0]}, r"weights have shape \(2,\); they must be \(k,\) = \(1,\)"),
        ({"weights": [3.1]}, r"weights sum to 3\.1 m/s; the maximum in this scenario is D̄ = 3 m/s"),
        ({"weights": [-1.0]}, r"weights\[0\] is -1\.0; it must be positive"),
    ],
)  # fmt: skip
def test_bad_measurements_are_named_and_change_nothing(change, message):
    robot, other = RobotPolicy(CLUTTER), RobotPolicy(CLUTTER)
    good = {"bearings": along(0), "obstacles": [along(30, 10)], "dt": 0.05}
    for each in (robot, other):
        each.act(**good)
    with pytest.raises(ValueError, match=message):
        robot.act(**{**good, **change})
    later = {"bearings": along(3), "obstacles": [along(35, 12)], "dt": 0.2}
    np.testing.assert_array_equal(robot.act(**later), other.act(**later))
    assert robot.time == other.time == pytest.approx(0.2)


@pytest.mark.parametrize(
    ("field", "change", "message"),
    [
        ("uav-6", {}, "gravity is None; it must be its direction in the body frame, a unit"),
        ("uav-6", {"gravity": [0, 0, -2.0]}, r"gravity is \[0, 0, -2.0\]; .* a unit vector \(3,\)"),
        ("uav-6", {"gravity": [0, -1.0]}, r"gravity is \[0, -1.0\]; .* a unit vector \(3,\)"),
        ("cloud-8", {"gravity": [0, 0, -1.0]}, "gravity is .*; it must be omitted"),
        ("clutter-3d", {"obstacles": [along(0, 1)]}, r"obstacles have shape .* \(…, 8, 3\)"),
        ("clutter-3d", {"obstacles": [OPPOSITE]}, r"obstacles\[0\] .* rays around a cone"),
    ],
)  # fmt: skip
def test_bad_measurements_in_3d_are_named(field, change, message):
    with pytest.raises(ValueError, match=message):
        RobotPolicy(field, baselines.names(field)[0]).act(**{"bearings": [[1, 0, 0]], **change})


def test_unsupported_robots_and_policies_are_rejected():
    with pytest.raises(ValueError, match=r"has double_integrator robots; a RobotPolicy steers"):
        RobotPolicy(rv.Scenario(robot_model="double_integrator"), LAWS["single_integrator"])
    with pytest.raises(ValueError, match=r"'tank-merged' is one of the rules under an energy tank"):
        RobotPolicy(CLUTTER, "tank-merged")
    with pytest.raises(ValueError, match=r"policy 'learnt' is unknown.*did you mean 'learned'"):
        RobotPolicy(CLUTTER, "learnt")
    with pytest.raises(ValueError, match="policy is 3; it must be a name, a Path"):
        RobotPolicy(CLUTTER, 3)


def test_least_cost_slots_equal_scipy():
    random = np.random.default_rng(0)
    for _ in range(2000):
        m = random.integers(1, 7)
        shape = m, random.integers(m, 9)
        cost = random.choice(
            [random.normal(size=shape), random.integers(0, 4, shape).astype(float)]
        )
        slots = min_cost_slots(cost)
        assert len(set(slots)) == m
        assert cost[range(m), slots].sum() == pytest.approx(cost[linear_sum_assignment(cost)].sum())
