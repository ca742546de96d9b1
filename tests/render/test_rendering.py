"""Pictures show what the data say: colours stand where the robots and the obstacles are."""

from __future__ import annotations

import copy
import os
import pickle
import sys
import warnings
from types import ModuleType

os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")

import gymnasium
import numpy as np
import pygame
import pytest
from conftest import MODELS, ROOT, five
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers.vector import RecordVideo
from test_package import run_python

import baselines
import rendezvous_env as rv
from rendezvous_env import rendezvous_v0
from rendezvous_env.envs.gymnasium_env import make_env
from rendezvous_env.obstacles.obstacle_set import pack
from rendezvous_env.render.camera import Area, fit, nice_step
from rendezvous_env.render.palette import OBSTACLE, ROBOTS, robot_colour
from rendezvous_env.render.renderer import MOST_TEAMS, Renderer
from rendezvous_env.vector import HeadingVectorWrapper

NAME = "rendezvous_env:rendezvous/Rendezvous-v0"
STRIP = 600 - 118
"""First row of pixels of the strip of V(t)."""


def still(env):
    return {name: np.zeros(env.action_space(name).shape, np.float32) for name in env.agents}


def drawn(scenario="fig4", steps=0, *, options=None, mode="rgb_array", **overrides):
    """An environment after some steps of rest, and its picture."""
    env = rv.parallel_env(scenario, render_mode=mode, **overrides)
    env.reset(seed=0, options=options)
    for _ in range(steps):
        env.step(still(env))
    return env, env.render()


def at(frame, place):
    """Colour of the pixel nearest to a place (x, y)."""
    x, y = np.round(place).astype(int)
    return frame[y, x].tolist()


def near(frame, place, colour, reach):
    """How many pixels within a reach of a place nearly have a colour."""
    x, y = np.round(place).astype(int)
    part = frame[max(0, y - reach) : y + reach + 1, max(0, x - reach) : x + reach + 1].astype(int)
    return int((np.abs(part - colour).max(axis=-1) < 30).sum())


# ---- what a picture shows -----------------------------------------------------------------------


