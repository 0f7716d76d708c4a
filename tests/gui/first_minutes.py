"""The pictures of docs/blender-first.md: the page's steps, by mouse and keys, in the real Blender.

python -m tests.gui.first_minutes tg4mm-sample.ply [docs/images]
"""

import shutil
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from PIL import Image

from . import beside, sidebar
from .session import ACTIVE, Session

SAMPLE = "tg4mm-sample.ply"
FILE, IMPORT, SPLATS = (42, 14), (78, 311), (380, 499)  # in the menus, pixels
PROBE = 58  # pixels from the button Blend as Trained to the header of the panel Probe
READING, PROBE_TOP = (
    "tg4mm.probe(source='CURSOR'",
    110,
)  # the button At 3D Cursor, pixels from the sidebar's top
PATIENCE = 120  # times two seconds


def settled(blender, shown=lambda: True):
    """Wait until what was asked for is shown and the window no longer changes."""
    blender.wait(shown, "what was asked for", 240.0)
    still, last = 0, blender.now()
    for _ in range(PATIENCE):
        time.sleep(2)
        now = blender.now()
        still = still + 1 if (now == last).all() else 0
        if still == 8:  # a busy machine draws late
            break
        last = now
    return last


def keep(blender, folder, number, width=1052):
    """The left part of the window, with the 3D view, as WebP."""
    picture = Image.fromarray(np.ascontiguousarray(settled(blender)[:, :width]))
    picture.save(folder / f"blender_first_{number}.webp", quality=80, method=6)
    print(f"picture {number}: {time.strftime('%H:%M:%S')}", flush=True)


def to_probe(blender):
    """Turn the wheel over the sidebar until the panel Probe stands at its top."""
    box = blender.region("VIEW_3D", "UI")
    for _ in range(40):
        if sidebar.find_button(blender, READING)[1] < box.top + PROBE_TOP:
            break
        blender.click(*box.middle, button=5)
    blender.move(*blender.region("VIEW_3D").middle)


def type_into(blender, name, text):
    """Click a number field and type."""
    blender.click(*sidebar.find(blender, name))
    time.sleep(1)
    blender.key("ctrl+a")
    blender.write(text)
    blender.key("Return")
    blender.wait(lambda: blender.ask("inputs")[name] == float(text), f"{name} {text}")


def walk(blender, folder):
    blender.click(*FILE)
    settled(blender)
    blender.click(*IMPORT)
    time.sleep(2)
    blender.move(*SPLATS)
    keep(blender, folder, 1)
    blender.key("Escape", "Escape", "Escape")
    plain = blender.now()[beside.MESSAGE]
    sidebar.import_by_menu(blender, SAMPLE, wait=120.0)
    time.sleep(10)
    compiled = lambda: not beside.share(blender.now()[beside.MESSAGE], plain)  # noqa: E731
    settled(blender, compiled)
    sidebar.open_tab(blender)
    keep(blender, folder, 2)
    blender.click(*sidebar.find_button(blender, "tg4mm.band(frequency=5", at=0.85))
    blender.wait(lambda: blender.ask("inputs")["Band Low"] > 0, "the band")
    type_into(blender, "Magnification", "50")
    keep(blender, folder, 3)
    blender.click(*sidebar.find(blender, "Colour By"))
    time.sleep(3)
    blender.key("a")
    settled(blender, lambda: blender.ask("inputs")["Colour By"] == "Amplitude" and compiled())
    keep(blender, folder, 4)
    box = blender.region("VIEW_3D")
    blender.click_with("shift", box.left + 0.4 * box.width, box.top + 0.45 * box.height, button=3)
    x, y = sidebar.find_button(blender, "tg4mm.blend_as_trained")
    blender.click(x, y + PROBE)
    time.sleep(5)
    blender.click(*sidebar.find_button(blender, READING))
    blender.wait(lambda: blender.value(f"'tg4mm_probe_label' in {ACTIVE}"), "the probe's reading")
    to_probe(blender)
    keep(blender, folder, 5)


def main(sample, folder):
    with tempfile.TemporaryDirectory() as scratch:
        shutil.copyfile(sample, copy := Path(scratch) / SAMPLE)
        with Session.start(beside.built(), [copy]) as blender:
            walk(blender, folder)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2] if len(sys.argv) > 2 else "docs/images"))
