"""Interactive window: keys and mouse change the episode as documented, without a display."""

import numpy as np
import pygame
import pytest
from drawing import near

import rendezvous_env as rv
from rendezvous_env.render import panel
from rendezvous_env.render.palette import OBSTACLE
from rendezvous_env.render.player import Player
from train import cli

SQUARE = rv.Polygon(((-1, -1), (1, -1), (1, 1), (-1, 1)))
APART = ((-4.0, 0.0), (4.0, 0.0), (0.0, 4.0))


def rest(observations, _):
    return np.zeros((1, observations.shape[1], 2))


@pytest.fixture
def play():
    """Factory of players of three robots around a square; windows are closed."""
    pygame.display.init()
    pygame.event.clear()
    made = []

    def make(policy=rest, **fields):
        fields = {
            "n_robots": 3, "start_positions": APART, "obstacles": [SQUARE], "time_step": 0.01,
            "allow_long_step": True, "max_speed": 2.0, "local_frames": "random", **fields,
        }  # fmt: skip
        player = Player(rv.Simulator(rv.Scenario(**fields)), policy, "rest", 400)
        made.append(player)
        return player

    yield make
    for player in made:
        player.close()


def press(*keys, released=False):
    for key in keys:
        pygame.event.post(pygame.Event(pygame.KEYUP if released else pygame.KEYDOWN, key=key))


def pixel(player, *point):
    return tuple(map(round, player._renderer.pixels(np.array(point, float)).tolist()))


def mouse(kind, place):
    more = {} if kind == pygame.MOUSEMOTION else {"button": 1}
    pygame.event.post(pygame.Event(kind, pos=place, **more))


def drag(player, start, end):
    mouse(pygame.MOUSEBUTTONDOWN, pixel(player, *start))
    mouse(pygame.MOUSEMOTION, pixel(player, *end))
    mouse(pygame.MOUSEBUTTONUP, pixel(player, *end))
    player.advance()


def test_space_pauses_and_s_steps(play):
    player = play()
    press(pygame.K_SPACE)
    assert not player.advance() and player.paused
    press(pygame.K_s)
    assert player.advance() and not player.advance()
    assert player.simulator.steps[0] == 1
    press(pygame.K_SPACE)
    assert player.run(3) == 3 and player.simulator.steps[0] == 4


def test_reset_and_close_keys(play):
    player = play(start_positions=None, obstacles=())
    player.run(2)
    first = player.simulator.positions
    press(pygame.K_r)
    player.advance()
    assert player.simulator.steps[0] == 1
    assert not np.array_equal(player.simulator.positions, first)
    press(pygame.K_q)
    assert player.run() == 0 and player.closed


def test_click_and_tab_select_robots(play):
    player = play()
    mouse(pygame.MOUSEBUTTONDOWN, pixel(player, 4, 0))
    player.advance()
    assert player.selected == 1
    mouse(pygame.MOUSEBUTTONUP, pixel(player, 4, 0))
    for expected in (2, 0, 1):
        press(pygame.K_TAB)
        player.advance()
        assert player.selected == expected


def test_dragged_robot_moves_but_not_into_obstacle(play):
    player = play()
    press(pygame.K_SPACE)
    drag(player, (4, 0), (3, -3))
    positions = player.simulator.positions[0]
    np.testing.assert_allclose(positions[1], (3, -3), atol=0.05)
    assert np.array_equal(positions[[0, 2]], np.array(APART)[[0, 2]])
    drag(player, (3, -3), (0.5, 0.5))  # in the square
    np.testing.assert_allclose(player.simulator.positions[0, 1], (3, -3), atol=0.05)
    bearing = player.simulator.observe()
    assert np.array_equal(player._observations, bearing)


def test_dragged_obstacle_moves_but_not_onto_robot(play):
    player = play()
    press(pygame.K_SPACE)
    before = player._canvas.copy()
    drag(player, (0.5, 0.5), (-2.5, 2.5))
    row = player.simulator.obstacles[0, 0]
    np.testing.assert_allclose(row[3:5], (-3, 2), atol=0.05)
    np.testing.assert_allclose(row[6:].reshape(4, 2).mean(axis=0), (-3, 2), atol=0.05)
    frame = pygame.surfarray.array3d(player._canvas).swapaxes(0, 1)
    old = pygame.surfarray.array3d(before).swapaxes(0, 1)
    place = pixel(player, -3, 2)  # the view has not changed
    assert near(frame, place, OBSTACLE, 3) > 40 and near(old, place, OBSTACLE, 3) == 0
    drag(player, (-3, 2), (0, 4))  # onto robot 2
    np.testing.assert_allclose(player.simulator.obstacles[0, 0, 3:5], (-3, 2), atol=0.05)


