"""Exposure, flicker and shake of a recording, and H.264: the same bytes every time, the same colours."""

import numpy as np
import pytest

from dataset_gen.cameras import CameraSetup, cameras_at, train_cameras
from dataset_gen.effects import record
from dataset_gen.effects.record import drift_gains, flicker_gains, slow_curve, turned, turns
from dataset_gen.pictures import over_white, to_display
from dataset_gen.settings import Quality

av = pytest.importorskip("av")

from dataset_gen.effects.codec import decode, encode  # noqa: E402

CAMERA = cameras_at(CameraSetup("rig", views=5), 0)["train"][3]
SIZE = 128
CODED = 64


def rng(seed=0):
    return np.random.default_rng(seed)


@pytest.mark.parametrize("seed", range(5))
def test_exposure_drifts_by_the_stated_percent_peak_to_peak(seed):
    gains = drift_gains(5.0, 90, 30.0, rng(seed))
    assert gains.shape == (90, 3)
    assert np.ptp(gains[:, 1]) == pytest.approx(0.05)
    assert gains.max() <= 1.0
    assert gains[:, 1].max() == pytest.approx(1.0)


@pytest.mark.parametrize(("n", "fps"), [(30, 30.0), (300, 30.0), (1000, 240.0)])
def test_the_drift_is_slow(n, fps):
    curve = np.array([slow_curve(n, fps, rng(seed)) for seed in range(8)])
    assert curve.min() == 0.0
    assert curve.max() == pytest.approx(1.0)
    # Of a sum of tones up to F the slope is 2π F times the size at most; sizes add up to three at most.
    fastest = min(1.5 * fps / n, 1.0)
    assert np.abs(np.diff(curve, axis=1)).max() * fps < 2 * np.pi * fastest * 1.5
    spectrum = np.abs(np.fft.rfft(curve - curve.mean(1, keepdims=True), axis=1)) ** 2
    f = np.fft.rfftfreq(n, 1 / fps)
    if n == 300:
        assert spectrum[:, f > 2.0].sum() < 0.02 * spectrum.sum()


def test_flicker_is_mains_light_sampled_by_the_frame_rate():
    times = np.arange(120) / 30.0
    gains = flicker_gains(2.0, 100.0, times, 0.4)
    assert gains.max() <= 1.0
    assert gains.min() >= 0.98
    spectrum = np.abs(np.fft.rfft(gains - gains.mean()))
    assert np.fft.rfftfreq(120, 1 / 30.0)[spectrum.argmax()] == pytest.approx(10.0)  # 100 Hz aliased at 30
    np.testing.assert_allclose(
        flicker_gains(2.0, 100.0, np.arange(120) / 25.0, 0.4), gains[0]
    )  # 100 = 4 · 25


@pytest.mark.parametrize("fps", [30.0, 240.0])
def test_shake_is_tremor_between_1_and_10_hz(fps):
    n = int(40 * fps)
    vectors = turns(CAMERA, SIZE, 1.0, n, fps, 7)
    power = (np.abs(np.fft.rfft(vectors * np.hanning(n)[:, None], axis=0)) ** 2).sum(1)
    f = np.fft.rfftfreq(n, 1 / fps)
    assert power[(f > 0.9) & (f < 10.1)].sum() > 0.99 * power.sum()
    assert power[(f > 1) & (f < 3)].sum() > 3 * power[(f > 7) & (f < 9)].sum()
    assert power[(f > 5) & (f < 9)].sum() > 0.003 * power.sum()


def test_a_warped_rendering_is_what_the_turned_camera_sees():
    pytest.importorskip("bpy")
    from dataset_gen import build, render
    from dataset_gen.scenes import SCENES

    size, margin, camera = 40, 5, train_cameras(30)[5]
    vector = np.array([0.5, -0.37, 0.3]) / camera.focal(size)
    stage = build.build(SCENES["mic"]())
    quality = Quality(size, size, samples=256, seed=0, threads=1)
    render.configure(stage, quality)

    def take(view, quality, seed=0):
        build.set_view(stage, view)
        render.use_picture(stage, quality, seed)
        return render.linear_picture(stage)

    def grey(linear):
        return 255.0 * to_display(over_white(linear))

    direct, again = (grey(take(turned(camera, vector), quality, seed)) for seed in (0, 1))
    fine = take(record.fine_camera(camera, size, margin), quality.finer(record.fine_size(size, margin), 2))
    object_ = direct.min(-1) < 250

    def rms(difference):
        return float(np.sqrt((difference[object_] ** 2).mean()))

    noise = rms(direct - again)
    assert rms(grey(record.frame(fine, camera, size, margin, vector)) - direct) < 1.3 * noise
    assert rms(grey(record.frame(fine, camera, size, margin, 0 * vector)) - direct) > 8 * noise
    assert rms(grey(record.frame(fine, camera, size, margin, -vector)) - direct) > 12 * noise


@pytest.fixture(scope="module")
def pictures():
    y, x = np.mgrid[0:CODED, 0:CODED] / CODED
    noise = np.random.default_rng(0).normal(0, 0.03, (CODED, CODED, 3))
    found = []
    for t in range(12):
        waves = [np.sin(9 * x + 0.3 * t), np.cos(7 * y), np.sin(5 * x + 4 * y)]
        found.append(np.clip((0.5 + 0.3 * np.stack(waves, -1) + noise) * 255, 0, 255).astype(np.uint8))
    return found


def through(pictures, folder, crf, fps=30.0):
    path = folder / "a.mp4"
    path.write_bytes(encode(pictures, CODED, fps, crf))
    return list(decode(path))


def rms(a, b):
    return float(np.sqrt(np.mean((np.asarray(a, float) - np.asarray(b, float)) ** 2)))


def test_colours_are_kept(tmp_path):
    y, x = np.mgrid[0:CODED, 0:CODED] / CODED
    smooth = np.stack([x, y, 0.5 + 0.3 * np.sin(5 * x + 4 * y)], -1)
    picture = (255 * (0.1 + 0.8 * smooth)).astype(np.uint8)
    back = through([picture] * 2, tmp_path, 1)[0].astype(float)
    assert np.abs((back - picture).mean((0, 1))).max() < 0.5
    assert rms(back[2:-2, 2:-2], picture[2:-2, 2:-2]) < 1.5


def test_the_same_pictures_give_the_same_bytes(pictures):
    assert encode(pictures, CODED, 30.0, 20) == encode(iter(pictures), CODED, 30.0, 20)


@pytest.mark.parametrize(
    ("fps", "rate"), [(30.0, "30"), (29.97002997, "30000/1001"), (240.0, "240"), (12.5, "25/2")]
)
def test_the_container_tells_the_frame_rate_and_the_matrix(pictures, tmp_path, fps, rate):
    path = tmp_path / "a.mp4"
    path.write_bytes(encode(pictures, CODED, fps, 20))
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        found = str(stream.average_rate).removesuffix("/1")  # av on 3.13 writes 30/1
        assert (found, stream.frames, stream.codec_context.name) == (rate, 12, "h264")
        assert stream.codec_context.pix_fmt == "yuv420p"
        times = [float(frame.pts * frame.time_base) for frame in container.decode(video=0)]
    np.testing.assert_allclose(times, np.arange(12) / fps, atol=1e-4)
