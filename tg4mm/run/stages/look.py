"""The look at a fixed camera's recording, region by region before the fit, kept in the run's log."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from tg4mm.capture import Capture, ImageStack
from tg4mm.capture.look import Found, Picture, look_at_pictures
from tg4mm.capture.look.compression import with_losses
from tg4mm.capture.look.reading import FEWEST, INTRA
from tg4mm.capture.look.record import from_record, to_record
from tg4mm.capture.look.rows import with_rows
from tg4mm.capture.pictures import FilePictures
from tg4mm.capture.scene import picture_kinds, video_file
from tg4mm.core.progress import progress
from tg4mm.fit.motion.observations import fixed_cameras
from tg4mm.run import Run

_STAGE = "look"
_LUMA = np.array([0.299, 0.587, 0.114], np.float32)


def look_at_capture(run: Run, capture: Capture, images: ImageStack | FilePictures) -> Found | None:
    """Look at the recording of a single fixed camera; return None for several cameras or too few pictures."""
    if len(fixed_cameras(capture)) != 1 or capture.n_timesteps < FEWEST:
        return None
    if (kept := look_of(run)) is None:
        kept = look_at_pictures(_pictures(capture, images), str(capture.root))
        if (video := video_file(capture.root)) is not None:
            lines = with_losses(kept, video.path, kept.rate, video.from_s, video.repeats)
            kept = replace(kept, lines=lines)
        kept = with_rows(kept, capture.rows_s)
        run.record(_STAGE, to_record(kept))
    return kept


def look_of(run: Run) -> Found | None:
    """Return the look stored in the run's log."""
    values = run.log().get(_STAGE)
    return None if not values else from_record(values)


def _pictures(capture: Capture, images: ImageStack | FilePictures) -> Iterator[Picture]:
    (frames,) = fixed_cameras(capture)[:1]
    kinds = picture_kinds(capture.root, len(frames.rows)) or [INTRA] * len(frames.rows)
    with progress("regions", len(frames.rows), "pictures") as update:
        for k, (row, time) in enumerate(zip(frames.rows, frames.times_s, strict=True)):
            yield Picture(255 * (images.rgb(int(row)) @ _LUMA), float(time), kinds[k])
            update(k + 1)
