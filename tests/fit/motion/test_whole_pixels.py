"""Motion of whole pixels before one fixed camera: pictures are put back, and its size and the scene come out."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from benchmarks.calibration.film import Coding, Film, Layer, sliding, texture, write_video
from tg4mm.capture import ImageStack, load_capture
from tg4mm.capture.pictures import over_white
from tg4mm.capture.sfm.reconstruct import reconstruct
from tg4mm.fit.motion.animate import displacement_at
from tg4mm.fit.motion.large import whole_pixels
from tg4mm.fit.motion.large.resampling import put_back
from tg4mm.fit.motion.observations import PosedFrames
from tg4mm.run.train import train

HEIGHT, WIDTH, FRAMES, FPS = 48, 64, 20, 20.0
TIMES_S = np.arange(FRAMES) / FPS


def waves(x, y):
    """[…, 3] in 0..1 at places in pixels."""
    return 0.5 + 0.3 * np.stack([np.sin(0.5 * x + 0.3 * y), np.cos(0.4 * x - 0.6 * y), np.sin(0.35 * x)], -1)


def course(times_s):
    """[2, …] of a motion to the right and one down."""
    return np.stack([np.cos(2 * np.pi * 3.2 * times_s), np.sin(2 * np.pi * 1.7 * times_s)])


def filmed(readout_s):
    """Pictures of waves that move within a disc, its flow [2, H, W, 2], and the frames.

    Row by row at its own time. What is seen at x + u(x) lies at x at rest; the inverse is found by iteration.
    """
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    disc = np.exp(-(((x - 36) / 12) ** 2 + ((y - 24) / 9) ** 2))
    disc[disc < 0.02] = 0
    flow = np.zeros((2, HEIGHT, WIDTH, 2), np.float32)
    flow[0, ..., 0], flow[1, ..., 1] = 2.0 * disc, -1.5 * disc
    delays = readout_s * ((np.arange(HEIGHT) + 0.5) / HEIGHT - 0.5)
    pictures = np.empty((FRAMES, HEIGHT, WIDTH, 4), np.uint16)
    pictures[..., 3] = 65535
    for t, seconds in enumerate(TIMES_S):
        gains = course(seconds + delays)[..., None]  # [2, H, 1]
        rx, ry = x.copy(), y.copy()
        for _ in range(
            60
        ):  # where what is seen here lies at rest: its row tells the time at which it is read
            at = np.exp(-(((rx - 36) / 12) ** 2 + ((ry - 24) / 9) ** 2))
            at[at < 0.02] = 0
            rx, ry = x - 2.0 * at * gains[0], y + 1.5 * at * gains[1]
        pictures[t, ..., :3] = (waves(rx, ry) * 65535).round()
    frames = PosedFrames("a", np.eye(4), np.eye(3), np.arange(FRAMES), TIMES_S, readout_s)
    return ImageStack(pictures), flow, frames


def test_what_moves_by_pixels_is_put_back_where_it_is_at_rest():
    pictures, flow, frames = filmed(0.0)
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    back = put_back(pictures, frames, flow, course(TIMES_S))
    shown = over_white(back.strips([3, 11, 0])(slice(None)), back.maximum)
    raw = over_white(pictures.strips([3, 11, 0])(slice(None)), pictures.maximum)
    inside = np.s_[:, 8:-8, 8:-8]
    assert np.abs(raw - waves(x, y))[inside].max() > 0.3
    # but for the disc's rim, which has a kink
    smooth = np.abs(gaussian_filter(shown - waves(x, y), (0, 1, 1, 0)))
    assert smooth[inside].max() < 0.02
    assert np.sqrt(((shown - waves(x, y))[inside] ** 2).mean()) < 0.004
    still = ~flow.any((0, 3))
    assert np.abs(shown - raw)[:, still].max() < 1e-4


def test_each_row_is_put_back_as_of_its_own_time():
    pictures, flow, frames = filmed(0.04)
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    rows = np.s_[:, 12:-12, 12:-12]
    errors = []
    for own in (frames, replace(frames, readout_s=0.0)):
        back = put_back(pictures, own, flow, course(TIMES_S))
        shown = over_white(back.strips(list(range(4, 16)))(slice(None)), back.maximum)
        errors.append(np.sqrt(((shown - waves(x, y))[rows] ** 2).mean()))
    assert errors[0] < 0.2 * errors[1]


@pytest.mark.slow
def test_modes_of_a_plate_that_moves_by_pixels(tmp_path, monkeypatch):
    """One at 2.2 px, one beside it at .2: within 7 % of each; killed on the way, to the bit the same."""
    width, height, rng = 256, 128, np.random.default_rng(4)
    sizes, hz, centres = (2.2, 0.2), (3.3, 5.1), ((64, 64), (188, 64))
    cloths = [texture(128, 128, rng, 0.4, 0.4, [1.5, 4.0, 9.0]) for _ in sizes]
    back = texture(height, width, rng, 0.25, 0.35, [2.0, 6.0])

    def moves(k):
        return lambda t: sizes[k] * np.sin(2 * np.pi * hz[k] * t) * np.array([0.8, -0.6])

    plates = [sliding(c, at, moves(k)) for k, (c, at) in enumerate(zip(cloths, centres, strict=True))]
    film = Film([Layer(back, None, [], 0.55)], 30, 120, 2.0, painters=plates)
    write_video(tmp_path / "plates.mp4", film.pictures(), 30, Coding("libx264", 6_000_000))
    reconstruct(tmp_path / "plates.mp4", tmp_path / "set")
    run = train(tmp_path / "set", tmp_path / "run")
    motion, capture, gaussians = run.load_motion(), load_capture(run.dataset), run.load_space()
    K, view = capture.Ks[0], capture.viewmats[0]
    at = gaussians.means.numpy() @ view[:3, :3].T + view[:3, 3]
    places = at[:, :2] / at[:, 2:] * K[[0, 1], [0, 1]] + K[:2, 2]
    moved = np.stack([displacement_at(motion, float(t)) for t in range(120)]) @ view[:3, :3].T[:, :2]
    pixels = moved / at[:, 2:] * K[[0, 1], [0, 1]] @ [0.8, -0.6]
    for k, centre in enumerate(centres):
        own = (np.abs(places - centre) < 24).all(1)
        true = sizes[k] * np.sin(2 * np.pi * hz[k] * np.arange(120) / 30)
        ratio = (true - true.mean()) @ pixels[:, own] / ((true - true.mean()) @ true)
        assert np.median(ratio) == pytest.approx(1, abs=0.07)
    assert run.log()["motion"]["gauss_newton"] >= 1
    calls = []

    def killed(*given):
        calls.append(None)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return put_back(*given)

    with monkeypatch.context() as patch:
        patch.setattr(whole_pixels, "put_back", killed)
        with pytest.raises(KeyboardInterrupt):
            train(tmp_path / "set", tmp_path / "again")
    again = train(tmp_path / "set", tmp_path / "again")
    assert np.array_equal(again.load_motion().displacement, motion.displacement)
    assert np.array_equal(again.load_space().means, gaussians.means)
