"""What the static Gaussians are fitted to: one mean picture per camera."""

import re
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

from tests.fit.space.scenes import capture_of
from tg4mm.capture.pictures import FilePictures
from tg4mm.core.pictures.decode import decode
from tg4mm.core.progress import PlainProgress
from tg4mm.fit.space import rest_views


def pictures(n, seed=0):
    return np.random.default_rng(seed).integers(0, 256, (n, 3, 5, 4)).astype(np.uint8)


def over_white(data):
    d = data.astype(np.float64) / 255
    return d[..., :3] * d[..., 3:] + 1 - d[..., 3:]


def test_a_fixed_camera_gives_its_mean_over_time():
    """Cameras 0 and 1 take turns; the pictures of each are composited over white, then averaged."""
    data = pictures(6)
    capture, images = capture_of([0, 1, 0, 1, 0, 1], [0, 0, 1, 1, 2, 2], data)
    views = rest_views(capture, images)
    assert views.size == (5, 3)
    for v in (0, 1):
        np.testing.assert_allclose(views.rgb[v], over_white(data[v::2]).mean(0), atol=1e-6)
        np.testing.assert_allclose(views.alpha[v], data[v::2, ..., 3].mean(0) / 255, atol=1e-6)
        np.testing.assert_array_equal(views.images[v], [v, v + 2, v + 4])
    # the mean of composites, not the composite of means: they differ where alpha changes
    mean = data.mean(0) / 255
    assert np.abs(views.rgb[0] - (mean[..., :3] * mean[..., 3:] + 1 - mean[..., 3:])).max() > 0.01


def test_each_picture_is_decoded_once_and_shown(tmp_path, monkeypatch, capsys):
    """Pictures stay on disk; what takes long says how far it is and how long it will take."""
    data = pictures(6)
    capture, images = capture_of([0, 1, 0, 1, 0, 1], [0, 0, 1, 1, 2, 2], data)
    paths = tuple(tmp_path / f"{i}.png" for i in range(6))
    for path, picture in zip(paths, data, strict=True):
        Image.fromarray(picture).save(path)
    seen = list[Path]()

    def slow(path):
        seen.append(path)
        time.sleep(0.05)
        return decode(path)

    monkeypatch.setattr("tg4mm.capture.frames.decode", slow)
    monkeypatch.setattr(PlainProgress, "first_s", 0.01)
    views = rest_views(capture, FilePictures(replace(capture, paths=paths)))
    assert sorted(seen) == sorted(paths)
    assert re.search(r"mean pictures: \d/6 pictures, 0:00 elapsed, 0:00 left", capsys.readouterr().err)
    np.testing.assert_array_equal(views.rgb, rest_views(capture, images).rgb)
