"""Encode a known motion as a video was encoded, and measure what remains; read the encoder's settings from the file."""

import re
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter, maximum_filter

from tg4mm.capture.planes import Orientation, orientation_of
from tg4mm.capture.tracking.region import region_motions
from tg4mm.capture.tracking.registration import Box, resampled
from tg4mm.capture.video import ALONE, BETWEEN, av_module, file_url, opened, stream_of
from tg4mm.core.errors import Tg4mmError
from tg4mm.core.lines import FEWEST
from tg4mm.core.lines.model import LineShape, refined
from tg4mm.core.lines.record import Record, envelope

_NOISE_PX = 8.0  # over which the key frames' noise is averaged
_AROUND_PX = 12  # about a region, that moves with it in the test: a codec decides by blocks of 16 pixels
_SEARCHED = 64  # about a region that is encoded alone; a multiple of 16, as vectors reach 16 pixels
_BLOCK = 16  # the side of a macroblock, which the encoder's grid keeps
_EDGE_PX = 2.0  # over which that motion fades
_TRACE = 1e-3  # of a mask: less is none
_UNEVEN = 0.01  # of a frame
_RESOLVED = 2.0  # deviations of a decay

_REGULAR = 0.8  # of the distances, that one must have to be a period
_PIXELS = ("yuv420p", "yuvj420p", "yuv420p10le")  # what the encoders are given
# Options that x264 and x265 write into the file, by the names under which they take them.
_OPTIONS = ("ref", "bframes", "b-adapt", "b-pyramid", "subme", "me", "trellis", "keyint", "scenecut", "rc-lookahead",
            "weightp", "weightb", "aq-mode", "rd")  # fmt: skip
# Of FFmpeg's names, those that keep every pixel.
_LOSSLESS = {"ffv1", "huffyuv", "ffvhuff", "utvideo", "rawvideo", "magicyuv", "lagarith", "qtrle", "png"}


