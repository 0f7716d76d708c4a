"""What the tests of background jobs share: waiting for one by hand, and what the panels show."""

import time
from types import SimpleNamespace

import bpy

from tests.addon.playing import Layout

KINDS = ("generate", "train")


def wait(extension, kind, until=lambda job: False, limit_s=120.0):
    """Call the timer's function, as Blender would, until a job ends or a condition holds; returns the job."""
    background = extension.jobs.commands
    job = background.get(kind)
    begun = time.monotonic()
    while job.running and not until(job):
        assert time.monotonic() - begun < limit_s, f"{job.progress} {job.message}"
        again = background.tick()
        assert again == (background.INTERVAL_S if any(map(background.running, KINDS)) else None)
        time.sleep(0.02)
    return job


def drawn(extension, *panels):
    """What panels of the jobs show, in order; all of them without names."""
    layout = Layout()
    for cls in extension.jobs.panels._ui.classes:
        if not panels or cls.bl_label in panels:
            cls.draw(SimpleNamespace(layout=layout), bpy.context)
    return layout.drawn


def said(shown, text):
    """Whether a message is among what was drawn, cut into lines wherever."""
    return "".join(text.split()) in "".join("".join(shown).split())
