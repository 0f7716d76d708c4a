"""Registration of a shaken camera's pictures to one pose, by the rotation of each.

A camera that turns about its own centre by R moves its picture by the homography K R K⁻¹, whatever the depths are
(Hartley & Zisserman 2004, §8.4). So pictures can be rotated back by resampling alone, beyond the linear range of the
shift; `nuisance/projection.py` removes the rest to first order.
"""

from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from tg4mm.core.progress import progress
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.checkpoints import Arrays, Checkpoint, Step, arrays_of, gaussians_of
from tg4mm.fit.motion.config import MotionConfig
from tg4mm.fit.motion.large.resampling import RegisteredPictures
from tg4mm.fit.motion.nuisance.projection import exposure_columns
from tg4mm.fit.motion.observations import Observations, PosedFrames, strips
from tg4mm.fit.motion.refine import refine_at_rest

_STEPS = 4
_STILL_PX = 0.003  # rms of a step below which another brings nothing
_RIDGE = 1e-6
_WINDOW_PX = 2.0  # standard deviation
_STILLEST = 0.25  # of the picture's slopes, by their squares
_ROBUST = 2.0  # times as far as these move counts half
_REFINING = 300  # iterations


def homographies(K: np.ndarray, rotations: np.ndarray) -> np.ndarray:
    """Return [F, 3, 3]: K R K⁻¹ of rotation vectors [F, 3], radians, camera axes."""
    K = K.astype(np.float64)
    return K @ Rotation.from_rotvec(rotations).as_matrix() @ np.linalg.inv(K)


def stabilised(
    gaussians: Gaussians,
    observations: Observations,
    config: MotionConfig,
    device: str,
    checkpoint: Checkpoint,
    refines: bool = True,
) -> tuple[Gaussians, Observations, float]:
    """The scene at rest that registered pictures show, the observations with these, and the shake (pixels, rms).

    Where fixed cameras alone made the scene at rest, it was fitted to means of shaken pictures, which are blurred. With
    `refines` the Gaussians are then fitted to those of the registered pictures; their number and order stay.
    """

    def compute() -> Arrays:
        rotations = camera_rotations(observations)
        if not refines or not observations.is_whole or observations.is_flat:
            return {"rotations": rotations}
        means = mean_pictures(registered(observations, rotations))
        sharper = refine_at_rest(gaussians, observations.frames, means, _REFINING, config.seed, device)
        return {"rotations": rotations, **arrays_of(sharper)}

    kept = checkpoint(Step.registration, compute)
    rotations = kept["rotations"]
    focal = max(float(f.K[0, 0]) for f in observations.frames)
    pixels = focal * float(np.sqrt((rotations[:, :2] ** 2).sum(1).mean()))
    scene = gaussians_of(kept) if "means" in kept else gaussians
    return scene, registered(observations, rotations), pixels


def registered(observations: Observations, rotations: np.ndarray) -> Observations:
    """The observations with every picture rotated back by its camera's rotation vector, [C, 3] in all."""
    back = np.tile(np.eye(3), (len(rotations), 1, 1))
    for frames in observations.frames:
        back[frames.rows] = homographies(frames.K, rotations[frames.rows])
    return replace(observations, pictures=RegisteredPictures(observations.pictures, back))


def camera_rotations(observations: Observations) -> np.ndarray:
    """Return [C, 3] rotation vectors of the pictures' cameras, radians, camera axes; of each fixed camera with mean 0.

    Gauss-Newton on the misfit to the camera's mean picture by the slopes of that, which is the same for all frames
    (inverse composition: Baker & Matthews 2004). The mean, blurred at first, is taken anew in every step. Exposure is
    fitted along. Places that move by themselves count little; what they still change the rotation by is small, and goes
    with the nuisance columns.
    """
    rotations = np.zeros((1 + max(int(f.rows.max()) for f in observations.frames), 3))
    with progress("registration", len(observations.frames), "cameras") as update:
        for v, frames in enumerate(observations.frames):
            rotations[frames.rows] = _rotations_of(observations, frames)
            update(v + 1)
    return rotations


