"""The panel beside the picture, shared by all open pages: sliders, spectrum, colours, time.

Controls that the program also moves are `Any`, since mypy does not see that viser's `value` can be set.
"""

import time
from typing import Any

import viser
from markupsafe import Markup

from tg4mm.core.digits import number
from tg4mm.show.maps import middle_depth
from tg4mm.show.view.charts import BAND_FIELD, block, composite_chart, spectrum_chart
from tg4mm.show.view.colours import (
    ALL,
    Colour,
    band_around,
    band_of_slider,
    band_words,
    choices,
    legend,
    main_peaks,
    peak_labels,
)
from tg4mm.show.view.scene import Standpoint, standpoint_of
from tg4mm.show.view.screen import NARROW
from tg4mm.show.view.session import Session

_FOLLOW_EVERY = 0.2  # seconds between moves of the time slider as it plays
_HANDS_OFF = 0.7  # seconds after the user moved it
_ALIASED = 4.0  # pictures a cycle; fewer mislead the eye
_BEFORE, _AGAIN, _NEXT = "previous", "back to it", "next"


class Panel:
    """Controls of display and time; scenes at rest only have notes."""

    def __init__(self, server: viser.ViserServer, session: Session) -> None:
        self._gui, self._session = server.gui, session
        self._followed = self._touched = 0.0
        self._rate: float | None = None
        self._size = ""
        scene = session.scene
        self._status = self._gui.add_html(block(*scene.notes, Markup('<p class="dim">&nbsp;</p>')))
        if scene.look is not None:
            self._gui.add_html(block("All regions together:", composite_chart(scene.look)))
        motion = scene.motion
        if motion is None or not len(scene.frequencies):
            self.view = self._gui.add_folder("View")
            return
        self._nyquist = motion.fps / 2
        self._peaks = scene.peaks()
        self._buttons = main_peaks(scene.frequencies, self._peaks, scene.duration)
        self._names = peak_labels(self._buttons)
        with self._gui.add_folder("Magnification"):
            self._add_magnification()
        with self._gui.add_folder("Time"):
            self._add_time()
        self.view = self._gui.add_folder("View")
        with self.view:
            self._add_colour()
        self._show_band()

    def _add_magnification(self) -> None:
        alpha = self._session.look.magnified.alpha
        top = max(100.0, 5 * alpha)
        hint = "A displacement δ becomes (1 + α) δ: 0 as captured, −1 at rest."
        slider = self._gui.add_slider(
            "α (factor 1 + α)", min=min(-1.0, alpha), max=top, step=0.5, initial_value=alpha, hint=hint
        )
        slider.on_update(lambda _: self._session.magnify(float(slider.value)))
        self._spectrum = self._gui.add_html("")
        names = (ALL, *self._names)
        buttons = self._gui.add_button_group("Peaks", names, hint="The band around one peak, or all.")
        buttons.on_click(lambda _: self._choose(str(buttons.value)))
        low, high = self._session.band or (0.0, self._nyquist)
        step = self._nyquist / 400
        self._band: Any = self._gui.add_multi_slider(
            "Band (Hz)",
            min=0.0,
            max=self._nyquist,
            step=step,
            initial_value=(low, high),
            min_range=step,
            hint="What is magnified.",
        )
        self._band.on_update(lambda event: self._slid(event))
        hint = "Two frequencies, as 4.5 5.5; or drag over a spectrum."
        self._typed = self._gui.add_text(BAND_FIELD, "", hint=hint)
        self._typed.on_update(lambda _: self._type(str(self._typed.value)))
        self._band_words = self._gui.add_html("")

    def _choose(self, name: str) -> None:
        """Select the band of a button: around a peak, or all frequencies."""
        frequencies = self._session.scene.frequencies
        if name not in self._names:
            band = None
        else:
            band = band_around(float(self._buttons[self._names.index(name)]), frequencies, self._nyquist)
        self._session.choose_band(band)
        self._band.value = band or (0.0, self._nyquist)
        self._show_band()

    def _slid(self, event: viser.GuiEvent[Any]) -> None:
        if event.client is None:  # set by a button, in the slider's steps
            return
        low, high = self._band.value
        self._session.choose_band(band_of_slider(float(low), float(high), self._nyquist))
        self._show_band()

    def _type(self, text: str) -> None:
        """Select the band of two numbers; incomplete text changes nothing."""
        try:
            low, high = (min(max(float(word), 0.0), self._nyquist) for word in text.replace(",", " ").split())
        except ValueError:
            return
        if low < high:
            self._session.choose_band((low, high))
            self._band.value = low, high
            self._show_band()

    def _show_band(self) -> None:
        """Update everything that depends on the band."""
        scene, look, band = self._session.scene, self._session.look, self._session.band
        labels = dict(zip(self._buttons.tolist(), self._names, strict=True))
        chart = spectrum_chart(
            scene.frequencies,
            self._peaks * scene.per_unit,
            self._nyquist,
            scene.unit,
            band,
            [labels.get(f, "") for f in scene.frequencies.tolist()],
        )
        self._spectrum.content = block(chart)
        self._band_words.content = block(band_words(band, scene.frequencies))
        self._legend.content = block(legend(scene, look.colour, look.magnified))
        self._show_speed()

    def _add_time(self) -> None:
        session, clock = self._session, self._session.clock
        self._play = self._gui.add_button("Pause" if clock.playing else "Play")
        self._play.on_click(lambda _: self._toggle())
        end = round(clock.duration, 4)
        hint = "Seconds of the capture."
        self._time: Any = self._gui.add_slider(
            "Time (s)", min=0.0, max=end, step=end / 1000, initial_value=0.0, hint=hint
        )
        self._time.on_update(lambda event: self._seek(event))
        hint = "Seconds of the capture per second: 1 is real time."
        speed = self._gui.add_slider(
            "Speed (× real)", min=0.01, max=2.0, step=0.01, initial_value=clock.speed, hint=hint
        )
        speed.on_update(
            lambda _: self._now_or(lambda c, now: c.changed(now, speed=max(float(speed.value), 0.01)))
        )
        loop = self._gui.add_checkbox("Loop", clock.loop, hint="Restart at the end.")
        loop.on_update(lambda _: session.set_clock(lambda c, now: c.changed(now, loop=bool(loop.value))))
        self._speed_words = self._gui.add_html("")

    def _now_or(self, change: Any) -> None:
        self._session.set_clock(change)
        self._show_speed()

    def _toggle(self) -> None:
        self._session.set_clock(lambda c, now: c.changed(now, playing=not c.running(now)))
        self._play.label = "Pause" if self._session.clock.running(time.monotonic()) else "Play"

    def _seek(self, event: viser.GuiEvent[Any]) -> None:
        if event.client is None:  # moved by `follow`
            return
        self._touched = time.monotonic()
        self._session.set_clock(lambda c, now: c.sought(now, float(self._time.value)))

    def _show_speed(self) -> None:
        """Show a warning if the fastest magnified motion has too few pictures a cycle."""
        band = self._session.band
        inside = [f for f in self._buttons if band is None or band[0] <= f <= band[1]]
        cycles = max(inside, default=0.0) * self._session.clock.speed
        words = ""
        if cycles > 0 and (rate := self._rate or 24.0) / cycles < _ALIASED:
            shown = f"{number(float(max(inside)))} Hz has {rate / cycles:.1f} pictures a cycle at this speed"
            words = f"{shown}: slow down to trust what you see."
        self._speed_words.content = block(words)

    def _add_colour(self) -> None:
        names = tuple(str(c) for c in choices(self._session.scene))
        chosen = self._gui.add_dropdown("Colour by", names, initial_value=str(self._session.look.colour))
        self._legend = self._gui.add_html("")

        @chosen.on_update
        def _(_: object) -> None:
            self._session.set_look(colour=Colour(chosen.value))
            self._show_band()

    def follow(self, now: float) -> None:
        """Move the time slider with the clock, and name the button after its action."""
        clock = self._session.clock
        if clock.duration <= 0 or now - self._followed < _FOLLOW_EVERY or now - self._touched < _HANDS_OFF:
            return
        self._followed = now
        self._time.value = min(clock.at(now), self._time.max)
        label = "Pause" if clock.running(now) else "Play"
        if self._play.label != label:
            self._play.label = label

    def show_size(self, rate: float | None, size: tuple[int, int], plays: bool) -> None:
        """Show the last picture's size and, while playing, pictures a second; `rate` is None between counts."""
        shown = f"{size[0]} × {size[1]} pixels"
        if (plays and rate is None) or (not plays and shown == self._size):
            return
        self._size = shown
        words = shown if rate is None else f"{shown}, {rate:.0f} frames/s"
        line = Markup('<p class="dim">{}</p>').format(words)
        self._status.content = block(*self._session.scene.notes, line)
        if rate is not None:
            self._rate = rate


