"""From pictures over time to target images: per view a few images, each the pictures' product with a function of time.

Displacements of less than a pixel change a picture in proportion, so that all frames of a fixed camera say no more than
their products with the functions of time that the motion has. With Ψ_v the orthonormal functions that view v is
projected on, its target images are y_v = (I − mean) Ψ_v and the model is y_v = J_v (C_v x), where x holds one
displacement field for each of R shared functions of time and C_v, the mixing matrix, says how these look in Ψ_v.

Synchronous cameras: the functions are the principal components of all changes of all cameras together, C_v = 1, so that
the R fields can be solved for one by one. Cameras with clocks of their own: cosines and sines of known frequencies. A
camera that moves: every frame is a view, with one row C_v of those cosines and sines.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter

from tg4mm.motion.nuisance import COLUMNS, Nuisance, inner_products, without
from tg4mm.motion.observations import Observations, PosedFrames, strips
from tg4mm.motion.shake import BlockShifts
from tg4mm.room import release, room

# Bytes of differences, kept from the first look for the second; what is more is composited again
CACHE_BYTES = 128 << 20
_RELATIVE_FLOOR = 1e-5  # of the first component's energy: below it is rounding
_NOISE_FACTOR = 2.0  # times the energy of the weakest components: below it is noise, at most
_MARGIN = 1.1
_RANK_FOR_NOISE = 7
_ROUNDING = 1e-7  # of the first component's energy: what sums in float32 leave of nothing
_SMOOTHING_PX = 1.5  # standard deviation of what evens out estimates of noise
_IMAGES = 4  # of one view that are worked on together


@dataclass(frozen=True)
class TargetImages:
    """What V views saw of R functions of time. `mixing` None: C_v is the identity, and Ψ_v the basis."""

    basis: np.ndarray  # [R, T] float64, orthonormal functions of time; each sums to zero over time
    energy: np.ndarray  # [T] float64, squared pixel values in every component, kept or not
    images: np.ndarray  # [V, ρ, H, W, 3] float32, `room`; ρ = R where mixing is None
    residual: np.ndarray  # [V, H, W] float32, energy of what was not kept, mean over channels
    rank: int  # of what residual and images hold together, functions of time
    mean: np.ndarray  # [V, H, W, 3] float32, over time and over white
    mixing: list[np.ndarray] | None = None  # V of [ρ, R] float32

    def of(self, v: int, rows: slice | np.ndarray = slice(None)) -> np.ndarray:
        """[r, H, W, 3] in memory: some of view v's images."""
        out = np.array(self.images[v, rows])
        release(self.images)
        return out


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


@dataclass(frozen=True)
class FirstLook:
    """Sums over one pass through the pictures of fixed cameras."""

    grams: list[np.ndarray]  # V of [F, F]: products of the changes of a camera's frames
    total: np.ndarray  # [V, H, W] energy of the changes, mean over channels
    mean: np.ndarray  # [V, H, W, 3]
    columns: list[np.ndarray]  # V of [12, F]: products of the nuisance columns with the changes
    column_grams: list[np.ndarray]  # V of [12, 12]: products of the nuisance columns, 0 for inactive ones
    cache: dict[int, list[tuple[slice, np.ndarray]]]  # of some views the changes, by strips
    shake: tuple[float, bool]  # of the cameras: pixels (rms), and whether it is one


