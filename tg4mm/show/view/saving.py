"""Writes a page's picture as a snapshot or clip."""

import re
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import viser

from tg4mm.core.errors import Tg4mmError
from tg4mm.core.files import write_atomic
from tg4mm.core.pictures.decode import write_png
from tg4mm.show.render.video import stream_mp4
from tg4mm.show.view.charts import block
from tg4mm.show.view.pixel_panel import Waveform
from tg4mm.show.view.screen import Viewport, full_size, picture_of
from tg4mm.show.view.session import Session

CLIP_RATE = 30.0  # pictures a second
LONGEST = 20.0  # seconds of a clip
_LARGEST = 1280  # pixels, a clip's longer side


def save_snapshot(session: Session, canvas: Viewport, now: float, folder: Path) -> Path:
    """Write the picture of `canvas` at `now`, at full size, as a new PNG in `folder`."""
    size = full_size(canvas.width, canvas.height)
    picture = picture_of(session.painter, session.look, session.clock.at(now), canvas, size)
    path = next_name(folder, "snapshot", ".png")
    write_png(path, picture)
    return path


def save_clip(
    session: Session, canvas: Viewport, folder: Path, update: Callable[[float], None] = lambda share: None
) -> Path:
    """Write one pass through the capture on `canvas`, at its present speed, as a new mp4 in `folder`.

    It has at most 20 seconds and 1280 pixels a side. `update` is called with the finished share, 0 … 1.
    """
    look, clock = session.look, session.clock
    share = min(1.0, _LARGEST / max(canvas.width, canvas.height))
    size = _even(canvas.width * share), _even(canvas.height * share)
    moments = clip_moments(clock.duration, clock.speed)

    def pictures() -> Iterator[np.ndarray]:
        for i, seconds in enumerate(moments):
            yield picture_of(session.painter, look, float(seconds), canvas, size)
            update((i + 1) / len(moments))

    path = next_name(folder, "clip", ".mp4")
    stream_mp4(path, pictures(), size, CLIP_RATE, len(moments))
    return path


def save_numbers(found: Waveform, unit: str, per_unit: float, folder: Path) -> Path:
    """Write a pixel's waveform as a new CSV for `tg4mm analyse`, and its spectrum; returns the waveform's file."""
    folder.mkdir(parents=True, exist_ok=True)
    path = next_name(folder, "waveform", ".csv")
    name = "along_" + unit.replace(" ", "_")
    columns = {"time_s": found.times, name: found.displacement * per_unit}
    if found.deviation is not None:
        columns[f"{name}_deviation"] = found.deviation * per_unit
    spectrum = {"frequency_hz": found.frequencies, name: found.amplitudes * per_unit}
    if found.floor is not None:
        spectrum["floor"] = found.floor * per_unit
    _write_table(path, columns)
    _write_table(path.with_name(path.name.replace("waveform", "spectrum")), spectrum)
    return path


def _write_table(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    rows = [",".join(f"{v:.9g}" for v in row) for row in zip(*columns.values(), strict=True)]
    text = "\n".join([",".join(columns), *rows, ""])
    write_atomic(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


def clip_moments(duration: float, speed: float) -> np.ndarray:
    """Return the capture's times in a clip, seconds: one pass, or its first 20 seconds of playing."""
    count = round(min(duration / speed, LONGEST) * CLIP_RATE)
    return np.arange(max(count, 1)) * speed / CLIP_RATE


def next_name(folder: Path, stem: str, suffix: str) -> Path:
    """Return `folder/stem_0001.suffix`, or the number after the highest that exists."""
    pattern = re.compile(rf"{stem}_(\d+){re.escape(suffix)}")
    found = [pattern.fullmatch(path.name) for path in folder.glob(f"{stem}_*{suffix}")]
    highest = max((int(match[1]) for match in found if match), default=0)
    return folder / f"{stem}_{highest + 1:04d}{suffix}"


def _even(pixels: float) -> int:
    return max(2, 2 * round(pixels / 2))


class SavePanel:
    """Buttons for snapshots (PNG) and clips (mp4) of their page, one at a time."""

    def __init__(
        self,
        server: viser.ViserServer,
        session: Session,
        folder: Path,
        canvas_of: Callable[[viser.ClientHandle], Viewport],
        answered: Callable[[], Waveform | None] = lambda: None,
    ) -> None:
        self._answered = answered
        self._session, self._folder, self._canvas_of = session, folder, canvas_of
        self._busy = threading.Lock()
        with server.gui.add_folder("Save"):
            snapshot = server.gui.add_button("Snapshot (PNG)", hint="This picture at full size.")
            clip = server.gui.add_button("Clip (mp4)", hint="One pass through the capture as it plays here.")
            clip.visible = session.scene.duration > 0
            numbers = server.gui.add_button(
                "Numbers (CSV)", hint="Waveform and spectrum of the clicked pixel."
            )
            numbers.visible = session.scene.duration > 0
            self._bar: Any = server.gui.add_progress_bar(0.0, visible=False)
            self._message = server.gui.add_html(block(f"To {folder}"))
        snapshot.on_click(lambda event: self._save(event.client, self._snapshot))
        numbers.on_click(lambda event: self._save(event.client, self._numbers))
        clip.on_click(lambda event: self._save(event.client, self._clip))

    def _save(self, client: viser.ClientHandle | None, write: Callable[[Viewport], Path]) -> None:
        if client is None or not self._busy.acquire(blocking=False):
            return
        try:
            path = write(self._canvas_of(client))
            self._message.content = block(f"Wrote {path}")
        except (Tg4mmError, OSError) as error:
            self._message.content = block(f"Not written: {error}")
        finally:
            self._bar.visible = False
            self._busy.release()

    def _snapshot(self, canvas: Viewport) -> Path:
        return save_snapshot(self._session, canvas, time.monotonic(), self._folder)

    def _numbers(self, _: Viewport) -> Path:
        if (found := self._answered()) is None:
            raise Tg4mmError("click a pixel first")
        return save_numbers(found, self._session.scene.unit, self._session.scene.per_unit, self._folder)

    def _clip(self, canvas: Viewport) -> Path:
        self._bar.value, self._bar.visible = 0.0, True
        return save_clip(self._session, canvas, self._folder, self._progress)

    def _progress(self, share: float) -> None:
        if share - self._bar.value / 100 >= 0.02:
            self._bar.value = 100 * share