def _rotations_of(observations: Observations, frames: PosedFrames) -> np.ndarray:
    """Return [F, 3] of one camera."""
    rows = frames.rows
    alone = replace(observations, frames=[frames])
    rotations, exposures = np.zeros((len(rows), 3)), np.zeros((len(rows), 6))
    mean = mean_pictures(alone)[0]
    weights = np.ones(mean.shape[:2], np.float32)
    for _ in range(_STEPS):
        everyone = np.zeros((int(rows.max()) + 1, 3))
        everyone[rows] = rotations
        n, mean, energy = _step(registered(alone, everyone), mean, weights, exposures)
        rotations = (Rotation.from_rotvec(rotations) * Rotation.from_rotvec(n[:, 6:])).as_rotvec()
        rotations -= rotations.mean(0)
        exposures = n[:, :6]
        if float(frames.K[0, 0]) * np.sqrt((n[:, 6:] ** 2).sum(1).mean()) < _STILL_PX:
            break
        weights = _weights_of(mean, energy)
    return rotations


def _step(
    observations: Observations, mean: np.ndarray, weights: np.ndarray, exposures: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Estimate exposure and rotation [F, 9] by which one camera's frames still differ from their mean.

    Also returns the mean [H, W, 3] and the energy [H, W], averaged over channels, of the changes that the exposures
    [F, 6] known so far leave unexplained.
    """
    frames = observations.frames[0]
    columns = np.concatenate([exposure_columns(mean), _rotation_columns(mean, frames.K)])
    weighted = columns * weights[..., None]
    products = np.zeros((len(columns), len(frames.rows)))
    new, energy = np.empty_like(mean), np.empty(mean.shape[:2], np.float32)
    for rows, strip in strips(observations.pictures, frames):
        new[rows] = strip.mean(0)
        strip -= new[rows]
        products += weighted[:, rows].reshape(len(columns), -1) @ strip.reshape(len(strip), -1).T
        gains, offsets = exposures[:, None, None, :3], exposures[:, None, None, 3:]
        strip -= (gains * new[rows] + offsets).astype(np.float32)
        energy[rows] = np.einsum("fhwc,fhwc->hw", strip, strip) / 3
    gram = (weighted.reshape(len(columns), -1) @ columns.reshape(len(columns), -1).T).astype(np.float64)
    scale = np.sqrt(np.diag(gram)) + 1e-12
    gram = gram / np.outer(scale, scale) + _RIDGE * np.eye(len(columns))
    return (np.linalg.solve(gram, products / scale[:, None]) / scale[:, None]).T, new, energy


def _rotation_columns(mean: np.ndarray, K: np.ndarray) -> np.ndarray:
    """Return [3, H, W, 3]: what a rotation of the camera by one radian about its x, y, z changes."""
    down, right = np.gradient(mean, axis=(0, 1))
    height, width = mean.shape[:2]
    v, u = np.mgrid[:height, :width] + 0.5
    rays = np.stack([u, v, np.ones_like(u)], -1) @ np.linalg.inv(K.astype(np.float64)).T
    out = np.empty((3, *mean.shape), np.float32)
    for k, axis in enumerate(np.eye(3)):
        moved = np.cross(axis, rays)
        flow = (moved[..., :2] - rays[..., :2] * moved[..., 2:]) @ K[:2, :2].T.astype(np.float64)
        out[k] = -(right * flow[..., :1] + down * flow[..., 1:])
    return out


def _weights_of(mean: np.ndarray, energy: np.ndarray) -> np.ndarray:
    """Return [H, W] float32: less where the picture about a pixel moves by more than where it moves least."""
    down, right = np.gradient(mean, axis=(0, 1))
    slopes = gaussian_filter((down**2 + right**2).mean(-1), _WINDOW_PX)
    moved = gaussian_filter(energy, _WINDOW_PX) / np.maximum(slopes, 1e-12)  # squared, about
    order = np.argsort(moved, axis=None)
    reached = np.cumsum(slopes.ravel()[order])
    stillest = float(moved.ravel()[order[np.searchsorted(reached, _STILLEST * reached[-1])]])
    return np.asarray(1 / (1 + moved / (_ROBUST**2 * max(stillest, 1e-12))), np.float32)


def mean_pictures(observations: Observations) -> np.ndarray:
    """Return [V, H, W, 3]: over time, of every camera."""
    pictures = observations.pictures
    return np.stack(
        [np.concatenate([s.mean(0) for _, s in strips(pictures, f)]) for f in observations.frames]
    )
