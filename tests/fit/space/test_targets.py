"""The mean picture of each camera, and that the fit does not depend on the unit and the origin of a scene."""

import json
import re
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from plyfile import PlyData, PlyElement

from tests.fit.space.scenes import capture_of
from tests.helpers.synthetic import make_synthetic_dataset
from tg4mm import SpaceConfig, fit_space, load_capture
from tg4mm.capture.pictures import FilePictures, pictures_for
from tg4mm.core.pictures.decode import decode
from tg4mm.core.progress import PlainProgress
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.jacobian.view import view_jacobian
from tg4mm.fit.motion.observations import observe
from tg4mm.fit.space import rest_views
from tg4mm.fit.space.view import near_plane, without_near
from tg4mm.show.render.image import render_image

SHORT = SpaceConfig(iterations=120, max_gaussians=900)


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


def moved(data, scale, offset):
    """The dataset in another unit, elsewhere; its points in double precision."""
    for file in data.rglob("transforms_*.json"):
        content = json.loads(file.read_text())
        for frame in content["frames"]:
            pose = np.array(frame["transform_matrix"])
            pose[:3, 3] = pose[:3, 3] * scale + offset
            frame["transform_matrix"] = pose.tolist()
        file.write_text(json.dumps(content))
    old = PlyData.read(data / "points3d.ply")["vertex"].data
    rows = np.zeros(len(old), [(n, "f8" if n in "xyz" else "u1") for n in old.dtype.names])
    for name in old.dtype.names:
        rows[name] = old[name]
    for k, name in enumerate("xyz"):
        rows[name] = rows[name] * scale + offset[k]
    PlyData([PlyElement.describe(rows, "vertex")]).write(data / "points3d.ply")
    return data


def fitted(folder, scale, offset):
    make_synthetic_dataset(folder, n_views=5, n_timesteps=8, size=40, alphas=())
    capture = load_capture(moved(folder, scale, offset * np.array([1.0, -1.0, 0.7])))
    return capture, fit_space(capture, SHORT)


def picture(capture, gaussians):
    return render_image(gaussians, capture.viewmats[0], capture.Ks[0], capture.width, capture.height)


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    return fitted(tmp_path_factory.mktemp("plain") / "data", 1.0, 0.0)


@pytest.mark.parametrize(("scale", "offset"), [(1e-4, 0.0), (1e4, 0.0), (1.0, 1e6)])
def test_a_scene_in_another_unit_and_place_is_fitted_and_drawn_alike(plain, tmp_path, scale, offset):
    capture, gaussians = fitted(tmp_path / "data", scale, offset)
    there, here = picture(capture, gaussians), picture(*plain)
    mse = [float(((p - plain_rgb(plain[0])) ** 2).mean()) for p in (there, here)]
    assert abs(10 * np.log10(mse[0] / mse[1])) < 1e-3
    test = load_capture(capture.root, "test")
    np.testing.assert_array_equal(test.origin, capture.origin)
    assert (capture.origin != 0).any() == (offset != 0)


def plain_rgb(capture):
    return pictures_for(capture).rgb(0)


@pytest.mark.parametrize("scale", [1e-4, 1e4])
def test_the_motion_stages_view_has_all_gaussians_in_any_unit(plain, scale):
    capture, gaussians = plain
    frames = observe(capture, pictures_for(capture)).frames[0]
    larger = Gaussians(
        gaussians.means * scale, gaussians.quats, gaussians.scales * scale, gaussians.opacities, gaussians.sh
    )
    viewmat = frames.viewmat.copy()
    viewmat[:3, 3] *= scale
    far = type(frames)(frames.name, viewmat, frames.K, frames.rows, frames.times_s, frames.readout_s)
    size = capture.width, capture.height
    image = view_jacobian(gaussians, frames, size).image
    np.testing.assert_allclose(view_jacobian(larger, far, size).image, image, atol=1e-4)
    assert torch.isfinite(larger.means).all()


def test_on_a_device_what_is_nearer_than_the_near_plane_goes_behind_the_camera():
    generator = torch.Generator().manual_seed(0)
    viewmat = torch.eye(4)
    viewmat[:3, 3] = torch.tensor([0.1, -0.2, 0.3])
    means = torch.randn(501, 3, generator=generator) * torch.tensor([1.0, 1.0, 3.0])
    means[:20, 2] = -0.3 + 0.01 * torch.rand(20, generator=generator)  # right before the camera
    depth = means[:, 2] + 0.3
    near = near_plane(means, viewmat)
    moved = without_near(means, viewmat)
    hidden = (depth > 0) & (depth <= near)
    assert 1 <= hidden.sum() <= 20
    torch.testing.assert_close(moved[~hidden], means[~hidden], rtol=0, atol=0)
    assert (moved[hidden, 2] + 0.3 <= 0).all()
