"""`tg4mm view` without a run: draws regions and a scale on a recording's first picture, and looks at them."""

import shlex
import threading
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import viser
from markupsafe import Markup

from tg4mm.capture import load_capture
from tg4mm.capture.frames import IMAGE_SUFFIXES, picture
from tg4mm.capture.look import look
from tg4mm.capture.transforms import natural
from tg4mm.capture.video import RECORDING_SUFFIXES, video_frames
from tg4mm.core.choices import Clock
from tg4mm.core.digits import number
from tg4mm.core.errors import CaptureError, Tg4mmError
from tg4mm.core.files import argument
from tg4mm.core.pictures.decode import decode
from tg4mm.core.regions import Regions, write_regions
from tg4mm.fit.motion.observations import frames_of
from tg4mm.show.look import HEADER, LookText
from tg4mm.show.view.charts import block, composite_chart, key_words
from tg4mm.show.view.drawing import TOOLS, Drawing, Texture, drawn, opened, texture_of
from tg4mm.show.view.local_server import add_side_panel, address, start_server, stop_server
from tg4mm.show.view.screen import NARROW

_FIRST = 24  # pictures, for the noise
_LUMA = np.array([0.299, 0.587, 0.114], np.float32)
_KEYS = (("b", "box"), ("p", "polygon"), ("o", "point"), ("l", "length"), ("r", "rectangle"), ("f", "Finish"),
         ("u", "Undo"), ("s", "Save"))  # fmt: skip


@dataclass(frozen=True)
class FirstPicture:
    """The first picture of one fixed camera."""

    camera: str  # "" for a recording
    rgb: np.ndarray  # [H, W, 3] uint8
    texture: Texture


def shots_of(path: Path) -> list[FirstPicture]:
    """Return the pictures of a video, a folder of numbered pictures, or a dataset.

    Raises CaptureError for anything else.
    """
    if path.is_file() and path.suffix.lower() in RECORDING_SUFFIXES:
        return [_shot("", [_rgb(frame.pixels) for frame in islice(video_frames(path), _FIRST)])]
    if path.is_dir() and (path / "scene.json").is_file():
        capture = load_capture(path)
        clock, frames = frames_of(capture)
        if clock == Clock.moving:
            raise CaptureError(
                f"{path}: the camera moves, so regions cannot be marked in its pictures; open its run instead"
            )
        return [_shot(f.name, [_rgb(picture(capture.paths[k])) for k in f.rows[:_FIRST]]) for f in frames]
    if path.is_dir():
        found = (f for f in path.iterdir() if f.suffix.lower() in IMAGE_SUFFIXES)
        files = sorted(found, key=lambda f: natural(f.name))
        if files:
            return [_shot("", [_rgb(decode(file)) for file in files[:_FIRST]])]
    raise CaptureError(f"{path}: is not a run, a dataset, a video or a folder of pictures")


def _shot(camera: str, pictures: list[np.ndarray]) -> FirstPicture:
    if not pictures or any(p.shape != pictures[0].shape for p in pictures):
        raise CaptureError(f"{camera or 'the recording'}: holds no pictures of one size")
    grey = np.stack([p.astype(np.float32) @ _LUMA for p in pictures])
    return FirstPicture(camera, pictures[0], texture_of(grey))


def _rgb(pixels: np.ndarray) -> np.ndarray:
    """Return [H, W, 3] uint8 of [H, W, 3 or 4] of any depth."""
    return np.asarray(pixels[..., :3] >> 8 if pixels.dtype == np.uint16 else pixels[..., :3]).astype(np.uint8)


