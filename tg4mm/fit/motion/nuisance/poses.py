"""Poses of a moving camera: their correction on the scene at rest, and which part of the scene its path shows at rest.

Poses and the scene at rest are refined in turn. Any rigid motion of the complete scene may be added to the fields that
explain a moving camera's pictures, since the unknown poses compensate it. So a vibration has two readings: the part
that was found to move does, and the rest is at rest; or that part is at rest, and the rest moves in the opposite
direction. Each implies another path of the camera: its poses, less the vibration's part by least squares. The two paths
differ by a line at the vibration's frequency, which a hand does not have: its spectrum there is as around. From the
path's Fourier coefficients [6] around the frequency follows the likelihood of each reading: that of the coefficient at
the frequency, with the line or without, for unknown covariance (Student's t of complex vectors). The prior probability
of the second reading is the share of the visible scene that moves. If a hand shakes at the frequency as much as the
scene, only that prior remains. A line in the path of the likelier reading is a rigid motion that the fields lack, or
have too much of.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from tg4mm.core.errors import RunError
from tg4mm.core.memory import mapped_zeros, release
from tg4mm.core.progress import progress
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.checkpoints import Arrays, Checkpoint, Step, arrays_of, gaussians_of
from tg4mm.fit.motion.config import MotionConfig
from tg4mm.fit.motion.jacobian.view import view_jacobian
from tg4mm.fit.motion.nuisance.projection import POSE, Nuisance, Projection, rigid_columns
from tg4mm.fit.motion.observations import Observations, PosedFrames, whole_pictures
from tg4mm.fit.motion.refine import refine_at_rest

_ALTERNATIONS = 3  # between poses and the scene at rest, at most
_POSE_STEPS = 2
_ROBUST = 3.0  # robust deviations: residuals beyond count less
_ALL = np.ones(12, bool)
_STILL_PX = 0.05  # rms correction of the poses below which another brings nothing
_AROUND = 12  # frequencies to either side of one, 1 / duration apart
_LINE = 2  # of those, the nearest ones that the line itself reaches into (Hann's window)
_OVERLAP = 1.9  # of those frequencies count as one: 1 + 2 (4/9 + 1/36), squares of Hann's correlations


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

        kept = checkpoint(Step.scene.numbered(k), compute)
        gaussians = gaussians_of(kept)
        frames = [replace(f, viewmat=v) for f, v in zip(frames, kept["viewmats"], strict=True)]
        moved.append(round(float(kept["pixels"]), 4))
        if moved[-1] < _STILL_PX:
            break
    return gaussians, frames, {"pose_corrections_px": moved}


def pictures_of(observations: Observations) -> Iterator[np.ndarray]:
    """Yield [H, W, 3] float32 of every frame, over white; NaN where it does not count."""
    for v, frame in enumerate(observations.frames):
        picture = next(whole_pictures(observations, frame.rows))[0]
        if observations.valid_mask is not None:
            picture[~observations.valid_mask[v]] = np.nan
        yield picture


def left_of(picture: np.ndarray, shown: np.ndarray) -> np.ndarray:
    """Return [H, W, 3]: a frame less what is shown, 0 where the frame does not count."""
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
    """Return [12] of one frame: least squares, residuals beyond three robust deviations counting less."""
    columns = nuisance.columns(shown).reshape(12, -1)
    flat, weights = residual.reshape(-1), np.ones(residual.size, np.float32)
    # with a blank margin the spread would be 0, and only what fits by chance would count
    shows = columns[POSE].any(0)
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
    """Return the pose from which the scene looks as if it had moved rigidly by n about the camera (`rigid_fields`)."""
    out = viewmat.astype(np.float64).copy()
    rotation = Rotation.from_rotvec(n[:3]).as_matrix()  # camera axes
    out[:3] = rotation @ out[:3]
    out[:3, 3] += n[3:]
    return out.astype(np.float32)


def _apart(a: PosedFrames, b: PosedFrames, means: np.ndarray, opacities: np.ndarray) -> float:
    """Return the mean squared distance in pixels between the Gaussians as seen from two poses."""
    pixels = []
    for frame in (a, b):
        x = means @ frame.viewmat[:3, :3].T + frame.viewmat[:3, 3]
        pixels.append(x[:, :2] / np.maximum(x[:, 2:], 1e-6) * np.diag(frame.K)[:2])
    seen = (x[:, 2] > 1e-3) & (np.abs(pixels[0]) < 2 * frame.K[:2, 2]).all(1) & (opacities > 0.1)
    return float(((pixels[0] - pixels[1])[seen] ** 2).sum(1).mean()) if seen.any() else 0.0


@dataclass(frozen=True)
class FieldReading:
    """The likelier reading of one frequency's fields."""

    moving_share: float  # of what is seen
    doubt: float  # probability that the other reading is right
    rigid: np.ndarray | None  # [N, 6] complex, units of the fields: to be taken off; None: nothing is
    # [N] of the error, units of the fields: by the doubt, and by the line that the path still has
    squares: np.ndarray
    is_determined: bool  # whether what moves moves by more than twice its error


