"""A camera's zoom and roll are distinguished from its shift, from noise, and from a moving object."""

import numpy as np
import pytest

from benchmarks.calibration.film import Film, FilmMode, Layer, texture
from tests.helpers.look import found as a_look
from tg4mm.capture.look import GreyPicture, look_at_pictures
from tg4mm.capture.look.model import FlickerLine, GlobalMotion
from tg4mm.capture.look.zoom import camera_shapes, designs, fitted, left_of, swing_note
from tg4mm.capture.tracking.template import Grid

SIZE, FRAMES = (320, 180), 200
PLACES = Grid.of(*SIZE, 16).centres()
NUISANCE = np.ones((FRAMES, 1))


def shifts(seed, noise=0.03):
    rng = np.random.default_rng(seed)
    sway = 0.1 * np.cumsum(rng.normal(size=(FRAMES, 1, 2)), 0)
    return sway + noise * rng.normal(size=(FRAMES, len(PLACES), 2)), rng


def shapes(shift):
    weights = np.broadcast_to(np.eye(2), (len(PLACES), 2, 2))
    return camera_shapes(PLACES, SIZE, weights, np.ones(shift.shape[:2]), shift, NUISANCE)


@pytest.mark.parametrize("shape", ["zoom", "roll"])
def test_what_the_whole_picture_follows_is_found_and_its_course_is_right(shape):
    shift, rng = shifts(0)
    course = 0.05 * np.sin(0.7 * np.arange(FRAMES)) + 0.02 * rng.normal(size=FRAMES)
    design = designs(PLACES, SIZE, (shape,))
    shift += design[..., 2] * course[:, None, None]
    assert shapes(shift) == (shape,)
    weights = np.broadcast_to(np.eye(2), (len(PLACES), 2, 2))
    found = fitted(design, weights, np.ones(shift.shape[:2]), shift)[:, 2]
    assert np.std(found - course) < 0.01


def test_neither_noise_nor_things_that_move_are_the_cameras():
    """Plates in any place move along and across the way from the middle; a tenth to a half of the picture."""
    for seed in range(40):
        shift, rng = shifts(seed)
        if seed:
            low, high = rng.uniform(0, 0.6, 2) * SIZE, rng.uniform(0.3, 0.7, 2) * SIZE
            plate = ((low < PLACES) & (low + high > PLACES)).all(1)
            shift[:, plate] += (
                rng.uniform(0.05, 0.3) * np.sin(0.9 * np.arange(FRAMES)[:, None, None]) * rng.normal(size=2)
            )
        assert shapes(shift) == (), seed


def test_a_lens_that_pumps_is_named_with_its_frequency_and_taken_off_what_vibrates():
    rng = np.random.default_rng(4)
    height, width = 112, 160
    away = np.stack(np.meshgrid(np.arange(width) + 0.5 - 80, np.arange(height) + 0.5 - 56), -1)
    pumps = FilmMode(away, lambda t: 0.002 * float(np.cos(2 * np.pi * 2.3 * t)))
    sways = FilmMode(np.broadcast_to([0.0, 0.1], away.shape), lambda t: float(np.cos(2 * np.pi * 6.1 * t)))
    cloths = [texture(height, width, rng, 0.3, 0.3, (1.5, 4.0)) for _ in range(2)]
    layers = [Layer(cloths[0], None, [pumps], 0.6), Layer(cloths[1], (48, 32, 112, 80), [pumps, sways], 0.6)]
    film = Film(layers, 30, 180, 3.0, light=lambda t: 1.0 if t < 3 else 1.2)
    found = look_at_pictures([GreyPicture(p, k / 30) for k, p in enumerate(film.pictures())], "a film")
    (line,) = found.vibrations
    assert line.hz == pytest.approx(6.1, abs=3 * line.hz_deviation)
    assert line.amplitude_px == pytest.approx(0.1, abs=2 * line.amplitude_deviation_px)
    zoom, light = found.swings
    assert zoom.largest == pytest.approx(0.002 * np.hypot(width, height) / 2, rel=0.2)
    assert zoom.tones[0].hz == pytest.approx(2.3, abs=0.02)
    assert "the lens focuses" in swing_note(zoom, found.size)
    assert light.largest == pytest.approx(1.2 ** (1 / 2.2) - 1, rel=0.2)
    assert light.at_s == pytest.approx(3, abs=0.3)


def test_a_faint_line_at_the_zooms_frequency_is_marked_and_a_strong_one_is_not():
    line = a_look().lines[0]
    for size, is_marked in ((10 * line.amplitude_px, True), (line.amplitude_px, False)):
        zoom = GlobalMotion("zoom", size, 0.0, (FlickerLine(line.hz, 0.01, size),))
        assert bool(left_of(line, [zoom], 10.0)) == is_marked
