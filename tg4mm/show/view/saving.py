"""Snapshots and clips: what a page shows, to disk."""

import re
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import viser

from tg4mm.core.errors import Tg4mmError
from tg4mm.core.pictures.frames import write_png
from tg4mm.show.render.video import stream_mp4
from tg4mm.show.view.charts import block
from tg4mm.show.view.screen import Canvas, full_size
from tg4mm.show.view.session import Session

CLIP_RATE = 30.0  # pictures a second
LONGEST = 20.0  # seconds of a clip
_LARGEST = 1280  # pixels, a clip's longer side


def save_snapshot(session: Session, canvas: Canvas, now: float, folder: Path) -> Path:
    """Write what `canvas` shows at `now`, at its full size, as a new PNG in `folder`."""
    camera = canvas.camera(full_size(canvas.width, canvas.height))
    picture = session.painter.paint(session.look, session.clock.at(now), camera)
    path = next_name(folder, "snapshot", ".png")
    write_png(path, picture)
    return path


def save_clip(
    session: Session, canvas: Canvas, folder: Path, update: Callable[[float], None] = lambda share: None
) -> Path:
    """Write one pass through the capture as `canvas` shows it now, at the speed it plays, as a new mp4 in `folder`.

    At most 20 seconds, at most 1280 pixels wide or high. `update` is told the share that is done, 0 … 1.
    """
    look, clock = session.look, session.clock
    share = min(1.0, _LARGEST / max(canvas.width, canvas.height))
    size = _even(canvas.width * share), _even(canvas.height * share)
    camera = canvas.camera(size)
    moments = clip_moments(clock.duration, clock.speed)

    def pictures() -> Iterator[np.ndarray]:
        for i, seconds in enumerate(moments):
            yield session.painter.paint(look, float(seconds), camera)
            update((i + 1) / len(moments))

    path = next_name(folder, "clip", ".mp4")
    stream_mp4(path, pictures(), size, CLIP_RATE, len(moments))
    return path


def clip_moments(duration: float, speed: float) -> np.ndarray:
    """Seconds of the capture that the pictures of a clip show: one pass, or as much of it as 20 seconds hold."""
    count = round(min(duration / speed, LONGEST) * CLIP_RATE)
    return np.arange(max(count, 1)) * speed / CLIP_RATE


def next_name(folder: Path, stem: str, suffix: str) -> Path:
    """`folder/stem_0001.suffix`, or the number after the highest that is there."""
    pattern = re.compile(rf"{stem}_(\d+){re.escape(suffix)}")
    found = [pattern.fullmatch(path.name) for path in folder.glob(f"{stem}_*{suffix}")]
    highest = max((int(match[1]) for match in found if match), default=0)
    return folder / f"{stem}_{highest + 1:04d}{suffix}"


def _even(pixels: float) -> int:
    return max(2, 2 * round(pixels / 2))


class SavePanel:
    """Snapshot (PNG) and clip (mp4) of the page whose button was pressed; one at a time."""

    def __init__(
        self,
        server: viser.ViserServer,
        session: Session,
        folder: Path,
        canvas_of: Callable[[viser.ClientHandle], Canvas],
    ) -> None:
        self._session, self._folder, self._canvas_of = session, folder, canvas_of
        self._busy = threading.Lock()
        with server.gui.add_folder("Save"):
            snapshot = server.gui.add_button("Snapshot (PNG)", hint="This picture at full size.")
            clip = server.gui.add_button("Clip (mp4)", hint="One pass through the capture as it plays here.")
            clip.visible = session.scene.duration > 0
            self._bar: Any = server.gui.add_progress_bar(0.0, visible=False)
            self._said = server.gui.add_html(block(f"To {folder}"))
        snapshot.on_click(lambda event: self._save(event.client, self._snapshot))
        clip.on_click(lambda event: self._save(event.client, self._clip))

    def _save(self, client: viser.ClientHandle | None, write: Callable[[Canvas], Path]) -> None:
        if client is None or not self._busy.acquire(blocking=False):
            return
        try:
            path = write(self._canvas_of(client))
            self._said.content = block(f"Wrote {path}")
        except (Tg4mmError, OSError) as error:
            self._said.content = block(f"Not written: {error}")
        finally:
            self._bar.visible = False
            self._busy.release()

    def _snapshot(self, canvas: Canvas) -> Path:
        return save_snapshot(self._session, canvas, time.monotonic(), self._folder)

    def _clip(self, canvas: Canvas) -> Path:
        self._bar.value, self._bar.visible = 0.0, True
        return save_clip(self._session, canvas, self._folder, self._progress)

    def _progress(self, share: float) -> None:
        if share - self._bar.value / 100 >= 0.02:
            self._bar.value = 100 * share
