"""The waveform and spectrum of a clicked pixel, and the mark in the scene."""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import viser
from markupsafe import Markup

from tg4mm.core.digits import number
from tg4mm.core.errors import Tg4mmError
from tg4mm.core.phasors import main_direction, peak_displacement
from tg4mm.core.progress import listened_to
from tg4mm.run import Run
from tg4mm.show.measure import Prepared, Sensor, SensorResult, measure_one, prepare
from tg4mm.show.measure.sensors import PIXEL_RADIUS
from tg4mm.show.measure.spectrum import strength_of
from tg4mm.show.view.charts import ACCENT_RGB, block, density_chart, spectrum_chart, waveform_chart
from tg4mm.show.view.colours import main_peaks, peak_labels
from tg4mm.show.view.scene import RunScene
from tg4mm.show.view.screen import Viewport, full_size
from tg4mm.show.view.session import Session

_ASK = "Click a pixel of the picture."
_MISSED = "Nothing there: the pixel shows background."
_STILL = "Nothing moves in this run."
_READING = "Reading the capture's pictures once, for all pixels …"
_SHADED = "; shaded: ± one standard deviation"
_MARK = 0.004  # radius of the mark over the picture's height at its depth
_FAINTEST = 0.05  # opacity of a pixel that counts as hit


class PixelPanel:
    """Waveform and spectrum of the last clicked pixel, on any page, from the fitted motion or the pictures."""

    def __init__(self, server: viser.ViserServer, session: Session) -> None:
        self._server, self._session = server, session
        self._measurer = Measurer(session.scene)
        self._busy = threading.Lock()
        self.shown: Waveform | None = None  # the last answer
        names = main_peaks(session.scene.frequencies, session.scene.peaks(), session.scene.duration)
        self._named = list(zip(names.tolist(), peak_labels(names), strict=True))
        self._last: tuple[np.ndarray, np.ndarray] | None = None  # place [3], weights [N]
        hint = "Measure in the pictures, with deviations and a noise floor. Reads all pictures once."
        with server.gui.add_folder("Pixel"):
            self._from_pictures = server.gui.add_checkbox("From pictures", False, hint=hint)
            self._from_pictures.visible = bool(len(session.scene.frequencies))
            self._answer = server.gui.add_html(block(_ASK))
        self._from_pictures.on_update(lambda _: self._answer_last())

    def clicked(self, canvas: Viewport, x: float, y: float) -> None:
        """Answer a click at (x, y), shares 0 … 1 of the canvas from its upper left corner."""
        session = self._session
        if session.look.beside and canvas.holds_two:
            x, canvas = min(2 * x - (x >= 0.5), 1.0), canvas.halved()
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
        """Show the last pixel's motion; one at a time, so that a slow answer never follows a later one."""
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
        """Measure the point; the first time all pictures are read."""
        words = "Measuring …" if self._measurer.is_ready else _READING
        self._answer.content = block(words)
        try:
            with listened_to(self._heard(words)):
                found = self._measurer.at(point)
        except (Tg4mmError, OSError) as error:
            self._answer.content = block(f"Not measured: {error}")
            return
        self._answer.content = self._words(found, point)

    def _heard(self, words: str) -> Callable[[str], None]:
        """Return a listener that shows a job's progress under `words`."""

        def heard(line: str) -> None:
            self._answer.content = block(words, line[:1].upper() + line[1:])

        return heard

    def _mark(self, point: np.ndarray, canvas: Viewport) -> None:
        self._session.set_look(mark=tuple(map(float, point)))
        if self._session.look.beside:  # drawn in both pictures
            self._server.scene.remove_by_name("/pixel")
            return
        distance = float(np.linalg.norm(point - np.array(canvas.position)))
        radius = _MARK * distance * 2 * np.tan(canvas.fov / 2)
        self._server.scene.add_icosphere("/pixel", radius=radius, color=ACCENT_RGB, position=tuple(point))

    def _words(self, found: "Waveform", point: np.ndarray) -> str:
        self.shown = found
        scene, per = self._session.scene, self._session.scene.per_unit
        unit = scene.unit
        deviation = None if found.deviation is None else found.deviation * per
        amplitudes = found.amplitudes * per
        if found.floor is not None:
            chart = density_chart(
                found.frequencies, amplitudes, found.floor * per, f"peak ({unit})", self._named
            )
            radius = number(self._measurer.radius(point) * per)
            clip = f"; the curve: {found.of_clip}" if found.of_clip else ""
            how = f"Measured in the pictures, within {radius} {unit}{_SHADED}; dashed: noise floor{clip}."
        else:
            assert scene.motion is not None
            band = self._session.band
            labels = dict(self._named)
            named = [labels.get(f, "") for f in found.frequencies.tolist()]
            chart = spectrum_chart(found.frequencies, amplitudes, scene.motion.fps / 2, unit, band, named)
            how = f"The fitted motion, as captured{_SHADED if deviation is not None else ''}."
        wave = waveform_chart(found.times, found.displacement * per, unit, deviation)
        where = Markup('<p class="dim">{}</p>').format(f"At ({vector(point)}) scene units. {how}")
        return block(_headline(found, unit, per), wave, chart, where)


