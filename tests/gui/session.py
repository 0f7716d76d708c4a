"""The real Blender on a virtual screen: started, driven by mouse and keys, looked at, asked for values.

    with Session.start(extension_zip, files=[splat]) as blender:
        blender.click(40, 12)
        blender.picture(Path("menu.png"))
        blender.ask("frame")

What setup.sh built is needed, and root. Positions are pixels from the screen's upper left corner.
"""

import json
import os
import shutil
import subprocess
import tempfile
import time
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
ROOT = Path(os.environ.get("TG4MM_BLENDER_ROOT", "/var/tmp/tg4mm/blender-5.2"))
SIZE = (1280, 1000)  # high enough for the sidebar's longest panel
START_LIMIT, ANSWER_LIMIT = 240.0, 120.0  # s; software OpenGL compiles shaders for a while
PAUSE = 0.08  # s between what the hand does, so that Blender sees it one after another
ACTIVE, OBJECTS = "bpy.context.view_layer.objects.active", "bpy.data.objects.keys()"  # asked for often
MISSING_ROOT = f"no Blender in {ROOT}; run tests/gui/setup.sh as root"


class SessionError(RuntimeError):
    """Blender did not start, ended, or did not answer; what it last printed is in the message."""


def missing():
    """Why no session can start here; empty where one can."""
    if not (ROOT / ".tg4mm-complete").exists():
        return MISSING_ROOT
    return "" if os.geteuid() == 0 else "a chroot needs root"


@dataclass(frozen=True)
class Box:
    """A region of Blender's window, pixels."""

    left: int
    top: int
    width: int
    height: int

    @property
    def middle(self):
        return self.left + self.width // 2, self.top + self.height // 2


def read_xwd(data):
    """uint8 [H, W, 3] of an X window dump as Xvfb keeps its screen: header, palette, rows of BGRX pixels."""
    header = np.frombuffer(data, ">u4", 25)
    width, height, bits, row, palette = (int(header[i]) for i in (4, 5, 11, 12, 19))
    if bits != 32:
        raise SessionError(f"the screen has {bits} bits a pixel; expected 32")
    rows = np.frombuffer(data, np.uint8, row * height, int(header[0]) + 12 * palette).reshape(height, row)
    return np.ascontiguousarray(rows[:, : 4 * width].reshape(height, width, 4)[..., 2::-1])


