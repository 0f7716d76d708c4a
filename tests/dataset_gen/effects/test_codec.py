"""H.264 and back: the same bytes every time, the same colours, artefacts that grow with the rate factor."""

import numpy as np
import pytest

av = pytest.importorskip("av")

from dataset_gen.effects.codec import decode, encode  # noqa: E402

SIZE = 64


@pytest.fixture(scope="module")
def pictures():
    y, x = np.mgrid[0:SIZE, 0:SIZE] / SIZE
    noise = np.random.default_rng(0).normal(0, 0.03, (SIZE, SIZE, 3))
    found = []
    for t in range(12):
        waves = [np.sin(9 * x + 0.3 * t), np.cos(7 * y), np.sin(5 * x + 4 * y)]
        found.append(np.clip((0.5 + 0.3 * np.stack(waves, -1) + noise) * 255, 0, 255).astype(np.uint8))
    return found


def through(pictures, folder, crf, fps=30.0):
    path = folder / "a.mp4"
    path.write_bytes(encode(pictures, SIZE, fps, crf))
    return list(decode(path))


def rms(a, b):
    return float(np.sqrt(np.mean((np.asarray(a, float) - np.asarray(b, float)) ** 2)))


def test_colours_are_kept(tmp_path):
    y, x = np.mgrid[0:SIZE, 0:SIZE] / SIZE
    smooth = np.stack([x, y, 0.5 + 0.3 * np.sin(5 * x + 4 * y)], -1)
    picture = (255 * (0.1 + 0.8 * smooth)).astype(np.uint8)
    back = through([picture] * 2, tmp_path, 1)[0].astype(float)
    assert np.abs((back - picture).mean((0, 1))).max() < 0.5
    assert rms(back[2:-2, 2:-2], picture[2:-2, 2:-2]) < 1.5


def test_the_same_pictures_give_the_same_bytes(pictures):
    assert encode(pictures, SIZE, 30.0, 20) == encode(iter(pictures), SIZE, 30.0, 20)


@pytest.mark.parametrize(
    ("fps", "rate"), [(30.0, "30"), (29.97002997, "30000/1001"), (240.0, "240"), (12.5, "25/2")]
)
def test_the_container_tells_the_frame_rate_and_the_matrix(pictures, tmp_path, fps, rate):
    path = tmp_path / "a.mp4"
    path.write_bytes(encode(pictures, SIZE, fps, 20))
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        found = str(stream.average_rate).removesuffix("/1")  # av on 3.13 writes 30/1
        assert (found, stream.frames, stream.codec_context.name) == (rate, 12, "h264")
        assert stream.codec_context.pix_fmt == "yuv420p"
        times = [float(frame.pts * frame.time_base) for frame in container.decode(video=0)]
    np.testing.assert_allclose(times, np.arange(12) / fps, atol=1e-4)
