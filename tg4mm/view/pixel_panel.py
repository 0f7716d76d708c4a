"""The panel's answer to a clicked pixel, and the mark in the scene."""

from __future__ import annotations

import time

import numpy as np
import viser
from markupsafe import Markup

from tg4mm.report.svg import number
from tg4mm.view.charts import ACCENT, block, spectrum_chart, waveform_chart
from tg4mm.view.pace import full_size
from tg4mm.view.pixel import Waveform, modal_waveform
from tg4mm.view.screen import Canvas
from tg4mm.view.session import Session

_ASK = "Click a pixel of the picture."
_MISSED = "Nothing there moves: the pixel shows background."
_MARK = 0.004  # radius of the mark, of the distance from the camera
_COLOUR = tuple(int(ACCENT[i : i + 2], 16) for i in (1, 3, 5))


class PixelPanel:
    """Waveform and spectrum of the pixel clicked last, on any page."""

    def __init__(self, server: viser.ViserServer, session: Session) -> None:
        self._server, self._session = server, session
        with server.gui.add_folder("Pixel"):
            self._answer = server.gui.add_html(block(_ASK))

    def clicked(self, canvas: Canvas, x: float, y: float) -> None:
        """Answer a click at (x, y), shares 0 … 1 of the canvas from its upper left corner."""
        session = self._session
        width, height = size = full_size(canvas.width, canvas.height)
        column, row = min(int(x * width), width - 1), min(int(y * height), height - 1)
        seconds = session.clock.at(time.monotonic())
        weights = session.painter.pixel_weights(session.look, seconds, canvas.camera(size), column, row)
        found = modal_waveform(session.scene, weights)
        if found is None:
            self._answer.content = block(_MISSED)
            return
        self._mark(found.point, canvas)
        self._answer.content = self._words(found)

    def _mark(self, point: np.ndarray, canvas: Canvas) -> None:
        distance = float(np.linalg.norm(point - np.array(canvas.position)))
        radius = _MARK * distance * 2 * np.tan(canvas.fov / 2)
        self._server.scene.add_icosphere("/pixel", radius, _COLOUR, position=tuple(point))

    def _words(self, found: Waveform) -> str:
        scene = self._session.scene
        assert scene.motion is not None
        strongest = int(found.amplitudes.argmax())
        peak = number(float(found.amplitudes[strongest]) * scene.per_unit)
        at = number(float(found.frequencies[strongest]))
        where, along = _vector(found.point), _vector(found.direction)
        per = scene.per_unit
        deviation = None if found.deviation is None else found.deviation * per
        return block(
            f"{peak} {scene.unit} at {at} Hz, along ({along})",
            waveform_chart(found.times, found.displacement * per, scene.unit, deviation),
            spectrum_chart(
                found.frequencies, found.amplitudes * per, scene.motion.fps / 2, scene.unit, self._session.look.band
            ),
            Markup('<p class="dim">{}</p>').format(
                f"At ({where}) scene units. The fitted motion, as captured"
                + ("; shaded: ± one standard deviation." if deviation is not None else ".")
            ),
        )


def _vector(v: np.ndarray) -> str:
    return ", ".join(f"{x:.2f}".replace("-", "−") for x in v + 0.0)
