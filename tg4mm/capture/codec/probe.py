"""What a video file tells of its encoder, and its brightness frame by frame as it is stored."""

import re
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np

from tg4mm.capture.planes import Orientation, orientation_of
from tg4mm.capture.video import ALONE, BETWEEN, av_module, opened, stream_of
from tg4mm.core.errors import Tg4mmError

_REGULAR = 0.8  # of the distances, that one must have to be a period
_PIXELS = ("yuv420p", "yuvj420p", "yuv420p10le")  # what the encoders are given
# Options that x264 and x265 write into the file, by the names under which they take them.
_OPTIONS = ("ref", "bframes", "b-adapt", "b-pyramid", "subme", "me", "trellis", "keyint", "scenecut", "rc-lookahead",
            "weightp", "weightb", "aq-mode", "rd")  # fmt: skip
# Of FFmpeg's names, those that keep every pixel.
_LOSSLESS = {"ffv1", "huffyuv", "ffvhuff", "utvideo", "rawvideo", "magicyuv", "lagarith", "qtrle", "png"}


@dataclass(frozen=True)
class Probe:
    """A stretch of a video as its decoder hands it out."""

    planes: (
        np.ndarray
    )  # [F, 3 H / 2, W] uint8, or uint16 of 10 bits, brightness and below it both colours, not turned
    is_key: np.ndarray  # [F] bool
    is_between: np.ndarray  # [F] bool
    rate: Fraction  # frames per second of the file
    bits: float  # per second
    encoder: str  # libx264, libx265, or "" where neither made it
    settings: dict[str, str]  # that the encoder wrote into the file
    orientation: Orientation

    @property
    def luma(self) -> np.ndarray:
        """[F, H, W], as the planes are."""
        return self.planes[:, : self.planes.shape[1] * 2 // 3]

    @property
    def pixels(self) -> str:
        """FFmpeg's name of their format."""
        return "yuv420p" if self.planes.dtype == np.uint8 else "yuv420p10le"


def probe(path: Path, start_s: float, most: int) -> Probe | None:
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
    own = np.array(kinds)
    return Probe(
        np.stack(planes), own == ALONE, own == BETWEEN, rate, 8 * float(np.mean(packets)) * float(rate),
        _encoder(codec, settings), _settings(settings), orientation,
    )  # fmt: skip


def is_lossless(path: Path) -> bool:
    """Whether a video's compression keeps every pixel: by its codec, or by what x264 and x265 wrote into the file.

    False where it cannot be read: who reads it says why.
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
    """The library that made it, where it says so and is here."""
    for name, made, library in (("x264", "h264", "libx264"), ("x265", "hevc", "libx265")):
        if name in settings[:200] and codec == made and library in av_module().codecs_available:
            return library
    return ""


def _settings(text: str) -> dict[str, str]:
    """Return the settings in `options: cabac=1 ref=3 …`; x265 writes switches without a value, which are left out."""
    found = dict(re.findall(r"([\w-]+)=([\w.]+)", text.partition("options:")[2]))
    return {key.replace("_", "-"): value for key, value in found.items()}


def rate_options(made: Probe) -> dict[str, str]:
    """Encoder options under which it would make a video of the same quality and kinds of frames."""
    own = made.settings
    options = {key: own[key] for key in _OPTIONS if key in own}
    control = own.get("rc", "")
    if control == "crf" and "crf" in own:
        rate = {"crf": own["crf"]}
    elif control == "cqp" and "qp" in own:
        rate = {"qp": own["qp"]}
    else:
        rate = {"b": str(round(made.bits))}
        if "vbv-maxrate" in own and "vbv-bufsize" in own:  # thousands of bits
            rate |= {"maxrate": own["vbv-maxrate"] + "000", "bufsize": own["vbv-bufsize"] + "000"}
    which = "x264-params" if made.encoder == "libx264" else "x265-params"
    quiet = {} if made.encoder == "libx264" else {"log-level": "none", "pools": "none", "frame-threads": "1"}
    joined = ":".join(f"{key}={value}" for key, value in (options | quiet).items())
    return rate | ({which: joined} if joined else {})


def codec_period(is_between: np.ndarray) -> int | None:
    """The distance of two frames that are predicted forward, if nearly all have one; is_between [T]: all others."""
    steps = np.diff(np.flatnonzero(~is_between))
    if not len(steps):
        return None
    period = int(np.bincount(steps).argmax())
    return period if period > 1 and (steps == period).mean() > _REGULAR else None
