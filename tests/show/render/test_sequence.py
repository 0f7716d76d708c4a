"""Sequences hold what was asked for, go on after a kill, and never mix two requests."""

import json
from dataclasses import replace

import numpy as np
import pytest

from tg4mm.capture import load_capture, load_images
from tg4mm.core.errors import RunError, Tg4mmError
from tg4mm.core.magnification import Magnification
from tg4mm.core.pictures.frames import read_png
from tg4mm.show.render.cameras import capture_cameras, orbit
from tg4mm.show.render.image import render_image
from tg4mm.show.render.sequence import RenderRequest, pose_of, render_orbit, render_sequence, work_folder


@pytest.fixture
def cameras(dataset):
    return capture_cameras(load_capture(dataset, split="test"))


def stamps(folder):
    return {path: path.stat().st_mtime_ns for path in folder.rglob("*.png")}


@pytest.mark.parametrize("slow", [1e9, 1e-9])
def test_a_video_that_no_player_plays_is_refused_before_rendering(run, cameras, tmp_path, slow):
    with pytest.raises(RunError, match=r"a video of .* pictures a second: expected 0.01 … 10000; see --slow"):
        render_sequence(run, cameras, RenderRequest(slow=slow), tmp_path / "out")
    assert not (tmp_path / "out").exists()
    render_sequence(run, cameras, RenderRequest(slow=slow), tmp_path / "out", timesteps=[0], video=False)


