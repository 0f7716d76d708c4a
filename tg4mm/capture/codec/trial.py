"""A known motion through the encoder that made a video, and what is left of it."""

import tempfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter, maximum_filter

from tg4mm.capture.codec.probe import Probe, rate_options
from tg4mm.capture.tracking.region import region_motions
from tg4mm.capture.tracking.registration import Box, resampled
from tg4mm.capture.video import BETWEEN, av_module, file_url

_NOISE_PX = 8.0  # over which the key frames' noise is averaged
_AROUND_PX = 12  # about a region, that moves with it in the test: a codec decides by blocks of 16 pixels
_EDGE_PX = 2.0  # over which that motion fades
_TRACE = 1e-3  # of a mask: less is none
_UNEVEN = 0.01  # of a frame


@dataclass(frozen=True)
class Tone:
    """A measured vibration of one region."""

    frequency_hz: float  # of the pictures' clock
    phasor: np.ndarray  # [2] complex, pixels right and down, zero to peak


def through(
    made: Probe,
    masks: Sequence[np.ndarray],
    tones: Sequence[Sequence[Tone]],
    times: np.ndarray,
    seed: int,
    without_between: bool,
) -> list[list[tuple[float, float]]]:
    """Gain and its standard error of each region's tones, after one encoding."""
    most = 255 if made.pixels == "yuv420p" else 1023
    rng, is_new = np.random.default_rng(seed), np.diff(times, prepend=-1) > 0
    mean, height = made.planes.mean(0, dtype=np.float32), made.luma.shape[1]
    luma = mean[:height]
    noise = _noise(made, mean)
    moves = [np.stack([_series(own, times, axis) for axis in (0, 1)], 1) for own in tones]
    soft = [gaussian_filter(mask, _EDGE_PX) for mask in _grown(masks)]
    boxes = [_box_of(mask) for mask in soft]

    def pictures() -> Iterator[np.ndarray]:
        for k in range(len(times)):
            if is_new[k]:
                shown = mean + noise * rng.standard_normal(mean.shape, dtype=np.float32)
                for u, mask, box in zip(moves, soft, boxes, strict=True):
                    moved = resampled(luma[None], -u[None, None, k], box)[0]
                    shown[box] += mask[box] * (moved - luma[box])
            yield np.clip(np.rint(shown), 0, most).astype(made.planes.dtype)

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "test.mkv"
        _encode(path, made, pictures())
        seen, is_between = _decoded(path)
    used = is_new & ~is_between if without_between else is_new
    return [
        [gain_of(u, own, j, times[used]) for j in range(len(own))]
        for own, u in zip(tones, shifts_of(seen[used], masks, times[used]), strict=True)
    ]


def _box_of(mask: np.ndarray) -> Box:
    """The rows and columns in which a mask is not 0."""
    rows, columns = (np.flatnonzero((mask > _TRACE).any(axis)) for axis in (1, 0))
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


def _grown(masks: Sequence[np.ndarray]) -> list[np.ndarray]:
    """The regions with what is around them and in no other."""
    wide = [maximum_filter(mask, 2 * _AROUND_PX + 1) for mask in masks]
    every = np.max(masks, axis=0)
    return [np.where(every > 0, mask, own).astype(np.float32) for mask, own in zip(masks, wide, strict=True)]


def _noise(made: Probe, mean: np.ndarray) -> np.ndarray:
    """[3 H / 2, W]: standard deviation of the key frames about the mean, smoothed, brightness and colours apart."""
    n, height = len(made.planes), made.luma.shape[1]
    keys = made.planes[made.is_key] if made.is_key.any() else made.planes[:1]
    variance = (np.mean([(key - mean) ** 2 for key in keys], axis=0) * n / max(n - 1, 1)).astype(np.float32)
    parts = variance[:height], variance[height:]
    return np.sqrt(np.concatenate([gaussian_filter(part, _NOISE_PX) for part in parts]))


def _series(tones: Sequence[Tone], times: np.ndarray, axis: int) -> np.ndarray:
    """[F] pixels."""
    waves = [(t.phasor[axis] * np.exp(2j * np.pi * t.frequency_hz * times)).real for t in tones]
    return np.sum(waves, axis=0)


def _encode(path: Path, made: Probe, pictures: Iterable[np.ndarray]) -> None:
    av = av_module()
    with av.open(file_url(path), "w") as container:
        stream = container.add_stream(made.encoder, rate=made.rate)
        stream.height, stream.width = made.luma.shape[1:]
        stream.pix_fmt = made.pixels
        options = rate_options(made)
        stream.codec_context.options = options
        stream.codec_context.thread_count = 1
        if "b" in options:
            stream.bit_rate = round(made.bits)
        for k, planes in enumerate(pictures):
            frame = av.VideoFrame.from_ndarray(planes, format=made.pixels)
            frame.pts, frame.time_base = k, 1 / made.rate
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


def _decoded(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Luma [F, H, W] as it is stored, and [F] bool: B frames."""
    with av_module().open(file_url(path)) as container:
        frames = [
            (f.to_ndarray()[: f.height], int(f.pict_type) == BETWEEN) for f in container.decode(video=0)
        ]
    return np.stack([luma for luma, _ in frames]), np.array([between for _, between in frames])


def shifts_of(seen: np.ndarray, masks: Sequence[np.ndarray], times: np.ndarray) -> list[np.ndarray]:
    """Motion [F, 2] of each region in pictures [F, H, W] at times [F], pixels right and down."""
    scale = 255 / np.iinfo(seen.dtype).max if seen.dtype == np.uint8 else 255 / 1023

    def grey(box: Box) -> np.ndarray:
        return seen[:, *box] * np.float32(scale)

    found = region_motions([grey], [(mask > 0.5).astype(np.float32) for mask in masks], times)
    return [motion.whole for motion in found]


def gain_of(u: np.ndarray, tones: Sequence[Tone], j: int, times: np.ndarray) -> tuple[float, float]:
    """Return the gain of tone j in the shifts u [F, 2].

    Along its direction, with all tones fitted, and the error that noise makes.
    """
    main = tones[j].phasor
    waves = [f(2 * np.pi * t.frequency_hz * times) for t in tones for f in (np.cos, np.sin)]
    design = np.stack([np.ones(len(times)), *waves], 1)
    answer, *_ = np.linalg.lstsq(design, u, rcond=None)
    phasor = answer[1 + 2 * j] - 1j * answer[2 + 2 * j]
    size = float((np.abs(main) ** 2).sum())
    gain = float((phasor @ main.conj()).real) / size
    left = u - design @ answer
    direction = np.abs(main) / np.sqrt(size)
    steps = np.diff(times)
    if np.ptp(steps) > _UNEVEN * steps[0]:  # frames are left out: as of white noise
        power = (left**2).sum(0) / max(len(times) - design.shape[1], 1)
        return gain, float(np.sqrt(2 / len(times) * (power * direction**2).sum() / size))
    spectrum = np.fft.rfft(left * np.hanning(len(left))[:, None], axis=0)
    hz = np.arange(len(spectrum)) / (len(times) * (times[1] - times[0]))
    near = np.argsort(np.abs(hz - tones[j].frequency_hz))[:16]
    power = (np.abs(spectrum[near]) ** 2).mean(0) / (np.hanning(len(left)) ** 2).sum()
    return gain, float(np.sqrt(2 / len(times) * (power * direction**2).sum() / size))