class TestContent:
    def test_each_robot_has_its_colour_where_it_is(self, kind):
        env, _ = drawn(five(kind))
        law = {name: np.full(env.action_space(name).shape, 0.4, np.float32) for name in env.agents}
        for _ in range(5):
            env.step(law)
        frame = env.render()
        assert frame.shape == (600, 600, 3) and frame.dtype == np.uint8
        places = env.renderer.pixels(env.simulator.positions[0])
        assert [at(frame, place) for place in places] == [list(c) for c in ROBOTS[:5]]

    def test_obstacles_are_orange_where_the_data_say(self):
        env, frame = drawn("fig4")
        disc, _, polygon = env.scenario.obstacles
        for inside in (disc.centre, polygon.centroid):
            assert at(frame, env.renderer.pixels(np.array(inside))) == list(OBSTACLE)
        for angle in np.linspace(0.0, 6.0, 12):
            along = np.array([np.cos(angle), np.sin(angle)])
            edge = np.array(disc.centre) + (disc.radius - 0.06) * along
            assert near(frame, env.renderer.pixels(edge), OBSTACLE, 0) == 1
            beyond = np.array(disc.centre) + (disc.radius + 0.06) * along
            assert near(frame, env.renderer.pixels(beyond), OBSTACLE, 0) == 0

    def test_a_sphere_is_orange_and_hides_what_is_behind(self):
        positions = np.array([[2.0, 0.0, 0.0], [-2.0, 0.0, 0.0], [0.0, 0.0, 2.5]])
        scenario = rv.Scenario(n_robots=3, dim=3, obstacles=(rv.Sphere((0.0, 0.0, 0.0), 1.0),))
        camera = fit(positions, pack(scenario.obstacles, 1), Area(0, 0, 600, 450), 18)
        behind, before = -1.5 * camera.back, 1.5 * camera.back
        points = np.array([behind, before, positions[2]])
        hidden = camera.hidden(points, pack(scenario.obstacles, 1))
        assert hidden.tolist() == [True, False, False]
        env, frame = drawn(scenario, options={"positions": np.array([behind, before, [0, 0, 2.5]])})
        places = env.renderer.pixels(env.simulator.positions[0])
        assert at(frame, places[1]) == list(ROBOTS[1])
        assert np.abs(np.subtract(at(frame, places[0]), ROBOTS[0])).max() > 60
        right = env.renderer.pixels(0.8 * camera.right)
        assert near(frame, right, (233, 171, 31), 3) > 40  # orange through which white shines

    def test_axes_are_equal(self):
        env, _ = drawn("fig3")
        origin, x, y = env.renderer.pixels(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
        assert x - origin == pytest.approx([(x - origin)[0], 0.0], abs=1e-9)
        assert y - origin == pytest.approx([0.0, -(x - origin)[0]], abs=1e-9)

    def test_space_is_seen_in_perspective(self):
        camera = fit(np.eye(3) * 4, np.zeros((0, 5)), Area(0, 0, 600, 400), 20)
        assert (
            camera.nearness(camera.centre + camera.back)
            > 1
            > camera.nearness(camera.centre - camera.back)
        )
        up = camera.directions(camera.centre, np.array([0.0, 0.0, 1.0]))
        assert up[0] == pytest.approx(0.0, abs=1e-9) and -1 < up[1] < -0.8
        assert camera.directions(camera.centre, camera.back) == pytest.approx([0, 0], abs=1e-9)

    @pytest.mark.parametrize("kind", MODELS)
    def test_everything_at_the_start_is_within_the_picture(self, kind):
        env, _ = drawn(five(kind))
        places = env.renderer.pixels(env.simulator.positions[0])
        assert (places >= 0).all() and (places[:, 0] < 600).all() and (places[:, 1] < STRIP).all()

    def test_a_robot_that_moves_leaves_a_path_and_the_view_stays(self):
        env, before = drawn("fig3", local_frames="global")
        fixed = np.array([[-1.0, 2.0], [3.0, 0.5]])
        view, start = env.renderer.pixels(fixed), env.simulator.positions[0].copy()
        for _ in range(20):
            env.step(still(env) | {"robot_0": np.array([1.0, 0.0], np.float32)})
        after = env.render()
        assert np.array_equal(env.renderer.pixels(fixed), view)
        assert at(before, env.renderer.pixels(start[0])) == list(ROBOTS[0])
        assert near(after, env.renderer.pixels(start[0]), ROBOTS[0], 1) == 0
        moved = env.simulator.positions[0, 0]
        assert np.linalg.norm(moved - start[0]) > 0.5
        path = at(after, env.renderer.pixels((start[0] + moved) / 2))
        assert path[2] > path[0] + 40  # a bluish line half way
        assert at(after, env.renderer.pixels(start[1])) == list(ROBOTS[1])

    def test_headings_and_bearings_stick_out_of_a_robot(self):
        scenario = rv.Scenario(n_robots=2, robot_model="unicycle")
        options = {"positions": [[0.0, 0.0], [4.0, 0.0]], "headings": [np.pi / 2, 0.0]}
        env, frame = drawn(scenario, options=options)
        place = env.renderer.pixels(np.zeros(2))
        up, right = np.array([0, -10]), np.array([18, 0])
        nose = np.array(at(frame, place + up))
        assert nose.max() < 160 and at(frame, place - up) != nose.tolist()
        assert near(frame, place + right, ROBOTS[0], 3) > 3  # its bearing points to the other
        assert near(frame, place - right, ROBOTS[0], 3) == 0

    def test_who_senses_whom_is_joined_by_a_line(self):
        path = np.array([[0, 1.0, 0], [1.0, 0, 1.0], [0, 1.0, 0]])
        scenario = rv.Scenario(n_robots=3, graph=path)
        options = {"positions": [[-3.1, 0.0], [0.0, 4.1], [3.1, 0.0]]}
        env, frame = drawn(scenario, options=options)
        positions = env.simulator.positions[0]
        middles = [
            env.renderer.pixels((positions[i] + positions[j]) / 2) for i, j in ((0, 1), (0, 2))
        ]
        assert near(frame, middles[0], (205, 205, 205), 1) > 0
        assert near(frame, middles[1], (205, 205, 205), 1) == 0

    def test_a_merge_leaves_a_cross_and_a_number(self):
        options = {"positions": [[0.0, 0.0], [0.3, 0.0], [4.0, 4.0]]}
        env, _ = drawn(rv.Scenario(n_robots=3), options=options)
        to_the_other = {"robot_0": 0.0, "robot_1": -1.0, "robot_2": 0.0}
        frames = env.simulator.frames[0]
        while env.simulator.active.all():
            away = np.array([[to_the_other[f"robot_{i}"], 0.0] for i in range(3)])
            local = np.einsum("nij,ni->nj", frames, away).astype(np.float32)
            env.step({name: local[env.index(name)] for name in env.agents})
        merged_at = env.simulator.positions[0, 0].copy()
        up = (frames[0].T @ np.array([0.0, 1.0])).astype(np.float32)
        for _ in range(60):
            env.step(still(env) | {"robot_0": up})
        frame = env.render()
        black = near(frame, env.renderer.pixels(merged_at), (0, 0, 0), 5)
        assert black > 4
        survivor = env.renderer.pixels(env.simulator.positions[0, 0])
        assert near(frame, survivor, (255, 255, 255), 3) > 3  # the 2
        assert near(frame, survivor, ROBOTS[0], 6) > 40

    def test_a_contact_is_ringed_and_stays_marked(self):
        scenario = rv.Scenario(
            n_robots=2, obstacles=(rv.Disc((0.0, 0.0), 1.0),), local_frames="global", max_speed=1.0
        )
        env, _ = drawn(scenario, options={"positions": [[-1.5, 0.0], [3.0, 3.0]]})
        ahead = np.array([1.0, 0.0], np.float32)
        while env.simulator.contacts[0] == 0:
            env.step(still(env) | {"robot_0": ahead})
        touching = env.renderer.pixels(env.simulator.positions[0, 0])
        assert near(env.render(), touching, (0, 0, 0), 11) > 20
        for _ in range(6):
            env.step(still(env) | {"robot_0": -ahead})
        frame = env.render()
        assert near(frame, touching, (0, 0, 0), 6) > 8
        assert near(frame, env.renderer.pixels(env.simulator.positions[0, 0]), (0, 0, 0), 11) == 0

    def test_the_strip_shows_v_falling(self):
        env = rv.parallel_env("duo", render_mode="rgb_array")
        policy = baselines.make("bearing-only", env.scenario)
        observations, _ = env.reset(seed=0)
        heights = []
        for _ in range(2):
            for _ in range(12):
                actions = {name: policy(observations[name], 0.0) for name in env.agents}
                observations, *_ = env.step(actions)
            rows, columns = np.nonzero((env.render()[STRIP:] == ROBOTS[0]).all(axis=-1))
            heights.append((columns.max(), rows[columns > columns.max() - 4].mean()))
        assert heights[1][0] > heights[0][0] and heights[1][1] > heights[0][1]

    def test_colours_go_round_by_index(self):
        assert robot_colour(7) == robot_colour(0) == ROBOTS[0]
        assert len(set(ROBOTS)) == len(ROBOTS) and OBSTACLE not in ROBOTS

    def test_steps_of_a_grid_are_round(self):
        assert [nice_step(span, 8) for span in (1.0, 9.0, 16.0, 20.0, 39.0)] == [0.2, 2, 2, 5, 5]


# ---- one interface ------------------------------------------------------------------------------


MAKERS = {
    "parallel": rv.parallel_env,
    "aec": rendezvous_v0.env,
    "raw": rendezvous_v0.raw_env,
    "gymnasium": make_env,
    "vector": rv.make_vec,
}


class TestInterface:
    @pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
    def test_every_kind_of_environment_renders(self, make):
        env = make("duo", render_mode="rgb_array")
        env.reset(seed=0)
        assert env.render_mode == "rgb_array"
        picture = env.render()
        assert (picture[0] if make is rv.make_vec else picture).shape == (600, 600, 3)
        assert env.metadata["render_modes"] == ["human", "rgb_array"]
        assert env.metadata["render_fps"] == round(1 / rv.scenarios.get("duo").tau)
        env.close()

    @pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
    def test_an_unknown_mode_is_refused_by_name(self, make):
        with pytest.raises(ValueError, match="render_mode is 'ansi'; it must be None or one of"):
            make("duo", render_mode="ansi")

    @pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
    def test_without_a_mode_a_warning_and_nothing_kept(self, make):
        env = make("duo")
        env.reset(seed=0)
        with pytest.warns(UserWarning, match="without a render mode"):
            assert env.render() is None
        assert env.unwrapped.renderer._histories == []

    def test_before_the_first_reset_there_is_nothing_to_draw(self):
        with pytest.raises(RuntimeError, match=r"call reset\(\) before render\(\)"):
            rv.parallel_env("duo", render_mode="rgb_array").render()
        with pytest.raises(RuntimeError, match=r"call render\(\) before pixels\(\)"):
            rv.parallel_env("duo", render_mode="rgb_array").renderer.pixels(np.zeros(2))

    def test_rendering_changes_neither_the_episode_nor_the_next_picture(self):
        env, first = drawn("fig4", 3)
        assert np.array_equal(env.render(), first)
        first[:] = 0
        assert env.render().max() == 255  # every picture belongs to its caller
        bare, _ = rv.parallel_env("fig4"), None
        bare.reset(seed=0)
        for _ in range(3):
            bare.step(still(bare))
        assert np.array_equal(bare.simulator.positions, env.simulator.positions)

    def test_a_path_does_not_depend_on_how_often_it_is_drawn(self):
        often, seldom = (rv.parallel_env("fig3", render_mode="rgb_array") for _ in range(2))
        for env in (often, seldom):
            env.reset(seed=2)
            for _ in range(15):
                env.step({name: np.ones(2, np.float32) for name in env.agents})
                if env is often:
                    env.render()
        assert np.array_equal(often.render(), seldom.render())

    def test_a_new_episode_has_a_view_of_its_own(self):
        env = rv.parallel_env("clutter-8", render_mode="rgb_array")
        env.reset(seed=1)
        env.step({name: np.ones(2, np.float32) for name in env.agents})
        env.render()
        env.reset(seed=2)
        fresh = rv.parallel_env("clutter-8", render_mode="rgb_array")
        fresh.reset(seed=2)
        assert np.array_equal(env.render(), fresh.render())

    def test_other_obstacles_at_the_same_start_are_seen(self):
        scenario = rv.scenarios.get("fig4").replace(obstacle_slots=3)
        env, _ = drawn(scenario)
        env.reset(seed=0, options={"obstacles": [rv.Disc((0.0, 0.0), 0.5)]})
        frame = env.render()
        assert at(frame, env.renderer.pixels(np.zeros(2))) == list(OBSTACLE)

    def test_a_state_put_back_begins_a_new_path(self):
        env, at_start = drawn("fig4")
        state = env.get_state()
        for _ in range(10):
            env.step({name: np.ones(2, np.float32) for name in env.agents})
        assert not np.array_equal(env.render(), at_start)
        env.set_state(state)
        assert np.array_equal(env.render(), at_start)

    @pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda e: pickle.loads(pickle.dumps(e))])
    def test_copies_draw_the_same_picture(self, duplicate):
        env, frame = drawn("clutter-3d", 4)
        twin = duplicate(env)
        assert np.array_equal(twin.render(), frame)
        twin.step(still(twin))
        assert np.array_equal(env.render(), frame)

    def test_a_wrapper_hands_the_picture_on(self):
        env = rv.HeadingVectorWrapper(rv.parallel_env("fig4", render_mode="rgb_array"))
        env.reset(seed=0)
        env.step({name: env.action_space(name).sample() for name in env.agents})
        assert env.render().shape == (600, 600, 3) and env.render_mode == "rgb_array"
        assert env.metadata["render_fps"] == round(1 / env.unwrapped.scenario.tau)

    def test_other_sizes(self):
        simulator = rv.Simulator(rv.scenarios.get("fig3"))
        simulator.reset(0)
        frame = Renderer(simulator, "rgb_array", size=(400, 320)).render()
        assert frame.shape == (320, 400, 3)
        assert (frame == OBSTACLE).all(axis=-1).sum() > 500

    def test_gymnasium_is_content(self):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            env = gymnasium.make(NAME, scenario="duo", render_mode="rgb_array")
            env.reset(seed=0)
            env.render()
            check_env(env.unwrapped)

    @pytest.mark.parametrize("scenario", ["duo", "uav-6"])
    def test_pettingzoo_is_content(self, scenario):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the suite's own imports are deprecated
            from pettingzoo.test import render_test
        render_test(lambda **options: rendezvous_v0.env(scenario, max_cycles=20, **options))
        render_test(lambda **options: rendezvous_v0.raw_env(scenario, max_cycles=20, **options))


