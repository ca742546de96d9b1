"""Bitwise equality of the compiled step for single and batched environments with plain Python."""

import os
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT, UNEQUAL, five, run_python
from parameters import marked
from test_measured_sensors import MEASURED
from test_sensing_engine import SHAPES, WORST

from rendezvous_env import (
    Activation,
    Capsule,
    Events,
    ObstacleField,
    Scenario,
    Simulator,
    Sphere,
    WallField,
    graphs,
    scenarios,
)
from rendezvous_env.compilation import compiled
from rendezvous_env.engine import batch_runner, threads
from rendezvous_env.engine.memory import LaneBlock, ScalarBlock
from rendezvous_env.engine.memory_layout import MemoryLayout

SOLIDS = (Sphere((0.3, 0.2, 0.0), 0.5), Capsule(((-1.0, -0.5, -0.5), (-0.4, 0.6, 0.4)), 0.3))
TIGHT = {"spawn_size": 5.0, "merge_radius": 0.3, "obstacle_range": 2.0}
FIELD = ObstacleField(count=(1, 3), radius=(0.2, 0.4), region=4.0, keep_out=0.1, passage=0.1)
WALLS = WallField("rooms", (2.0, 2.5), (0.6, 0.9), thickness=0.2, region=0.5, keep_out=0.1)
DRAWN = graphs.erdos_renyi(0.4, (0.5, 1.5))
INERT = {"n_robots": 5, "graph": UNEQUAL, "robot_model": "double_integrator"}
FAST = {
    "discs": five("single_integrator-2d", obstacles=SHAPES[:1], **TIGHT),
    "shapes": five("single_integrator-2d", obstacles=SHAPES, obstacle_contact="stop", **TIGHT),
    "unicycles": five("unicycle", graph=DRAWN, obstacles=SHAPES[:1], **TIGHT),
    "two rows": Scenario(n_robots=6, graph="cycle", **TIGHT),
    "errors in the open": five("single_integrator-2d", sensing=WORST, spawn_size=3.0),
}
SLOW = {
    "walls": five("single_integrator-2d", obstacles=WALLS, **TIGHT),
    "spheres": five("single_integrator-3d", obstacles=SOLIDS[:1], **TIGHT),
    "measured": five("unicycle", obstacles=SHAPES[:1], sensing=MEASURED, **TIGHT),
    "packing": scenarios.get("robotarium-4"),
    "failures": five(
        "single_integrator-2d",
        events=Events(n_crashed=1, n_blind=2, slip=0.3, disturbance=0.2, compass_walk=0.5),
        **TIGHT,
    ),
    "own clocks": five("unicycle", activation=Activation(kind="bounded", max_wait=3), **TIGHT),
    "nothing in the way": five("single_integrator-2d", spawn_size=3.0),
    "field": five("single_integrator-2d", obstacles=FIELD, **TIGHT),
    "solids": five("single_integrator-3d", obstacles=SOLIDS, **TIGHT),
    "unicycles among shapes": five("unicycle", obstacles=SHAPES, **TIGHT),
    "flying": five("nonholonomic_3d", obstacles=SOLIDS[:1], **TIGHT),
    "flying among solids": five("nonholonomic_3d", obstacles=SOLIDS, **TIGHT),
    "inertia in the plane": Scenario(**INERT, obstacles=SHAPES, **TIGHT),
    "inertia in space": Scenario(**INERT, dim=3, obstacles=SOLIDS, **TIGHT),
    "errors": five("single_integrator-2d", obstacles=SHAPES, sensing=WORST, **TIGHT),
    "drawn graphs": Scenario(n_robots=6, graph="random_tree", on_merge="follow", **TIGHT),
    "errors in space": five("nonholonomic_3d", obstacles=SOLIDS[:1], sensing=WORST, **TIGHT),
    "measured in space": five("nonholonomic_3d", sensing=MEASURED, **TIGHT),
    "measured in two rows": Scenario(n_robots=5, graph="cycle", sensing=MEASURED, **TIGHT),
    "errors in two rows": Scenario(n_robots=6, graph="cycle", sensing=WORST, **TIGHT),
}
"""Covered by the other cases, except for compilation."""
SCENARIOS = FAST | SLOW
KERNELS = (
    "own clocks", "failures", "packing", "field", "errors", "measured in two rows",
)  # fmt: skip
"""Cases that call nearly every kernel of a step; other tests call the rest."""
OWN_PATH = {*KERNELS, "spheres", "flying", "inertia in the plane"}
"""Cases that are not nightly: events, clocks, robot models, and kinds of obstacles."""
MEETS_NOTHING = (
    "nothing in the way", "two rows", "drawn graphs", "errors in the open", "errors in two rows",
    "measured in space", "measured in two rows", "packing", "own clocks",
    "failures",
)  # fmt: skip


