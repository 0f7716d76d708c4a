"""The space stage of one fixed camera: a quadtree of discs on a plane whose colours are a least-squares solution."""

from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from tg4mm.core.errors import CaptureError, Tg4mmError
from tg4mm.fit.rasterize import rasterization
from tg4mm.fit.space import RestViews, SpaceConfig
from tg4mm.fit.space.plane import FINEST, RIDGE, plane_gaussians, plane_psnr, quadtree, solve_colours
from tg4mm.run import Run
from tg4mm.run.stages import train_plane
from tg4mm.show.render.image import render_image

# at the origin of a world whose z is up, looking along +y
VIEWMAT = np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]], np.float32)
BABY = Path(__file__).resolve().parents[4] / "shared" / "data" / "evm" / "baby.mp4"


def camera(width, height):
    f = max(width, height)
    return np.array([[f, 0, width / 2], [0, f, height / 2], [0, 0, 1]], np.float32)


def textured(width, height):
    """Stripes and an edge at the left, a slow ramp at the right."""
    v, u = np.mgrid[:height, :width] + 0.5
    left = 0.5 + 0.3 * np.sin(u / 2.5) * np.cos(v / 3) + 0.15 * (v > height / 3)
    grey = np.where(u < width / 2, left, 0.3 + 0.2 * v / height)
    return np.stack([grey, 0.8 * grey, 1 - grey], -1).astype(np.float32)


def views_of(picture, count=1):
    height, width = picture.shape[:2]
    K = np.stack([camera(width, height)] * count)
    rgb, alpha = np.stack([picture] * count), np.ones((count, height, width), np.float32)
    rows = tuple(np.array([i]) for i in range(count))
    return RestViews(np.stack([VIEWMAT] * count), K, rgb, alpha, rows)


def fitted(picture, budget, iterations=14):
    K = camera(picture.shape[1], picture.shape[0])
    return solve_colours(plane_gaussians(picture, K, VIEWMAT, budget), picture, VIEWMAT, K, iterations)


# The quadtree.


def test_detail_gets_the_small_cells_and_the_budget_holds():
    picture = textured(128, 96)
    cells = quadtree(picture, 700)
    assert 600 < len(cells.sides) <= 700
    small = cells.sides == FINEST
    assert (cells.centres[small, 0] < 66).mean() > 0.95


# The discs.


def test_discs_lie_at_distance_one_and_face_the_camera_wherever_it_is():
    picture = textured(96, 64)
    K, viewmat = camera(96, 64), np.eye(4)
    viewmat[:3, :3] = Rotation.from_rotvec([0.3, -0.8, 1.9]).as_matrix()
    viewmat[:3, 3] = [0.4, -2, 7]
    gaussians = plane_gaussians(picture, K, viewmat, 400)
    in_camera = gaussians.means.numpy() @ viewmat[:3, :3].T + viewmat[:3, 3]
    assert np.abs(in_camera[:, 2] - 1).max() < 4e-3
    assert len(gaussians) <= 400
    image = render_image(gaussians, viewmat, K, 96, 64)
    at_home = plane_gaussians(picture, K, VIEWMAT, 400)
    assert np.abs(image - render_image(at_home, VIEWMAT, K, 96, 64)).max() < 2e-3
    normals = Rotation.from_quat(np.roll(gaussians.quats.numpy(), -1, 1)).as_matrix()[:, :, 2]
    assert np.allclose(normals, viewmat[2, :3], atol=1e-5)
    assert (gaussians.scales[:, 2] < 0.02 * gaussians.scales[:, 0]).all()


# The colours.


