"""Motion as pictures: maps of the model seen from a camera, space-time slices, difference maps, mean spectra.

Maps need projections into the camera and the Gaussians' blending weights, which are here as well.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch

from tg4mm.capture import Capture
from tg4mm.core.errors import RunError
from tg4mm.core.magnification import AS_CAPTURED, Magnification
from tg4mm.core.phasors import peak_displacement, scale_top
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.fit.rasterize import rasterization
from tg4mm.fit.space.view import drawn_from
from tg4mm.show.render.cameras import Camera
from tg4mm.show.render.image import render_features

_SHARE = 0.5  # of the strongest mode's rms: weaker modes do not lead
Axis = Literal["row", "column"]


def evenly(n: int, most: int) -> np.ndarray:
    """Return at most `most` indices, spread evenly over 0 … n − 1."""
    return np.unique(np.linspace(0, n - 1, min(most, n)).round().astype(int))


def blending_weights(gaussians: Gaussians, capture: Capture) -> np.ndarray:
    """Return each Gaussian's blending weight at rest: Σ over images and pixels of α·T ([3DGS] Eq. (3)), [N] float64.

    In pixels. It is the gradient of the summed rendering with respect to the Gaussian's colour, which the rasteriser
    gives exactly. A camera that took several images is rendered once and counts that many times.
    """
    total = np.zeros(len(gaussians))
    _, first, counts = np.unique(capture.camera_ids, return_index=True, return_counts=True)
    ones = np.ones((capture.height, capture.width, 1), np.float32)
    for i, count in zip(first, counts, strict=True):
        total += count * pixel_sums(gaussians, ones, capture.viewmats[i], capture.Ks[i])[:, 0]
    return total


def pixel_sums(gaussians: Gaussians, maps: np.ndarray, viewmat: np.ndarray, K: np.ndarray) -> np.ndarray:
    """Return Σ over pixels of blending weight times maps [H, W, C], [N, C] float64; viewmat [4, 4], K [3, 3]."""
    g, device = gaussians.detach(), gaussians.means.device
    height, width, channels = maps.shape
    colors = torch.ones(len(g), channels, device=device, requires_grad=True)
    view, k = (torch.as_tensor(m, dtype=torch.float32, device=device)[None] for m in (viewmat, K))
    means, near = drawn_from(g.means, view[0])
    image, _, _ = rasterization(means, g.quats, g.scales, g.opacities, colors, view, k, width, height, near)
    target = torch.as_tensor(maps, dtype=torch.float32, device=device)
    (gradient,) = torch.autograd.grad((image[0] * target).sum(), colors)
    return np.asarray(gradient.double().cpu().numpy())


@dataclass(frozen=True)
class MotionMaps:
    """One frequency of the motion as seen by a camera, at the surface under each pixel."""

    amplitude: np.ndarray  # [H, W] peak displacement, scene units
    phase: np.ndarray  # [H, W] radians, of the motion along the main direction, at timestep 0
    opacity: np.ndarray  # [H, W] in 0..1


def leading_modes(
    motion: ModalMotion, weights: np.ndarray, magnified: Magnification = AS_CAPTURED, most: int = 2
) -> list[int]:
    """Return indices of the in-band frequencies with most weighted motion, strongest first.

    At most `most`, each with an rms of at least half the strongest one's. Frequencies with less than a cycle in the
    capture (drift, 0 Hz) count only if there are no others in the band.
    """
    rms = np.sqrt(motion.powers(weights))
    inside = magnified.inside(motion.freqs_hz)
    cyclic = inside & (motion.freqs_hz * motion.n_timesteps > (1 - 1e-9) * motion.fps)
    rms = np.where(cyclic if cyclic.any() else inside, rms, -1.0)
    order = np.argsort(-rms, kind="stable")[:most]
    return [int(k) for k in order if rms[k] >= 0 and rms[k] >= _SHARE * rms[order[0]]]


def strongest(motion: ModalMotion, weights: np.ndarray, magnified: Magnification) -> int:
    """Return the index of the in-band frequency with most weighted motion. Raises RunError for a band without any."""
    leading = leading_modes(motion, weights, magnified, most=1)
    if not leading:
        known = ", ".join(f"{f:g}" for f in motion.freqs_hz) or "none"
        named = " and ".join(f"({low:g}, {high:g})" for low, high in magnified.limits)
        raise RunError(f"band {named} Hz holds none of the model's frequencies ({known} Hz)")
    return leading[0]


def motion_maps(
    gaussians: Gaussians, motion: ModalMotion, k: int, direction: np.ndarray, camera: Camera
) -> MotionMaps:
    """Render amplitude and phase of frequency `k` from `camera`, blended over Gaussians as colours are."""
    phasors = motion.displacement_of(k)
    features = np.concatenate([phasors.real, phasors.imag], axis=1).astype(np.float32)
    blended, opacity = render_features(gaussians, features, camera)
    seen = blended[..., :3] + 1j * blended[..., 3:]
    return MotionMaps(peak_displacement(seen), np.angle(seen @ direction), opacity)


def uncertainty_map(gaussians: Gaussians, deviation: np.ndarray, camera: Camera) -> np.ndarray:
    """Render the peak of a sinusoid whose rms is the standard deviation [N]: [H, W] scene units, blended as colours."""
    blended, _ = render_features(gaussians, np.sqrt(2) * deviation[:, None].astype(np.float32), camera)
    return blended[..., 0]


def image_motion(
    gaussians: Gaussians, motion: ModalMotion, weights: np.ndarray, camera: Camera
) -> np.ndarray:
    """Return each mode's weighted rms [K], pixels, across the picture of `camera`, of Gaussians in view."""
    size = camera.width, camera.height
    rows, inside = pixel_rows(gaussians.means.cpu().numpy(), camera.viewmat, camera.K, size)
    used = weights * inside
    moved = np.einsum("nab,rnb->rna", rows, motion.fields[..., :3])
    products = np.tensordot(moved * used[:, None], moved, axes=([1, 2], [1, 2]))
    power = np.einsum("kr,rs,ks->k", motion.series, products, motion.series.conj()).real
    return np.asarray(np.sqrt(np.maximum(power, 0) / max(used.sum(), 1e-12)))


