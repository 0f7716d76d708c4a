"""Input of the motion stage: posed cameras, their pictures and times (docs/method.md, "Observation model").

Only the part of a recording where motion may be is read, and of a long recording fewer, larger pixels: time and
temporary files of the stage grow with pixels times pictures. Displacements of less than a pixel can be estimated from
averaged pixels if the texture is coarse enough; the loss is reported.
"""

import warnings
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tg4mm.capture import Capture, ImageStack
from tg4mm.capture.model import FEWEST_FRAMES, FEWEST_MOVING
from tg4mm.capture.pictures import FilePictures, MaskedPictures, Pictures, Window, mask_of, over_white
from tg4mm.capture.scene import codec_period
from tg4mm.core.choices import Clock, Kind
from tg4mm.core.errors import CaptureError
from tg4mm.core.even_clock import later
from tg4mm.core.progress import progress
from tg4mm.fit.motion.config import MotionConfig, asked_factor
from tg4mm.fit.space.view import EPS2D

STRIP_VALUES = 1 << 23  # float32 values of a strip, 32 MiB; compositing it takes about three times that
# of a frame: by how much the time stamps of one clock differ from each other, and even ones from even steps
_CLOCK = 0.1
_AT_ONCE = 8  # whole pictures in memory
PERIODS = 2.0  # in the record, of the lowest frequency that a fit may hold
LEAST_PERIODS = 0.5  # of a band that a person gives: less is a slope
CLEAR_PERIODS = 2.5  # of one that is distinguished from drift
PIXELS = 6e8  # times pictures, that are read as they are: about a minute of two cores a pass
PICTURE = 1920 * 1080  # pixels of one picture, likewise: more add little for the number of Gaussians
_SHORTEST = 270  # pixels along a side, which are never made fewer
_AROUND = 16  # pixels at least
_SAMPLED = 16  # pictures from which the fineness of the texture is estimated
SHOWN = 50_000_000  # pixels, which take some seconds
Strips = Iterator[tuple[slice, np.ndarray]]  # rows of the picture, and [F, rows, W, 3] of all F frames


@dataclass(frozen=True)
class PosedFrames:
    """The F pictures that were taken with one pose and one lens."""

    name: str
    viewmat: np.ndarray  # [4, 4] float32, world-to-camera, OpenCV axes
    K: np.ndarray  # [3, 3] float32, pixels
    rows: np.ndarray  # [F] of the capture's pictures
    times_s: np.ndarray  # [F] float64, seconds on this camera's own clock, of the middle row
    readout_s: float = 0.0  # from the first row to the last; 0: all rows at once
    low_pass: float = EPS2D  # square pixels, of the picture that Gaussians make
    carriers: np.ndarray | None = None  # [C, F] known vibrations
    shares: np.ndarray | None = None  # [C, F] of them that the pictures show: a codec's B-frames keep less

    def later(self, functions: np.ndarray, seconds: float) -> np.ndarray:
        """Return functions [R, F], of mean 0, so many seconds later, for rows that are read then.

        A vibration of which frames show unlike shares is no smooth function of time: it is delayed, then shared.
        """
        if self.carriers is None or not seconds:
            return later(self.times_s, functions, seconds)
        shown = self.shares * self.carriers
        moved = self.shares * later(self.times_s, self.carriers, seconds)
        shown, moved = (each - each.mean(1, keepdims=True) for each in (shown, moved))
        weights = np.linalg.lstsq(shown.T, functions.T, rcond=None)[0].T
        return np.asarray(weights @ moved + later(self.times_s, functions - weights @ shown, seconds))

    def through(self, window: Window, height: int) -> "PosedFrames":
        """Return the frames seen through a window on pictures `height` pixels high; averaging widens Gaussians."""
        k, rows = window.factor, window.rows * window.factor
        middle = (window.top + rows / 2) / height - 0.5
        return replace(
            self,
            K=window.K(self.K),
            times_s=self.times_s + self.readout_s * middle,
            readout_s=self.readout_s * rows / height,
            low_pass=(self.low_pass + (k * k - 1) / 12) / k**2,
        )