class Session:
    """A running Blender. Made by `Session.start`."""

    def __init__(self, folder):
        self.folder = folder  # seen from here
        self.inside = "/" + str(folder.relative_to(ROOT))  # seen by Blender
        self._number = 0
        self._display = ""

    @classmethod
    @contextmanager
    def start(cls, extension, files=(), size=SIZE):
        """Install the zip the way a person does, start Blender, wait for its window; end it all at the end.

        `files` are copied to where Blender sees them, `inside`. Raises SessionError.
        """
        if missing():
            raise SessionError(missing())
        folder = Path(tempfile.mkdtemp(prefix="tg4mm-gui-", dir=ROOT / "var" / "tmp"))
        try:
            (folder / "home").mkdir()
            (folder / "resources").mkdir()
            (folder / "screen").mkdir()
            shutil.copyfile(extension, folder / "extension.zip")
            shutil.copyfile(HERE / "answering.py", folder / "answering.py")
            for file in files:
                shutil.copyfile(file, folder / file.name)
            process = _launch(folder, size)
            try:
                session = cls(folder)
                session._wait_for_window()
                yield session
            finally:
                _end(process)
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    # What a person does.

    def move(self, x, y):
        self._xdotool("mousemove", str(round(x)), str(round(y)))

    def click(self, x, y, button=1):
        self.move(x, y)
        self._xdotool("click", str(button))

    def click_with(self, held, x, y, button=1):
        """Click while a key is held."""
        self._xdotool("keydown", held)
        self.click(x, y, button)
        self._xdotool("keyup", held)

    def drag(self, start, by, steps=10, button=1):
        """Press at `start`, move by pixels in steps, let go. Relative, as a number field holds the pointer."""
        self.move(*start)
        self._xdotool("mousedown", str(button))
        done = (0, 0)
        for i in range(1, steps + 1):
            now = (round(by[0] * i / steps), round(by[1] * i / steps))
            self._xdotool("mousemove_relative", "--", str(now[0] - done[0]), str(now[1] - done[1]))
            done = now
        self._xdotool("mouseup", str(button))

    def key(self, *keys):
        """Press keys, each as xdotool writes it: `Return`, `ctrl+a`."""
        for key in keys:
            self._xdotool("key", key)

    def key_at(self, x, y, key):
        """Press a key that means what lies under the pointer."""
        self._xdotool("mousemove", str(round(x)), str(round(y)), "sleep", "0.06", "key", key)

    def write(self, text):
        self._xdotool("type", "--delay", "25", text)

    # What a person sees.

    def picture(self, path):
        """Write the whole screen as PNG; returns uint8 [H, W, 3]."""
        from PIL import Image

        path.parent.mkdir(parents=True, exist_ok=True)
        shot = self.now()
        Image.fromarray(shot).save(path, compress_level=1)
        return shot

    def now(self):
        """The whole screen, uint8 [H, W, 3]."""
        return read_xwd((self.folder / "screen" / "Xvfb_screen0").read_bytes())

    def region(self, area, region="WINDOW"):
        """A region of the first area of a type: `region("VIEW_3D", "UI")`."""
        found = next(a for a in self.ask("areas") if a["type"] == area)
        return Box(*found["regions"][region])

    # What only Blender knows.

    def ask(self, name, limit=ANSWER_LIMIT, **arguments):
        """The answer of a function of answering.py."""
        self._number += 1
        question = {"id": self._number, "name": name, "with": arguments}
        partial = self.folder / "ask.partial"
        partial.write_text(json.dumps(question), encoding="utf-8")
        os.replace(partial, self.folder / "ask.json")
        answer = self.folder / "answer.json"
        self.wait(answer.exists, f"an answer to {name}", limit, 0.02)
        reply = json.loads(answer.read_text(encoding="utf-8"))
        answer.unlink()
        assert reply["id"] == self._number, f"{reply} is no answer to {question}"
        if "error" in reply:
            raise SessionError(f"{name}: {reply['error']}")
        return reply["value"]

    def value(self, of, limit=ANSWER_LIMIT):
        """What an expression of `bpy` is in there."""
        return self.ask("value", limit, of=of)

    def places(self):
        """float32 [N, 3]: where the instances of the active object are drawn, in its own axes."""
        self.ask("places", file="places.npy")
        return np.load(self.folder / "places.npy")

    def wait(self, condition, what, limit=120.0, every=0.2):
        """Wait until something holds. Raises SessionError when it does not in `limit` seconds."""
        ends = time.monotonic() + limit
        while not condition():
            if self._status() in ("ended", "not installed"):
                raise SessionError(f"Blender {self._status()} before {what}\n{self.log()}")
            if time.monotonic() > ends:
                raise SessionError(f"{what}: not in {limit:g} s\n{self.log()[-2000:]}")
            time.sleep(every)

    def log(self):
        """All that Blender has printed: the installation, then the program."""
        logs = (self.folder / name for name in ("install.log", "blender.log"))
        return "".join(log.read_text(encoding="utf-8", errors="replace") for log in logs if log.exists())

    def complaints(self):
        """The lines of the log in which Python or Blender complains."""
        words = ("Traceback", "Error", "rna_uiItem", "unknown", "not found")
        return [line for line in self.log().splitlines() if any(word in line for word in words)]

    # How.

    def _status(self):
        file = self.folder / "status"
        return file.read_text(encoding="utf-8").strip() if file.exists() else ""

    def _wait_for_window(self):
        self.wait(lambda: self._status() == "started", "the virtual screen", START_LIMIT)
        self._display = ":" + (self.folder / "display").read_text(encoding="utf-8").strip()
        self.value("bpy.app.version", START_LIMIT)  # answered once the window is there
        # Without a window manager nobody gives it the keyboard.
        self._xdotool("search", "--sync", "--onlyvisible", "--class", "Blender", "windowfocus")

    def _xdotool(self, *words):
        self._run("xdotool", *words)
        time.sleep(PAUSE)

    def _run(self, *words):
        """Run a program inside, on the screen; returns what it printed."""
        variables = ("env", "-i", "PATH=/usr/bin:/bin", "HOME=/tmp", f"DISPLAY={self._display}")
        done = subprocess.run(
            ["chroot", str(ROOT), *variables, *words], capture_output=True, text=True, timeout=90
        )
        if done.returncode != 0:
            raise SessionError(f"{' '.join(words)}: {done.stderr.strip()}\n{self.log()[-2000:]}")
        return done.stdout


def _launch(folder, size):
    """Process and mount namespaces of its own: with its first process end all others, and the mounts."""
    for old in folder.parent.glob("tg4mm-gui-*"):  # of a session that was killed
        if old != folder and time.time() - old.stat().st_mtime > 6 * 3600:
            shutil.rmtree(old)
    namespaces = ("unshare", "--mount", "--pid", "--fork", "--kill-child", "--propagation", "private")
    script = ("/bin/sh", str(HERE / "run_inside.sh"), str(ROOT), "/" + str(folder.relative_to(ROOT)))
    words = [*namespaces, *script, *(str(n) for n in size)]
    return subprocess.Popen(words, stdin=subprocess.PIPE)


def _end(process):
    process.stdin.close()
    process.wait(timeout=300)