def towards_neighbours(scenario: Scenario, observations: np.ndarray) -> np.ndarray:
    """Actions that lead any robot model to rendezvous: along f, against the velocity."""
    layout = scenario.observation_layout
    f = layout.net_bearing(observations)
    if scenario.model.senses == "velocity":
        f = f - 2.0 * observations[..., -1, :]
    if scenario.model.nonholonomic:
        return np.concatenate([0.3 + f[..., :1], f[..., 1:]], axis=-1)
    return f


def episode(scenario: Scenario, batch: int, seed: int, steps: int, **how) -> dict[str, np.ndarray]:
    """All outputs of the steps of some environments, each (steps, batch, …)."""
    sim = Simulator(scenario, batch, **how)
    observations, found = sim.reset(seed), []
    for _ in range(steps):
        outcome = sim.step(towards_neighbours(scenario, observations))
        observations = outcome.observations
        own = {"positions": sim.positions, "scores": outcome.scores.T}
        found.append({name: a.copy() for name, a in (outcome._asdict() | own).items()})
    return {name: np.stack([one[name] for one in found]) for name in found[0]}


def assert_equal(found: dict[str, np.ndarray], expected: dict[str, np.ndarray]) -> None:
    assert found.keys() == expected.keys()
    for name, array in expected.items():
        assert array.dtype == found[name].dtype
        np.testing.assert_array_equal(found[name], array, err_msg=name)


@pytest.fixture
def shared(monkeypatch):
    """Number of threads of each following step; none if it was not shared."""
    given, real_share = [], threads.share

    def share(calls_of, blocks, most, head_start=0.0):
        given.append(most)
        real_share(calls_of, blocks, most, head_start)

    monkeypatch.setattr(threads, "share", share)
    return given


@pytest.mark.skipif(not compiled(), reason="plain Python has no threads")
def test_little_work_is_not_shared(shared):
    for n, expected in ((8, []), (32, [2])):
        simulator = Simulator(Scenario(n_robots=n, spawn_size=1e3), 512, num_threads=2)
        simulator.reset(0)
        shared.clear()
        simulator.step(np.zeros((512, n, 2), np.float32))
        assert shared == expected


@pytest.mark.parametrize(
    "name",
    marked(SCENARIOS, slow=SLOW, own_path=OWN_PATH, kernels=KERNELS),
)
def test_batch_equals_singles(name, shared, monkeypatch):
    """40 environments are one full block and one padded block, one per thread."""
    monkeypatch.setattr(batch_runner, "_WORK_PER_THREAD", 1)
    scenario, batch, steps = SCENARIOS[name], 40, 150 if compiled() else 20
    assert MemoryLayout(scenario, batch).width == LaneBlock()
    assert MemoryLayout(scenario, 1).width == ScalarBlock()
    together = episode(scenario, batch, 3, steps, num_threads=2)
    assert shared == [2] * steps or not compiled()
    for team in (0, 1, 5, 31, 32, 39):
        alone = episode(scenario, 1, 3 + team, steps)
        assert_equal({key: array[:, team : team + 1] for key, array in together.items()}, alone)
    few = episode(scenario, 6, 3, steps)
    assert_equal({key: array[:, :6] for key, array in together.items()}, few)
    if compiled():
        assert together["active"].all() == (name == "packing")
        assert together["contact"].any() == (name not in MEETS_NOTHING)


LANES = ("shapes", "spheres", "unicycles among shapes", "flying", "errors", "measured")
BRIEFLY = {
    **dict(zip([(name, 1) for name in LANES[:4]], (40, 40, 12, 8), strict=True)),
    **{(name, 5): 3 for name in LANES},
}
"""Numbers of environments and scenarios of the test."""


def save_brief(path: str) -> None:
    """Write the outputs of these steps to a file."""
    found = {}
    for (name, batch), steps in BRIEFLY.items():
        brief = episode(SCENARIOS[name], batch, 3, steps)
        found |= {f"{name}|{batch}|{key}": array for key, array in brief.items()}
    np.savez(path, **found)


@pytest.mark.slow
def test_interpreted_kernels_match_compiled(tmp_path):
    paths = [str(Path(__file__).parent), str(ROOT / "tests"), str(ROOT)]
    plain = {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": os.pathsep.join(paths)}
    script = (
        f"import test_batch_equals_singles as it; it.save_brief({str(tmp_path / 'plain.npz')!r})"
    )
    run_python(tmp_path, "-c", script, **plain)
    save_brief(str(tmp_path / "compiled.npz"))
    with np.load(tmp_path / "plain.npz") as plain, np.load(tmp_path / "compiled.npz") as compiled:
        assert_equal(dict(plain), dict(compiled))
        assert any(compiled[name].any() for name in compiled if name.endswith("contact"))
        assert not all(compiled[name].all() for name in compiled if name.endswith("active"))
