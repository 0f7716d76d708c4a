"""A Cycles picture of splats beside the core's rasteriser: same silhouette, same colours.

They differ a little where they must: the core widens every Gaussian by 0.3 square pixels and blends display-referred
values, Cycles blends linear light, so a mixture of two colours is lighter there.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from tg4mm.core.splatfile import SplatFile, positions_at, rotations_at, write_splat

bpy = pytest.importorskip("bpy", reason="needs pip's Blender: pip install '.[generate]'")
torch = pytest.importorskip("torch", reason="compares with the core's rasteriser: pip install '.[core]'")
pytest.importorskip("numba", reason="compares with the core's rasteriser: pip install '.[core]'")

from tests.addon.playing import add_camera, import_splat, render_cycles, setter  # noqa: E402

SIZE = 96
ALPHA, FRAME = 4.0, 4
DIVISIONS = 4  # the stripes of the ball


def striped_ball(n=1500):
    """A ball of two colours that sways and turns, its Gaussians flat on its surface and half see-through."""
    golden = math.pi * (3 - math.sqrt(5))
    i = np.arange(n)
    z = 1 - 2 * (i + 0.5) / n
    ring = np.sqrt(1 - z**2)
    normal = np.stack([ring * np.cos(golden * i), ring * np.sin(golden * i), z], axis=1)
    means = normal * [1.0, 0.8, 0.6]
    # The turn from z to the normal: half the angle about z × normal.
    quats = np.stack([1 + z, -normal[:, 1], normal[:, 0], np.zeros(n)], axis=1)
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    stripes = (np.floor(np.arctan2(normal[:, 1], normal[:, 0]) / math.pi * DIVISIONS) % 2)[:, None]
    rgb = stripes * [0.85, 0.35, 0.15] + (1 - stripes) * [0.2, 0.45, 0.75]
    sway = np.zeros((1, n, 3), np.complex64)
    sway[0, :, 2] = -0.06j * means[:, 0]
    turn = np.zeros_like(sway)
    turn[0, :, 1] = 0.06j
    return SplatFile(
        means=means.astype(np.float32),
        quats=quats.astype(np.float32),
        scales=np.tile(np.float32([0.06, 0.06, 0.01]), (n, 1)),
        opacities=np.full(n, 0.7, np.float32),
        sh=((rgb - 0.5) / 0.28209479177387814)[:, None].astype(np.float32),
        freqs_hz=np.array([3.0]),
        displacement=sway,
        rotation=turn,
        fps=24.0,
        n_timesteps=24,
    )


def rasterized(splat, camera):
    """[SIZE, SIZE, 4] straight RGBA of the core at the frame and α of the test."""
    from tg4mm.fit.rasterize import rasterization

    viewmat = np.diag([1.0, -1.0, -1.0, 1.0]) @ np.linalg.inv(np.array(camera.matrix_world))
    focal = SIZE / (2 * math.tan(camera.data.angle_x / 2))
    K = [[focal, 0, SIZE / 2], [0, focal, SIZE / 2], [0, 0, 1.0]]
    moved = positions_at(splat, FRAME - 1, ALPHA), rotations_at(splat, FRAME - 1, ALPHA)
    arrays = (*moved, splat.scales, splat.opacities, splat.sh)
    tensors = [torch.as_tensor(np.asarray(a), dtype=torch.float32) for a in arrays]
    views = torch.as_tensor(viewmat, dtype=torch.float32)[None]
    rgb, alpha, _ = rasterization(*tensors, views, torch.tensor([K]), SIZE, SIZE, sh_degree=0)
    return torch.cat([rgb / alpha.clamp_min(1e-6), alpha], -1)[0].clamp(0, 1).numpy()


def overlap(a, b):
    """Intersection over union of two silhouettes, alpha above one half."""
    a, b = a[..., 3] > 0.5, b[..., 3] > 0.5
    return (a & b).sum() / (a | b).sum()


@pytest.mark.parametrize(("draw", "iou", "difference"), [("Splats", 0.96, 0.05), ("Ellipsoids", 0.93, 0.05)])
def test_picture_agrees_with_the_core(extension, tmp_path, draw, iou, difference):
    splat = striped_ball()
    write_splat(tmp_path / "ball.ply", splat)
    obj = import_splat(tmp_path / "ball.ply")
    put, names = setter(extension, obj), extension.names
    put(names.DRAW, draw)
    put(names.ALPHA, ALPHA)
    put(names.SPEED, 1.0)  # an import plays in slow motion
    put(names.MIN_OPACITY, 0.0)
    camera = add_camera((2.6, -2.2, 1.4), (SIZE, SIZE))
    bpy.ops.tg4mm.true_colours()
    bpy.context.scene.frame_set(FRAME)
    render_cycles(tmp_path / "ball.png", samples=12, clear=True)
    picture = np.asarray(Image.open(tmp_path / "ball.png"), dtype=float) / 255
    truth = rasterized(splat, camera)
    assert overlap(picture, truth) > iou
    inside = (picture[..., 3] > 0.95) & (truth[..., 3] > 0.95)
    assert inside.sum() > 0.15 * SIZE**2
    off = np.abs(picture - truth)[..., :3][inside].mean()
    assert off < difference
    # The comparison can fail: the same at rest, and the same in other colours.
    frozen = replace(splat, displacement=0 * splat.displacement, rotation=0 * splat.rotation)
    still = rasterized(frozen, camera)
    assert overlap(picture, still) < overlap(picture, truth) - 0.01
    assert np.abs(picture[..., ::-1][..., 1:] - truth[..., :3])[inside].mean() > 3 * difference
    print(f"{draw}: IoU {overlap(picture, truth):.3f} (still {overlap(picture, still):.3f}), off {off:.3f}")
