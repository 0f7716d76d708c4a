"""Server, panel and drawing loop of `tg4mm view`."""

import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import viser

from tg4mm.show.view.charts import block, key_words
from tg4mm.show.view.local_server import add_side_panel, address, set_theme, start_server, stop_server
from tg4mm.show.view.panel import CameraPanel, Panel
from tg4mm.show.view.pixel_panel import PixelPanel
from tg4mm.show.view.saving import SavePanel
from tg4mm.show.view.screen import RATE, Screen, Viewport
from tg4mm.show.view.session import Session

_IDLE = 0.1  # seconds between checks of cameras without events
_BESIDE = "Side by side"
_KEYS = ((" ", "Play|Pause"), ("b", _BESIDE), ("0", "all"), ("c", "Clip (mp4)"), ("n", "Numbers (CSV)"),
         ("s", "Snapshot (PNG)"), ("j", "previous"), ("k", "next"))  # fmt: skip


def canvas_of(client: viser.ClientHandle) -> Viewport:
    """Return the present camera of a page."""
    c = client.camera
    return Viewport(
        tuple(map(float, c.position)),
        tuple(map(float, c.wxyz)),
        float(c.fov),
        int(c.image_width),
        int(c.image_height),
    )


class App:
    """A session in the browser: shared controls for all open pages, and a camera for each."""

    def __init__(self, session: Session, port: int, folder: Path) -> None:
        """Serve at 127.0.0.1:`port`; pictures and clips go to `folder`. Raises Tg4mmError if the port is taken."""
        self._session = session
        self._screens: dict[int, tuple[viser.ClientHandle, Screen]] = {}
        self._stopping = threading.Event()
        self._failure: BaseException | None = None
        self.server = start_server(port)
        self.url = address(self.server)
        add_side_panel(self.server, session.scene.path)
        self._panel = Panel(self.server, session)
        self._cameras = CameraPanel(self.server, session, self._panel.view)
        self._pixel = PixelPanel(self.server, session)
        with self._panel.view:
            if session.scene.duration > 0:
                beside = self.server.gui.add_button(
                    _BESIDE, hint="The scene as captured beside the magnified one."
                )
                beside.on_click(lambda _: self._put_beside())
            dark = self.server.gui.add_checkbox(
                "Dark page", False, hint="A dark panel; the scene stays on white."
            )
        dark.on_update(lambda _: set_theme(self.server, bool(dark.value)))
        SavePanel(self.server, session, folder, canvas_of, lambda: self._pixel.shown)
        self.server.gui.add_html(block(key_words(_KEYS if session.scene.duration > 0 else _KEYS[-3:])))
        self._listen()
        self._thread = threading.Thread(target=self._draw, daemon=True)
        self._thread.start()

    def _put_beside(self) -> None:
        self._session.set_look(beside=not self._session.look.beside)
        for client, _ in list(self._screens.values()):
            self._cameras.again(client)

    def _listen(self) -> None:
        server = self.server

        @server.on_client_connect
        def _(client: viser.ClientHandle) -> None:
            self._cameras.jump(client, 0)
            client.camera.on_update(lambda _: self._session.changed.set())
            self._screens[client.client_id] = client, Screen(self._session, _sender(client))
            self._session.changed.set()

        @server.on_client_disconnect
        def _(client: viser.ClientHandle) -> None:
            self._screens.pop(client.client_id, None)

        @server.scene.on_click()
        def _(event: viser.SceneClickEvent) -> None:
            self._pixel.clicked(canvas_of(event.client), *event.screen_pos)

    def wait(self) -> None:
        """Wait for `stop` or an interrupt; raises an error of the drawing loop."""
        while not self._stopping.wait(0.2):
            pass
        if self._failure is not None:
            raise self._failure

    def stop(self) -> None:
        """End drawing and serving."""
        self._stopping.set()
        self._session.changed.set()
        if self._thread is not threading.current_thread():
            self._thread.join(timeout=5.0)
        stop_server(self.server)

    def _draw(self) -> None:
        try:
            meter = _Meter()
            while not self._stopping.is_set():
                self._round(meter)
        except BaseException as error:
            self._failure = error
            self._stopping.set()

    def _round(self, meter: "_Meter") -> None:
        """Draw for every page that needs a picture, then wait for the next moment or change."""
        begun = time.monotonic()
        self._session.changed.clear()
        drew = [
            screen for client, screen in list(self._screens.values()) if _refreshed(client, screen, begun)
        ]
        self._panel.follow(begun)
        if drew:
            plays = self._session.clock.running(begun)
            self._panel.show_size(meter.rate(begun) if plays else None, drew[-1].size, plays)
            self._stopping.wait(max(1 / RATE - (time.monotonic() - begun), 0.0))
        else:
            self._session.changed.wait(_IDLE)


class _Meter:
    """Counts drawing rounds a second while time advances."""

    def __init__(self) -> None:
        self._since = self._last = 0.0
        self._count = 0

    def rate(self, now: float) -> float | None:
        """Count a round; return the rate once a second, otherwise None."""
        if now - self._last > 0.5:  # paused in between
            self._since, self._count = now, -1
        self._last = now
        self._count += 1
        if now - self._since < 1.0:
            return None
        rate = self._count / (now - self._since)
        self._since, self._count = now, 0
        return rate


def _sender(client: viser.ClientHandle) -> Callable[[np.ndarray, int], None]:
    def send(picture: np.ndarray, quality: int) -> None:
        client.scene.set_background_image(picture, format="jpeg", jpeg_quality=quality)
        client.flush()  # without it viser waits 16 ms for more

    return send


def _refreshed(client: viser.ClientHandle, screen: Screen, now: float) -> bool:
    canvas = canvas_of(client)
    return canvas.can_be_drawn and screen.refresh(canvas, now)