def _headline(found: "Waveform", unit: str, per: float) -> str:
    if found.peak is None:
        return f"Nothing stands out of the noise, along {found.along}"
    hz, amplitude = number(found.peak[0]), number(found.peak[1] * per)
    if found.peak_deviation is None:
        return f"{amplitude} {unit} at {hz} Hz, along {found.along}"
    unsure = [number(d, 2) for d in (found.peak_deviation[0], found.peak_deviation[1] * per)]
    return f"{amplitude} ± {unsure[1]} {unit} at {hz} ± {unsure[0]} Hz, along {found.along}"


@dataclass(frozen=True)
class Waveform:
    """The captured motion (α = 0) of the surface in a pixel, scene units."""

    along: str  # the direction, in words
    times: np.ndarray  # [F] seconds
    displacement: np.ndarray  # [F] about its mean
    deviation: np.ndarray | None  # [F] standard deviation
    frequencies: np.ndarray  # [B] Hz
    amplitudes: np.ndarray  # [B] zero to peak
    peak: tuple[float, float] | None  # Hz and zero to peak; None if nothing stands out
    floor: np.ndarray | None = None  # [B] noise floor of the amplitudes; None for the fitted motion
    peak_deviation: tuple[float, float] | None = None  # standard deviations of the peak's two numbers
    of_clip: str = ""  # direction of the displacement in a clip, if another


def seen_at(scene: RunScene, weights: np.ndarray) -> np.ndarray | None:
    """Return the mean position [3] of Gaussians by blending weights [N]; None for background (opacity below 0.05)."""
    total = float(weights.sum())
    return None if total < _FAINTEST else weights @ scene.gaussians.means.numpy().astype(float) / total


def modal_waveform(scene: RunScene, weights: np.ndarray) -> Waveform | None:
    """Return the fitted motion of the Gaussians in a pixel by their blending weights [N]; None if nothing moves.

    Displacements are blended like colours; the standard deviation is that of a single Gaussian, as if all had the same
    error.
    """
    if scene.motion is None or not len(scene.frequencies):
        return None
    rows = np.flatnonzero(weights > 1e-4 * weights.sum())
    share = weights[rows] / weights[rows].sum()
    kept = np.flatnonzero(scene.motion.is_magnified())
    kept = kept[np.argsort(scene.motion.freqs_hz[kept], kind="stable")]
    frequencies = scene.motion.freqs_hz[kept]
    fields = np.einsum("n,rnc->rc", share, scene.motion.fields[:, rows, :3])
    phasors = scene.motion.series[kept] @ fields  # [K, 3]
    direction = main_direction(phasors, np.ones(len(phasors)))
    amplitudes = peak_displacement(phasors)
    k = int(amplitudes.argmax())
    times = _times(scene.duration, frequencies, float(frequencies[k]))
    turns = np.exp(2j * np.pi * np.outer(times, frequencies))
    deviation = None
    if scene.deviation is not None:
        deviation = np.full(len(times), float(np.sqrt(share @ scene.deviation[rows].astype(float) ** 2)))
    return Waveform(
        f"({vector(direction)})",
        times,
        (turns @ (phasors @ direction)).real,
        deviation,
        frequencies,
        amplitudes,
        (float(frequencies[k]), float(amplitudes[k])),
    )