@dataclass(frozen=True)
class Observations:
    """All pictures of a capture that show motion.

    `clock` is one of: `synchronous`, fixed cameras with the same times; `independent`, fixed cameras each with
    a clock (or a start of the vibration) of its own; `moving`, every picture with a pose of its own.
    """

    kind: Kind
    clock: Clock
    frames: list[PosedFrames]  # V poses
    pictures: Pictures
    fps: float  # Hz
    n_timesteps: int
    is_whole: bool  # no other pictures made the scene at rest
    codec_period: int | None = None  # frames, of the video's compression
    valid_mask: np.ndarray | None = None  # [V, H, W] bool: pixels of each pose that are used; None: all
    # [2L, T] cosine and sine of vibrations that single regions showed, of synchronous cameras; None: not looked for.
    # As the pictures show them: a codec's B-frames keep a share; and the vibrations' own
    time_courses: np.ndarray | None = None
    own_courses: np.ndarray | None = None
    steady_hz: tuple[float, ...] = ()  # of those that neither begin nor ring down: each is a mode
    factor: int = 1  # pixels of the recording along a side of one of these
    is_part: bool = False  # of the recording's pictures: the scene reaches beyond

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        height, width = self.pictures.size
        return width, height

    @cached_property
    def is_opaque(self) -> bool:
        """Return whether pictures show a background, by the first of each of up to four poses."""
        step = max(len(self.frames) // 4, 1)
        rows = [int(f.rows[0]) for f in self.frames[::step]]
        raw = self.pictures.strips(rows)
        return bool((raw(slice(None))[..., 3] == self.pictures.maximum).all())

    @property
    def is_flat(self) -> bool:
        """Return whether the capture is flat: one fixed camera, which shows only motion across its line of sight."""
        return not self.kind.sees_depth

    @property
    def duration_s(self) -> float:
        """Length of the longest record of one clock."""
        if self.clock == Clock.moving:
            times = np.concatenate([f.times_s for f in self.frames])
            return float(np.ptp(times)) + 1 / self.fps
        return max(float(np.ptp(f.times_s)) for f in self.frames) + 1 / self.fps

    @property
    def lowest_hz(self) -> float:
        """The lowest frequency of which the record holds two periods."""
        return PERIODS / self.duration_s


def observe(
    capture: Capture, images: ImageStack | FilePictures, window: Window | None = None
) -> Observations:
    """The observations in a capture of T > 1 timesteps, through a window on its pictures where one is given.

    Raises CaptureError where too few pictures show motion.
    """
    clock, frames = frames_of(capture)
    if clock != Clock.moving and (short := _too_short(capture, frames)):
        warnings.warn(
            f"{', '.join(short)}: left out: fewer than half as many pictures over time as other cameras have",
            stacklevel=2,
        )
    if clock == Clock.moving and capture.readout_s:
        warnings.warn(
            f"{capture.root}: row delays are ignored for a moving camera: readout_s is not used",
            stacklevel=2,
        )
    is_whole = sum(len(f.rows) for f in frames) == len(capture)
    valid = _valid_mask(capture, frames) if capture.masks else None
    factor = 1
    if window is not None:
        frames = [f.through(window, capture.height) for f in frames]
        valid = None if valid is None else np.stack([window.all_of(v) for v in valid])
        images, factor = images.through(window), window.factor
    found = Observations(
        capture.kind, clock, frames, images, capture.fps, capture.n_timesteps, is_whole,
        codec_period(capture.root), valid, factor=factor, is_part=window is not None,
    )  # fmt: skip
    return found if valid is None or clock == Clock.moving else masked(found, ~valid)


def _valid_mask(capture: Capture, frames: Sequence[PosedFrames]) -> np.ndarray:
    """Return [V, H, W] bool: the pixels that count in all pictures of a pose."""
    valid = np.ones((len(frames), capture.height, capture.width), bool)
    for v, of_camera in enumerate(frames):
        for row in of_camera.rows.tolist():
            if (mask := mask_of(capture, row)) is not None:
                valid[v] &= mask
    return valid


def masked(observations: Observations, masks: np.ndarray) -> Observations:
    """Fixed cameras whose masked pixels [V, H, W] bool, which do not count, stay as in each one's first picture."""
    of_row = {int(row): v for v, frames in enumerate(observations.frames) for row in frames.rows}
    first = tuple(int(frames.rows[0]) for frames in observations.frames)
    return replace(observations, pictures=MaskedPictures(observations.pictures, masks, of_row, first))


def check_shows_motion(capture: Capture) -> None:
    """Raise CaptureError where pictures are too few (`frames_of`), or the record too short for any frequency."""
    clock, frames = frames_of(capture)
    longest = max(len(f.rows) for f in frames)
    if clock != Clock.moving and longest < FEWEST_FRAMES:
        raise CaptureError(
            f"{capture.root}: a camera holds {longest} pictures over time, too few to resolve any frequency below half "
            f"the frame rate; expected {FEWEST_FRAMES} or more, better several periods of the vibration"
        )


def check_band_resolved(band: Sequence[float], duration_s: float) -> None:
    """Raise CaptureError for a band (low, high) in Hz of which a record holds less than half a period."""
    lowest = LEAST_PERIODS / duration_s
    if band[1] < lowest:
        raise CaptureError(
            f"--band {band[0]:g} {band[1]:g}: the record of {duration_s:.3g} s contains less than half a period of it, "
            f"which looks like drift; raise the band to {lowest:.3g} Hz or above, or film longer"
        )


def frames_of(capture: Capture) -> tuple[Clock, list[PosedFrames]]:
    """The clock of `Observations`, and the poses with their pictures; those without a time show the scene at rest.

    Raises CaptureError where there are too few pictures to show motion, or cameras declared synchronous are not.
    """
    fixed = fixed_cameras(capture)
    if fixed:
        is_independent = capture.kind.in_turn or (capture.clocks == Clock.independent and len(fixed) > 1)
        are_synchronous = not is_independent and _are_synchronous(fixed)
        if (
            capture.clocks == Clock.synchronous
            and len(fixed) > 1
            and not is_independent
            and not are_synchronous
        ):
            counts = ", ".join(f"{f.name} {len(f.rows)}" for f in fixed)
            raise CaptureError(
                f"{capture.root}: scene.json says that its cameras are synchronous, but their times differ (pictures: "
                f"{counts}); make it again with tg4mm sfm --until, or without --synchronous"
            )
        return Clock.synchronous if are_synchronous else Clock.independent, fixed
    rows = np.flatnonzero(np.isfinite(capture.times_s))
    rows = rows[np.argsort(capture.times_s[rows], kind="stable")]
    if len(rows) < FEWEST_MOVING or len(rows) < capture.n_timesteps / 2:
        raise CaptureError(
            f"{capture.root}: no camera is fixed, and {len(rows)} pictures have a time, too few to show motion; "
            "expected a fixed camera with a picture at every timestep, or one moving camera's video"
        )
    return Clock.moving, [_frames(capture, np.array([row])) for row in rows]


def fixed_cameras(capture: Capture) -> list[PosedFrames]:
    """The cameras that took at least half as many pictures from one pose as the one with the most, and 2 or more."""
    has_time = np.isfinite(capture.times_s)
    counts = np.bincount(capture.camera_ids[has_time], minlength=int(capture.camera_ids.max()) + 1)
    if counts.max(initial=0) < 2:
        return []
    found = []
    for camera in np.flatnonzero(2 * counts >= counts.max()):
        rows = np.flatnonzero((capture.camera_ids == camera) & has_time)
        found.append(_frames(capture, rows[np.argsort(capture.times_s[rows], kind="stable")]))
    return found


def _too_short(capture: Capture, frames: Sequence[PosedFrames]) -> list[str]:
    """Names of cameras with several pictures over time that are not among `frames`."""
    has_time = np.isfinite(capture.times_s)
    taken = {int(capture.camera_ids[f.rows[0]]) for f in frames}
    rows = [
        np.flatnonzero(has_time & (capture.camera_ids == c)) for c in np.unique(capture.camera_ids[has_time])
    ]
    return [
        capture.paths[r[0]].stem for r in rows if len(r) > 1 and int(capture.camera_ids[r[0]]) not in taken
    ]


def _frames(capture: Capture, rows: np.ndarray) -> PosedFrames:
    first = rows[0]
    return PosedFrames(
        capture.paths[first].stem,
        capture.viewmats[first].astype(np.float32),
        capture.Ks[first].astype(np.float32),
        rows,
        capture.times_s[rows],
        capture.rows_s,
    )


def _are_synchronous(frames: list[PosedFrames]) -> bool:
    """Return whether all cameras have the same times, to a tenth of a frame. Steps may differ: phones drop frames."""
    times = frames[0].times_s
    if any(len(f.times_s) != len(times) for f in frames):
        return False
    within = _CLOCK * float(np.median(np.diff(times)))
    return all(np.abs(f.times_s - times).max() < within for f in frames)


def watched(label: str, observations: Observations) -> Iterator[tuple[int, PosedFrames, Strips]]:
    """Every camera's number, frames and strips, with progress where they are many: how many pictures are behind."""
    (width, height), counts = observations.size, [len(frames.rows) for frames in observations.frames]

    def counted(v: int, frames: PosedFrames) -> Strips:
        for rows, strip in strips(observations.pictures, frames):
            yield rows, strip
            update(sum(counts[:v]) + counts[v] * rows.stop // height)

    many = sum(counts) * width * height > SHOWN
    with progress(label, sum(counts), "pictures") if many else nullcontext(lambda _done: None) as update:
        for v, frames in enumerate(observations.frames):
            yield v, frames, counted(v, frames)
            update(sum(counts[: v + 1]))


def strips(pictures: Pictures, frames: PosedFrames) -> Strips:
    """Rows of the picture from top to bottom: slice and [F, rows, W, 3] float32 over white, all F pictures.

    At most `STRIP_VALUES` values at a time, or one row.
    """
    height, width = pictures.size
    at_once = max(STRIP_VALUES // (len(frames.rows) * width * 3), 1)
    raw = pictures.strips(frames.rows.tolist())
    for top in range(0, height, at_once):
        rows = slice(top, min(top + at_once, height))
        yield rows, over_white(raw(rows), pictures.maximum)


def whole_pictures(observations: Observations, rows: np.ndarray) -> Iterator[np.ndarray]:
    """Yield [f, H, W, 3] float32 over white, a few of the pictures `rows` at a time."""
    for first in range(0, len(rows), _AT_ONCE):
        raw = observations.pictures.strips(rows[first : first + _AT_ONCE].tolist())
        yield over_white(raw(slice(None)), observations.pictures.maximum)


def window_on(capture: Capture, config: MotionConfig, moves: np.ndarray | None = None) -> Window | None:
    """The window through which the pictures of fixed cameras are read; None where they are read as they are.

    moves [H, W] bool: where motion may be, if given.
    """
    cameras = fixed_cameras(capture)
    if not cameras:
        return None
    whole = Window.on(capture.height, capture.width, 1, moves)
    factor = asked_factor(config.reduce)
    if factor is None:
        pixels = whole.rows * whole.columns
        share = max(pixels * sum(len(c.rows) for c in cameras) / PIXELS, pixels / PICTURE)
        factor = max(min(int(np.ceil(np.sqrt(share))), min(whole.size) // _SHORTEST), 1)
    # what lies around is held still: without it the prior would carry motion on beyond the region
    margin = max(_AROUND, max(whole.size) // 2)
    window = Window.on(capture.height, capture.width, factor, moves, margin)
    return None if factor == 1 and window.size == (capture.height, capture.width) else window


def note_on(capture: Capture, images: ImageStack | FilePictures, window: Window) -> str:
    """Return a note on the growth of standard deviations by averaging pixels.

    Motion is resolved by slopes of the picture. Averaging k² pixels makes independent noise k times smaller and slopes
    per pixel k times larger, where the texture is coarse. Slopes are separated from noise by the product of two means
    over different pictures.
    """
    rows = fixed_cameras(capture)[0].rows
    some = rows[np.linspace(0, len(rows) - 1, min(len(rows), _SAMPLED)).round().astype(int)].tolist()
    whole = [
        np.mean([window.part(images.rgb(row)) for row in half], axis=0) for half in (some[::2], some[1::2])
    ]
    k = window.factor
    squares = [half.reshape(window.rows, k, window.columns, k, 3).mean((1, 3)) for half in whole]
    ratio = _slopes(*whole) / max(_slopes(*squares), 1e-30)
    height, width = window.size
    return (
        f"motion was fitted to pictures of {width}×{height}, {window.factor}×{window.factor} pixels averaged, which "
        f"makes ± about {np.sqrt(max(ratio, 1.0)):.2g} times as large; tg4mm measure reads them whole, and so does "
        "train with --region around what matters or --set motion.reduce=1"
    )


def _slopes(a: np.ndarray, b: np.ndarray) -> float:
    """Sum of products of the slopes of two pictures of one scene."""
    return float(sum(np.sum(np.diff(a, axis=axis) * np.diff(b, axis=axis)) for axis in (0, 1)))
