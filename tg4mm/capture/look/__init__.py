"""Vibrations in a video of a fixed camera, region by region: one pass, seconds, no model.

from tg4mm.capture.look import look
for line in look("pump.mp4").vibrations:
    print(line.hz, line.hz_deviation, line.amplitude_px, line.amplitude_deviation_px, line.box)
"""

from tg4mm.capture.look.look import look, look_at_pictures
from tg4mm.capture.look.model import FlickerLine, Look, LookLine, LookSummary, MovingRegion
from tg4mm.capture.look.reading import GreyPicture
from tg4mm.capture.look.recording import video_pictures

__all__ = [
    "FlickerLine",
    "GreyPicture",
    "Look",
    "LookLine",
    "LookSummary",
    "MovingRegion",
    "look",
    "look_at_pictures",
    "video_pictures",
]
