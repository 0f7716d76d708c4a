"""A flat capture's result names what its regions showed."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tests.helpers.look import found
from tg4mm.capture.sfm.flat import VIEWMAT
from tg4mm.show.regions import region_picture
from tg4mm.show.result.looked import looked_notes, looked_vibrations


def test_a_line_is_a_vibration_in_pixels_and_scene_units_at_its_place() -> None:
    K = np.array([[64.0, 0, 32], [0, 64.0, 25], [0, 0, 1]])
    capture = SimpleNamespace(viewmats=VIEWMAT[None], Ks=K[None])
    (v,) = looked_vibrations(found(), capture, fps=30.0, duration_s=6.0)
    assert (v.hz, v.deviation_hz) == (5.2, 0.01)
    assert v.pixels is not None
    assert (v.pixels.value, v.pixels.deviation) == (0.12, 0.004)
    assert v.amplitude.value == pytest.approx(0.12 / 64)
    assert v.place == pytest.approx(((40 - 32) / 64, 1.0, (25 - 24) / 64))
    assert v.damping == 0.02
    assert v.band[0] < 5.2 < v.band[1]


def test_a_marked_line_is_no_vibration_and_the_notes_say_why() -> None:
    marked = found("2 × 2.600 Hz")
    notes = looked_notes(marked)
    assert any("5.2 Hz (0.12 px at (40, 24)): 2 × 2.600 Hz" in note for note in notes)
    assert not any("5.2 Hz" in note for note in looked_notes(found()))


def test_an_amplitude_that_the_codec_took_from_is_said_to_be_larger() -> None:
    seen = found()
    lost = replace(seen, lines=(replace(seen.lines[0], lost="smaller than the codec lets through"),))
    said = "how much more than 0.12 px things move at 5.2 Hz at (40, 24): smaller than the codec lets through"
    assert said in looked_notes(lost)
    assert said not in looked_notes(seen)


def test_what_moves_by_itself_and_the_light_are_said() -> None:
    notes = " ".join(looked_notes(found()))
    assert (
        "between pixels (0, 0) and (16, 16): something there moves by itself, periodically at 7.5 Hz" in notes
    )
    assert "it flickers at 10 Hz" in notes


def test_the_picture_of_regions_tints_the_line_and_stripes_what_moves_by_itself() -> None:
    shown = region_picture(found(), np.full((50, 64, 3), 128, np.uint8))
    scale = shown.shape[0] // 50
    inside, wall = shown[18 * scale, 34 * scale], shown[40 * scale, 8 * scale]
    assert inside[0] > inside[2] + 40
    assert (wall == 128).all()
    assert shown[2 * scale : 14 * scale, 2 * scale : 14 * scale].min() == 20
