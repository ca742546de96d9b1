"""``rendezvous render``: videos and figures of one episode."""

import numpy as np
import pytest
from parameters import slow
from PIL import Image

import baselines
import rendezvous_env as rv
from rendezvous_env.render.palette import OBSTACLE, ROBOTS
from train.checks import UserError
from train.figures import render


def make(path, **options):
    """Run the command for a short video; returns its exit status."""
    chosen = {"scenario": "fig4", "policy": "tangent-merged", "size": 300, "fps": 10, "speed": 1.0}
    return render.run(render.Config(out=path, **(chosen | options)))


@pytest.fixture(scope="module")
def gif(tmp_path_factory):
    path = tmp_path_factory.mktemp("films") / "fig4.gif"
    assert make(path) == 0
    return path


def pictures(path):
    """Frames of a GIF and their durations, ms."""
    with Image.open(path) as film:
        found = []
        for number in range(film.n_frames):
            film.seek(number)
            found.append((np.asarray(film.convert("RGB")), film.info["duration"]))
    return found


def seconds(path):
    return sum(duration for _, duration in pictures(path)) / 1000


def length_of(name, policy):
    scenario = rv.scenarios.get(name)
    return float(rv.rollout(scenario, baselines.make(policy, scenario)).times[-1])


def count(picture, colour):
    """Pixels with approximately a colour."""
    return int((np.abs(picture.astype(int) - colour).max(axis=-1) < 25).sum())


class TestGif:
    def test_gif_lasts_as_long_as_episode(self, gif):
        simulated = length_of("fig4", "tangent-merged")
        assert seconds(gif) == pytest.approx(simulated + 1.5, abs=0.11)
        *others, last = (duration for _, duration in pictures(gif))
        assert last >= 1500 > max(others)
        assert gif.stat().st_size < 100_000

    def test_gif_shows_obstacles_and_merges(self, gif):
        (first, _), *_, (last, _) = pictures(gif)
        assert first.shape == (300, 300, 3)
        for picture, seen in ((first, [True] * 3), (last, [True, False, False])):
            assert count(picture, OBSTACLE) > 500
            assert [count(picture[:240], colour) > 5 for colour in ROBOTS[:3]] == seen

    def test_gif_speed_halves_duration(self, gif, tmp_path):
        make(tmp_path / "fast.gif", speed=2.0)
        fast, slow = (seconds(path) - 1.5 for path in (tmp_path / "fast.gif", gif))
        assert slow / fast == pytest.approx(2.0, rel=0.1)

    def test_gif_frame_rate_is_valid(self, tmp_path):
        assert render.video_rate(tmp_path / "a.gif", 30) == pytest.approx(100 / 3)
        assert render.video_rate(tmp_path / "a.GIF", 100) == 50.0
        assert render.video_rate(tmp_path / "a.mp4", 30) == 30.0

    def test_gif_default_speed_gives_eight_seconds(self, tmp_path):
        make(tmp_path / "a.gif", scenario="duo", policy="bearing-only", speed=None)
        steps = round(length_of("duo", "bearing-only") / rv.scenarios.get("duo").tau)
        expected = 1.5 + min(8.0, steps / 15)
        assert seconds(tmp_path / "a.gif") == pytest.approx(expected, abs=0.3)


@pytest.mark.slow
@pytest.mark.filterwarnings(
    "ignore:unclosed file:ResourceWarning",  # of the library's reader, as is the next
    "ignore::pytest.PytestUnraisableExceptionWarning",
)
def test_mp4_holds_same_frames(gif, tmp_path):
    import imageio_ffmpeg

    path = tmp_path / "fig4.mp4"
    assert make(path, size=301) == 0
    reader = imageio_ffmpeg.read_frames(str(path))
    about = next(reader)
    frames = [np.frombuffer(raw, np.uint8).reshape(300, 300, 3) for raw in reader]
    assert about["source_size"] == (300, 300) and about["fps"] == 10.0
    assert len(frames) / 10 == pytest.approx(seconds(gif), abs=0.11)
    difference = np.abs(frames[-1].astype(int) - pictures(gif)[-1][0])
    assert difference.mean() < 8  # of 255; colours are subsampled


@pytest.mark.parametrize(
    ("scenario", "best"),
    [("fig4", "learned-tank"), slow("clutter-3d", None), slow("uav-6", "nonholonomic-3d"),
     slow("duo", "bearing-only")],
)  # fmt: skip
def test_still_uses_best_fitting_policy(scenario, best, tmp_path, capsys):
    policy = "bearing-only" if best is None else None
    for ending in ("png", "pdf"):
        assert make(tmp_path / f"a.{ending}", scenario=scenario, policy=policy) == 0
    assert f"{scenario}, {best or policy}: met after" in capsys.readouterr().out
    with Image.open(tmp_path / "a.png") as image:
        assert image.size[0] == 700 and np.asarray(image.convert("RGB")).std() > 10
    assert (tmp_path / "a.pdf").read_bytes().startswith(b"%PDF")


class TestMistakes:
    def test_render_into_existing_folder_name_leaves_nothing(self, tmp_path):
        (tmp_path / "a.gif").mkdir()
        with pytest.raises(UserError, match=r"--out .*a\.gif: cannot write there"):
            make(tmp_path / "a.gif")
        assert [path.name for path in tmp_path.iterdir()] == ["a.gif"]

    def test_interrupted_render_keeps_old_file(self, tmp_path, monkeypatch):
        (tmp_path / "a.gif").write_bytes(b"old")
        monkeypatch.setattr(render, "_palette", lambda: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            make(tmp_path / "a.gif")
        assert [path.read_bytes() for path in tmp_path.iterdir()] == [b"old"]
