"""Snapshots and clips hold what the page shows."""

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image

from tg4mm.core.magnification import Magnification
from tg4mm.show.view.painter import Look
from tg4mm.show.view.saving import LONGEST, clip_moments, next_name, save_clip, save_snapshot
from tg4mm.show.view.screen import Canvas
from tg4mm.show.view.session import Clock, Session


@pytest.fixture
def session(scene):
    return Session(scene, Look(Magnification.of(20.0)), Clock(scene.duration, offset=0.1))


@pytest.fixture
def canvas(scene):
    camera = scene.cameras[0]
    from scipy.spatial.transform import Rotation

    wxyz = Rotation.from_matrix(camera.viewmat[:3, :3].T).as_quat(scalar_first=True)
    return Canvas(tuple(camera.position), tuple(wxyz), 2 * np.arctan(24 / camera.K[1, 1]), 65, 48)


def test_a_snapshot_is_the_picture_at_full_size(session, canvas, tmp_path):
    path = save_snapshot(session, canvas, 0.0, tmp_path / "new")
    shown = session.painter.paint(session.look, 0.1, canvas.camera((65, 48)))
    np.testing.assert_array_equal(np.asarray(Image.open(path)), shown)
    assert path.name == "snapshot_0001.png"
    assert save_snapshot(session, canvas, 0.0, tmp_path / "new").name == "snapshot_0002.png"


def test_a_clip_is_one_pass_at_the_speed_it_plays(session, canvas, tmp_path):
    session.set_clock(lambda c, now: c.changed(now, speed=0.5))
    told = []
    path = save_clip(session, canvas, tmp_path, told.append)
    reader = imageio_ffmpeg.read_frames(str(path))
    meta = next(reader)
    width, height = meta["size"]
    frames = [np.frombuffer(f, np.uint8).reshape(height, width, 3) for f in reader]
    assert (width, height) == (64, 48)
    assert meta["fps"] == pytest.approx(30)
    assert len(frames) == 24  # 12 timesteps at 30 Hz, half speed
    assert told[-1] == 1.0
    wanted = session.painter.paint(session.look, 10 * 0.5 / 30, canvas.camera((64, 48)))
    assert np.abs(frames[10].astype(int) - wanted).mean() < 6
    assert not list(tmp_path.glob(".*"))


def test_clips_end_after_their_longest():
    assert len(clip_moments(1000.0, 0.5)) == LONGEST * 30
    assert len(clip_moments(0.0, 1.0)) == 1


def test_names_go_on_after_the_highest(tmp_path):
    (tmp_path / "clip_0041.mp4").touch()
    (tmp_path / "clip_x.mp4").touch()
    assert next_name(tmp_path, "clip", ".mp4").name == "clip_0042.mp4"
