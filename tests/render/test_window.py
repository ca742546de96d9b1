"""Window that plays an episode: keys, closing, copies."""

import copy

import pygame
import pytest
from conftest import run_python
from drawing import drawn, still

import rendezvous_env as rv
from rendezvous_env.render.palette import ROBOTS
from rendezvous_env.render.window import Window


def press(*keys):
    for key in keys:
        pygame.event.post(pygame.Event(pygame.KEYDOWN, key=key))


@pytest.fixture
def shown():
    """An environment with a window and short steps; keys of other tests are cleared."""
    env, nothing = drawn("duo", mode="human", time_step=1e-3, allow_long_step=True)
    assert nothing is None
    pygame.event.clear()
    yield env
    env.close()


class TestWindow:
    def test_window_shows_picture_and_closes(self, shown):
        window = shown.renderer.window
        pixels = pygame.surfarray.array3d(window.screen.get_surface())
        assert (pixels == ROBOTS[0]).all(axis=-1).sum() > 50
        assert shown.render() is None
        shown.close()
        assert window.closed and shown.renderer.window is None
        shown.close()
        shown.reset(seed=0)
        assert shown.renderer.window is not None

    def test_space_pauses_and_arrow_steps(self, shown):
        window = shown.renderer.window
        press(pygame.K_SPACE, pygame.K_RIGHT, pygame.K_s)
        shown.step(still(shown))
        shown.step(still(shown))
        assert window.paused and window.is_held()
        press(pygame.K_SPACE)
        shown.step(still(shown))
        assert not window.paused and not window.is_held()
        assert shown.simulator.steps[0] == 3

    @pytest.mark.parametrize(
        ("kind", "more"),
        [(pygame.QUIT, {}), (pygame.WINDOWCLOSE, {}), (pygame.KEYDOWN, {"key": pygame.K_ESCAPE})],
        ids=["quit", "close", "escape"],
    )
    def test_closed_window_does_not_stop_episode(self, shown, kind, more):
        press(pygame.K_SPACE)  # closing ends a pause
        pygame.event.post(pygame.Event(kind, **more))
        for _ in range(3):
            shown.step(still(shown))
        assert shown.simulator.steps[0] == 3
        assert shown.renderer.window is None
        assert shown.render() is None
        shown.reset(seed=1)
        assert shown.renderer.window is None

    def test_copy_has_no_window_until_reset(self, shown):
        twin = copy.deepcopy(shown)
        twin.step(still(twin))
        assert twin.renderer.window is None
        twin.reset(seed=0)
        assert twin.renderer.window is not None
        twin.close()
        assert not shown.renderer.window.closed

    @pytest.mark.parametrize("again", [False, True])
    def test_window_survives_pygame_quit(self, shown, again):
        pygame.quit()  # as Gymnasium's own environments do when they are closed
        if again:
            pygame.display.init()
        shown.step(still(shown))
        shown.render()
        pixels = pygame.surfarray.array3d(shown.renderer.window.screen.get_surface())
        assert (pixels == ROBOTS[0]).all(axis=-1).sum() > 50

    def test_old_window_does_not_close_new_one(self):
        window, picture = Window("", (600, 600)), pygame.Surface((600, 600))
        picture.fill(ROBOTS[0])
        for _ in range(50):  # often the new one lies at the address of the old one
            pygame.quit()
            pygame.display.init()
            window.show(picture)
            assert window.screen.get_surface().get_at((300, 300))[:3] == tuple(ROBOTS[0])
        window.close()

    def test_environments_share_window(self):
        venv = rv.make_vec("duo", num_envs=4, render_mode="human")
        venv.reset(seed=0)
        assert venv.renderer.window is not None
        venv.close()
        assert venv.renderer.window is None

    @pytest.mark.slow
    def test_missing_display_error_names_remedy(self, tmp_path):
        code = (
            "import rendezvous_env as rv\n"
            "env = rv.parallel_env('duo', render_mode='human')\n"
            "try: env.reset(seed=0)\n"
            "except RuntimeError as error: print(error)"
        )
        printed = run_python(tmp_path, "-c", code, SDL_VIDEODRIVER="nowhere").stdout
        assert "no window can be opened here" in printed and 'render_mode="rgb_array"' in printed