def test_colours_are_the_minimum_of_the_quadratic():
    """Against the normal equations, A made column by column."""
    picture = 0.25 + 0.5 * textured(24, 16)
    K = camera(24, 16)
    start = plane_gaussians(picture, K, VIEWMAT, 60)
    n = len(start)
    args = (start.means, start.quats, start.scales, start.opacities)
    pose = (torch.from_numpy(VIEWMAT)[None], torch.from_numpy(K)[None], 24, 16)
    columns = [rasterization(*args, torch.eye(n)[:, i : i + 1], *pose) for i in range(n)]
    A = torch.stack([c[0][0, ..., 0].flatten() for c in columns], 1).double().numpy()
    behind = (1 - columns[0][1][0, ..., 0]).double().numpy().ravel()
    x0 = (0.5 + start.sh[:, 0] * 0.28209479177387814).double().numpy()
    D = np.diag(A.sum(0))
    right = A.T @ (picture.reshape(-1, 3) - behind[:, None]) + RIDGE * D @ x0
    exact = np.linalg.solve(A.T @ A + RIDGE * D, right)
    assert exact.min() > 0  # or the clamp would have a say
    found = solve_colours(start, picture, VIEWMAT, K, 150)
    assert np.allclose(0.5 + found.sh[:, 0].numpy() * 0.28209479177387814, exact, atol=2e-3)


def test_the_picture_is_met_and_colours_are_none_below_black():
    picture = textured(160, 120) * np.linspace(0, 1, 160, dtype=np.float32)[:, None]
    K = camera(160, 120)
    means = plane_gaussians(picture, K, VIEWMAT, 6000)
    solved = fitted(picture, 6000)
    assert plane_psnr(solved, picture, VIEWMAT, K) > plane_psnr(means, picture, VIEWMAT, K) + 8
    assert plane_psnr(solved, picture, VIEWMAT, K) > 38
    assert float(0.5 + solved.sh.min() * 0.28209479177387814) >= -1e-6


# The stage.


def test_the_run_holds_the_plane_and_its_figures(tmp_path):
    picture = textured(96, 64)
    run = Run.create(tmp_path / "run", tmp_path, "modal", {})
    gaussians = train_plane(run, views_of(picture), SpaceConfig())
    saved, log = run.load_space(), run.log()["space"]
    assert torch.equal(saved.sh, gaussians.sh)
    assert saved.sh_degree == 0
    assert log["n_gaussians"] == len(gaussians) <= 96 * 64 // 9
    assert log["init"] == "plane"
    shown = render_image(saved, VIEWMAT, camera(96, 64), 96, 64)
    assert log["psnr_train"] == pytest.approx(-10 * np.log10(((shown - picture) ** 2).mean()), abs=0.01)
    assert log["seconds"] > 0
    other = Run.create(tmp_path / "again", tmp_path, "modal", {})
    again = train_plane(other, views_of(picture), SpaceConfig())
    assert torch.equal(again.sh, gaussians.sh)
    few = SpaceConfig(max_gaussians=50)
    assert len(train_plane(Run.create(tmp_path / "few", tmp_path, "modal", {}), views_of(picture), few)) <= 50


def test_what_is_not_flat_is_refused(tmp_path):
    run = Run.create(tmp_path / "run", tmp_path, "modal", {})
    with pytest.raises(CaptureError, match="this one has 2"):
        train_plane(run, views_of(textured(48, 32), 2), SpaceConfig())
    with pytest.raises(Tg4mmError, match="max_gaussians is 5, expected >= 16"):
        train_plane(run, views_of(textured(48, 32)), SpaceConfig(max_gaussians=5))
    assert not run.has_space


@pytest.mark.slow
@pytest.mark.skipif(not BABY.is_file(), reason="the video is not here")
def test_a_real_videos_mean_picture_is_met_above_32_db():
    import imageio_ffmpeg

    frames = imageio_ffmpeg.read_frames(str(BABY))
    width, height = next(frames)["size"]
    pictures = [
        np.frombuffer(f, np.uint8).reshape(height, width, 3) for f, _ in zip(frames, range(60), strict=False)
    ]
    mean = (np.mean(pictures, 0) / 255).astype(np.float32)
    assert plane_psnr(fitted(mean, width * height // 9), mean, VIEWMAT, camera(width, height)) > 32
