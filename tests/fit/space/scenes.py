"""Cameras on a sphere and analytic silhouettes: what the space stage's tests know exactly."""

from pathlib import Path

import numpy as np

from tg4mm.capture import Capture, ImageStack
from tg4mm.fit.space import RestViews


def orbit(n, centre, radius=4.0):
    """n world-to-camera matrices [n, 4, 4] that look at `centre` from all round (a Fibonacci sphere)."""
    k = np.arange(n) + 0.5
    z = 1 - 2 * k / n
    azimuth = np.pi * (1 + 5**0.5) * k
    out = np.stack([np.cos(azimuth) * np.sqrt(1 - z * z), np.sin(azimuth) * np.sqrt(1 - z * z), z], 1)
    forward = -out
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    viewmats = np.tile(np.eye(4), (n, 1, 1))
    viewmats[:, :3, :3] = np.stack([right, np.cross(forward, right), forward], 1)
    viewmats[:, :3, 3] = -np.einsum("nij,nj->ni", viewmats[:, :3, :3], centre + radius * out)
    return viewmats


def intrinsics(size, angle=0.7):
    """K [3, 3] of a square image with the given field of view in radians."""
    focal = size / (2 * np.tan(angle / 2))
    return np.array([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1]])


def rays(viewmat, K, size):
    """Origin [3] and unit directions [size, size, 3] through the pixel centres, in the world."""
    x, y = np.meshgrid(np.arange(size) + 0.5, np.arange(size) + 0.5)
    cam = np.stack([(x - K[0, 2]) / K[0, 0], (y - K[1, 2]) / K[1, 1], np.ones_like(x)], -1)
    directions = cam @ viewmat[:3, :3]
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    return -viewmat[:3, :3].T @ viewmat[:3, 3], directions


def capsule_mask(viewmat, K, size, ends, radius):
    """[size, size] bool: the ray comes within `radius` of the segment between `ends` [2, 3] (equal: a ball)."""
    origin, d = rays(viewmat, K, size)
    along, start = ends[1] - ends[0], ends[0] - origin
    b, e = d @ along, d @ start
    share = np.clip((b * e - along @ start) / np.maximum(along @ along - b * b, 1e-12), 0, 1)
    to = start + share[..., None] * along
    return np.linalg.norm(to - (to * d).sum(-1, keepdims=True) * d, axis=-1) < radius


def views_of(viewmats, K, alpha, rgb=None):
    """RestViews of masks alpha [V, H, W]; white pictures unless rgb [V, H, W, 3] is given."""
    rgb = np.ones((*alpha.shape, 3)) if rgb is None else rgb
    return RestViews(
        viewmats.astype(np.float32),
        np.repeat(K[None], len(viewmats), 0).astype(np.float32),
        rgb.astype(np.float32),
        alpha.astype(np.float32),
        tuple(np.array([v]) for v in range(len(viewmats))),
    )


def capture_of(camera_ids, timesteps, data):
    """A capture whose image i is data[i] ([C, H, W, 4]), each camera with a pose of its own."""
    ids, c = np.asarray(camera_ids), len(camera_ids)
    viewmats = np.tile(np.eye(4), (c, 1, 1))
    viewmats[:, 0, 3] = ids
    Ks = np.tile(np.diag([10.0, 11.0, 1.0]), (c, 1, 1))
    paths = tuple(Path(f"/data/{i}.png") for i in range(c))
    height, width = data.shape[1:3]
    times = np.asarray(timesteps)
    capture = Capture(
        Path("/data"), "train", width, height, 30.0, int(times.max()) + 1, viewmats, Ks, times, ids, paths
    )
    return capture, ImageStack(data)
