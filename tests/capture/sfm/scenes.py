"""A textured box on a textured floor, ray-traced: pictures whose cameras and surfaces are known exactly."""

from functools import cache

import numpy as np
from PIL import Image
from scipy.ndimage import zoom

HALF = np.array([0.8, 0.6, 0.5])  # of the box, which stands on the floor
FLOOR = 2.2  # half the floor's side
CENTRE = np.array([0.0, 0.0, 0.3])


@cache
def texture(seed, cells=256):
    """[cells, cells, 3] in 0..1: noise at several scales, so that features are found from near and far."""
    rng = np.random.default_rng(seed)
    total = np.zeros((cells, cells, 3))
    for step in (8, 16, 32, 64):
        coarse = rng.random((cells // step, cells // step, 3)) ** 2
        total += zoom(coarse, (step, step, 1), order=3, mode="nearest") * step**0.3
    total -= total.min((0, 1))
    return total / total.max((0, 1))


def faces():
    """(axis, level, centre, half sides) of the floor and the box's six sides."""
    out = [(2, 0.0, np.zeros(3), np.full(3, FLOOR))]
    middle = np.array([0, 0, HALF[2]])
    for axis in range(3):
        for side in (-1, 1):
            out.append((axis, float(middle[axis] + side * HALF[axis]), middle, HALF))
    return out


def orbit(n, turn=2 * np.pi, low=0.45, high=0.9):
    """[n, 4, 4] world-to-camera, four units from the centre, at elevations between low and high radians."""
    viewmats = []
    for i in range(n):
        a = turn * i / n
        e = low + (high - low) * ((i * 0.618) % 1)
        back = np.array([np.cos(a) * np.cos(e), np.sin(a) * np.cos(e), np.sin(e)])
        right = np.cross([0, 0, 1.0], back)
        right /= np.linalg.norm(right)
        rotation = np.stack([right, -np.cross(back, right), -back])
        viewmat = np.eye(4)
        viewmat[:3, :3], viewmat[:3, 3] = rotation, -rotation @ (CENTRE + 4 * back)
        viewmats.append(viewmat)
    return np.stack(viewmats)


def intrinsics(width, height, focal):
    """K [3, 3] with the principal point in the middle."""
    return np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])


def picture(viewmat, K, size, k1=0.0, plain=False, floor=True):
    """[H, W, 4] uint8: what a camera with radial distortion k1 sees. plain: no texture. Nothing: transparent."""
    width, height = size
    u, v = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    bent = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1]], -1)
    straight = bent.copy()
    for _ in range(30):  # the lens bends x to x (1 + k1 |x|²)
        straight = bent / (1 + k1 * (straight**2).sum(-1, keepdims=True))
    directions = np.concatenate([straight, np.ones((height, width, 1))], -1) @ viewmat[:3, :3]
    origin = -viewmat[:3, :3].T @ viewmat[:3, 3]
    nearest = np.full((height, width), np.inf)
    colour, alpha = np.zeros((height, width, 3)), np.zeros((height, width))
    for k, (axis, level, centre, half) in enumerate(faces()):
        if k == 0 and not floor:
            continue
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (level - origin[axis]) / directions[..., axis]
            place = (origin + t[..., None] * directions - centre) / half
        a, b = [i for i in range(3) if i != axis]
        hit = (t > 0) & (t < nearest) & (np.abs(place[..., a]) <= 1) & (np.abs(place[..., b]) <= 1)
        nearest[hit] = t[hit]
        alpha[hit] = 1
        colour[hit] = (0.3, 0.5, 0.7) if plain else sample(texture(k), place[hit][:, [a, b]])
    return (np.concatenate([colour, alpha[..., None]], -1) * 255 + 0.5).astype(np.uint8)


def sample(image, place):
    """Bilinear texture at place [M, 2] in −1..1."""
    at = (place + 1) / 2 * (len(image) - 1)
    low = np.clip(np.floor(at).astype(int), 0, len(image) - 2)
    f = at - low
    i, j = low.T
    top = image[i, j] * (1 - f[:, 1:]) + image[i, j + 1] * f[:, 1:]
    bottom = image[i + 1, j] * (1 - f[:, 1:]) + image[i + 1, j + 1] * f[:, 1:]
    return top * (1 - f[:, :1]) + bottom * f[:, :1]


def surface_distance(xyz):
    """[M] distance of points to the nearest face."""
    best = np.full(len(xyz), np.inf)
    for axis, level, centre, half in faces():
        gap = np.maximum(np.abs(xyz - centre) - half, 0)
        gap[:, axis] = np.abs(xyz[:, axis] - level)
        best = np.minimum(best, np.linalg.norm(gap, axis=1))
    return best


def save(path, pixels, opaque=True):
    """Write a picture, over grey if opaque."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if opaque:
        alpha = pixels[..., 3:] / 255
        pixels = (pixels[..., :3] * alpha + 128 * (1 - alpha) + 0.5).astype(np.uint8)
    Image.fromarray(pixels).save(path)


def umeyama(source, target):
    """scale, rotation and translation of the similarity that brings source [M, 3] nearest to target [M, 3]."""
    ms, mt = source.mean(0), target.mean(0)
    u, d, vt = np.linalg.svd((target - mt).T @ (source - ms) / len(source))
    sign = np.diag([1, 1, np.sign(np.linalg.det(u) * np.linalg.det(vt))])
    rotation = u @ sign @ vt
    scale = float(np.trace(np.diag(d) @ sign) / ((source - ms) ** 2).sum(1).mean())
    return scale, rotation, mt - scale * rotation @ ms