# ---- teams --------------------------------------------------------------------------------------


class TestTile:
    def test_each_team_has_its_place(self):
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

    def test_of_many_teams_the_first_are_shown(self):
        few, many = (
            rv.make_vec("duo", num_envs=count, render_mode="rgb_array")
            for count in (MOST_TEAMS, 3 * MOST_TEAMS)
        )
        for venv in (few, many):
            venv.reset(seed=5)
        assert np.array_equal(few.renderer.render(), many.renderer.render())
        first, rest = many.render()[:MOST_TEAMS], many.render()[MOST_TEAMS:]
        assert np.array_equal(first, few.render()) and len(rest) == 2 * MOST_TEAMS
        assert all(part.min() == 255 and part.shape == first[0].shape for part in rest)
        assert len(many.renderer._histories) == MOST_TEAMS

    @pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
    def test_a_team_that_begins_anew_has_no_old_path(self, mode):
        scenario = rv.scenarios.get("clutter-4").replace(time_limit=0.2)
        venv = rv.make_vec(scenario, num_envs=4, autoreset_mode=mode, render_mode="rgb_array")
        venv.reset(seed=0)
        for _ in range(5):
            venv.step(np.ones((4, 4, 2), np.float32))
        assert all(len(history.moments) <= 2 for history in venv.renderer._histories)
        places = venv.renderer
        frame = venv.renderer.render()
        for team in range(4):
            place = places.pixels(venv.simulator.positions[team], team)
            assert at(frame, place[0]) == list(ROBOTS[0])

    def test_the_vector_wrapper_shows_every_base_step(self):
        base = rv.make_vec("fig4", num_envs=2, render_mode="rgb_array")
        venv = HeadingVectorWrapper(base, decision_period=5)
        venv.reset(seed=0)
        venv.step(venv.action_space.sample())
        assert [len(history.moments) for history in base.renderer._histories] == [6, 6]
        assert [part.shape for part in venv.render()] == [(600, 300, 3)] * 2
        assert venv.metadata["render_fps"] == round(base.metadata["render_fps"] / 5)

    def test_gymnasium_records_films_of_teams(self, tmp_path, monkeypatch):
        """All but the last step, which makes a file of the frames."""
        films = []

        class Clip:
            def __init__(self, frames, fps):
                films.append((np.stack(frames), fps))

            def write_videofile(self, path, logger):
                assert path.endswith(".mp4")

        writer = ModuleType("moviepy.video.io.ImageSequenceClip")
        writer.ImageSequenceClip = Clip
        for name in ("moviepy", "moviepy.video", "moviepy.video.io"):
            monkeypatch.setitem(sys.modules, name, ModuleType(name))
        monkeypatch.setitem(sys.modules, writer.__name__, writer)
        for first_only in (False, True):
            venv = rv.make_vec("duo", num_envs=4, render_mode="rgb_array")
            film = RecordVideo(
                venv,
                str(tmp_path / str(first_only)),
                video_length=6,
                record_first_only=first_only,
                disable_logger=True,
            )
            film.reset(seed=0)
            whole = venv.renderer.render()
            for _ in range(8):
                film.step(np.ones((4, 2, 2), np.float32))
            frames, fps = films[-1]
            assert len(frames) == 7 and fps == venv.metadata["render_fps"]
            part = whole[:300, :300]
            assert np.array_equal(frames[0][:300, :300], part)
            assert frames[0].size == part.size * (1 if first_only else 4)
            assert (frames[1:] != frames[0]).any(axis=(1, 2, 3)).all()