@dataclass(frozen=True)
class _Line:
    """The path's Fourier coefficient at a frequency, as a motion of the scene, and those at other frequencies."""

    value: np.ndarray  # [6] complex
    # [6, 6] complex, inverse of the sum of products of so many independent coefficients around it
    scatter: np.ndarray
    count: float

    def ratio(self, line: np.ndarray) -> float:
        """Likelihood that it is −line [6] and noise, over that it is noise alone."""
        none, there = (1 + self._power(v) for v in (self.value, self.value + line))
        return float(np.exp(np.clip((self.count + 1) * np.log(none / there), -600, 600)))

    def beyond_noise(self, value: np.ndarray) -> float:
        """Share of the power of a coefficient [6] that noise does not explain."""
        of_noise = len(value) / (self.count - len(value))  # mean, of as many independent ones
        return max(1 - of_noise / max(self._power(value), 1e-300), 0.0)

    def _power(self, value: np.ndarray) -> float:
        return float((value.conj() @ self.scatter @ value).real)


@dataclass(frozen=True)
class CameraPath:
    """The path of a camera in F frames as the motion that the scene would have before a camera that stands still."""

    times_s: np.ndarray  # [F]
    moved: np.ndarray  # [F, 6] turn (radians) and shift (scene units) about `centre` along the world's axes
    to_world: np.ndarray  # [F, 6, 6] of coefficients of the pose columns
    centre: np.ndarray  # [3] scene units
    means: np.ndarray  # [N, 3]
    seen: np.ndarray  # [N]: how much is seen of each Gaussian

    @staticmethod
    def of(
        times_s: np.ndarray, viewmats: np.ndarray, left: np.ndarray, means: np.ndarray, seen: np.ndarray
    ) -> "CameraPath":
        """Make the path of poses [F, 4, 4] and coefficients [F, 6] of the pose columns in each frame's residual."""
        viewmats = viewmats.astype(np.float64)
        centre = np.average(means, axis=0, weights=seen)
        to_world = np.stack([_to_world(v, centre) for v in viewmats])
        steps = [_step(a, b) for a, b in pairwise(viewmats)]
        steps = [t @ s for t, s in zip(to_world, steps, strict=False)]
        moved = np.concatenate([np.zeros((1, 6)), np.cumsum(steps, axis=0)])
        moved += np.einsum("fab,fb->fa", to_world, left)
        return CameraPath(times_s, moved, to_world, centre, means.astype(np.float64), seen)

    def without(
        self, fields: np.ndarray, functions: np.ndarray, projections: Sequence[Projection]
    ) -> np.ndarray:
        """Return poses [F, 6] less the part of the motion Σ fields [R, N, 6] · functions [R, F] that they absorbed."""
        out = self.moved.copy()
        for f, projection in enumerate(projections):
            motion = np.tensordot(functions[:, f].astype(np.float32), fields, 1)
            out[f] -= self.to_world[f] @ projection.coefficients_of_motion(motion)[POSE]
            projection.release()
        return out

    def reading(
        self,
        path: np.ndarray,
        field: np.ndarray,
        moves: np.ndarray,
        hz: float,
        others: np.ndarray,
        scale: float,
    ) -> FieldReading:
        """Judge the phasors [N, 3] of a field at a frequency, which `moves` [N]; path [F, 6] as `without` gives it.

        scale: field times it are phasors of displacement. others: further frequencies of the scene.
        """
        share = float(self.seen[moves].sum() / self.seen.sum())
        columns, root = rigid_columns(self.means - self.centre), np.sqrt(self.seen * moves)
        design = (columns * root[:, None, None]).reshape(-1, 6)
        # the rigid motion nearest to the field
        wanted = np.linalg.lstsq(design, (field * root[:, None]).ravel(), rcond=1e-6)[0]
        seen = self._line(path, hz, others)
        odds = share / max(1 - share, 1e-9) * (1.0 if seen is None else seen.ratio(scale * wanted))
        probability = odds / (1 + odds)
        is_other, doubt = probability > 0.5, min(probability, 1 / (1 + odds))
        squares = doubt * (np.abs(columns @ wanted) ** 2).sum(1)
        if seen is not None:
            left = seen.value + scale * wanted * is_other
            squares += seen.beyond_noise(left) * (np.abs(columns @ left) ** 2).sum(1) / scale**2
        rigid = np.concatenate([columns @ wanted, np.broadcast_to(wanted[:3], field.shape)], axis=1)
        moved = field - rigid[:, :3] * is_other
        where = self.seen * (~moves if is_other else moves)
        power, error = where @ (np.abs(moved) ** 2).sum(1), where @ squares
        return FieldReading(
            1 - share if is_other else share, doubt, rigid if is_other else None, squares, 4 * error <= power
        )

    def _line(self, path: np.ndarray, hz: float, others: np.ndarray) -> _Line | None:
        """Return the spectral line of the path at a frequency; None with too few frequencies around it."""
        steps, times = np.diff(path, axis=0), self.times_s[:-1]
        duration, step = float(np.ptp(self.times_s)), float(np.median(np.diff(self.times_s)))
        offsets = np.arange(_LINE, _AROUND + 1)
        around = hz + np.concatenate([-offsets[::-1], offsets]) / duration
        inside = (around > _LINE / duration) & (around < 0.5 / step)
        apart = np.abs(around[:, None] - others).min(1, initial=np.inf) > _LINE / duration
        around = around[inside & apart]
        count = len(around) / _OVERLAP
        if count < 7:
            return None
        to_shift = 1 / (np.exp(2j * np.pi * hz * step) - 1)  # of steps
        noise = _fourier(steps, times, around) * to_shift
        scale = np.sqrt((np.abs(noise) ** 2).mean(0)) + 1e-30
        white = noise / scale
        rise = np.log(around / hz)  # a hand's spectrum falls, and found poses' noise in steps rises
        slope = np.polyfit(rise, np.log((np.abs(white) ** 2).mean(1) + 1e-300), 1)[0]
        white *= np.exp(-slope * rise / 2)[:, None]
        inverse = np.linalg.pinv(white.T @ white.conj() / _OVERLAP, rcond=1e-6, hermitian=True)
        value = _fourier(steps, times, np.array([hz]))[0] * to_shift
        return _Line(value, inverse / np.outer(scale, scale), count)


def _to_world(viewmat: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Return [6, 6]: a turn and shift along a camera's axes about it as those along the world's about `centre`."""
    axes = viewmat[:3, :3]
    away = centre + axes.T @ viewmat[:3, 3]
    out = np.zeros((6, 6))
    out[:3, :3] = out[3:, 3:] = axes.T
    out[3:, :3] = np.cross(axes, away).T  # ω × away
    return out


def _step(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return [6]: by what turn and shift along the camera's axes the scene seems to move from one pose to the next."""
    between = b @ np.linalg.inv(a)
    return np.concatenate([Rotation.from_matrix(between[:3, :3]).as_rotvec(), between[:3, 3]])


def _fourier(values: np.ndarray, times_s: np.ndarray, hz: np.ndarray) -> np.ndarray:
    """Return [M, 6] complex: amplitudes of values [F, 6] at frequencies [M], by Hann's window."""
    window = np.hanning(len(times_s) + 2)[1:-1]
    about = values - np.average(values, axis=0, weights=window)
    return 2 / window.sum() * np.exp(-2j * np.pi * hz[:, None] * times_s) @ (window[:, None] * about)