def middle_depth(means: np.ndarray, weights: np.ndarray, camera: Camera) -> float:
    """Return the weighted median depth, scene units, of points [N, 3] with weights [N] in view of `camera`."""
    inside = pixel_rows(means, camera.viewmat, camera.K, (camera.width, camera.height))[1] & (weights > 0)
    depth = means[inside] @ camera.viewmat[2, :3] + camera.viewmat[2, 3]
    return scale_top(depth, weights[inside], 0.5) if inside.any() else 1.0


def pixel_rows(
    means: np.ndarray, viewmat: np.ndarray, K: np.ndarray, size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the derivative [N, 2, 3] of the pixel by the position of points [N, 3], and which are in the picture."""
    x, y, z = (means @ viewmat[:3, :3].T + viewmat[:3, 3]).T
    front = z > 1e-6
    z = np.where(front, z, 1.0)
    u, v = K[0, 0] * x / z + K[0, 2], K[1, 1] * y / z + K[1, 2]
    inside = front & (u >= 0) & (u < size[0]) & (v >= 0) & (v < size[1])
    zero = np.zeros_like(z)
    across = np.stack([K[0, 0] / z, zero, -K[0, 0] * x / z**2], -1)
    down = np.stack([zero, K[1, 1] / z, -K[1, 1] * y / z**2], -1)
    by_camera = np.stack([across, down], 1)
    return np.where(inside[:, None, None], by_camera @ viewmat[:3, :3].astype(np.float64), 0.0), inside


def space_time_slice(video: np.ndarray, axis: Axis, index: int) -> np.ndarray:
    """One line of pixels over time.

    `video` is [T, H, W, 3] (or [T, H, W]). A row gives [T, W, 3], time running down; a column gives
    [H, T, 3], time running right. Raises ValueError for an axis or index that the video does not have.
    """
    video = _check_video(video)
    length = {"row": video.shape[1], "column": video.shape[2]}.get(axis)
    if length is None:
        raise ValueError(f"axis is {axis!r}, expected 'row' or 'column'")
    if not 0 <= index < length:
        raise ValueError(f"{axis} {index} is outside the video's {length} {axis}s")
    return video[:, index].copy() if axis == "row" else np.swapaxes(video[:, :, index], 0, 1).copy()


def most_moving_line(video: np.ndarray, axis: Axis | None = None) -> tuple[Axis, int]:
    """Return axis and index of the row or column of [T, H, W, 3] with the largest mean variance over time.

    With `axis` given, the line of that axis. Where nothing varies it is the middle row (column).
    """
    video = _check_video(video)
    # row by row: numbers of all of a long video would fill the memory
    variance = np.stack([video[:, y].var(axis=0, dtype=np.float64) for y in range(video.shape[1])])
    variance = variance.mean(axis=-1) if variance.ndim == 3 else variance  # [H, W]
    lines: dict[Axis, np.ndarray] = {"row": variance.mean(axis=1), "column": variance.mean(axis=0)}
    if axis is not None:
        lines = {axis: lines[axis]}
    best: Axis = max(lines, key=lambda a: float(lines[a].max()))
    line = lines[best]
    return best, int(line.argmax()) if line.max() > 0 else len(line) // 2


def difference_maps(video: np.ndarray, count: int | None = None) -> tuple[np.ndarray, float]:
    """Return ([n, H, W] maps, scale): D_t(p) = |I(p, t + 1) − I(p, t)|, [TG4MM] Eq. (17), mean over channels.

    The first `count` maps of a video [T, H, W, 3] (the paper shows 6 of its first 7 frames), or all T − 1.
    `scale` is the largest value: one colour scale for all maps. To compare several videos, take the largest
    of their scales. Raises ValueError for fewer than two frames or a count outside 1..T − 1.
    """
    video = _check_video(video)
    available = len(video) - 1
    n = available if count is None else count
    if not 1 <= n <= available:
        raise ValueError(f"{n} difference maps asked of {len(video)} frames, expected 1 to {available}")
    maps = np.abs(np.diff(video[: n + 1].astype(np.float64), axis=0))
    maps = maps.mean(axis=-1) if maps.ndim == 4 else maps
    return maps, float(maps.max())


def amplitude_spectrum(
    motion: ModalMotion, weights: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return (frequencies [K] Hz, amplitude [K] scene units): weighted mean over Gaussians of each phasor's length.

    The length of a phasor vector is sqrt(Σ |component|²): for motion along a line, the peak displacement.
    `weights` [N] ≥ 0, all 1 if None. Sorted by frequency. Raises ValueError if the weights do not fit.
    """
    n, modes = motion.n_gaussians, range(len(motion.freqs_hz))
    weights = np.ones(n) if weights is None else np.asarray(weights, dtype=np.float64)
    if weights.shape != (n,):
        raise ValueError(f"weights have shape {weights.shape}, expected {(n,)}")
    total = weights.sum()
    if not (total > 0 and (weights >= 0).all()):
        raise ValueError(f"weights must be ≥ 0 and not all 0; their sum is {total:g}")
    lengths = (np.linalg.norm(motion.displacement_of(k).astype(np.complex128), axis=1) for k in modes)
    amplitude = np.array([length @ weights / total for length in lengths])
    order = np.argsort(motion.freqs_hz, kind="stable")
    return np.asarray(motion.freqs_hz, dtype=np.float64)[order], amplitude[order]


def _check_video(video: np.ndarray) -> np.ndarray:
    video = np.asarray(video)
    if video.ndim not in {3, 4} or 0 in video.shape:
        raise ValueError(f"video has shape {video.shape}, expected [T, H, W, 3] or [T, H, W], not empty")
    return video
