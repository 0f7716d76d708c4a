"""How much of a small motion a video's compression lets through, by a blind test with a known one.

A codec skips what changes too little, so that it is a low-pass over time: of .02 pixels at a third of the frame rate a
fifth may be left. What it leaves depends on the texture, the noise, the rate, the amplitude and the encoder. So the
mean picture, moved in each region by a tone of the measured frequency, direction and amplitude, with noise as strong as
in the key frames, goes through the encoder that the file names, with the settings that it wrote there, and is measured
again, two times: the second tone is as large as the first gain says that the motion was.

Nothing is fitted. Where the file names no encoder that is here, what the pictures themselves show decides: a region
whose pixels hardly ever repeat and whose noise is as fresh in each frame lost nothing; of any other a mark says so.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter, maximum_filter

from tg4mm.capture.codec.probe import Probe, probe, rate_options
from tg4mm.capture.sfm.video import av_module
from tg4mm.core.errors import Tg4mmError

# The deviation of a gain: times the test's standard error, and beside it (docs/uncertainty.md, films of x264, x265)
SCATTER, BESIDE = 1.15, 0.05
LOST = 0.5  # a gain below it is marked
FRESH_PIXELS, FRESH_NOISE = (
    0.15,
    0.1,
)  # equal pixels and the noise's correlation from frame to frame, at most,
FRESH = 0.08  # of what lost nothing; the deviation of its gain
_PIXELS, _FEWEST, _PERIODS = 30e6, 64, 6  # of the test, frames at least, and periods of its slowest tone
_NOISE_PX = 8.0  # over which the key frames' noise is averaged
_AROUND_PX = 12  # about a region, that moves with it in the test: a codec decides by blocks of 16 pixels
_EDGE_PX = 2.0  # over which that motion fades
_GAINS = 0.15, 1.1  # that the second tone is corrected by


@dataclass(frozen=True)
class Tone:
    """A measured vibration of one region."""

    frequency_hz: float  # of the pictures' clock
    phasor: np.ndarray  # [2] complex, pixels right and down, zero to peak


@dataclass(frozen=True)
class Loss:
    """What compression let through of one tone: amplitude kept / true amplitude."""

    gain: float  # 1 where nothing is lost; NaN where it is not known
    deviation: float  # standard deviation of the gain
    why: str = ""  # the mark: why the true amplitude is larger, by an amount that is not known


def codec_losses(
    video: Path,
    regions: Sequence[np.ndarray],
    tones: Sequence[Sequence[Tone]],
    fps: float | None = None,
    start_s: float = 0.0,
    repeats: Sequence[int] = (),
    seed: int = 0,
) -> list[list[Loss]]:
    """Of each region's tones; two encodings of the film for each set of regions that do not overlap.

    Args:
        video: the file that was measured.
        regions: [H, W] bool or float masks on the upright picture.
        tones: of each region.
        fps: pictures per second that frequencies refer to; None: the file's own.
        start_s: seconds of the file that come before.
        repeats: frames from there on that show the picture before them again.

    Raises Tg4mmError for a region of another size than the picture.
    """
    if not any(tones):
        return [[] for _ in tones]
    rate = fps or 30.0
    slowest = min(tone.frequency_hz for own in tones for tone in own)
    height, width = regions[0].shape
    most = int(max(_FEWEST, _PERIODS * rate / max(slowest, 1e-3), _PIXELS / (height * width)))
    try:
        made = probe(video, start_s, most)
    except (OSError, ValueError, Tg4mmError, av_module().FFmpegError):
        made = None
    if made is None:
        why = "what its compression takes is not known: the video cannot be tested"
        return [[Loss(float("nan"), float("nan"), why) for _ in own] for own in tones]
    shape = np.rot90(made.luma[0], made.turns).shape
    for region in regions:
        if region.shape != shape:
            raise Tg4mmError(f"a region has the shape {region.shape}, the video's pictures {shape}")
    masks = [np.rot90(region.astype(np.float32), -made.turns) for region in regions]
    if made.is_key.all():  # every picture by itself: noise, but no memory
        return [[Loss(1.0, 0.0) for _ in own] for own in tones]
    if not made.encoder:
        return [[_by_pictures(made, mask)] * len(own) for mask, own in zip(masks, tones, strict=True)]
    is_new = ~np.isin(np.arange(len(made.luma)), list(repeats))
    is_new[0] = True
    return _tested(made, masks, tones, (np.cumsum(is_new) - 1) / float(fps or made.rate), seed)


def _tested(
    made: Probe, masks: Sequence[np.ndarray], tones: Sequence[Sequence[Tone]], times: np.ndarray, seed: int
) -> list[list[Loss]]:
    """times [F] seconds, of frames that show one picture the same."""
    found: list[list[Loss]] = [[] for _ in tones]
    for group in _apart([k for k, own in enumerate(tones) if own], masks):
        own = [[_stored(t, made.turns) for t in tones[k]] for k in group]
        gains = [np.ones(len(t)) for t in own]
        for again in range(2):
            scaled = [
                [Tone(t.frequency_hz, t.phasor / np.clip(g, *_GAINS)) for t, g in zip(ts, gs, strict=True)]
                for ts, gs in zip(own, gains, strict=True)
            ]
            results = _through(made, [masks[k] for k in group], scaled, times, seed + again)
            gains = [np.array([g for g, _ in result]) for result in results]
        for k, result in zip(group, results, strict=True):
            found[k] = [_told(gain, float(np.hypot(SCATTER * error, BESIDE))) for gain, error in result]
    return found


def _told(gain: float, deviation: float) -> Loss:
    if gain >= LOST:
        return Loss(gain, deviation)
    kept = max(gain, 0.0)
    why = f"smaller than the codec lets through: of a test tone of this size {kept:.2f} ± {deviation:.2f} is left"
    return Loss(gain, deviation, why)


def _by_pictures(made: Probe, mask: np.ndarray) -> Loss:
    """Where no encoder can be asked."""
    inside = mask > 0.5
    own = made.luma[:, inside].astype(np.float32)
    equal = float((own[1:] == own[:-1]).mean())
    own -= own.mean(0)
    own -= own.mean(1, keepdims=True)
    memory = float((own[1:] * own[:-1]).mean() / max(float((own**2).mean()), 1e-9))
    if equal < FRESH_PIXELS and abs(memory) < FRESH_NOISE:
        return Loss(1.0, FRESH)
    why = (
        f"may be smaller than it was: {equal:.0%} of its pixels repeat the frame before, and the file names no encoder "
        "that can be tested"
    )
    return Loss(float("nan"), float("nan"), why)


def _apart(rows: Sequence[int], masks: Sequence[np.ndarray]) -> list[list[int]]:
    """The regions in groups in which none overlap."""
    groups: list[list[int]] = []
    for k in rows:
        free = (g for g in groups if not any((np.minimum(masks[k], masks[j]) > 0).any() for j in g))
        group = next(free, None)
        groups.append([k]) if group is None else group.append(k)
    return groups


def _grown(masks: Sequence[np.ndarray]) -> list[np.ndarray]:
    """The regions with what is around them and in no other."""
    wide = [maximum_filter(mask, 2 * _AROUND_PX + 1) for mask in masks]
    every = np.max(masks, axis=0)
    return [np.where(every > 0, mask, own).astype(np.float32) for mask, own in zip(masks, wide, strict=True)]


def _stored(tone: Tone, turns: int) -> Tone:
    """The tone in the picture as it is stored, before `turns` quarter turns counterclockwise."""
    right, down = tone.phasor
    for _ in range(turns % 4):
        right, down = -down, right
    return Tone(tone.frequency_hz, np.array([right, down]))


def _through(
    made: Probe, masks: Sequence[np.ndarray], tones: Sequence[Sequence[Tone]], times: np.ndarray, seed: int
) -> list[list[tuple[float, float]]]:
    """Gain and its standard error of each region's tones, after one encoding."""
    rng, is_new = np.random.default_rng(seed), np.diff(times, prepend=-1) > 0
    mean, height = made.planes.mean(0, dtype=np.float32), made.luma.shape[1]
    down, right = np.gradient(mean[:height])
    noise = _noise(made, mean)
    moves = [np.stack([_series(own, times, axis) for axis in (0, 1)], 1) for own in tones]
    soft = [gaussian_filter(mask, _EDGE_PX) for mask in _grown(masks)]

    def pictures() -> Iterator[np.ndarray]:
        for k in range(len(times)):
            if is_new[k]:
                shown = mean + noise * rng.standard_normal(mean.shape, dtype=np.float32)
                for u, mask in zip(moves, soft, strict=True):
                    shown[:height] -= mask * (u[k, 0] * right + u[k, 1] * down)
            yield np.clip(np.rint(shown), 0, 255).astype(np.uint8)

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "test.mkv"
        _encode(path, made, pictures())
        seen = _decoded(path)[is_new]
    return [
        [gain_of(u, own, j, times[is_new]) for j in range(len(own))]
        for own, u in ((own, shifts_of(seen, mask)) for own, mask in zip(tones, masks, strict=True))
    ]


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
    with av.open(str(path), "w") as container:
        stream = container.add_stream(made.encoder, rate=made.rate)
        stream.height, stream.width = made.luma.shape[1:]
        stream.pix_fmt = "yuv420p"
        options = rate_options(made)
        stream.codec_context.options = options
        stream.codec_context.thread_count = 1
        if "b" in options:
            stream.bit_rate = round(made.bits)
        for k, planes in enumerate(pictures):
            frame = av.VideoFrame.from_ndarray(planes, format="yuv420p")
            frame.pts, frame.time_base = k, 1 / made.rate
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


