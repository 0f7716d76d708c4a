"""One look through a recording: its times, how its camera moves, how sharp it is, its mean; and what is wrong with it.

sfm/survey/<clip>.json and .png, so that a look is taken once.
"""

import warnings
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from scipy.ndimage import laplace

from tg4mm.capture.cameras import check_picture_size
from tg4mm.capture.codec.trial import codec_period
from tg4mm.capture.duplicates import DuplicateMeter, Duplicates
from tg4mm.capture.scene import KINDS_OF_PICTURES
from tg4mm.capture.sfm.clip import (
    Clip,
    Frame,
    TimeWindow,
    check_numbers,
    clip_frames,
    frame_rate,
    is_regular,
    regular_times,
)
from tg4mm.capture.sfm.steadiness import NoveltyMeter, PartMeter, reduced
from tg4mm.capture.video import VideoInfo, video_info
from tg4mm.core.errors import CaptureError
from tg4mm.core.files import write_atomic, write_json
from tg4mm.core.progress import progress
from tg4mm.core.untrusted import JsonRecord, read_record

BLACK = 16  # of 255: a frame whose brightest hundredth does not reach it shows nothing
NOTHING = -1  # the part of such a frame
FASTEST = 10**9  # frames a second
_EVERY = 8  # pixels in each direction, of which one is read for the light


@dataclass(frozen=True)
class Survey:
    """The results of one pass through a clip's T pictures."""

    name: str
    path: Path  # of the clip
    mean: Path  # its mean picture, RGB or RGBA, 8 bits
    size: tuple[int, int]  # width and height in pixels
    fps: Fraction | None  # as the container has it; None for a folder
    times: tuple[Fraction, ...] | None  # T, seconds since the first frame; None for a folder
    parts: np.ndarray  # [T] which scene a frame shows, from 0; NOTHING of a black one
    shifts_px: np.ndarray  # [T, 2] of the whole picture from the first one of its part; NaN: no likeness
    together: np.ndarray  # [T] share of the blocks with something to see that this shift makes more alike
    repeats: tuple[int, ...]  # duplicate frames of the recording, left out of the T
    share: Fraction | None  # of its frames that are left, in a regular pattern; None: without one
    frozen: np.ndarray  # [T] bool: frames that repeat the one before, in a recording that does not
    sharpness: np.ndarray  # [T] variance of the Laplacian
    codec_period: int | None  # frames, from one that is predicted forward to the next; None: no period
    created_s: float | None  # when the recording began, seconds since 1970
    light: np.ndarray  # [T, 3] logarithms of green, red / green and blue / green, of the first picture's
    filmed_at: float | None = None  # frames per second, where the file says that its times are others
    kinds: str = ""  # of each picture I, P or B, as a video's frames are coded; empty: not known

    def __len__(self) -> int:
        """T, the number of pictures."""
        return len(self.sharpness)

    def clock(self, fps: float | None = None) -> tuple[float, np.ndarray]:
        """Return the frame rate and the times [T] in seconds; fps: the filmed rate, None: as the file says.

        Raises CaptureError if neither the container nor fps gives a rate.
        """
        if self.times is None or self.fps is None:
            if fps is None:
                raise CaptureError(
                    f"--fps is missing: the pictures of {self.name} need their frames per second"
                )
            rate = fps * float(self.share or 1)
            return rate, np.arange(len(self)) / rate
        fps = fps or self.filmed_at
        stretch = 1.0 if fps is None else float(self.fps) / fps
        return fps or float(self.fps), np.array([float(time) for time in self.times]) * stretch


def survey_clip(clip: Clip, folder: Path, window: TimeWindow, keep_duplicates: bool = False) -> Survey:
    """Look through a clip, or read what an earlier look wrote to `folder`.

    keep_duplicates: duplicate frames are not looked for. Raises CaptureError for a recording that is damaged, black, or
    holds fewer than two frames.
    """
    path = folder / f"{clip.name}.json"
    if not path.is_file():
        folder.mkdir(parents=True, exist_ok=True)
        write_json(path, _looked_through(clip, folder, window, keep_duplicates))
    try:
        return _read(clip, folder, read_record(path).values)
    except (CaptureError, KeyError, TypeError, ValueError, ArithmeticError):
        raise CaptureError(f"{path}: is damaged or edited; remove it and run the command again") from None


def _looked_through(clip: Clip, folder: Path, window: TimeWindow, keep_duplicates: bool) -> dict[str, Any]:
    info = video_info(clip.path) if clip.is_video else None
    check_numbers(clip.pictures)
    total = (info.total if info else len(clip.pictures)) or 1
    look = _SurveyLook(clip)
    with progress(f"reading {clip.name}", total, "frames") as update:
        for frame in clip_frames(clip, window):
            look.add(frame)
            update(min(frame.index + 1, total))
    if len(look.sharpness) < 2:
        span = "" if window.is_all else f" from {window.start_s:g} s to {window.stop_s:g} s"
        raise CaptureError(f"{clip.path}: holds {len(look.sharpness)} frames{span}, at least 2 are needed")
    write_atomic(folder / f"{clip.name}.png", lambda temporary: look.mean().save(temporary, format="PNG"))
    return look.record(info, keep_duplicates)


