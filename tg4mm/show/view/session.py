"""The state shared by all pages: the scene, the display settings, and the time in the capture."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from tg4mm.core.magnification import Magnification
from tg4mm.show.view.painter import Look, Painter
from tg4mm.show.view.scene import RunScene


class Session:
    """A scene that is being looked at.

    `revision` counts the changes of the look, `changed` is set by every change: whoever draws waits for it.
    """

    def __init__(self, scene: RunScene, look: Look, clock: Clock) -> None:
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

    @property
    def band(self) -> tuple[float, float] | None:
        """The magnified band in Hz, or None for all frequencies."""
        return next(iter(self._look.magnified.limits), None)

    def magnify(self, alpha: float) -> None:
        """Set another α in the same band."""
        self.set_look(magnified=self._look.magnified.times(alpha))

    def choose_band(self, band: tuple[float, float] | None) -> None:
        """Another band, by the same α; None: all frequencies."""
        limits = () if band is None else (band,)
        self.set_look(magnified=Magnification.of(self._look.magnified.alpha, *limits))

    def set_clock(self, change: Callable[[Clock, float], Clock]) -> None:
        """Put `change(clock, now)` in the clock's place."""
        with self._lock:
            self._clock = change(self._clock, time.monotonic())
        self.changed.set()


@dataclass(frozen=True)
class Clock:
    """Seconds of the capture as they play; moments `now` are of one monotonic clock, in seconds.

    Every change returns a new clock that goes on from where this one was.
    """

    duration: float  # seconds of the capture, T / fps; 0 for a scene that does not move
    offset: float = 0.0  # seconds of the capture at `since`
    since: float = 0.0
    speed: float = 1.0  # seconds of the capture for each second
    playing: bool = False
    loop: bool = True

    def at(self, now: float) -> float:
        """Seconds of the capture: 0 … duration; with `loop` it starts anew at the end, else it stays there."""
        if not self.playing or self.duration <= 0:
            return self.offset
        position = self.offset + self.speed * (now - self.since)
        return position % self.duration if self.loop else min(position, self.duration)

    def running(self, now: float) -> bool:
        """Return whether time advances: playing, and not at the end."""
        return self.playing and self.duration > 0 and (self.loop or self.at(now) < self.duration)

    def changed(self, now: float, **changes: object) -> Clock:
        """With other `speed`, `playing` or `loop` from now on; playing from the end starts at 0."""
        offset = self.at(now)
        if changes.get("playing") and not self.running(now) and offset >= self.duration:
            offset = 0.0
        return replace(self, offset=offset, since=now, **changes)  # type: ignore[arg-type]

    def sought(self, now: float, seconds: float) -> Clock:
        """Moved to `seconds`, held within the capture; plays on from there if it played."""
        return replace(self, offset=min(max(seconds, 0.0), self.duration), since=now)


def slow_enough(frequency_hz: float, cycles_per_second: float = 3.0) -> float:
    """A round speed, at most 1, at which `frequency_hz` shows at most so many cycles a second.

    At 24 pictures a second that leaves eight for a cycle.
    """
    speeds = (1.0, 0.5, 0.25, 0.2, 0.1, 0.05, 0.02, 0.01)
    return next((s for s in speeds if s * frequency_hz <= cycles_per_second), speeds[-1])