class Desk:
    """The recording in the browser; one drawing for all open pages."""

    def __init__(
        self, source: Path, file: Path, drawing: Regions | None, port: int, fps: float | None
    ) -> None:
        """Serve at 127.0.0.1:`port`; Save writes `file`. Raises Tg4mmError if the port is taken."""
        self._source, self._file, self._fps = source, file, fps
        self._shots = shots_of(source)
        self._shot = self._shots[0]
        height, width = self._shot.rgb.shape[:2]
        if drawing is not None:
            drawing.check_size((width, height), source)
        begun = opened(drawing) if drawing is not None else Drawing((width, height))
        self._drawing = replace(begun, camera=self._stored_camera())
        self._lock, self._looking = threading.Lock(), threading.Lock()
        self._stopping = threading.Event()
        self.server = start_server(port)
        self.url = address(self.server)
        self._add_panel()
        self._listen()

    def _stored_camera(self) -> str:
        """Return the camera name stored in a region, or nothing if there is only one camera."""
        return self._shot.camera if len(self._shots) > 1 else ""

    def _add_panel(self) -> None:
        gui = self.server.gui
        add_side_panel(self.server, self._source)
        with gui.add_folder("Draw"):
            if len(self._shots) > 1:
                cameras = gui.add_dropdown("Camera", tuple(shot.camera for shot in self._shots))
                cameras.on_update(lambda _: self._turn_to(cameras.value))
            tools = gui.add_button_group("Tool", tuple(TOOLS))
            tools.on_click(lambda _: self._change(lambda d: d.taking(str(tools.value))))
            self._name: Any = gui.add_text("Name", "", hint="Name of the next region; if empty, a number.")
            self._wide: Any = gui.add_number(
                "Length, width (mm)", 0.0, min=0.0, hint="Size of the next length or rectangle."
            )
            self._high: Any = gui.add_number("Height (mm)", 0.0, min=0.0, hint="Of the next rectangle.")
            finish = gui.add_button_group("Shape", ("Finish", "Undo"))
            finish.on_click(
                lambda _: self._change(Drawing.undone if finish.value == "Undo" else Drawing.finished)
            )
            self._show: Any = gui.add_checkbox(
                "Texture", True, hint="Green: motion is measurable. Amber: only along the stroke."
            )
            self._show.on_update(lambda _: self._draw())
            self._message = gui.add_html("")
        with gui.add_folder("File"):
            gui.add_button("Save").on_click(lambda _: self._save())
            self._saved = gui.add_html(block(f"To {self._file}", key_words(_KEYS)))
        if not (self._source / "scene.json").is_file():
            with gui.add_folder("Look"):
                gui.add_button("What vibrates?").on_click(lambda _: self._look())
                self._found = gui.add_html("")
        self._show_state()

    def _listen(self) -> None:
        server = self.server

        @server.on_client_connect
        def _(client: viser.ClientHandle) -> None:
            shape = [(0, 0)]

            def resized(_: object) -> None:
                now = (client.camera.image_width, client.camera.image_height)
                if now != shape[0]:
                    shape[0] = now
                    self._draw_for(client)

            client.camera.on_update(resized)
            self._draw_for(client)

        @server.scene.on_click()
        def _(event: viser.SceneClickEvent) -> None:
            x, y = self._place(event.client, *event.screen_pos)
            height, width = self._shot.rgb.shape[:2]
            if -2 <= x <= width + 2 and -2 <= y <= height + 2:
                self._change(lambda drawing: drawing.clicked((x, y)))

        @server.scene.on_rect_select()
        def _(event: viser.SceneRectSelectEvent) -> None:
            corners = [self._place(event.client, *at) for at in (event.screen_min, event.screen_max)]
            self._change(lambda drawing: drawing.dragged(*corners))

    def wait(self) -> None:
        """Wait for `stop` or an interrupt."""
        self._stopping.wait()

    def stop(self) -> None:
        """End serving."""
        self._stopping.set()
        stop_server(self.server)

    def _turn_to(self, camera: str) -> None:
        self._shot = next(shot for shot in self._shots if shot.camera == camera)
        height, width = self._shot.rgb.shape[:2]
        self._change(lambda d: replace(d, camera=camera, clicks=(), size=(width, height)))

    def _change(self, change: Any) -> None:
        """Apply `change` to the drawing; an impossible change is reported and its last click undone."""
        with self._lock:
            before = self._drawing
            sides = (float(self._wide.value or 0), float(self._high.value or 0))
            try:
                self._drawing = change(replace(before, name=str(self._name.value), sides_mm=sides))
                if len(self._drawing.regions) > len(before.regions):
                    self._name.value = ""
                self._show_state()
            except Tg4mmError as error:
                self._show_state(str(error))
        self._draw()

    def _show_state(self, error: str = "") -> None:
        drawing, size = self._drawing, (int(self._drawing.size[0]), int(self._drawing.size[1]))
        lines = [Markup('<p class="dim">{}</p>').format(f"{drawing.tool}: {TOOLS[drawing.tool]}")]
        if error:
            lines.append(Markup("<p><b>{}</b></p>").format(error[:1].upper() + error[1:]))
        for region in drawing.regions:
            if region.camera == drawing.camera:
                lines.append(
                    Markup("<p><b>{}</b>: {}</p>").format(region.name, self._shot.texture.words(region, size))
                )
        if drawing.scale is not None and (drawing.scale.lengths or drawing.scale.corners):
            at = f"{number(1e3 * drawing.scale.reference_m)} mm per pixel ± {100 * drawing.scale.share:.2g} %"
            tilt = ", tilted" if drawing.scale.corners else ", of a surface that the camera faces"
            lines.append(Markup("<p>Scale: {}</p>").format(at + tilt))
        self._message.content = block(*lines)

    def _fit(self, client: viser.ClientHandle) -> tuple[float, int, int, int, int]:
        """Return scale, left and upper edge of the picture on a page's canvas, and the canvas' size."""
        width, height = max(int(client.camera.image_width), 2), max(int(client.camera.image_height), 2)
        high, wide = self._shot.rgb.shape[:2]
        scale = min(width / wide, height / high)
        upper = (
            round((height - high * scale) / 2) if width > NARROW else 0
        )  # the panel must not hide the picture
        return scale, round((width - wide * scale) / 2), upper, width, height

    def _place(self, client: viser.ClientHandle, x: float, y: float) -> tuple[float, float]:
        scale, left, upper, width, height = self._fit(client)
        return (x * width - left) / scale, (y * height - upper) / scale

    def _draw(self) -> None:
        for client in self.server.get_clients().values():
            self._draw_for(client)

    def _draw_for(self, client: viser.ClientHandle) -> None:
        scale, left, upper, width, height = self._fit(client)
        texture = self._shot.texture if self._show.value else None
        shown = drawn(self._shot.rgb, self._drawing, texture, scale)[:height, :width]
        canvas = np.full((height, width, 3), 235, np.uint8)
        part = canvas[upper : upper + shown.shape[0], left : left + shown.shape[1]]
        part[:] = shown[: part.shape[0], : part.shape[1]]
        client.scene.set_background_image(canvas, format="jpeg", jpeg_quality=92)
        client.flush()

    def _regions(self) -> Regions:
        return self._drawing.as_file(self._source.name)

    def _save(self) -> None:
        try:
            with self._lock:
                write_regions(self._file, self._regions())
        except (Tg4mmError, OSError) as error:
            self._saved.content = block(f"Not written: {error}")
            return
        source, file = argument(self._source), argument(self._file)
        out = shlex.quote(self._source.resolve().stem)
        commands = [
            f"tg4mm look {source} --regions {file}",
            f"tg4mm process {source} --regions {file} --out {out}-out",
        ]
        if (self._source / "scene.json").is_file():
            commands = [f"tg4mm measure RUN --regions {file} --out {out}-measured"]
        code = [Markup("<p><code>{}</code></p>").format(command) for command in commands]
        self._saved.content = block(f"Wrote {self._file}. Next:", *code, key_words(_KEYS))

    def _look(self) -> None:
        """Run `tg4mm look` on the recording and the regions, one at a time."""
        if not self._looking.acquire(blocking=False):
            return
        try:
            self._found.content = block("Looking: one pass over the recording …")
            regions = self._regions()
            found = look(self._source, self._fps, regions=regions)
            words = LookText(found, self._source, self._fps, drawn=regions)
            rows = words.region_rows() or words.rows()
            header = words.region_header() if words.region_rows() else list(HEADER)
            named = [[(h, cell) for h, cell in zip(header, row, strict=True) if cell] for row in rows]
            lines = [
                ", ".join(cell if h in ("region", "remark") else f"{h} {cell}" for h, cell in row)
                for row in named
            ]
            self._found.content = block(words.verdict, composite_chart(found), *lines)
        except (Tg4mmError, OSError) as error:
            self._found.content = block(f"Failed: {error}")
        finally:
            self._looking.release()
