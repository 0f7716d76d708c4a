"""tg4mm sfm from videos of a known scene: tripod, clips and handheld, their times exact, their poses found."""

import json
from fractions import Fraction

import numpy as np
import pytest
from PIL import Image

from tests.capture.conftest import refused
from tests.capture.sfm.scenes import intrinsics, orbit, picture, save, umeyama
from tests.capture.sfm.videos import write_video
from tg4mm.capture import load_capture
from tg4mm.capture.cameras import optical_axes
from tg4mm.capture.sfm.config import SfmConfig
from tg4mm.capture.sfm.reconstruct import reconstruct
from tg4mm.cli import main

pytest.importorskip("pycolmap")
SIZE, FOCAL = (240, 180), 250.0
NTSC = Fraction(30000, 1001)
CAMERAS = orbit(12, turn=2.4)


def filmed(viewmats, seed=0):
    """What a camera at each pose sees, with a sensor's noise, over grey."""
    rng = np.random.default_rng(seed)
    frames, cached = [], {}
    for viewmat in viewmats:
        key = viewmat.tobytes()
        if key not in cached:
            rgba = picture(viewmat, intrinsics(*SIZE, FOCAL), SIZE) / 255.0
            cached[key] = 255 * (rgba[..., :3] * rgba[..., 3:] + 0.5 * (1 - rgba[..., 3:]))
        frames.append(np.clip(cached[key] + rng.normal(0, 2, cached[key].shape), 0, 255).astype(np.uint8))
    return frames


def place_error(capture, rows, true):
    """The largest error of a camera's place after alignment; the true distance from the scene is 4."""
    ours, _ = optical_axes(capture.viewmats[rows])
    expected, _ = optical_axes(true)
    scale, rotation, shift = umeyama(ours, expected)
    return float(np.linalg.norm(scale * ours @ rotation.T + shift - expected, axis=1).max())


def rows_of(capture, timestep):
    """Row of each picture of a timestep by its stem."""
    return {capture.paths[i].stem: int(i) for i in np.flatnonzero(capture.timesteps == timestep)}


