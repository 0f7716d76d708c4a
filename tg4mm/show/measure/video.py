"""A video of one fixed camera made ready to be measured, without a dataset and without training."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from tg4mm.capture import Capture
from tg4mm.capture.codec.trial import codec_period
from tg4mm.capture.duplicates import DuplicateMeter
from tg4mm.capture.look import GreyPicture, LookSummary, look_at_pictures
from tg4mm.capture.look.compression import with_losses
from tg4mm.capture.look.reading import BETWEEN, INTRA
from tg4mm.capture.look.recording import taken, video_pictures
from tg4mm.capture.look.rows import with_rows
from tg4mm.capture.model import FEWEST_FRAMES
from tg4mm.capture.scene import VideoFile
from tg4mm.capture.video import RECORDING_SUFFIXES, is_turned, is_untimed, video_info
from tg4mm.core.choices import Clock, Kind
from tg4mm.core.memory import mapped_zeros
from tg4mm.core.progress import progress
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.modes import ModalMotion, MotionFit
from tg4mm.fit.motion.nuisance.fixed_cameras import BlockShifts
from tg4mm.fit.motion.observations import Observations, PosedFrames
from tg4mm.show.measure.scene import GreyPictures, ModalFields, Prepared, SharedClock
from tg4mm.show.measure.sensors import MeasureError

_AT_ONCE = 32  # frames
# as that of a flat dataset: x to the right, z up, y along the line of sight
_VIEWMAT = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
_STRIP = 1 << 24  # values of all frames' rows


def is_video(path: Path) -> bool:
    """Return whether this is a file that `prepare_video` reads, judged by its name."""
    return path.is_file() and path.suffix.lower() in RECORDING_SUFFIXES


def prepare_video(path: Path | str, fps: float | None = None, readout_s: float = 0.0) -> Prepared:
    """Read a video of one fixed camera, for any number of measurements in pixels.

    Args:
        path: the video.
        fps: pictures a second at which it was filmed, where the file says another rate or none.
        readout_s: rolling shutter, seconds from a picture's first row to its last; 0: all rows at once.

    Returns:
        What `measure` takes. A scene unit is a pixel; the camera is called as the file, without suffix.

    Raises:
        MeasureError: too few pictures, or a readout that does not fit.
        CaptureError: it cannot be decoded.
    """
    path = Path(path)
    if fps is None and is_untimed(path):
        raise MeasureError(f"{path}: has no time stamps; give --fps, frames per second")
    if readout_s and is_turned(path):
        raise MeasureError(
            f"--readout: {path.name} is rotated for display, so its rows are not read from top to bottom; leave it out"
        )
    fps = fps or video_info(path).filmed_at
    data, stamps, kinds, meter = _read(path, fps)
    new, times, repeats = taken(path, stamps, fps, meter)
    if new.sum() < FEWEST_FRAMES:
        raise MeasureError(f"{path}: holds {int(new.sum())} pictures, at least {FEWEST_FRAMES} are needed")
    step = float(np.median(np.diff(times)))
    if readout_s > 1.001 * step:
        raise MeasureError(
            f"--readout is {1e3 * readout_s:g} ms, expected at most the {1e3 * step:.4g} ms of a frame of {path.name}"
        )
    data, kinds = data if new.all() else data[new], kinds[new]
    return _prepared(path, GreyPictures(data, kinds), times - times[0], readout_s, repeats)


def _read(path: Path, fps: float | None) -> tuple[np.ndarray, np.ndarray, np.ndarray, DuplicateMeter]:
    """Luma [F, H, W] uint8, time stamps [F], kinds of coded pictures [F], and the meter that has seen all."""
    meter, parts, stamps, kinds = DuplicateMeter(), [], [], []
    waiting: list[np.ndarray] = []

    def keep() -> None:
        part = mapped_zeros((len(waiting), *waiting[0].shape), waiting[0].dtype)
        part[:] = waiting
        parts.append(part)
        waiting.clear()

    with progress("pictures", max(video_info(path).total, 1), "pictures", brief=True) as update:
        for k, picture in enumerate(video_pictures(path, fps), 1):
            meter.add(picture.grey, picture.kind == INTRA, picture.kind == BETWEEN)
            waiting.append(picture.grey.copy())
            stamps.append(picture.time_s)
            kinds.append(picture.kind)
            if len(waiting) == _AT_ONCE:
                keep()
            update(k)
    if waiting:
        keep()
    if not parts:
        raise MeasureError(f"{path}: holds no picture")
    data = mapped_zeros((len(stamps), *parts[0].shape[1:]), parts[0].dtype)
    np.concatenate(parts, out=data)
    return data, np.array(stamps), np.array(kinds), meter


def _prepared(
    path: Path,
    pictures: GreyPictures,
    times_s: np.ndarray,
    readout_s: float,
    repeats: Sequence[int],
) -> Prepared:
    count, (height, width) = len(times_s), pictures.size
    fps = 1 / float(np.median(np.diff(times_s)))
    focal = float(max(width, height))
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    name = path.stem
    frames = PosedFrames(
        name, _VIEWMAT.astype(np.float32), K.astype(np.float32), np.arange(count), times_s, readout_s
    )
    capture = Capture(
        path.parent, "train", width, height, fps, count, np.tile(_VIEWMAT, (count, 1, 1)),
        np.tile(K, (count, 1, 1)), np.arange(count), np.zeros(count, np.int64), (path,) * count,
        kind=Kind.flat, readout_s=readout_s, times_s=times_s,
    )  # fmt: skip
    is_between = pictures.kinds == BETWEEN
    observations = Observations(
        Kind.flat, Clock.synchronous, [frames], pictures, fps, count, True, codec_period(is_between)
    )
    nothing = Gaussians(
        torch.zeros(0, 3), torch.zeros(0, 4), torch.zeros(0, 3), torch.zeros(0), torch.zeros(0, 1, 3)
    )
    none = np.zeros((0, 0, 3), np.complex64)
    fit = MotionFit(nothing, ModalMotion.of_phasors(np.zeros(0), none, none, fps, count), {}, {})
    modal = ModalFields.of(None, 0)
    clock = SharedClock("", (0,), times_s, None, np.zeros((0, count)))
    return Prepared(
        fit, None, capture, observations, modal, (), (clock,), np.zeros(0), video=VideoFile(path, 0.0, tuple(repeats)),
        b_frames=is_between if is_between.any() else None, notes=tuple(filter(None, [_shake(pictures)])),
    )  # fmt: skip


def looked_at(scene: Prepared) -> LookSummary:
    """Return what vibrates in the video's pictures, as `tg4mm look` finds it."""
    (frames,), video, pictures = scene.observations.frames, scene.video, scene.observations.pictures
    assert video is not None
    assert isinstance(pictures, GreyPictures)

    def shown() -> Iterator[GreyPicture]:
        with progress("regions", len(frames.rows), "pictures", brief=True) as update:
            for k, time in enumerate(frames.times_s):
                yield GreyPicture(pictures.data[k], float(time), int(pictures.kinds[k]))
                update(k + 1)

    found = look_at_pictures(shown(), str(video.path))
    found = replace(found, lines=with_losses(found, video.path, found.rate, 0.0, video.repeats))
    return with_rows(found, frames.readout_s)


def _shake(pictures: GreyPictures) -> str:
    """Return a note about a camera that moves; empty if it stands still."""
    mean = pictures.data.mean(0, dtype=np.float32)[..., None]
    blocks = BlockShifts.of(mean, len(pictures.data))
    height, step = len(mean), max(1, _STRIP // pictures.data[:, 0].size)
    for top in range(0, height, step):
        rows = slice(top, min(top + step, height))
        blocks.add(rows, pictures.data[:, rows, :, None].astype(np.float32) - mean[rows])
    pixels, is_shaking = blocks.shake()
    if not is_shaking:
        return ""
    return (
        f"the camera shakes by about {pixels:.2g} px (rms), which every sensor includes: compare with a sensor on a "
        "static part, or train a run, which removes it"
    )
