"""The poses of a moving camera, corrected on the scene at rest, and that scene refined with them."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from tg4mm.core.errors import RunError
from tg4mm.core.memory import mapped_zeros, release
from tg4mm.core.progress import progress
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.checkpoints import Arrays, Checkpoint, arrays_of, gaussians_of
from tg4mm.fit.motion.config import MotionConfig
from tg4mm.fit.motion.jacobian.view import view_jacobian
from tg4mm.fit.motion.nuisance.projection import POSE, Nuisance
from tg4mm.fit.motion.observations import Observations, PosedFrames, whole_pictures
from tg4mm.fit.motion.refine import refine_at_rest

_ALTERNATIONS = 3  # between poses and the scene at rest, at most
_POSE_STEPS = 2
_ROBUST = 3.0  # robust deviations: residuals beyond count less
_ALL = np.ones(12, bool)
_STILL_PX = 0.05  # rms correction of the poses below which another brings nothing


def refine_scene_and_poses(
    gaussians: Gaussians,
    observations: Observations,
    config: MotionConfig,
    device: str,
    checkpoint: Checkpoint,
) -> tuple[Gaussians, list[PosedFrames], dict[str, Any]]:
    """Gaussians and poses refined in turn on all frames, and how far poses went (pixels)."""
    frames, moved = observations.frames, []
    for k in range(_ALTERNATIONS):

        def compute(
            frames: list[PosedFrames] = frames, gaussians: Gaussians = gaussians, k: int = k
        ) -> Arrays:
            width, height = observations.size
            pictures = mapped_zeros((len(frames), height, width, 3))
            new, _, pixels = corrected_poses(gaussians, replace(observations, frames=frames), k, pictures)
            iterations = int(np.clip(4 * len(frames), 300, 1500))
            shown = refine_at_rest(gaussians, new, pictures, iterations, config.seed + k, device)
            poses = {"viewmats": np.stack([f.viewmat for f in new]), "pixels": np.array(pixels)}
            return arrays_of(shown) | poses

        kept = checkpoint(f"scene_{k}", compute)
        gaussians = gaussians_of(kept)
        frames = [replace(f, viewmat=v) for f, v in zip(frames, kept["viewmats"], strict=True)]
        moved.append(round(float(kept["pixels"]), 4))
        if moved[-1] < _STILL_PX:
            break
    return gaussians, frames, {"pose_corrections_px": moved}


def pictures_of(observations: Observations) -> Iterator[np.ndarray]:
    """[H, W, 3] float32 of every frame, over white; NaN where it does not count."""
    for v, frame in enumerate(observations.frames):
        picture = next(whole_pictures(observations, frame.rows))[0]
        if observations.counts is not None:
            picture[~observations.counts[v]] = np.nan
        yield picture


def left_of(picture: np.ndarray, shown: np.ndarray) -> np.ndarray:
    """[H, W, 3]: a frame less what is shown, 0 where the frame does not count."""
    return np.nan_to_num(picture - shown)


def corrected_poses(
    gaussians: Gaussians, observations: Observations, k: int, pictures: np.ndarray | None = None
) -> tuple[list[PosedFrames], np.ndarray, float]:
    """Frames with corrected poses, gain and offset [F, 6] of each, and the rms correction in pixels.

    `pictures` [F, H, W, 3], where they are given, become those of the frames with exposure taken out.
    """
    out, exposures, squares = [], [], []
    means = gaussians.means.numpy()
    label = f"poses, {k + 1} of {_ALTERNATIONS}"
    with progress(label, len(observations.frames), "frames") as update:
        for i, (frame, picture) in enumerate(
            zip(observations.frames, pictures_of(observations), strict=True)
        ):
            first = frame
            for _ in range(_POSE_STEPS):
                view = view_jacobian(gaussians, frame, observations.size)
                shown = view.over_white
                nuisance = Nuisance(view, frame, means, _ALL)
                n = _coefficients(nuisance, shown, left_of(picture, shown))
                frame = replace(frame, viewmat=_corrected(frame.viewmat, n[POSE]))
            if not np.isfinite(frame.viewmat).all():
                raise RunError(f"the pose of frame {i} cannot be refined: it does not show the scene at rest")
            out.append(frame)
            exposures.append(n[:6].astype(np.float32))
            if pictures is not None:
                pictures[i] = (picture - exposures[i][3:]) / (1 + exposures[i][:3])
                pictures[i] = np.where(np.isnan(pictures[i]), shown, pictures[i])
                release(pictures)
            squares.append(_apart(first, frame, means, gaussians.opacities.numpy()))
            update(i + 1)
    return out, np.array(exposures), float(np.sqrt(np.mean(squares)))


def _coefficients(nuisance: Nuisance, shown: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """[12] of one frame: least squares, residuals beyond three robust deviations counting less."""
    columns = nuisance.columns(shown).reshape(12, -1)
    flat, weights = residual.reshape(-1), np.ones(residual.size, np.float32)
    shows = columns[POSE].any(
        0
    )  # with a blank margin the spread would be 0, and only what fits by chance would count
    shows = shows if shows.any() else ~shows
    scale = np.sqrt((columns.astype(np.float64) ** 2).sum(1)) + 1e-12
    n = np.zeros(12)
    for _ in range(3):
        weighted = columns * weights
        gram = (weighted @ columns.T).astype(np.float64) / np.outer(scale, scale)
        side = (weighted @ flat).astype(np.float64) / scale
        n = np.linalg.solve(gram + 1e-6 * np.eye(12), side) / scale
        error = flat - n.astype(np.float32) @ columns
        spread = 1.4826 * float(np.median(np.abs(error[shows]))) + 1e-6
        weights = 1 / (1 + (error / (_ROBUST * spread)) ** 2)
    return n


def _corrected(viewmat: np.ndarray, n: np.ndarray) -> np.ndarray:
    """The pose that shows what the scene would show if it moved rigidly by n about the camera (`rigid_fields`)."""
    out = viewmat.astype(np.float64).copy()
    rotation = Rotation.from_rotvec(n[:3]).as_matrix()  # camera axes
    out[:3] = rotation @ out[:3]
    out[:3, 3] += n[3:]
    return out.astype(np.float32)


def _apart(a: PosedFrames, b: PosedFrames, means: np.ndarray, opacities: np.ndarray) -> float:
    """Mean squared distance in pixels between what two poses make of the Gaussians before the camera."""
    pixels = []
    for frame in (a, b):
        x = means @ frame.viewmat[:3, :3].T + frame.viewmat[:3, 3]
        pixels.append(x[:, :2] / np.maximum(x[:, 2:], 1e-6) * np.diag(frame.K)[:2])
    seen = (x[:, 2] > 1e-3) & (np.abs(pixels[0]) < 2 * frame.K[:2, 2]).all(1) & (opacities > 0.1)
    return float(((pixels[0] - pixels[1])[seen] ** 2).sum(1).mean()) if seen.any() else 0.0
