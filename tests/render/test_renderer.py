"""Renderer interface for every kind of environment; tiles of environments; drawing library."""

import copy
import pickle
import sys
import warnings
from types import ModuleType

import numpy as np
import pygame
import pytest
from conftest import run_python
from drawing import at, drawn, still
from gymnasium.wrappers.vector import RecordVideo

import rendezvous_env as rv
from rendezvous_env import rendezvous_v0
from rendezvous_env.engine.memory import RENDEZVOUS
from rendezvous_env.envs.gymnasium_env import make_env
from rendezvous_env.render.palette import OBSTACLE, ROBOTS
from rendezvous_env.render.renderer import MAX_TEAMS, Renderer
from rendezvous_env.vector import HeadingVectorWrapper


def forward(env, steps):
    """An environment after some steps along x of each robot's own frame."""
    for _ in range(steps):
        env.step({name: np.ones(2, np.float32) for name in env.agents})
    return env


@pytest.mark.parametrize("make", [rv.parallel_env, rendezvous_v0.env, make_env, rv.make_vec])
def test_every_environment_renders_by_mode(make):
    env = make("duo", render_mode="rgb_array")
    env.reset(seed=0)
    assert env.render_mode == "rgb_array"
    picture = env.render()
    assert (picture[0] if make is rv.make_vec else picture).shape == (600, 600, 3)
    assert env.metadata["render_modes"] == ["human", "rgb_array"]
    assert env.metadata["render_fps"] == round(1 / rv.scenarios.get("duo").tau)
    with pytest.raises(ValueError, match="render_mode is 'ansi'; it must be None or one of"):
        make("duo", render_mode="ansi")
    env = make("duo")
    env.reset(seed=0)
    with pytest.warns(UserWarning, match="without a render mode"):
        assert env.render() is None


class TestPicture:
    def test_render_before_reset_raises(self):
        env = rv.parallel_env("duo", render_mode="rgb_array")
        with pytest.raises(RuntimeError, match=r"call reset\(\) before render\(\)"):
            env.render()
        with pytest.raises(RuntimeError, match=r"call render\(\) before pixels\(\)"):
            env.renderer.pixels(np.zeros(2))

    def test_rendering_does_not_change_episode(self):
        env, first = drawn("fig4", 3)
        assert np.array_equal(env.render(), first)
        first[:] = 0
        assert env.render().max() == 255  # every picture belongs to its caller
        bare = rv.parallel_env("fig4")
        bare.reset(seed=0)
        for _ in range(3):
            bare.step(still(bare))
        assert np.array_equal(bare.simulator.positions, env.simulator.positions)

    def test_path_is_independent_of_render_rate(self):
        often, seldom = (drawn("fig3")[0] for _ in range(2))
        for _ in range(15):
            forward(often, 1).render()
        assert np.array_equal(often.render(), forward(seldom, 15).render())

    def test_new_episode_has_new_view(self):
        env, picture = drawn("clutter-8")
        env.reset(seed=1)
        assert not np.array_equal(forward(env, 1).render(), picture)
        env.reset(seed=0)
        assert np.array_equal(env.render(), picture)

    def test_changed_obstacles_are_drawn(self):
        env, _ = drawn(rv.scenarios.get("fig4").replace(obstacle_slots=3))
        env.reset(seed=0, options={"obstacles": [rv.Disc((0.0, 0.0), 0.5)]})
        frame = env.render()
        assert at(frame, env.renderer.pixels(np.zeros(2))) == list(OBSTACLE)

    def test_restored_state_starts_new_path(self):
        env, at_start = drawn("fig4")
        state = env.get_state()
        assert not np.array_equal(forward(env, 10).render(), at_start)
        env.set_state(state)
        assert np.array_equal(env.render(), at_start)

    @pytest.mark.parametrize("dim", [2, 3])
    def test_finished_environment_is_drawn(self, dim):
        """All robots at one position without obstacles: the extent of the scene is undefined."""
        start, ahead = np.zeros((2, dim)), np.eye(dim, dtype=np.float32)[0]
        start[1, 0] = 0.3
        options = {"positions": start, "frames": np.tile(np.eye(dim), (2, 1, 1))}
        (met, _), (fresh, _) = (drawn("duo", dim=dim, options=own) for own in (options, None))
        met.step({"robot_0": ahead, "robot_1": -ahead})
        assert not met.agents
        fresh.set_state(met.get_state())
        frame = fresh.render()
        assert at(frame, fresh.renderer.pixels(start.mean(axis=0))) != [255, 255, 255]

    @pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda e: pickle.loads(pickle.dumps(e))])
    def test_copies_draw_identically(self, duplicate):
        env, frame = drawn("fig4", 4)
        twin = duplicate(env)
        assert np.array_equal(twin.render(), frame)
        twin.step(still(twin))
        assert np.array_equal(env.render(), frame)

    def test_renderer_survives_pygame_quit(self):
        env, picture = drawn("duo")
        pygame.quit()
        assert (env.render() == picture).all()
        assert (drawn("duo")[1] == picture).all()

    def test_wrapper_forwards_render(self):
        env = rv.HeadingVectorWrapper(rv.parallel_env("fig4", render_mode="rgb_array"))
        env.reset(seed=0)
        assert env.render().shape == (600, 600, 3) and env.render_mode == "rgb_array"
        assert env.metadata["render_fps"] == round(1 / env.unwrapped.scenario.tau)

    def test_other_sizes_are_supported(self):
        env, _ = drawn("fig3")
        frame = Renderer(env.simulator, "rgb_array", size=(400, 320)).render()
        assert frame.shape == (320, 400, 3)
        assert (frame == OBSTACLE).all(axis=-1).sum() > 500

    @pytest.mark.parametrize("scenario", ["duo", "uav-6"])
    def test_pettingzoo_render_test_passes(self, scenario):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the suite's own imports are deprecated
            from pettingzoo.test import render_test
        render_test(lambda **options: rendezvous_v0.env(scenario, max_cycles=20, **options))