def _read(clip: Clip, folder: Path, record: dict[str, Any]) -> Survey:
    """Raises one of many errors for a record that is not as `_SurveyLook.record` gives it."""
    times, fps = record["times"], record["fps"]
    sharpness = np.array(record["sharpness"], np.float64)
    shifts = [[np.nan if x is None else x for x in row] for row in record["shifts_px"]]
    shifts_px = np.array(shifts, np.float64).reshape(len(sharpness), 2)
    parts = np.array([int(part) for part in record["parts"]], np.int64)
    frozen = np.array([bool(x) for x in record["frozen"]], bool)
    together = np.array([np.nan if x is None else x for x in record["together"]], np.float64)
    written = record.get("share", 1)
    share = None if written is None else Fraction(written)
    if (share is not None and not 0 < share <= 1) or np.isinf(together).any():
        raise ValueError("a share that is none")
    if not len(parts) == len(frozen) == len(together) == len(
        sharpness
    ) or not NOTHING <= parts.min() <= parts.max() < len(parts):
        raise ValueError("parts that are not those of the pictures")
    moments = None if times is None else tuple(Fraction(time) for time in times)
    if moments is not None and len(moments) != len(sharpness):
        raise ValueError(f"{len(moments)} times of {len(sharpness)} pictures")
    if moments is not None and any(b <= a for a, b in pairwise(moments)):
        raise ValueError("times that do not go forward")
    if sharpness.ndim != 1 or not np.isfinite(sharpness).all() or np.isinf(shifts_px).any():
        raise ValueError("a number that is not finite")
    found = JsonRecord(clip.name, record)
    return Survey(
        name=clip.name,
        path=clip.path,
        mean=folder / f"{clip.name}.png",
        size=(found.whole("width", 1), found.whole("height", 1)),
        fps=None if fps is None else _positive(Fraction(fps)),
        times=moments,
        parts=parts,
        shifts_px=shifts_px,
        together=together,
        repeats=tuple(int(k) for k in record.get("repeats", [])),
        share=share,
        frozen=frozen,
        sharpness=sharpness,
        codec_period=found.whole("codec_period", 2) if found.has("codec_period") else None,
        light=np.array(record.get("light", []), np.float64).reshape(-1, 3),
        created_s=found.number("created_s") if found.has("created_s") else None,
        filmed_at=found.number("filmed_at", 0) if found.has("filmed_at") else None,
        kinds=_kinds(record.get("kinds", ""), len(sharpness)),
    )


def _kinds(text: Any, count: int) -> str:
    if not isinstance(text, str) or text.strip(KINDS_OF_PICTURES) or len(text) not in (0, count):
        raise ValueError(f"kinds are {text!r}, expected {count} of {', '.join(KINDS_OF_PICTURES)}")
    return text


def _positive(rate: Fraction) -> Fraction:
    if not 0 < rate < FASTEST:
        raise ValueError(f"{rate} frames a second")
    return rate


