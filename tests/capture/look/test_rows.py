"""How long rows take to be read: found from phases and from light, with a correct ±, offered and never applied."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.calibration.film import Film, FilmMode, Layer, texture
from tests.helpers.look import found
from tg4mm.capture.look import GreyPicture, look_at_pictures
from tg4mm.capture.look.model import Readout
from tg4mm.capture.look.record import from_record, to_record
from tg4mm.capture.look.rows import by_light, by_phases, readout_of, row_note, with_rows

WIDTH, HEIGHT, FPS, FRAMES, HZ, READOUT_S = 96, 128, 30, 120, 6.3, 0.02
POST = (32, 8, 64, 120)


def swaying(readout_s):
    """A rigid post; every sixteen rows are read at the time of their middle."""
    films = []
    for top in range(0, HEIGHT, 16):
        rng, delay = np.random.default_rng(4), readout_s * ((top + 8) / HEIGHT - 0.5)
        wall, post = (texture(HEIGHT, WIDTH, rng, 0.3, 0.3, (1.5, 4.0)) for _ in range(2))
        shape = np.broadcast_to([0.15, 0.05], (HEIGHT, WIDTH, 2))
        mode = FilmMode(shape, lambda t, d=delay: float(np.cos(2 * np.pi * HZ * (t + d))))
        film = Film([Layer(wall, None, [], 0.6), Layer(post, POST, [mode], 0.6)], FPS, FRAMES, 3.0, seed=4)
        films.append(film.pictures())
    for k, parts in enumerate(zip(*films, strict=True)):
        rows = [np.asarray(p)[16 * i : 16 * i + 16] for i, p in enumerate(parts)]
        yield GreyPicture(np.concatenate(rows), k / FPS)


@pytest.fixture(scope="module")
def post():
    return look_at_pictures(swaying(READOUT_S), "a post")


def test_a_rigid_post_tells_the_readout_and_the_option_is_offered(post):
    estimate = readout_of(post)
    assert abs(estimate.seconds - READOUT_S) < 2.5 * estimate.deviation_s < 0.006
    note = row_note(post)
    assert f"--readout {1e3 * estimate.seconds:.1f} would explain it, ± " in note
    assert note.endswith("if what vibrates moves at the same time at all heights")
    assert post.rows_s == 0  # never applied
    assert row_note(with_rows(post, READOUT_S)) == ""
    assert "other than the readout that was given" in row_note(with_rows(post, READOUT_S - 0.012))


def test_a_phase_is_that_of_the_frames_time_where_the_readout_is_given(post):
    (line,) = post.vibrations
    upper = replace(line, centre_px=(48.0, 16.0), phase_rad=-2 * np.pi * HZ * READOUT_S * 0.375)
    (given,) = with_rows(replace(post, lines=(upper,)), READOUT_S).lines
    assert given.phase_rad == pytest.approx(0, abs=0.01)


def test_deviations_by_phases_cover_the_truth():
    rng, off, answered = np.random.default_rng(1), [], 0
    for _ in range(200):
        hz, readout, weight = rng.uniform(2, 20), rng.uniform(0.006, 0.03), np.exp(rng.uniform(3.5, 6))
        heights = np.repeat(np.linspace(0.1, 0.9, 10), 3)
        angles = 2 * np.pi * hz * readout * heights + rng.normal(size=30) / weight**0.5
        angles += np.pi * (heights > rng.uniform(0, 2))  # beyond a node
        estimate = by_phases(angles, np.full(30, weight), heights, hz)
        if estimate is not None:
            answered += 1
            off.append(abs(estimate.seconds - readout) / estimate.deviation_s)
    assert answered > 100
    assert np.mean(np.array(off) < 2) > 0.93
    assert np.mean(np.array(off) < 1) < 0.95  # and not by being far too wide


def bands_of_light(rate, mains, depth, rng):
    times, rows = np.arange(int(4 * rate)) / rate, 0.015 * (np.arange(120) + 0.5) / 120
    level = 100 + 20 * np.sin(np.arange(120) / 9)
    turns = mains * (times[:, None] + rows) + 0.3
    return level * (1 + depth * np.cos(2 * np.pi * turns)) + rng.normal(size=(len(times), 120)) * 0.3


@pytest.mark.parametrize(("rate", "mains"), [(30, 100), (24, 100.02), (60, 99.97), (25, 120), (50, 120)])
def test_a_lamp_tells_the_readout(rate, mains):
    rows = bands_of_light(rate, mains, 0.01, np.random.default_rng(2))
    estimate = by_light(rows, np.arange(len(rows)) / rate)
    assert estimate.light_hz == round(mains / 20) * 20
    assert abs(estimate.seconds - 0.015) < max(3 * estimate.deviation_s, 1e-5) < 1e-3
    light = replace(found(), light_readout=estimate)
    assert f"if lamps flicker at {estimate.light_hz:g} Hz" in row_note(light)
    assert from_record(to_record(light)).light_readout == estimate


@pytest.mark.parametrize(("rate", "mains", "depth"), [(30, 120, 0.05), (25, 100, 0.05), (30, 100, 0.0)])
def test_light_that_stands_or_is_steady_tells_nothing(rate, mains, depth):
    rows = bands_of_light(rate, mains, depth, np.random.default_rng(3))
    assert by_light(rows, np.arange(len(rows)) / rate) is None


@pytest.mark.parametrize("seconds", [-0.012, 0.06])
def test_what_no_readout_explains_is_offered_none(seconds):
    note = row_note(replace(found(), light_readout=Readout(seconds, 0.001)))
    assert "which no readout of 0 to 33.33 ms from top to bottom explains" in note
    assert "--readout" not in note
