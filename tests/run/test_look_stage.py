"""The whole way of a flat video: the line is named beside a wheel, and the wheel is left out."""

import json

import numpy as np
import pytest

from benchmarks.calibration.film import Coding, Film, FilmMode, Layer, texture, write_video
from tg4mm.capture.sfm.reconstruct import reconstruct
from tg4mm.run.stages import look_of
from tg4mm.run.train import train
from tg4mm.show.measure import measure
from tg4mm.show.measure.write import write_json_file
from tg4mm.show.report import write_report
from tg4mm.show.result import lines_of, result_of

WIDTH, HEIGHT, FPS, FRAMES, HZ = 160, 112, 30, 120, 5.6


def video(path):
    rng = np.random.default_rng(0)
    shape = np.broadcast_to([0.16, 0.0], (HEIGHT, WIDTH, 2))
    plate = FilmMode(shape, lambda t: float(np.cos(2 * np.pi * HZ * t)))
    cloths = [texture(HEIGHT, WIDTH, rng, 0.3, 0.3, (1.5, 4.0)) for _ in range(2)]
    layers = [Layer(cloths[0], None, [], 0.6), Layer(cloths[1], (32, 32, 96, 80), [plate], 0.6)]
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    disc, angle = np.hypot(x - 132, y - 28) < 20, np.arctan2(y - 28, x - 132)

    def wheel(picture, t, k):
        return np.where(disc, 0.3 + 0.25 * np.sign(np.cos(3 * (angle - 2 * np.pi * 2.7 * t))), picture)

    film = Film(layers, FPS, FRAMES, 3.0, painters=[wheel])
    write_video(path, film.pictures(), FPS, Coding("libx264", 2_000_000))
    return path


@pytest.mark.slow
def test_a_plate_beside_a_wheel_the_whole_way(tmp_path):
    reconstruct(video(tmp_path / "plate.mp4"), tmp_path / "set")
    scene = json.loads((tmp_path / "set" / "scene.json").read_text())
    assert len(scene["picture_kinds"]) == FRAMES
    run = train(tmp_path / "set", tmp_path / "run")
    found = look_of(run)
    assert found.moves_by_itself[1, 8]
    result = result_of(run)
    first = [*result.vibrations, *result.beside][0]
    assert abs(first.hz - HZ) < 3 * first.deviation_hz < 0.1
    assert abs(first.pixels.value - 0.16) < 3 * first.pixels.deviation
    text = "\n".join(lines_of(result))
    assert "an object there moves independently" in text
    assert [v.hz for v in [*result.vibrations, *result.beside]] == [line.hz for line in found.vibrations]
    measured = measure(run)
    assert measured.sensors[0].name == f"{first.hz:.4g} Hz"
    values = json.loads(write_json_file(measured, tmp_path).read_text())
    assert len(values["composite"]["frequency_hz"]) == len(values["composite"]["power_over_noise"])
    page = write_report(run, tmp_path / "report.html").read_text()
    assert "Region by region" in page
    modes = run.load_motion()
    means = run.load_space().means.numpy()
    x = means[:, 0] * max(WIDTH, HEIGHT) + WIDTH / 2
    size = np.abs(modes.displacement).max((0, 2)) if len(modes.freqs_hz) else np.zeros(len(means))
    if result.vibrations:  # the model holds the plate, not the wheel
        assert size[(x > 120) & (x < 144)].mean() < 0.5 * size[(x > 40) & (x < 88)].mean()