def first_look(
    observations: Observations, nuisances: Sequence[Nuisance], looks_for_shake: bool = False
) -> FirstLook:
    """One pass through the pictures. Of the nuisances' pose columns only active ones have products, else 0."""
    width, height = observations.size
    n = len(observations.frames)
    total, mean = np.empty((n, height, width), np.float32), np.empty((n, height, width, 3), np.float32)
    grams, columns, column_grams = [], [], []
    cache: dict[int, list[tuple[slice, np.ndarray]]] = {}
    free = CACHE_BYTES
    shakes = []
    for v, frames in enumerate(observations.frames):
        blocks = BlockShifts.of(_at_rest(nuisances[v]), len(frames.rows)) if looks_for_shake else None
        free -= len(frames.rows) * height * width * 12
        n_frames, kept = len(frames.rows), []
        gram, products = np.zeros((n_frames, n_frames)), np.zeros((COLUMNS, n_frames))
        for rows, strip in strips(observations.pictures, frames):
            mean[v, rows] = strip.mean(0, dtype=np.float64)
            strip -= mean[v, rows]
            if blocks is not None:
                blocks.add(rows, strip)
            flat = strip.reshape(len(strip), -1)
            gram += flat @ flat.T
            products += inner_products(nuisances[v], mean[v], rows, flat)
            total[v, rows] = np.einsum("fhwc,fhwc->hw", strip, strip) / 3
            if free >= 0:
                kept.append((rows, strip))
        grams.append(gram)
        columns.append(products)
        column_grams.append(_column_gram(nuisances[v], mean[v]))
        nuisances[v].__dict__.pop("pose", None)  # 72 bytes a pixel, made again where it is asked for
        if kept:
            cache[v] = kept
        if blocks is not None:
            shakes.append(blocks.shake())
    pixels = float(np.sqrt(np.mean([p**2 for p, _ in shakes]))) if shakes else 0.0
    shake = pixels, bool(shakes and np.mean([s for _, s in shakes]) > 0.5)
    return FirstLook(grams, total, mean, columns, column_grams, cache, shake)


def _column_gram(nuisance: Nuisance, mean: np.ndarray) -> np.ndarray:
    out = np.zeros((COLUMNS, COLUMNS))
    out[np.ix_(nuisance.active, nuisance.active)] = nuisance.gram(mean)
    return out


def _at_rest(nuisance: Nuisance) -> np.ndarray:
    view = nuisance.view
    return view.image[..., :3] + view.transmittance[..., None]


def principal_components(
    observations: Observations, look: FirstLook, nuisances: Sequence[Nuisance], most: int
) -> TargetImages:
    """Principal components over time of the changes of all synchronous cameras together, at most `most`.

    What the active nuisance columns explain of a frame is taken out first.
    """
    gram = np.zeros_like(look.grams[0])
    for v, nuisance in enumerate(nuisances):
        gram += look.grams[v] - nuisance.explained(look.mean[v], look.columns[v])
    energy, vectors = np.linalg.eigh(gram)
    energy, vectors = np.maximum(energy[::-1], 0), vectors[:, ::-1].T
    rank = int((energy[:-1] > _ROUNDING * energy[0]).sum())
    found = kept_components(energy, rank, _effective_pixels(look.total))
    if found > most:
        warnings.warn(
            f"{found} temporal components stand out of the noise, motion.components keeps the strongest {most}",
            stacklevel=2,
        )
    basis = vectors[: min(found, most)]
    basis = basis - basis.mean(1, keepdims=True)  # zero already, but for rounding
    images, residual = _projected(observations, look, nuisances, [basis] * len(look.grams))
    return TargetImages(basis, energy, images, residual, max(rank, 1), look.mean)


def sinusoid_targets(
    observations: Observations, look: FirstLook, nuisances: Sequence[Nuisance], freqs_hz: np.ndarray
) -> TargetImages:
    """Cosines and sines of K frequencies in every camera's own time, with a constant and a trend taken out.

    Functions 2k and 2k + 1 are √(2/F) cos and −√(2/F) sin of frequency k, F the mean number of frames, so that a field
    pair is the real and imaginary part of √(F/2) times the phasor.
    """
    frames = observations.frames
    scale = np.sqrt(2 / np.mean([len(f.rows) for f in frames]))
    bases, mixing = [], []
    for f in frames:
        basis, mix = _orthonormal(f.times_s, freqs_hz, float(scale))
        bases.append(basis)
        mixing.append(mix)
    images, residual = _projected(observations, look, nuisances, bases)
    shared = sinusoids(np.arange(observations.n_timesteps) / observations.fps, freqs_hz) * scale
    energy = np.zeros(observations.n_timesteps)
    energy[: 2 * len(freqs_hz)] = np.sort((images.astype(np.float64) ** 2).sum((0, 2, 3, 4)))[::-1]
    rank = round(float(np.mean([len(f.rows) for f in frames]))) - 2
    return TargetImages(shared, energy, images, residual, max(rank, 1), look.mean, mixing)


def sinusoids(times_s: np.ndarray, freqs_hz: np.ndarray) -> np.ndarray:
    """[2K, F]: cos 2πf_k t and −sin 2πf_k t by turns: Re[m exp(i 2πf t)] = Re m · row 2k + Im m · row 2k + 1."""
    angles = 2 * np.pi * np.asarray(freqs_hz)[:, None] * times_s
    return np.stack([np.cos(angles), -np.sin(angles)], 1).reshape(-1, len(times_s))


