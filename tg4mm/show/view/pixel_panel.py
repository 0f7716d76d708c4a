"""The panel's answer to a clicked pixel, and the mark in the scene."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import numpy as np
import viser
from markupsafe import Markup

from tg4mm.core.errors import Tg4mmError
from tg4mm.core.pages.svg import number
from tg4mm.core.progress import listened_to
from tg4mm.show.view.charts import ACCENT_RGB, block, density_chart, spectrum_chart, waveform_chart
from tg4mm.show.view.pace import full_size
from tg4mm.show.view.pixel import Measurer, Waveform, modal_waveform, seen_at, vector
from tg4mm.show.view.screen import Canvas
from tg4mm.show.view.session import Session

_ASK = "Click a pixel of the picture."
_MISSED = "Nothing there: the pixel shows background."
_STILL = "Nothing moves in this run."
_READING = "Reading the capture's pictures once, for all pixels …"
_SHADED = "; shaded: ± one standard deviation"
_MARK = 0.004  # radius of the mark, of the picture's height where it lies


class PixelPanel:
    """Waveform and spectrum of the pixel clicked last, on any page: of the fitted motion, or of the pictures."""

    def __init__(self, server: viser.ViserServer, session: Session) -> None:
        self._server, self._session = server, session
        self._measurer = Measurer(session.scene)
        self._busy = threading.Lock()
        self._last: tuple[np.ndarray, np.ndarray] | None = None  # place [3], weights [N]
        hint = (
            "The samples that the pictures give, with deviations and a noise floor. Reads all pictures once."
        )
        with server.gui.add_folder("Pixel"):
            self._from_pictures = server.gui.add_checkbox("From pictures", False, hint=hint)
            self._from_pictures.visible = bool(len(session.scene.frequencies))
            self._answer = server.gui.add_html(block(_ASK))
        self._from_pictures.on_update(lambda _: self._answer_last())

    def clicked(self, canvas: Canvas, x: float, y: float) -> None:
        """Answer a click at (x, y), shares 0 … 1 of the canvas from its upper left corner."""
        session = self._session
        width, height = size = full_size(canvas.width, canvas.height)
        column, row = min(int(x * width), width - 1), min(int(y * height), height - 1)
        seconds = session.clock.at(time.monotonic())
        weights = session.painter.pixel_weights(session.look, seconds, canvas.camera(size), column, row)
        point = seen_at(session.scene, weights)
        if point is None:
            self._answer.content = block(_MISSED)
            return
        self._last = point, weights
        self._mark(point, canvas)
        self._answer_last()

    def _answer_last(self) -> None:
        """Show what is known of the last pixel; one at a time, lest a slow answer come after a later one."""
        with self._busy:
            if self._last is None:
                return
            point, weights = self._last
            if self._from_pictures.value:
                self._measure(point)
                return
            found = modal_waveform(self._session.scene, weights)
            self._answer.content = block(_STILL) if found is None else self._words(found, point)

    def _measure(self, point: np.ndarray) -> None:
        """Measure there; until the pictures are read that lasts."""
        words = "Measuring …" if self._measurer.is_ready else _READING
        self._answer.content = block(words)
        try:
            with self._session.painter.beside() as let_paint, listened_to(self._heard(words, let_paint)):
                found = self._measurer.at(point)
        except (Tg4mmError, OSError) as error:
            self._answer.content = block(f"Not measured: {error}")
            return
        self._answer.content = self._words(found, point)

    def _heard(self, words: str, let_paint: Callable[[], None]) -> Callable[[str], None]:
        """Shows under `words` how far a job is."""

        def heard(line: str) -> None:
            self._answer.content = block(words, line[:1].upper() + line[1:])
            let_paint()

        return heard

    def _mark(self, point: np.ndarray, canvas: Canvas) -> None:
        distance = float(np.linalg.norm(point - np.array(canvas.position)))
        radius = _MARK * distance * 2 * np.tan(canvas.fov / 2)
        self._server.scene.add_icosphere("/pixel", radius=radius, color=ACCENT_RGB, position=tuple(point))

    def _words(self, found: Waveform, point: np.ndarray) -> str:
        scene, per = self._session.scene, self._session.scene.per_unit
        unit = scene.unit
        deviation = None if found.deviation is None else found.deviation * per
        amplitudes = found.amplitudes * per
        if found.floor is not None:
            chart = density_chart(found.frequencies, amplitudes, found.floor * per, f"peak ({unit})")
            radius = number(self._measurer.radius(point) * per)
            clip = f"; the curve: {found.of_clip}" if found.of_clip else ""
            how = f"Measured in the pictures, within {radius} {unit}{_SHADED}; dashed: noise floor{clip}."
        else:
            assert scene.motion is not None
            band = self._session.look.band
            chart = spectrum_chart(found.frequencies, amplitudes, scene.motion.fps / 2, unit, band)
            how = f"The fitted motion, as captured{_SHADED if deviation is not None else ''}."
        wave = waveform_chart(found.times, found.displacement * per, unit, deviation)
        where = Markup('<p class="dim">{}</p>').format(f"At ({vector(point)}) scene units. {how}")
        return block(_headline(found, unit, per), wave, chart, where)


def _headline(found: Waveform, unit: str, per: float) -> str:
    if found.peak is None:
        return f"Nothing stands out of the noise, along {found.along}"
    hz, amplitude = number(found.peak[0]), number(found.peak[1] * per)
    if found.peak_deviation is None:
        return f"{amplitude} {unit} at {hz} Hz, along {found.along}"
    unsure = [number(d, 2) for d in (found.peak_deviation[0], found.peak_deviation[1] * per)]
    return f"{amplitude} ± {unsure[1]} {unit} at {hz} ± {unsure[0]} Hz, along {found.along}"