def _times(duration: float, frequencies: np.ndarray, main: float) -> np.ndarray:
    """Return a drawn waveform's times, seconds: the capture, or the first 12 cycles of its main frequency."""
    end = min(duration, 12.0 / main)
    steps = int(np.clip(16 * end * float(frequencies.max()), 100, 1200))
    return np.linspace(0.0, end, steps + 1)


def vector(v: np.ndarray) -> str:
    """Return x, y, z with two decimals."""
    return ", ".join(f"{x:.2f}".replace("-", "−") for x in np.round(v, 2) + 0.0)


class Measurer:
    """Measures points of the scene in the capture's pictures, which it reads at the first request."""

    def __init__(self, scene: RunScene) -> None:
        self._scene = scene
        self._prepared: Prepared | None = None

    @property
    def is_ready(self) -> bool:
        """Return whether the pictures have been read."""
        return self._prepared is not None

    def radius(self, point: np.ndarray) -> float:
        """Return four pixels of the capture's nearest camera at a point, scene units."""
        per_pixel = [
            float(np.linalg.norm(point - camera.position)) / camera.K[0, 0] for camera in self._scene.cameras
        ]
        return PIXEL_RADIUS * min(per_pixel)

    def at(self, point: np.ndarray) -> Waveform:
        """Measure the displacement within `radius` of `point` [3]. Raises Tg4mmError as `measure` does."""
        if self._prepared is None:
            self._prepared = prepare(Run.open(self._scene.path))
        sensor = Sensor("pixel", "sphere", (*map(float, point), self.radius(point)))
        return measured_waveform(measure_one(self._prepared, sensor))


def measured_waveform(result: SensorResult) -> Waveform:
    """A sensor's series along the one of its axes on which its strongest peak is largest; else the surest axis.

    Of clips the one in which that peak is surest; the spectrum and the peak are of all of them together.
    """
    spectrum = result.spectrum
    peak = spectrum.peaks[0] if spectrum.peaks else None
    record = max(result.records, key=lambda r: strength_of(r.peaks[0]) if peak else 0.0)
    series, own = record.series, record.peaks[0] if peak else None
    along = _best_axis(None if own is None else own.amplitude, series.deviation)
    axis = along if not result.clips else _best_axis(None if peak is None else peak.amplitude, spectrum.floor)
    found = sure = None
    if peak is not None and bool(peak.is_above[axis]):
        found = peak.frequency_hz, float(peak.amplitude[axis])
        sure = peak.frequency_deviation_hz, float(peak.deviation[axis])
    return Waveform(
        result.labels[axis],
        series.times_s - series.times_s[0],
        series.displacement[:, along],
        series.deviation[:, along],
        spectrum.freqs_hz,
        spectrum.amplitude[:, axis],
        found,
        spectrum.floor[:, axis],
        sure,
        f"{series.labels[along]} of {series.clock}" if result.clips else "",
    )


def _best_axis(amplitude: np.ndarray | None, deviation: np.ndarray) -> int:
    """Return the observed axis with the largest amplitude [3], or the least deviation [T, 3] if there is none."""
    if amplitude is None:
        return int(np.argmax(1.0 / np.square(deviation).mean(axis=0)))
    return int(np.argmax(amplitude * np.isfinite(deviation).all(axis=0)))