@pytest.mark.parametrize("alpha", [1e308, -1e7])
def test_a_magnification_beyond_all_measure_is_refused(run, cameras, tmp_path, alpha):
    with pytest.raises(RunError, match=r"--alpha .*: must be within ±1e\+06"):
        render_sequence(run, cameras, RenderRequest(Magnification.of(alpha)), tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("alpha", [0, 20])
def test_the_exact_model_renders_its_ground_truth(run, cameras, dataset, tmp_path, alpha):
    out = render_sequence(run, cameras, RenderRequest(Magnification.of(alpha)), tmp_path / "out", video=False)
    truth = load_capture(dataset, split="test", magnification=alpha)
    images = load_images(truth)
    for i in range(len(images)):
        rendered = read_png(out / f"{truth.timesteps[i]:03d}" / truth.paths[i].name) / 255
        # Both were rounded to 8 bits, the truth as straight colour and alpha.
        assert np.abs(rendered - images.rgb(i)).max() < 0.025
        assert np.abs(rendered - images.rgb(i)).mean() < 0.002


def test_resume_keeps_complete_pictures_and_finishes_the_rest(run, cameras, tmp_path):
    request = RenderRequest(Magnification.of(5))
    out = render_sequence(run, cameras, request, tmp_path / "out", video=False)
    expected = {path: path.read_bytes() for path in stamps(out)}
    torn, gone = out / "001" / "r_000.png", out / "004" / "r_001.png"
    torn.write_bytes(torn.read_bytes()[:-20])
    gone.unlink()
    before = stamps(out)
    render_sequence(run, cameras, request, out, video=False)
    after = stamps(out)
    assert {path: path.read_bytes() for path in after} == expected
    assert {path for path in after if after[path] != before.get(path)} == {torn, gone}


@pytest.mark.parametrize(
    ("request_2", "message"),
    [
        (RenderRequest(Magnification.of(6)), r"alpha = 5, asked is 6"),
        (RenderRequest(Magnification.of(5, (1.0, 6.0))), r"band_hz = null, asked is \[1.0, 6.0\]"),
        (RenderRequest(Magnification.of(5), background=(0.0, 0.0, 0.0)), "background"),
    ],
)
def test_another_request_in_the_same_folder_is_refused(run, cameras, tmp_path, request_2, message):
    out = render_sequence(
        run, cameras, RenderRequest(Magnification.of(5)), tmp_path / "out", [0], video=False
    )
    before = stamps(out)
    with pytest.raises(RunError, match=message):
        render_sequence(run, cameras, request_2, out, [0, 1], video=False)
    assert stamps(out) == before


def test_other_cameras_and_another_model_are_refused(run, cameras, tmp_path):
    out = render_sequence(run, cameras, RenderRequest(), tmp_path / "out", [0], video=False)
    with pytest.raises(RunError, match="other cameras"):
        render_sequence(run, cameras[:1], RenderRequest(), out, [0], video=False)
    space = run.load_space()
    run.save_space(replace(space, opacities=space.opacities * 0.5), {})
    with pytest.raises(RunError, match="of another model"):
        render_sequence(run, cameras, RenderRequest(), out, [0], video=False)


def test_a_folder_of_foreign_pictures_is_refused(run, cameras, tmp_path):
    (tmp_path / "mine.png").write_bytes(b"keep me")
    with pytest.raises(RunError, match=r"holds no render\.json, but 'mine\.png'"):
        render_sequence(run, cameras, RenderRequest(), tmp_path, [0], video=False)


@pytest.mark.parametrize(
    ("request_", "timesteps", "message"),
    [
        (RenderRequest(Magnification.of(float("nan"))), None, "--alpha nan"),
        (RenderRequest(Magnification.of(float("inf"))), None, "--alpha inf"),
        (RenderRequest(slow=0), None, "--slow 0"),
        (RenderRequest(Magnification.of(0.0, (4.0, 40.0))), None, "half the frame rate"),
        (RenderRequest(), [6], "timestep 6 is outside 0 … 5"),
    ],
)
def test_bad_requests_are_refused_before_anything_is_written(
    run, cameras, tmp_path, request_, timesteps, message
):
    with pytest.raises(Tg4mmError, match=message):
        render_sequence(run, cameras, request_, tmp_path / "out", timesteps)
    assert not (tmp_path / "out").exists()


def test_without_motion_only_alpha_0_renders(still_run, cameras, tmp_path):
    with pytest.raises(RunError, match=r"--alpha 5.*no motion"):
        render_sequence(still_run, cameras, RenderRequest(Magnification.of(5)), tmp_path / "out")
    out = render_sequence(still_run, cameras, RenderRequest(), tmp_path / "out")
    assert sorted(path.name for path in out.iterdir()) == ["000", "render.json"]


def test_an_orbit_has_a_picture_a_camera_while_time_runs(run, dataset, tmp_path):
    cameras = orbit(load_capture(dataset), 4)
    same = tuple(replace(cameras[0], name=camera.name) for camera in cameras)
    out = render_orbit(run, same, RenderRequest(Magnification.of(20), slow=2), tmp_path / "out")
    assert sorted(path.name for path in out.iterdir()) == [
        *("orbit.mp4", "r_000.png", "r_001.png", "r_002.png", "r_003.png", "render.json")
    ]
    pose, _, _ = pose_of(run, RenderRequest(Magnification.of(20)))
    for i in range(4):  # at half speed, picture i shows time i / 2
        expected = render_image(pose(i / 2), same[0].viewmat, same[0].K, 32, 32)
        np.testing.assert_allclose(read_png(out / f"r_{i:03d}.png") / 255, expected, atol=0.5 / 255 + 1e-6)
    assert json.loads((out / "render.json").read_text())["slow"] == 2


@pytest.mark.parametrize("command", [render_sequence, render_orbit])
def test_two_processes_do_not_render_into_one_folder(run, cameras, tmp_path, command):
    with (
        work_folder(tmp_path / "out").held("busy"),
        pytest.raises(RunError, match="in use: another process renders"),
    ):
        command(run, cameras[:1], RenderRequest(), tmp_path / "out")
    command(run, cameras[:1], RenderRequest(), tmp_path / "out")
    assert not (tmp_path / "out" / ".lock").exists()


def test_slow_motion_videos_stand_beside_the_others(run, cameras, tmp_path):
    out = render_sequence(run, cameras[:1], RenderRequest(Magnification.of(5)), tmp_path / "out")
    render_sequence(run, cameras[:1], RenderRequest(Magnification.of(5), slow=4), out)
    assert sorted(path.name for path in out.glob("*.mp4")) == ["r_000.mp4", "r_000_slow4.mp4"]


def test_the_background_shows_where_nothing_is(run, cameras):
    camera = cameras[0]
    size = (camera.width, camera.height)
    picture = render_image(run.load_space(), camera.viewmat, camera.K, *size, background=(0.2, 0.4, 0.6))
    assert picture.dtype == np.float32
    assert picture.shape == (32, 32, 3)
    np.testing.assert_allclose(picture[0, 0], [0.2, 0.4, 0.6], atol=1e-6)
