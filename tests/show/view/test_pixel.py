"""The waveform of a pixel, and snapshots and clips that hold what the page shows."""

import imageio_ffmpeg
import numpy as np
import pytest

from tests.show.view.conftest import DEVIATION
from tg4mm.core.magnification import Magnification
from tg4mm.fit.motion.animate import displacement_at
from tg4mm.show.view.pixel_panel import Measurer, modal_waveform, seen_at
from tg4mm.show.view.saving import save_clip
from tg4mm.show.view.screen import Viewport
from tg4mm.show.view.session import DisplaySettings, PlaybackClock, SceneRenderer, Session


def on_the_ball(scene):
    """[N] blending weights of the pixel that shows the middle of what moves at 5 Hz."""
    k, camera = scene.strongest(Magnification.of(1.0, (4.0, 6.0))), scene.cameras[0]
    moves = np.abs(scene.motion.displacement[k]).max(axis=1) > 5e-3
    centre = scene.gaussians.means.numpy()[moves].mean(axis=0)
    u, v, depth = camera.K @ (camera.viewmat[:3, :3] @ centre + camera.viewmat[:3, 3])
    return SceneRenderer(scene).pixel_weights(
        DisplaySettings(Magnification.of(0.0)), 0.0, camera, int(u / depth), int(v / depth)
    )


def test_of_two_gaussians_it_is_their_weighted_mean(scene):
    k = scene.strongest()
    order = np.argsort(-np.abs(scene.motion.displacement[k]).sum(axis=1))
    weights = np.zeros(len(scene.weights))
    weights[order[0]], weights[order[7]] = 0.6, 0.2
    found = modal_waveform(scene, weights)
    direction = np.array([float(v.replace("−", "-")) for v in found.along.strip("()").split(", ")])
    for i in (3, 40, 77):
        blended = weights @ displacement_at(scene.motion, found.times[i] * scene.motion.fps) / 0.8
        assert found.displacement[i] == pytest.approx(blended @ direction, abs=1e-4)
    assert np.abs(found.displacement).max() > 5e-3
    np.testing.assert_allclose(found.deviation, DEVIATION, rtol=1e-5)
    np.testing.assert_allclose(
        seen_at(scene, weights), weights @ scene.gaussians.means.numpy() / 0.8, rtol=1e-5
    )
    assert found.frequencies.tolist() == [2.5, 5.0]
    assert found.peak == (scene.motion.freqs_hz[k], found.amplitudes.max())
    assert np.abs(found.displacement).max() == pytest.approx(found.amplitudes.max(), rel=0.3)


def test_the_pictures_say_the_same(scene):
    weights = on_the_ball(scene)
    fitted = modal_waveform(scene, weights)
    measurer = Measurer(scene)
    point = seen_at(scene, weights)
    assert not measurer.is_ready
    measured = measurer.at(point)
    assert measurer.is_ready
    assert measured.peak[0] == pytest.approx(5.0, abs=0.3)
    assert measured.peak[1] == pytest.approx(fitted.peak[1], rel=0.3)
    assert measured.displacement.shape == measured.deviation.shape == (12,)
    assert measured.floor.shape == measured.amplitudes.shape == measured.frequencies.shape


@pytest.fixture
def session(scene):
    return Session(scene, DisplaySettings(Magnification.of(20.0)), PlaybackClock(scene.duration, offset=0.1))


@pytest.fixture
def canvas(scene):
    camera = scene.cameras[0]
    from scipy.spatial.transform import Rotation

    wxyz = Rotation.from_matrix(camera.viewmat[:3, :3].T).as_quat(scalar_first=True)
    return Viewport(tuple(camera.position), tuple(wxyz), 2 * np.arctan(24 / camera.K[1, 1]), 65, 48)


def test_a_clip_is_one_pass_at_the_speed_it_plays(session, canvas, tmp_path):
    session.set_clock(lambda c, now: c.changed(now, speed=0.5))
    shares = []
    path = save_clip(session, canvas, tmp_path, shares.append)
    reader = imageio_ffmpeg.read_frames(str(path))
    meta = next(reader)
    width, height = meta["size"]
    frames = [np.frombuffer(f, np.uint8).reshape(height, width, 3) for f in reader]
    assert (width, height) == (64, 48)
    assert meta["fps"] == pytest.approx(30)
    assert len(frames) == 24  # 12 timesteps at 30 Hz, half speed
    assert shares[-1] == 1.0
    wanted = session.painter.paint(session.look, 10 * 0.5 / 30, canvas.camera((64, 48)))
    assert np.abs(frames[10].astype(int) - wanted).mean() < 6
    assert not list(tmp_path.glob(".*"))