class CameraPanel:
    """A list of cameras, and buttons to step through it."""

    def __init__(self, server: viser.ViserServer, session: Session, folder: viser.GuiFolderHandle) -> None:
        self._session = session
        self._cameras = session.scene.cameras
        self._names = tuple(camera.name for camera in self._cameras)
        with folder:
            hint = "Jump to a camera of the capture."
            self._list: Any = server.gui.add_dropdown("Camera", self._names, hint=hint)
            steps = server.gui.add_button_group("Step", (_BEFORE, _AGAIN, _NEXT))
        self._list.on_update(lambda event: self.jump(event.client, self._chosen()))
        steps.on_click(lambda event: self._step(event.client, str(steps.value)))

    def _chosen(self) -> int:
        return self._names.index(self._list.value)

    def _step(self, client: viser.ClientHandle | None, name: str) -> None:
        i = (self._chosen() + {_BEFORE: -1, _AGAIN: 0, _NEXT: 1}[name]) % len(self._names)
        self._list.value = self._names[i]
        self.jump(client, i)

    def jump(self, client: viser.ClientHandle | None, i: int) -> None:
        """Move a page's camera to that of camera `i` of the capture, with all of its picture in view.

        None, for a change by the program, moves no page.
        """
        if client is None:
            return
        scene = self._session.scene
        depth = middle_depth(scene.gaussians.means.numpy(), scene.weights, self._cameras[i])
        aspect = client.camera.aspect
        if self._session.look.beside and client.camera.image_width >= NARROW:
            aspect /= 2
        place(client, standpoint_of(self._cameras[i], depth, aspect))

    def again(self, client: viser.ClientHandle) -> None:
        """Return a page to the chosen camera."""
        self.jump(client, self._chosen())


def place(client: viser.ClientHandle, to: Standpoint) -> None:
    """Move a page's camera to a standpoint at once."""
    with client.atomic():
        client.camera.up_direction = to.up
        client.camera.position = to.position
        client.camera.look_at = to.target
        client.camera.fov = to.fov
