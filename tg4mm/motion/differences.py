"""What changes in the images: per camera the difference from its mean over time, in few temporal components.

What the static Gaussians get wrong is the same in every frame of a camera that stays put; the difference takes
it out of the fit. Displacements of less than a pixel change an image linearly, so with orthonormal functions of
time a_r(t) the least-squares fit of all timesteps falls apart into one fit for each component image
Σ_t a_r(t) (I_t − mean I). The functions are the principal components of all differences of all cameras
together: nothing is lost, the first few hold the motion, the others noise, and the cost does not grow with T.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np

from tg4mm.capture import Capture, ImageStack
from tg4mm.errors import CaptureError

_RELATIVE_FLOOR = 1e-5  # of the first component's energy: below it is rounding
_NOISE_FACTOR = 2.0  # times the energy of the weakest components: below it is noise
_TIMESTEPS_FOR_NOISE = 8


@dataclass(frozen=True)
class FixedCamera:
    """A camera that took an image at every timestep from the same place."""

    viewmat: np.ndarray  # [4, 4] float32
    K: np.ndarray  # [3, 3] float32
    rows: np.ndarray  # [T] its image at each timestep, row of the capture


@dataclass(frozen=True)
class TemporalComponents:
    """Orthonormal functions of time, by falling energy, and the images that go with them."""

    basis: np.ndarray  # [R, T] float64, a_r(t); each sums to zero over time
    energy: np.ndarray  # [T] float64, squared pixel values in every component, kept or not
    images: np.ndarray  # [V, R, H, W, 3] float32


def fixed_cameras(capture: Capture) -> list[FixedCamera]:
    """The cameras with one image at every timestep. Raises CaptureError if there is none."""
    found = []
    for camera in range(int(capture.camera_ids.max()) + 1):
        rows = np.flatnonzero(capture.camera_ids == camera)
        rows = rows[np.argsort(capture.timesteps[rows], kind="stable")]
        if np.array_equal(capture.timesteps[rows], np.arange(capture.n_timesteps)):
            viewmat, K = capture.viewmats[rows[0]], capture.Ks[rows[0]]
            found.append(FixedCamera(viewmat.astype(np.float32), K.astype(np.float32), rows))
    if not found:
        raise CaptureError(
            f"{capture.root}: no camera has one image at each of the {capture.n_timesteps} timesteps "
            "from the same pose, which the motion stage needs"
        )
    return found


def camera_differences(images: ImageStack, camera: FixedCamera) -> np.ndarray:
    """[T, H, W, 3] float32: the camera's images over white less their mean."""
    video = np.stack([images.rgb(int(i)) for i in camera.rows])
    return video - video.mean(0, dtype=np.float64).astype(np.float32)


def kept_components(energy: np.ndarray) -> int:
    """How many components stand out of rounding and noise: `energy` [T] falling. At least 1.

    Noise is alike in all components, and one of the T is empty since the mean is taken out; so the weakest quarter of
    the others tells its level. With fewer than eight timesteps that is no sample, and all but rounding is kept.
    """
    floor = _RELATIVE_FLOOR * energy[0]
    used = len(energy) - 1
    if len(energy) >= _TIMESTEPS_FOR_NOISE:
        floor = max(floor, _NOISE_FACTOR * float(energy[used - used // 4 : used].mean()))
    return max(int((energy[:used] > floor).sum()), 1)


def temporal_components(images: ImageStack, cameras: list[FixedCamera], most: int) -> TemporalComponents:
    """Principal components over time of the differences of all cameras together, at most `most`."""
    n_timesteps = len(cameras[0].rows)
    gram = np.zeros((n_timesteps, n_timesteps))
    for camera in cameras:
        flat = camera_differences(images, camera).reshape(n_timesteps, -1)
        gram += (flat @ flat.T).astype(np.float64)
    energy, vectors = np.linalg.eigh(gram)
    energy, vectors = np.maximum(energy[::-1], 0), vectors[:, ::-1].T
    found = kept_components(energy)
    if found > most:
        warnings.warn(
            f"{found} temporal components stand out of the noise, motion.components keeps the strongest {most}",
            stacklevel=2,
        )
    basis = vectors[: min(found, most)]
    basis = basis - basis.mean(1, keepdims=True)  # zero already, but for rounding
    shape = images.data.shape[1:3]
    components = np.empty((len(cameras), len(basis), *shape, 3), np.float32)
    for v, camera in enumerate(cameras):
        components[v] = project(camera_differences(images, camera), basis)
    return TemporalComponents(basis, energy, components)


def project(video: np.ndarray, basis: np.ndarray) -> np.ndarray:
    """Σ_t a_r(t) video[t]: [T, H, W, 3] and [R, T] -> [R, H, W, 3] float32."""
    flat = basis.astype(np.float32) @ video.reshape(len(video), -1)
    return flat.reshape(len(basis), *video.shape[1:])


def phasors(basis: np.ndarray, shapes: np.ndarray, fps: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies [K] in Hz and phasors [K, N, D] complex64 of Σ_r a_r(t) shapes[r], for every DFT bin above 0.

    basis [R, T], shapes [R, N, D]. Σ_k Re[m_k exp(i 2π f_k t / fps)] gives the motion back at every timestep;
    only its mean over time is left out, which is the rest pose.
    """
    n_timesteps = basis.shape[1]
    spectrum = np.fft.rfft(basis, axis=1)[:, 1:] * (2 / n_timesteps)
    if n_timesteps % 2 == 0:
        spectrum[:, -1] /= 2  # the Nyquist bin has no mirror image
    freqs = np.arange(1, n_timesteps // 2 + 1) * fps / n_timesteps
    values = np.tensordot(spectrum.T, shapes, axes=1)
    return freqs, values.astype(np.complex64)
