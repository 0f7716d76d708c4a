"""What all open pages share: what is shown, and when in the capture. Changes from any thread."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import replace

from tg4mm.show.view.clock import Clock
from tg4mm.show.view.painter import Look, Painter
from tg4mm.show.view.scene import Scene


class Session:
    """A scene that is being looked at.

    `revision` counts the changes of the look, `changed` is set by every change: whoever draws waits for it.
    """

    def __init__(self, scene: Scene, look: Look, clock: Clock) -> None:
        self.scene = scene
        self.painter = Painter(scene)
        self.changed = threading.Event()
        self.revision = 0
        self._look, self._clock = look, clock
        self._lock = threading.Lock()

    @property
    def look(self) -> Look:
        return self._look

    @property
    def clock(self) -> Clock:
        return self._clock

    def set_look(self, **changes: object) -> None:
        """Replace fields of the look."""
        with self._lock:
            self._look = replace(self._look, **changes)  # type: ignore[arg-type]
            self.revision += 1
        self.changed.set()

    def set_clock(self, change: Callable[[Clock, float], Clock]) -> None:
        """Put `change(clock, now)` in the clock's place."""
        with self._lock:
            self._clock = change(self._clock, time.monotonic())
        self.changed.set()
