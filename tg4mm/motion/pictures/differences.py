"""What changes in the images: per camera the difference from its mean over time, in few temporal components.

What the static Gaussians get wrong is the same in every frame of a camera that stays put; the difference takes
it out of the fit. Displacements of less than a pixel change an image linearly, so with orthonormal functions of
time a_r(t) the least-squares fit of all timesteps falls apart into one fit for each component image
Σ_t a_r(t) (I_t − mean I). The functions are the principal components of all differences of all cameras
together: nothing is lost, the first few hold the motion, the others noise, and the cost does not grow with T.

Memory: what is returned, 4 · V · H · W · (3 R + 4) bytes with R at most `most`; `CACHE_BYTES` of differences; about
four strips of 32 MiB (`video.py`); from files the pictures of one camera (`capture/pictures.py`). For 30 views of 512²,
300 timesteps at 8 bits and sixteen components that is 1,560 + 128 + 128 + 300 MiB, 2.1 GiB.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter

from tg4mm.capture import ImageStack
from tg4mm.capture.pictures import FilePictures, pictures_of
from tg4mm.motion.pictures.video import FixedCamera, Video, video_of

# Bytes of differences, kept from the first look for the second; what is more is composited again
CACHE_BYTES = 128 << 20
_RELATIVE_FLOOR = 1e-5  # of the first component's energy: below it is rounding
_NOISE_FACTOR = 2.0  # times the energy of the weakest components: below it is noise, at most
_MARGIN = 1.1
_RANK_FOR_NOISE = 7
_ROUNDING = 1e-7  # of the first component's energy: what sums in float32 leave of nothing
_SMOOTHING_PX = 1.5  # standard deviation of what evens out estimates of noise


@dataclass(frozen=True)
class TemporalComponents:
    """Orthonormal functions of time, by falling energy, and the images that go with them."""

    basis: np.ndarray  # [R, T] float64, a_r(t); each sums to zero over time
    energy: np.ndarray  # [T] float64, squared pixel values in every component, kept or not
    images: np.ndarray  # [V, R, H, W, 3] float32
    residual: np.ndarray  # [V, H, W] float32, energy of all components that were not kept, mean over channels
    rank: int  # components that are not empty: T − 1, or fewer where pictures repeat
    mean: np.ndarray  # [V, H, W, 3] float32, over time and over white


def kept_components(energy: np.ndarray, rank: int | None = None, pixels: float = 0.0) -> int:
    """How many components stand out of rounding and noise: `energy` [T] falling. At least 1.

    Noise is alike in all components, but for those that are empty: one of the T, since the mean is taken out, and more
    where pictures repeat (`rank` are not). So the weakest quarter of the others tells its level. Fewer than seven are
    no sample, and all but rounding is kept. How far chance lifts the strongest of noise over the weakest goes by the
    number of `pixels` it is spread over (Marchenko & Pastur 1967); where that is not known, or few, twice is noise.
    """
    used = len(energy) - 1 if rank is None else rank
    floor = _RELATIVE_FLOOR * energy[0]
    if used >= _RANK_FOR_NOISE:
        root = np.sqrt(used / max(pixels, 2 * used))
        factor = min(_MARGIN * ((1 + root) / (1 - root)) ** 2, _NOISE_FACTOR)
        floor = max(floor, factor * float(energy[used - used // 4 : used].mean()))
    return max(int((energy[:used] > floor).sum()), 1)


def temporal_components(
    images: ImageStack | FilePictures, cameras: list[FixedCamera], most: int
) -> TemporalComponents:
    """Principal components over time of the differences of all cameras together, at most `most`.

    `FilePictures` are read one camera after the other: once each as long as `CACHE_BYTES` holds the differences, of
    further cameras twice.
    """
    pictures = pictures_of(images)
    videos = [video_of(pictures, camera) for camera in cameras]
    gram, total, mean, cache = _first_look(videos)
    energy, vectors = np.linalg.eigh(gram)
    energy, vectors = np.maximum(energy[::-1], 0), vectors[:, ::-1].T
    states = np.unique(np.stack([video.state for video in videos]), axis=1).shape[1]
    rank = min(states - 1, int((energy > _ROUNDING * energy[0]).sum()))
    found = kept_components(energy, rank, _effective_pixels(total))
    if found > most:
        warnings.warn(
            f"{found} temporal components stand out of the noise, motion.components keeps the strongest {most}",
            stacklevel=2,
        )
    basis = vectors[: min(found, most)]
    basis = basis - basis.mean(1, keepdims=True)  # zero already, but for rounding
    components = np.empty((len(videos), len(basis), *total.shape[1:], 3), np.float32)
    for v, video in enumerate(videos):
        of_states = _by_state(basis, video)
        for rows, strip in cache.get(v) or ((rows, strip) for rows, _, strip in video.strips()):
            components[v, :, rows] = project(strip, of_states)
        for image in components[v]:
            total[v] -= np.einsum("hwc,hwc->hw", image, image) / 3
    return TemporalComponents(basis, energy, components, np.maximum(total, 0), max(rank, 1), mean)


def _first_look(
    videos: list[Video],
) -> tuple[np.ndarray, np.ndarray, np.ndarray, dict[int, list[tuple[slice, np.ndarray]]]]:
    """Products of all timesteps [T, T], energy of every pixel [V, H, W] (mean over channels), means over time
    [V, H, W, 3], and what was kept."""
    n_timesteps, (height, width) = len(videos[0].state), videos[0].pictures.size
    gram = np.zeros((n_timesteps, n_timesteps))
    total = np.empty((len(videos), height, width), np.float32)
    mean = np.empty((len(videos), height, width, 3), np.float32)
    cache: dict[int, list[tuple[slice, np.ndarray]]] = {}
    free = CACHE_BYTES
    for v, video in enumerate(videos):
        free -= len(video.rows) * height * width * 12
        own = np.zeros((len(video.rows),) * 2)
        count = (video.share * n_timesteps).astype(np.float32)
        kept = []
        for rows, own_mean, strip in video.strips():
            mean[v, rows] = own_mean
            flat = strip.reshape(len(strip), -1)
            own += flat @ flat.T
            total[v, rows] = (count @ (flat * flat)).reshape(strip.shape[1:]).mean(-1)
            if free >= 0:
                kept.append((rows, strip))
        if kept:
            cache[v] = kept
        gram += own[video.state][:, video.state]
    return gram, total, mean, cache


def _effective_pixels(total: np.ndarray) -> float:
    """Over how many pixels energy [V, H, W] is spread: all if alike in all, 1 if in one."""
    squares = np.einsum("vhw,vhw->", total, total, dtype=np.float64)
    return float(total.sum(dtype=np.float64) ** 2 / squares) if squares else 0.0


def _by_state(basis: np.ndarray, video: Video) -> np.ndarray:
    """[R, S]: Σ of a_r(t) over the timesteps that show picture s."""
    out = np.zeros((len(video.rows), len(basis)))
    np.add.at(out, video.state, basis.T)
    return out.T


def project(video: np.ndarray, basis: np.ndarray) -> np.ndarray:
    """Σ_t a_r(t) video[t]: [T, H, W, 3] and [R, T] -> [R, H, W, 3] float32."""
    flat = basis.astype(np.float32) @ video.reshape(len(video), -1)
    return flat.reshape(len(basis), *video.shape[1:])


def pixel_noise(components: TemporalComponents, is_noise: np.ndarray) -> np.ndarray:
    """[V, H, W] float32: variance of the noise in one pixel and channel of one component image.

    From what is not motion: the components that were not kept, and of the kept ones those that `is_noise` [R] bool
    names. Their energy, mean over channels, is divided by the number of components that hold it and smoothed (Gaussian
    of 1.5 px, edges reflected). Zeros where there are no such components. Where more components stood out than were
    asked for, those left out count as noise: the estimate is then too large. Raises ValueError on another R.
    """
    n_kept = len(components.basis)
    if np.shape(is_noise) != (n_kept,):
        raise ValueError(f"is_noise has shape {np.shape(is_noise)}, expected ({n_kept},)")
    rows = np.flatnonzero(is_noise)
    freedom = max(components.rank - n_kept, 0) + len(rows)
    if not freedom:
        return np.zeros_like(components.residual)
    energy = components.residual if components.rank > n_kept else np.zeros_like(components.residual)
    for r in rows:
        energy = energy + np.einsum("vhwc,vhwc->vhw", *2 * [components.images[:, r]]) / 3
    sigma = (0, _SMOOTHING_PX, _SMOOTHING_PX)
    return gaussian_filter(energy / np.float32(freedom), sigma, mode="reflect")