def _orthonormal(times_s: np.ndarray, freqs_hz: np.ndarray, scale: float) -> tuple[np.ndarray, np.ndarray]:
    """Orthonormal functions [2K, F] that span the sinusoids less a constant and a trend, and the mixing [2K, 2K]."""
    slow = np.stack([np.ones_like(times_s), times_s - times_s.mean()])
    design = np.concatenate([slow, scale * sinusoids(times_s, freqs_hz)]).T
    q, r = np.linalg.qr(design)
    return q[:, 2:].T, r[2:, 2:].astype(np.float32)


def _projected(
    observations: Observations, look: FirstLook, nuisances: Sequence[Nuisance], bases: Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Of every view the products [V, ρ, H, W, 3] with its functions of time [ρ, F], and the energy [V, H, W] left."""
    width, height = observations.size
    images = room((len(bases), len(bases[0]), height, width, 3))
    total = np.stack(
        [
            t - n.energy(m, c)
            for t, n, m, c in zip(look.total, nuisances, look.mean, look.columns, strict=True)
        ]
    )
    for v, (frames, basis) in enumerate(zip(observations.frames, bases, strict=True)):
        cached = look.cache.get(v) or _changes(observations, frames, look.mean[v])
        for rows, strip in cached:
            images[v, :, rows] = project(strip, basis)
        for some in _at_once(len(basis)):
            images[v, some] = without(nuisances[v], look.mean[v], images[v, some])
            for image in images[v, some]:
                total[v] -= np.einsum("hwc,hwc->hw", image, image) / 3
            release(images)
        nuisances[v].__dict__.pop("pose", None)
    return images, np.maximum(total, 0, out=total)


def _at_once(n: int) -> Iterator[slice]:
    """Of n images those that are in memory together."""
    return (slice(first, min(first + _IMAGES, n)) for first in range(0, n, _IMAGES))


def _changes(observations: Observations, frames: PosedFrames, mean: np.ndarray):
    for rows, strip in strips(observations.pictures, frames):
        strip -= mean[rows]
        yield rows, strip


def _effective_pixels(total: np.ndarray) -> float:
    """Over how many pixels energy [V, H, W] is spread: all if alike in all, 1 if in one."""
    squares = np.einsum("vhw,vhw->", total, total, dtype=np.float64)
    return float(total.sum(dtype=np.float64) ** 2 / squares) if squares else 0.0


def project(video: np.ndarray, basis: np.ndarray) -> np.ndarray:
    """Σ_t a_r(t) video[t]: [T, H, W, 3] and [R, T] -> [R, H, W, 3] float32."""
    flat = basis.astype(np.float32) @ video.reshape(len(video), -1)
    return flat.reshape(len(basis), *video.shape[1:])


def pixel_noise(targets: TargetImages, is_noise: np.ndarray) -> np.ndarray:
    """[V, H, W] float32: variance of the noise in one pixel and channel of one target image.

    From what is not motion: the components that were not kept, and of the kept ones those that `is_noise` [ρ] bool
    names. Their energy, mean over channels, is divided by the number of components that hold it and smoothed (Gaussian
    of 1.5 px, edges reflected). Zeros where there are no such components. Where more components stood out than were
    asked for, those left out count as noise: the estimate is then too large. Raises ValueError on another ρ.
    """
    n_kept = targets.images.shape[1]
    if np.shape(is_noise) != (n_kept,):
        raise ValueError(f"is_noise has shape {np.shape(is_noise)}, expected ({n_kept},)")
    rows = np.flatnonzero(is_noise)
    freedom = max(targets.rank - n_kept, 0) + len(rows)
    if not freedom:
        return np.zeros_like(targets.residual)
    energy = targets.residual if targets.rank > n_kept else np.zeros_like(targets.residual)
    for r in rows:
        energy = energy + np.einsum("vhwc,vhwc->vhw", *2 * [targets.images[:, r]]) / 3
        release(targets.images)
    sigma = (0, _SMOOTHING_PX, _SMOOTHING_PX)
    return gaussian_filter(energy / np.float32(freedom), sigma, mode="reflect")