class _SurveyLook:
    def __init__(self, clip: Clip) -> None:
        self.clip = clip
        self.times: list[Fraction | None] = []
        self.shifts: list[tuple[float, float]] = []
        self.together: list[float] = []
        self.sharpness: list[float] = []
        self.parts: list[int] = []
        self._between: list[bool] = []
        self._kinds: list[str] = []
        self._brightest = 0.0
        self._light, self._first = list[np.ndarray](), np.zeros(0)
        self._sum: np.ndarray | None = None  # of colour · alpha, and of alpha where there is any
        self._meter = PartMeter()
        self._novelty = NoveltyMeter()
        self._duplicates: DuplicateMeter | None = DuplicateMeter()  # None: a frame was black

    def add(self, frame: Frame) -> None:
        if not self.times:
            check_picture_size(self.clip.path, frame.pixels.shape[1], frame.pixels.shape[0])
        pixels = frame.pixels if frame.pixels.dtype == np.uint8 else (frame.pixels >> 8).astype(np.uint8)
        if pixels.shape[2] == 4 and (pixels[..., 3] == 255).all():
            pixels = pixels[..., :3]
        self._add_to_sum(frame, pixels)
        grey, k = reduced(pixels[..., 1])  # green carries most of the light, and is there without arithmetic
        brightest = float(np.quantile(grey, 0.99))
        if brightest < BLACK:
            self._novelty.add_black()
            self._duplicates = None
            part, x, y, together = NOTHING, np.nan, np.nan, np.nan
        else:
            self._novelty.add(pixels[::k, ::k, 1], frame.is_alone)
            part, x, y, together = self._meter.add(grey)
        if self._duplicates is not None:
            self._duplicates.add(pixels[..., 1], frame.is_alone, frame.is_between)
        self.times.append(frame.time)
        self._between.append(frame.is_between)
        self._kinds.append("I" if frame.is_alone else "B" if frame.is_between else "P")
        self.parts.append(part)
        self.shifts.append((x * k, y * k))
        self.together.append(together)
        self.sharpness.append(float(laplace(grey).var()))
        self._brightest = max(self._brightest, brightest)
        few = np.log1p(pixels[::_EVERY, ::_EVERY, :3].astype(np.float32))
        few[..., [0, 2]] -= few[..., 1:2]
        self._first = self._first if self._light else few
        self._light.append(np.median((few - self._first)[..., [1, 0, 2]], (0, 1)))

    def _add_to_sum(self, frame: Frame, pixels: np.ndarray) -> None:
        if pixels.shape[2] == 4:
            alpha = pixels[..., 3:] / np.float32(255)
            pixels = np.concatenate([pixels[..., :3] * alpha, 255 * alpha], axis=2)
        if self._sum is None:
            self._sum = np.zeros(pixels.shape, np.float32)
        if self._sum.shape != pixels.shape:
            where = frame.path or self.clip.path
            (h, w, _), (first_h, first_w, _) = pixels.shape, self._sum.shape
            raise CaptureError(
                f"{where}: frame {frame.index} is {w}×{h} pixels, the first is {first_w}×{first_h}"
                + (", or only some are transparent" if (h, w) == (first_h, first_w) else "")
            )
        self._sum += pixels

    def _check(self, is_new: np.ndarray) -> None:
        path = self.clip.path
        if self._brightest < BLACK:
            raise CaptureError(f"{path}: is black: its brightest pixels reach {self._brightest:.0f} of 255")
        if self._novelty.hardly_changes(is_new):
            warnings.warn(
                f"{path.name}: hardly anything changes from frame to frame: the recording is a single picture, or "
                "compression removed the changes",
                stacklevel=2,
            )

    def mean(self) -> Image.Image:
        assert self._sum is not None
        values = self._sum / len(self.sharpness)
        if values.shape[2] == 4:
            values[..., :3] /= np.maximum(values[..., 3:], 1e-3) / 255
        return Image.fromarray((np.clip(values, 0, 255) + 0.5).astype(np.uint8))

    def record(self, info: VideoInfo | None, keep_duplicates: bool) -> dict[str, Any]:
        assert self._sum is not None
        fps, times = self._clock(info)
        found = None if keep_duplicates else self._found(times, fps, info)
        is_new = np.ones(len(self.sharpness), bool) if found is None else found.is_new
        self._check(is_new)
        kept, share = np.flatnonzero(is_new), Fraction(1) if found is None else found.share
        if found is not None and times is not None and fps is not None:
            times = [times[0] + t for t in found.times(fps)]
            fps *= share or 1
        return {
            "width": self._sum.shape[1],
            "height": self._sum.shape[0],
            "fps": None if fps is None else str(fps),
            "times": None if times is None else [str(time) for time in times],
            "repeats": [] if found is None else list(found.rows),
            "share": None if share is None else str(share),
            "shifts_px": [[None if np.isnan(x) else round(x, 4) for x in self.shifts[k]] for k in kept],
            "together": [None if np.isnan(self.together[k]) else round(self.together[k], 4) for k in kept],
            "parts": [self.parts[k] for k in kept],
            "frozen": self._novelty.frozen_frames(is_new)[kept].tolist(),
            "sharpness": [self.sharpness[k] for k in kept],
            "codec_period": codec_period(np.array(self._between)) if found is None else None,
            "light": [[round(float(x), 5) for x in self._light[k]] for k in kept],
            "kinds": "".join(self._kinds[k] for k in kept) if self.clip.is_coded else "",
            "filmed_at": None if info is None else info.filmed_at,
            "created_s": info.created.timestamp() if info is not None and info.created is not None else None,
        }

    def _found(
        self, times: list[Fraction] | None, fps: Fraction | None, info: VideoInfo | None
    ) -> Duplicates | None:
        """Return the duplicates; None if the file's clock is irregular, since such a file needs none."""
        if self._duplicates is None:
            return None
        if info is None:  # without times only a pattern determines when pictures were taken
            return self._duplicates.found(irregular=False)
        is_regular_clock = times is not None and fps is not None and is_regular(times, fps, info.tick)
        return self._duplicates.found() if is_regular_clock else None

    def _clock(self, info: VideoInfo | None) -> tuple[Fraction | None, list[Fraction] | None]:
        times = [time for time in self.times if time is not None]
        if info is None or self.clip.is_untimed or len(times) < len(self.times):
            return None, None
        fps = frame_rate(self.clip.path, times, info.rates, info.tick)
        return fps, regular_times(times, fps, info.tick)