def _decoded(path: Path) -> np.ndarray:
    """[F, H, W] uint8 luma."""
    with av_module().open(str(path)) as container:
        return np.stack([f.to_ndarray()[: f.height] for f in container.decode(video=0)])


def shifts_of(seen: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """[F, 2] pixels right and down of a region about its mean picture, by least squares (Lucas & Kanade 1981)."""
    inside = mask > 0.5
    mean = seen.mean(0, dtype=np.float32)
    down, right = np.gradient(mean)
    slopes = np.stack([right[inside], down[inside]])
    slopes -= slopes.mean(1, keepdims=True)
    changes = seen[:, inside].astype(np.float32) - mean[inside]
    changes -= changes.mean(1, keepdims=True)
    return np.linalg.lstsq((slopes @ slopes.T).astype(np.float64), -(slopes @ changes.T), rcond=None)[0].T


def gain_of(u: np.ndarray, tones: Sequence[Tone], j: int, times: np.ndarray) -> tuple[float, float]:
    """Of tone j in the shifts u [F, 2]: along its direction, with all tones fitted, and the error that noise makes."""
    main = tones[j].phasor
    waves = [f(2 * np.pi * t.frequency_hz * times) for t in tones for f in (np.cos, np.sin)]
    design = np.stack([np.ones(len(times)), *waves], 1)
    answer, *_ = np.linalg.lstsq(design, u, rcond=None)
    phasor = answer[1 + 2 * j] - 1j * answer[2 + 2 * j]
    size = float((np.abs(main) ** 2).sum())
    gain = float((phasor @ main.conj()).real) / size
    left = u - design @ answer
    direction = np.abs(main) / np.sqrt(size)
    spectrum = np.fft.rfft(left * np.hanning(len(left))[:, None], axis=0)
    hz = np.arange(len(spectrum)) / (len(times) * (times[1] - times[0]))
    near = np.argsort(np.abs(hz - tones[j].frequency_hz))[:16]
    power = (np.abs(spectrum[near]) ** 2).mean(0) / (np.hanning(len(left)) ** 2).sum()
    return gain, float(np.sqrt(2 / len(times) * (power * direction**2).sum() / size))