class TestTile:
    def test_tile_has_place_per_environment(self):
        venv = rv.make_vec("clutter-4", num_envs=4, render_mode="rgb_array")
        venv.reset(seed=0)
        before = venv.renderer.render()
        for team, (y, x) in enumerate([(0, 0), (0, 300), (300, 0), (300, 300)]):
            part = before[y : y + 300, x : x + 300]
            assert np.array_equal(venv.render()[team], part)
            places = venv.renderer.pixels(venv.simulator.positions[team], team)
            assert ((places > (x, y)) & (places < (x + 300, y + 300))).all()
            assert [at(before, place) for place in places] == [list(c) for c in ROBOTS[:4]]
            assert (part == OBSTACLE).all(axis=-1).sum() > 200
        actions = np.zeros((4, 4, 2), np.float32)
        actions[2] = 1.0
        for _ in range(8):
            venv.step(actions)
        changed = (venv.renderer.render() != before).any(axis=-1)
        pictures = [changed[y + 21 : y + 298, x + 2 : x + 298] for y in (0, 300) for x in (0, 300)]
        assert [bool(part.any()) for part in pictures] == [False, False, True, False]

    def test_tile_shows_first_environments(self):
        few, many = (
            rv.make_vec("duo", num_envs=count, render_mode="rgb_array")
            for count in (MAX_TEAMS, 3 * MAX_TEAMS)
        )
        for venv in (few, many):
            venv.reset(seed=5)
        assert np.array_equal(few.renderer.render(), many.renderer.render())
        first, rest = many.render()[:MAX_TEAMS], many.render()[MAX_TEAMS:]
        assert np.array_equal(first, few.render()) and len(rest) == 2 * MAX_TEAMS
        assert all(part.min() == 255 and part.shape == first[0].shape for part in rest)

    @pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
    def test_autoreset_clears_old_path(self, mode):
        """As if the renderer had first observed the environment after the last reset."""
        scenario = rv.scenarios.get("clutter-4").replace(time_limit=0.2)
        venv = rv.make_vec(scenario, num_envs=4, autoreset_mode=mode, render_mode="rgb_array")
        venv.reset(seed=0)
        while venv.simulator.steps[0] or not venv.simulator.get_state()["episode"][0]:
            venv.step(np.ones((4, 4, 2), np.float32))
        fresh = Renderer(venv.simulator, "rgb_array")
        assert np.array_equal(venv.renderer.render(), fresh.render())

    def test_vector_wrapper_renders_every_step(self):
        bare = rv.make_vec("fig4", num_envs=2, render_mode="rgb_array")
        venv = HeadingVectorWrapper(bare, decision_period=5)
        venv.reset(seed=0)
        seen, see = [], bare.renderer.see
        bare.renderer.see = lambda contact: seen.append(contact) or see(contact)
        venv.step(venv.action_space.sample())
        assert len(seen) == 5
        assert [part.shape for part in venv.render()] == [(600, 300, 3)] * 2
        assert venv.metadata["render_fps"] == round(bare.metadata["render_fps"] / 5)

    @pytest.mark.parametrize("first_only", [False, True])
    def test_gymnasium_records_videos(self, first_only, tmp_path, monkeypatch):
        """``moviepy`` only writes the recording."""
        monkeypatch.setitem(sys.modules, "moviepy", ModuleType("moviepy"))
        venv = rv.make_vec("duo", num_envs=4, render_mode="rgb_array")
        options = {"episode_trigger": lambda episode: True, "record_first_only": first_only}
        film = RecordVideo(venv, str(tmp_path / "films"), **options)
        film.reset(seed=0)
        part = venv.renderer.render()[:300, :300]
        for _ in range(6):
            film.step(np.ones((4, 2, 2), np.float32))
        frames, film.recorded_frames = np.stack(film.recorded_frames), []
        assert len(frames) == 7 and film.frames_per_sec == venv.metadata["render_fps"]
        assert np.array_equal(frames[0][:300, :300], part)
        assert frames[0].size == part.size * (1 if first_only else 4)
        assert (frames[1:] != frames[0]).any(axis=(1, 2, 3)).all()


@pytest.mark.slow
def test_pygame_is_imported_with_first_picture(tmp_path):
    code = (
        "import sys, rendezvous_env as rv; env = rv.parallel_env('duo', render_mode='rgb_array');"
        "env.reset(seed=0); print('pygame' in sys.modules); env.render();"
        "print('pygame' in sys.modules)"
    )
    assert run_python(tmp_path, "-W", "error", "-c", code).stdout.split() == ["False", "True"]


def test_missing_pygame_names_extra(monkeypatch):
    env = rv.parallel_env("duo", render_mode="rgb_array")
    env.reset(seed=0)
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(ImportError, match=r"a picture needs pygame: pip .*\[render\]"):
        env.render()


def test_tile_reports_packed_rendezvous():
    """All its robots remain, and the tile counted them."""
    env = rv.make_vec("robotarium-4", 2, render_mode="rgb_array", autoreset_mode="Disabled")
    env.reset(seed=0)
    before, state = env.render(), env.get_state()
    state["status"][0] = RENDEZVOUS
    env.set_state(state)
    after = env.render()
    assert not np.array_equal(before[0], after[0]) and np.array_equal(before[1], after[1])