@dataclass(frozen=True)
class CodecSample:
    """A part of a video as decoded."""

    # [F, 3 H / 2, W] uint8, or uint16 of 10 bits, brightness and below it both colours, not turned
    planes: np.ndarray
    is_key: np.ndarray  # [F] bool
    is_between: np.ndarray  # [F] bool
    rate: Fraction  # frames per second of the file
    bits: float  # per second
    encoder: str  # libx264, libx265, or "" where neither made it
    settings: dict[str, str]  # that the encoder wrote into the file
    orientation: Orientation

    @property
    def luma(self) -> np.ndarray:
        """Return [F, H, W], as the planes are."""
        return self.planes[:, : self.planes.shape[1] * 2 // 3]

    @property
    def is_local(self) -> bool:
        """Return whether a part of a picture is encoded as within the whole.

        x264 then chooses the quality of each block by the block and those that refer to it: at constant quality with
        its tree of macroblocks, or with a constant quantiser. Otherwise the rate or the mean of the picture counts.
        """
        of_file = self.settings
        constant = of_file.get("rc") == "cqp" or (of_file.get("rc") == "crf" and of_file.get("mbtree") == "1")
        return self.encoder == "libx264" and constant and of_file.get("aq", "1") in ("0", "1")

    def within(self, box: Box) -> "CodecSample":
        """Return the part of the pictures in a box of even sides."""
        n, (height, width) = len(self.planes), self.luma.shape[1:]
        colours = self.planes.reshape(n, -1)[:, height * width :].reshape(n, 2, height // 2, width // 2)
        half = [slice(side.start // 2, side.stop // 2) for side in box]
        luma, colours = self.luma[:, *box], colours[:, :, *half]
        parts = [luma.reshape(n, -1), colours.reshape(n, -1)]
        return replace(self, planes=np.concatenate(parts, 1).reshape(n, -1, luma.shape[2]))

    @property
    def pixels(self) -> str:
        """Name of the pixel format in FFmpeg."""
        return "yuv420p" if self.planes.dtype == np.uint8 else "yuv420p10le"


@dataclass(frozen=True)
class MeasuredTone:
    """A measured vibration of one region."""

    frequency_hz: float  # of the pictures' clock
    phasor: np.ndarray  # [2] complex, pixels right and down, zero to peak, where the envelope is 1
    decay_per_s: float = 0.0  # of the envelope, which is 1 at `start_s`
    start_s: float = 0.0  # since the first frame: before it there is no motion

    def wave(self, times: np.ndarray) -> np.ndarray:
        """Return [F] complex at times [F] in seconds: the phasor's factor."""
        turning = np.exp(2j * np.pi * self.frequency_hz * times)
        return turning * envelope(times, self.decay_per_s, self.start_s, self.start_s or None)


@dataclass(frozen=True)
class TestedTone:
    """A tone as measured after an encoding."""

    gain: float  # of its amplitude
    error: float  # standard deviation of the gain by noise
    decay_per_s: float = 0.0  # as measured; 0 where none is resolved
    decay_error: float = 0.0


def through(
    made: CodecSample,
    masks: Sequence[np.ndarray],
    tones: Sequence[Sequence[MeasuredTone]],
    times: np.ndarray,
    seed: int,
    without_between: bool,
) -> list[list[TestedTone]]:
    """Measure each region's tones after one encoding."""
    most = 255 if made.pixels == "yuv420p" else 1023
    rng, is_new = np.random.default_rng(seed), np.diff(times, prepend=-1) > 0
    mean, height = made.planes.mean(0, dtype=np.float32), made.luma.shape[1]
    luma = mean[:height]
    noise = _noise(made, mean)
    moves = [np.stack([_series(of_region, times, axis) for axis in (0, 1)], 1) for of_region in tones]
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
        [gain_of(u, of_region, j, times[used]) for j in range(len(of_region))]
        for of_region, u in zip(tones, shifts_of(seen[used], masks, times[used]), strict=True)
    ]


def _box_of(mask: np.ndarray) -> Box:
    """Return the rows and columns in which a mask is not 0."""
    rows, columns = (np.flatnonzero((mask > _TRACE).any(axis)) for axis in (1, 0))
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


def box_about(mask: np.ndarray) -> Box:
    """Return the blocks of 16 pixels about a region, as far as an encoder looks for what moved there."""

    def blocks(side: slice, most: int) -> slice:
        first, last = (side.start - _SEARCHED) // _BLOCK, -(-(side.stop + _SEARCHED) // _BLOCK)
        return slice(max(0, first * _BLOCK), min(most, last * _BLOCK))

    (rows, columns), (height, width) = _box_of(mask), mask.shape
    return blocks(rows, height), blocks(columns, width)


def _grown(masks: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Return the regions with their surroundings that belong to no other."""
    wide = [maximum_filter(mask, 2 * _AROUND_PX + 1) for mask in masks]
    every = np.max(masks, axis=0)
    return [
        np.where(every > 0, mask, grown).astype(np.float32) for mask, grown in zip(masks, wide, strict=True)
    ]


def _noise(made: CodecSample, mean: np.ndarray) -> np.ndarray:
    """Return [3 H / 2, W]: the smoothed standard deviation of the key frames about the mean, luma and chroma apart."""
    n, height = len(made.planes), made.luma.shape[1]
    keys = made.planes[made.is_key] if made.is_key.any() else made.planes[:1]
    variance = (np.mean([(key - mean) ** 2 for key in keys], axis=0) * n / max(n - 1, 1)).astype(np.float32)
    parts = variance[:height], variance[height:]
    return np.sqrt(np.concatenate([gaussian_filter(part, _NOISE_PX) for part in parts]))


def _series(tones: Sequence[MeasuredTone], times: np.ndarray, axis: int) -> np.ndarray:
    """Return [F] pixels."""
    waves = [(t.phasor[axis] * t.wave(times)).real for t in tones]
    return np.sum(waves, axis=0)


def _encode(path: Path, made: CodecSample, pictures: Iterable[np.ndarray]) -> None:
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
    """Luma [F, H, W] as it is stored, and [F] bool: B-frames."""
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


def gain_of(u: np.ndarray, tones: Sequence[MeasuredTone], j: int, times: np.ndarray) -> TestedTone:
    """Return the gain of tone j in the shifts u [F, 2], along its direction, with all tones fitted."""
    if tones[j].decay_per_s > 0 and (found := _decaying_gain(u, tones, j, times)) is not None:
        return found
    main = tones[j].phasor
    waves = [part for wave in (t.wave(times) for t in tones) for part in (wave.real, -wave.imag)]
    design = np.stack([np.ones(len(times)), *waves], 1)
    answer, *_ = np.linalg.lstsq(design, u, rcond=None)
    phasor = answer[1 + 2 * j] + 1j * answer[2 + 2 * j]
    size = float((np.abs(main) ** 2).sum())
    gain = float((phasor @ main.conj()).real) / size
    left = u - design @ answer
    direction = np.abs(main) / np.sqrt(size)
    steps = np.diff(times)
    if np.ptp(steps) > _UNEVEN * steps[0]:  # frames are left out: as of white noise
        power = (left**2).sum(0) / max(len(times) - design.shape[1], 1)
        return TestedTone(gain, float(np.sqrt(2 / len(times) * (power * direction**2).sum() / size)))
    spectrum = np.fft.rfft(left * np.hanning(len(left))[:, None], axis=0)
    hz = np.arange(len(spectrum)) / (len(times) * (times[1] - times[0]))
    near = np.argsort(np.abs(hz - tones[j].frequency_hz))[:16]
    power = (np.abs(spectrum[near]) ** 2).mean(0) / (np.hanning(len(left)) ** 2).sum()
    return TestedTone(gain, float(np.sqrt(2 / len(times) * (power * direction**2).sum() / size)))


def _decaying_gain(
    u: np.ndarray, tones: Sequence[MeasuredTone], j: int, times: np.ndarray
) -> TestedTone | None:
    """Return amplitude and decay of tone j as the measurement does, from its beginning on; None if unresolved."""
    own, size = tones[j], float(np.linalg.norm(tones[j].phasor))
    since = times >= own.start_s - 1e-9
    if since.sum() < FEWEST + 4 * len(tones) or not size:
        return None
    # frames without B may be too few a second for their half
    ends = 0.0, 2 * max(t.frequency_hz for t in tones)
    record = Record.of(u[since], times[since], 0.0, ends)
    if record is None:
        return None
    shapes = [LineShape(t.frequency_hz, t.decay_per_s, 0, t.decay_per_s > 0) for t in tones]
    shapes = refined(shapes, record.t, record.y, ends)
    line = record.whitened(shapes).result(shapes).lines[j]
    if line.decay_per_s < _RESOLVED * np.sqrt(line.covariance[1, 1]):
        return None
    error = float(np.linalg.norm(line.amplitude_deviation * np.abs(own.phasor))) / size**2
    decay_error = float(np.sqrt(line.covariance[1, 1]))
    return TestedTone(float(np.linalg.norm(line.phasor)) / size, error, line.decay_per_s, decay_error)


def probe(path: Path, start_s: float, most: int) -> CodecSample | None:
    """`most` frames from start_s on; None where it is no video of 8 or 10 bits with half the colour, or of odd size.

    Raises Tg4mmError where PyAV is absent, OSError and FFmpegError where the file cannot be read.
    """
    planes, kinds, settings = [], [], ""
    with opened(path) as container:
        stream = stream_of(container)
        context, rate = stream.codec_context, stream.average_rate or stream.guessed_rate
        if context.pix_fmt not in _PIXELS or context.width % 2 or context.height % 2 or not rate:
            return None
        codec, first = context.name, None
        for frame in container.decode(stream):
            for data in frame.side_data:
                if data.type.name == "SEI_UNREGISTERED" and not settings:
                    settings = bytes(data)[16:].decode("latin1")
            stamp = float(frame.pts * frame.time_base) if frame.pts is not None else 0.0
            first = stamp if first is None else first
            if stamp - first < start_s - 1e-6:
                continue
            planes.append(frame.to_ndarray())
            kinds.append(int(frame.pict_type))
            orientation = orientation_of(frame)
            if len(planes) == most:
                break
    if len(planes) < 2:
        return None
    with opened(path) as container:
        packets = [p.size for p in container.demux(stream_of(container)) if p.size]
    kind_of = np.array(kinds)
    return CodecSample(
        np.stack(planes), kind_of == ALONE, kind_of == BETWEEN, rate, 8 * float(np.mean(packets)) * float(rate),
        _encoder(codec, settings), _settings(settings), orientation,
    )  # fmt: skip


def is_lossless(path: Path) -> bool:
    """Return whether a video is lossless, by its codec or by the settings of x264 and x265 in the file.

    False for an unreadable file: reading it reports the error.
    """
    av = av_module()
    try:
        with opened(path) as container:
            stream = stream_of(container)
            if stream.codec_context.name not in ("h264", "hevc"):
                return stream.codec_context.name in _LOSSLESS
            frame = next(container.decode(stream), None)
            data = frame.side_data if frame else ()
            texts = [bytes(d)[16:].decode("latin1") for d in data if d.type.name == "SEI_UNREGISTERED"]
    except (OSError, ValueError, Tg4mmError, av.FFmpegError):
        return False
    options = texts[0].rstrip("\0").partition("options:")[2].split() if texts else []
    return "lossless" in options or ("rc=cqp" in options and "qp=0" in options)


def _encoder(codec: str, settings: str) -> str:
    """Return the library that encoded the video, if named and available."""
    for name, made, library in (("x264", "h264", "libx264"), ("x265", "hevc", "libx265")):
        if name in settings[:200] and codec == made and library in av_module().codecs_available:
            return library
    return ""


def _settings(text: str) -> dict[str, str]:
    """Return the settings in `options: cabac=1 ref=3 …`; x265 writes switches without a value, which are left out."""
    found = dict(re.findall(r"([\w-]+)=([\w.]+)", text.partition("options:")[2]))
    return {key.replace("_", "-"): value for key, value in found.items()}


def rate_options(made: CodecSample) -> dict[str, str]:
    """Return encoder options that reproduce the quality and the frame kinds."""
    settings = made.settings
    options = {key: settings[key] for key in _OPTIONS if key in settings}
    control = settings.get("rc", "")
    if control == "crf" and "crf" in settings:
        rate = {"crf": settings["crf"]}
    elif control == "cqp" and "qp" in settings:
        rate = {"qp": settings["qp"]}
    else:
        rate = {"b": str(round(made.bits))}
        if "vbv-maxrate" in settings and "vbv-bufsize" in settings:  # thousands of bits
            rate |= {"maxrate": settings["vbv-maxrate"] + "000", "bufsize": settings["vbv-bufsize"] + "000"}
    which = "x264-params" if made.encoder == "libx264" else "x265-params"
    quiet = {} if made.encoder == "libx264" else {"log-level": "none", "pools": "none", "frame-threads": "1"}
    joined = ":".join(f"{key}={value}" for key, value in (options | quiet).items())
    return rate | ({which: joined} if joined else {})


def codec_period(is_between: np.ndarray) -> int | None:
    """Return the distance between P-frames if nearly all have one; is_between [T]: B-frames."""
    steps = np.diff(np.flatnonzero(~is_between))
    if not len(steps):
        return None
    period = int(np.bincount(steps).argmax())
    return period if period > 1 and (steps == period).mean() > _REGULAR else None