# ---- the window ---------------------------------------------------------------------------------


def press(*keys):
    for key in keys:
        pygame.event.post(pygame.Event(pygame.KEYDOWN, key=key))


@pytest.fixture
def shown():
    """An environment with a window, whose steps are short; keys of other tests are forgotten."""
    env, nothing = drawn("duo", mode="human", time_step=1e-3, allow_long_step=True)
    assert nothing is None
    pygame.event.clear()
    yield env
    env.close()


class TestWindow:
    def test_it_shows_the_picture_and_goes_away(self, shown):
        window = shown.renderer._window
        pixels = pygame.surfarray.array3d(window._window.get_surface())
        assert (pixels == ROBOTS[0]).all(axis=-1).sum() > 50
        assert shown.render() is None
        shown.close()
        assert window.closed and shown.renderer._window is None
        shown.close()
        shown.reset(seed=0)
        assert shown.renderer._window is not None

    def test_space_pauses_and_the_arrow_makes_single_steps(self, shown):
        window = shown.renderer._window
        press(pygame.K_SPACE, pygame.K_RIGHT, pygame.K_s)
        shown.step(still(shown))
        shown.step(still(shown))
        assert window.paused and window._is_held()
        press(pygame.K_SPACE)
        shown.step(still(shown))
        assert not window.paused and not window._is_held()
        assert shown.simulator.steps[0] == 3

    def test_an_arrow_pauses_too(self, shown):
        press(pygame.K_RIGHT)
        shown.step(still(shown))
        assert shown.renderer._window._is_held()

    @pytest.mark.parametrize(
        "event",
        [
            pygame.Event(pygame.QUIT),
            pygame.Event(pygame.WINDOWCLOSE),
            pygame.Event(pygame.KEYDOWN, key=pygame.K_ESCAPE),
        ],
        ids=["quit", "close", "escape"],
    )
    def test_once_closed_the_episode_goes_on_unseen(self, shown, event):
        press(pygame.K_SPACE)  # closing ends a pause
        pygame.event.post(event)
        for _ in range(3):
            shown.step(still(shown))
        assert shown.simulator.steps[0] == 3
        assert shown.renderer._window is None
        assert shown.render() is None
        shown.reset(seed=1)
        assert shown.renderer._window is None

    def test_a_copy_has_no_window_until_its_reset(self, shown):
        twin = copy.deepcopy(shown)
        twin.step(still(twin))
        assert twin.renderer._window is None
        twin.reset(seed=0)
        assert twin.renderer._window is not None
        twin.close()
        assert not shown.renderer._window.closed

    def test_teams_share_a_window(self):
        venv = rv.make_vec("duo", num_envs=4, render_mode="human")
        venv.reset(seed=0)
        assert venv.renderer._window is not None
        venv.close()
        assert venv.renderer._window is None

    def test_where_there_is_no_screen_the_error_says_what_needs_none(self, tmp_path):
        code = (
            "import rendezvous_env as rv\n"
            "env = rv.parallel_env('duo', render_mode='human')\n"
            "try: env.reset(seed=0)\n"
            "except RuntimeError as error: print(error)"
        )
        printed = run_python(code, tmp_path, SDL_VIDEODRIVER="nowhere")
        assert "no window can be opened here" in printed and 'render_mode="rgb_array"' in printed


# ---- the drawing library ------------------------------------------------------------------------


def test_it_is_loaded_when_the_first_picture_is_drawn(tmp_path):
    code = (
        "import sys, rendezvous_env as rv; env = rv.parallel_env('duo', render_mode='rgb_array');"
        "env.reset(seed=0); print('pygame' in sys.modules); env.render();"
        "print('pygame' in sys.modules)"
    )
    assert run_python(code, tmp_path, "-W", "error").split() == ["False", "True"]


def test_without_it_the_error_says_what_to_install(monkeypatch):
    env = rv.parallel_env("duo", render_mode="rgb_array")
    env.reset(seed=0)
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(ImportError, match=r"pip install rendezvous-env\[render\]"):
        env.render()


def test_the_wheel_holds_the_drawing_package():
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    assert '"rendezvous_env.render"' in text
