"""Buttons that write snapshots and clips. Where to is said on the command line, so that no page can choose."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import viser

from tg4mm.core.errors import Tg4mmError
from tg4mm.show.view.charts import block
from tg4mm.show.view.recording import save_clip, save_snapshot
from tg4mm.show.view.screen import Canvas
from tg4mm.show.view.session import Session


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