@pytest.fixture(scope="module")
def tripod(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tripod")
    for i, viewmat in enumerate(CAMERAS):
        save(folder / "sweep" / f"{i:03d}.png", picture(viewmat, intrinsics(*SIZE, FOCAL), SIZE))
    fixed = np.repeat(CAMERAS[5][None] + 1e-3, 9, axis=0)
    write_video(folder / "film.mp4", filmed(fixed), NTSC, crf=8)
    return folder


@pytest.fixture(scope="module")
def tripod_dataset(tripod, tmp_path_factory):
    out = tmp_path_factory.mktemp("out") / "tripod"
    reconstruct(tripod, out, threads=1)
    return out


def test_a_tripod_is_one_fixed_camera_and_pictures_at_rest(tripod_dataset):
    capture = load_capture(tripod_dataset)
    assert (capture.kind, capture.n_timesteps, capture.fps) == ("tripod", 9, float(NTSC))
    first = rows_of(capture, 0)
    assert list(first) == ["film", *(f"sweep_{i:03d}" for i in range(12))]
    assert [list(rows_of(capture, t)) for t in range(1, 9)] == [["film"]] * 8
    films = [rows_of(capture, t)["film"] for t in range(9)]
    assert len(set(capture.camera_ids[films].tolist())) == 1
    assert capture.times_s[films].tolist() == [float(t / NTSC) for t in range(9)]
    assert np.isnan(np.delete(capture.times_s, films)).all()
    frames = json.loads((tripod_dataset / "000/transforms_train.json").read_text())["frames"]
    assert ["time" in frame for frame in frames] == [True] + [False] * 12


def test_photographs_stored_sideways_are_set_upright(tmp_path):
    """As phones store them: the sensor's picture, and how to turn it in EXIF."""
    exif = Image.Exif()
    exif[0x0112] = 6
    folder = tmp_path / "in"
    folder.mkdir()
    for i, viewmat in enumerate(CAMERAS[:7]):
        upright = picture(viewmat, intrinsics(180, 240, FOCAL), (180, 240))
        stored = Image.fromarray(np.rot90(filmed_over_grey(upright)))
        stored.save(folder / f"{i}.jpg", exif=exif, quality=97)
    reconstruct(folder, tmp_path / "out", threads=1)
    capture = load_capture(tmp_path / "out")
    assert (capture.width, capture.height) == (180, 240)
    assert place_error(capture, list(range(7)), CAMERAS[:7]) < 0.06
    shown = np.asarray(Image.open(capture.paths[3]).convert("RGB")).astype(int)
    stored = np.asarray(Image.open(folder / "3.jpg")).astype(int)
    assert np.abs(shown - np.rot90(stored, 3)).mean() < 3
    ups = -capture.viewmats[:, 1, 2]  # of each camera's up, the part along the world's
    assert ups.min() > 0.5


def filmed_over_grey(rgba):
    alpha = rgba[..., 3:] / 255
    return (rgba[..., :3] * alpha + 128 * (1 - alpha)).astype(np.uint8)


def test_clips_are_fixed_cameras_with_a_clock_each(tmp_path):
    places = orbit(5, turn=0.7, low=0.6, high=0.7)
    for k, viewmat in enumerate(places[:4]):
        frames = filmed(np.repeat(viewmat[None], 8 + k, axis=0), seed=k)
        write_video(tmp_path / "in" / f"cam_{k:02d}.mp4", frames, 30, crf=8)
    words = ["sfm", str(tmp_path / "in"), "--kind", "clips", "--out", str(tmp_path / "out"), "--threads", "1"]
    assert main(words) == 0
    capture = load_capture(tmp_path / "out")
    assert (capture.kind, capture.n_timesteps, capture.fps) == ("clips", 11, 30.0)
    assert [len(rows_of(capture, t)) for t in range(11)] == [*[4] * 8, 3, 2, 1]
    np.testing.assert_allclose(capture.times_s, capture.timesteps / 30)
    rows = rows_of(capture, 0)
    assert place_error(capture, list(rows.values()), places[:4]) < 0.06


def test_cameras_of_two_frame_rates_are_refused(tmp_path):
    for name, rate in (("a", 30), ("b", 60)):
        write_video(tmp_path / "in" / f"{name}.mp4", filmed(np.repeat(CAMERAS[:1], 8, axis=0)), rate)
    said = "camera b has 60 frames per second, a has 30: a dataset has one frame rate"
    refused(lambda: reconstruct(tmp_path / "in", tmp_path / "out", threads=1), said)


@pytest.fixture(scope="module")
def walk():
    """[24, 4, 4] a camera carried past the scene, trembling."""
    viewmats = orbit(24, turn=1.4, low=0.6, high=0.6)
    tremor = np.random.default_rng(3).normal(0, 0.01, (24, 2))
    viewmats[:, :2, 3] += tremor
    return viewmats


def test_every_frame_of_a_handheld_camera_gets_its_own_pose(walk, tmp_path):
    path = write_video(tmp_path / "walk.mp4", filmed(walk), NTSC, crf=8)
    report = reconstruct(path, tmp_path / "out", SfmConfig(frames=10), threads=1)
    assert (report["kind"], report["pictures"], report["placed"]) == ("handheld", 24, 24)
    capture = load_capture(tmp_path / "out")
    assert (capture.kind, capture.n_timesteps, len(capture)) == ("handheld", 24, 24)
    assert {path.name for path in capture.paths} == {"walk.png"}
    assert len(set(capture.camera_ids.tolist())) == 24
    assert capture.times_s.tolist() == [float(t / NTSC) for t in range(24)]
    assert place_error(capture, list(range(24)), walk) < 0.05
    assert place_error(capture, list(range(24)), np.roll(walk, 1, axis=0)) > 0.1


@pytest.mark.slow
def test_frames_that_cannot_be_placed_are_left_out_and_keep_the_others_times(walk, tmp_path):
    frames = filmed(walk)
    rng = np.random.default_rng(0)
    for t in (7, 8):  # something else held before the lens
        coarse = Image.fromarray(rng.integers(0, 256, (18, 24, 3), np.uint8))
        frames[t] = np.asarray(coarse.resize(SIZE, Image.Resampling.BICUBIC))
    path = write_video(tmp_path / "walk.mp4", frames, 30, crf=8)
    said = "2 pictures could not be placed and are left out: frames/00007.png, frames/0"
    with pytest.warns(UserWarning, match=said):
        reconstruct(path, tmp_path / "out", SfmConfig(frames=12), threads=1)
    capture = load_capture(tmp_path / "out")
    kept = [t for t in range(24) if t not in (7, 8)]
    assert capture.timesteps.tolist() == list(range(22))
    np.testing.assert_allclose(capture.times_s, np.array(kept) / 30)
    assert place_error(capture, list(range(22)), walk[kept]) < 0.05


def test_two_cameras_that_stay_put_are_named_as_such(tmp_path):
    """Two views are no start for poses; said with what to add, and what works as it is."""
    for i in (0, 1):
        write_video(tmp_path / "two" / f"cam_{i:02d}.mp4", filmed(np.stack([CAMERAS[i]] * 8), seed=i))
    said = (
        "two: holds 2 recordings of fixed cameras, and nothing else: ",
        " Add sweep/ ",
        " tg4mm sfm ",
        "cam",
    )
    refused(lambda: reconstruct(tmp_path / "two", tmp_path / "out"), *said)