def test_keys_drive_one_robot_and_policy_the_others(play):
    player = play(lambda seen, _: np.ones((1, 3, 2)))
    start = player.simulator.positions[0].copy()
    press(pygame.K_TAB, pygame.K_d, pygame.K_UP)
    player.run(11)  # the first step precedes the keys
    moved = player.simulator.positions[0] - start
    assert player.driven == 1
    np.testing.assert_allclose(moved[1], (0, 0.01 * 2.0 * 10), atol=0.03)
    assert np.linalg.norm(moved[[0, 2]], axis=1) == pytest.approx(0.11 * 2**0.5, rel=1e-5)
    press(pygame.K_UP, released=True)
    player.advance()
    place = player.simulator.positions[0, 1]
    player.run(3)
    assert np.array_equal(player.simulator.positions[0, 1], place)
    press(pygame.K_d)
    player.run(2)
    assert player.driven is None
    assert not np.array_equal(player.simulator.positions[0, 1], place)


@pytest.mark.parametrize(
    ("keys", "sign"), [((pygame.K_UP,), (1, 0)), ((pygame.K_DOWN, pygame.K_LEFT), (-1, 1))]
)
def test_keys_drive_unicycle_by_speed_and_turn_rate(play, keys, sign):
    player = play(robot_model="unicycle", start_headings=((0.0,), (0.0,), (0.0,)), obstacles=())
    press(pygame.K_SPACE, pygame.K_d, *keys)
    player.advance()
    bounds = player.simulator.scenario.action_bounds
    assert np.array_equal(player._driven_action(0), np.array(sign) * bounds)


def test_keys_drive_robots_of_a_mixed_team_at_their_own_limits(play):
    models, speeds = ("single_integrator", "unicycle", "unicycle"), (1.0, 2.0, 0.5)
    player = play(robot_model=models, max_speed=speeds, obstacles=())
    press(pygame.K_SPACE, pygame.K_d, pygame.K_UP)
    player.advance()
    actions = np.stack([player._driven_action(robot) for robot in range(3)])
    assert np.linalg.norm(actions[0]) == pytest.approx(1.0)
    assert actions[1:].tolist() == [[2.0, 0.0], [0.5, 0.0]]


def test_driven_robot_in_3d_follows_view(play):
    starts = ((-4.0, 0.0, 0.0), (4.0, 0.0, 0.0), (0.0, 4.0, 1.0))
    player = play(lambda seen, _: np.zeros((1, 3, 3)), dim=3, start_positions=starts, obstacles=())
    press(pygame.K_d, pygame.K_PAGEUP)
    player.run(11)
    moved = player.simulator.positions[0, 0] - starts[0]
    np.testing.assert_allclose(moved, (0, 0, 0.2), atol=0.03)
    drag(player, starts[1], (0.0, 0.0, 0.0))  # space has no drag
    assert player.selected == 1
    assert player.simulator.positions[0, 1].tolist() == [4.0, 0.0, 0.0]


def test_selection_follows_merge(play):
    player = play(lambda seen, _: seen[:, :, :2].sum(axis=2), obstacles=(), merge_radius=0.5)
    player.selected, player.driven = 2, 2
    while not player.simulator.ended[0]:
        player.driven = None if player.simulator.active[0].all() else player.driven
        player.advance()
    assert player.selected == 0 and not player.advance()


def test_panel_lists_observation(play):
    player = play(obstacle_range=5.0, local_frames="global")
    layout = player.simulator.scenario.observation_layout
    lines = panel.lines_of(layout, player._observations[0, 0])
    assert lines == [
        "row 0: (1.00, 0.00) m/s",
        "row 1: (0.71, 0.71) m/s",
        "obstacle 0: (0.95, 0.32) to (0.95, -0.32)",
    ]
    empty = np.zeros_like(player._observations[0, 0])
    assert panel.lines_of(layout, empty) == ["no neighbour"]
    side = pygame.surfarray.array3d(player._canvas)[400:]
    assert side.shape[0] == panel.WIDTH and (side < 128).any()


def test_play_command_steps_and_closes(capsys):
    words = "play duo --policy bearing-only --steps 3 --size 300"
    assert cli.main(words.split()) == 0
    assert "duo, bearing-only: 3 steps" in capsys.readouterr().out


def test_play_command_without_display_names_remedy(monkeypatch, capsys):
    pygame.quit()
    monkeypatch.setenv("SDL_VIDEODRIVER", "nowhere")
    assert cli.main("play duo --steps 3".split()) == 2
    assert "no window can be opened here" in capsys.readouterr().err
    monkeypatch.undo()
    pygame.display.init()
