"""Recordings that were converted from another frame rate: the conversion is named, and its images are no vibrations."""

from dataclasses import replace

import numpy as np
import pytest

from tests.capture.look.test_look import film, seen, tone
from tg4mm.capture.look import GreyPicture, look_at_pictures

HZ = 4.37


def blended(source, n, m):
    """m / n source pictures a frame, each frame a mixture of the two beside its time."""
    for k in range(len(source) * n // m - 1):
        before, part = divmod(k * m, n)
        yield ((n - part) * source[before] + part * source[before + 1]) / n


def nearest(source, n, m):
    for k in range(len(source) * n // m):
        yield source[k * m // n]


def pulled_down(source, *fields):
    """Each source picture for so many fields; two fields, even rows and odd ones, are a frame."""
    shown = np.repeat(np.arange(len(source)), np.resize(fields, len(source)))
    for k in range(len(shown) // 2):
        frame = source[shown[2 * k]].copy()
        frame[1::2] = source[shown[2 * k + 1]][1::2]
        yield frame


CONVERTED = {
    "24 a second were made 30 by pulldown": lambda s: pulled_down(s, 2, 3),
    "24 a second were made 30 by pulldown, ": lambda s: pulled_down(s, 2, 3, 3, 2),
    "24 a second were made 25 by pulldown": lambda s: pulled_down(s, *[2] * 11, 3),
    "24 a second were made 30 by blending": lambda s: blended(s, 5, 4),
    "25 a second were made 30 by blending": lambda s: blended(s, 6, 5),
    "50 a second were made 60 by blending": lambda s: blended(s, 6, 5),
    "30 a second were made 25 by showing the nearest": lambda s: nearest(s, 5, 6),
    "24 a second were made 30 by showing the nearest": lambda s: nearest(s, 5, 4),
}


@pytest.mark.parametrize("words", CONVERTED)
def test_a_converted_recording_is_recognised_by_the_images_of_its_strongest_line(words):
    rate, shown = float(words.split()[0]), float(words.split()[5])
    hz = 3 * HZ if shown > 50 else HZ  # what blending takes goes by the square of it
    made = film((0.4, 0.0), tone(hz), noise=1.0)
    source = list(replace(made, fps=rate, frames=round(8 * rate)).pictures())
    found = look_at_pictures(
        (GreyPicture(p, k / shown) for k, p in enumerate(CONVERTED[words](source))), "a film"
    )
    assert found.conversion.startswith(words.strip(", "))
    assert [round(line.hz, 2) for line in found.vibrations] == [round(hz, 2)]
    (line,) = found.vibrations
    assert bool(line.lost) == (line.amplitude_px < 0.98 * 0.4)
    assert all(one.mark for one in found.lines if one.hz != line.hz)


@pytest.mark.parametrize("hz", [(HZ,), (HZ, 12 - HZ), (HZ, 6 + HZ, 12 - HZ)])
def test_vibrations_that_lie_as_images_would_are_their_own(hz):
    sizes = (1.0, 0.25, 0.2)
    made = film(
        (0.4, 0.0), lambda t: sum(a * np.cos(2 * np.pi * f * t + f) for a, f in zip(sizes, hz, strict=False))
    )
    found = seen(replace(made, frames=240))
    assert found.conversion == ""
    assert {round(line.hz, 1) for line in found.vibrations} >= {round(f, 1) for f in hz}
