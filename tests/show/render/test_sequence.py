"""Sequences hold what was asked for, go on after a kill, and never mix two requests."""

import json
from dataclasses import replace

import numpy as np
import pytest

from tg4mm.capture import load_capture, load_images
from tg4mm.core.errors import CaptureError, RunError
from tg4mm.core.magnification import Magnification
from tg4mm.core.pictures.decode import read_png
from tg4mm.show.render.cameras import capture_cameras, capture_path, orbit
from tg4mm.show.render.image import render_image
from tg4mm.show.render.sequence import RenderRequest, pose_of, render_orbit, render_path, render_sequence


@pytest.fixture
def cameras(dataset):
    return capture_cameras(load_capture(dataset, split="test"))


def stamps(folder):
    return {path: path.stat().st_mtime_ns for path in folder.rglob("*.png")}


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


def test_of_a_video_alone_some_pictures_are_written(run, cameras, tmp_path, monkeypatch):
    """Its frames are those of a sequence whose pictures are all there; without a whole video it is made again."""
    request = RenderRequest(Magnification.of(5))
    whole = render_sequence(run, cameras[:1], request, tmp_path / "whole")
    name = f"{cameras[0].name}.mp4"
    brief, out = replace(request, kept=2), tmp_path / "brief"
    calls = iter([render_image] * 3)
    monkeypatch.setattr("tg4mm.show.render.sequence.render_image", lambda *a: _next_or_interrupt(calls)(*a))
    with pytest.raises(KeyboardInterrupt):
        render_sequence(run, cameras[:1], brief, out)
    monkeypatch.undo()
    assert not list(out.glob("*.mp4"))
    render_sequence(run, cameras[:1], brief, out)
    assert (out / name).read_bytes() == (whole / name).read_bytes()
    pictures = {path.relative_to(out) for path in out.rglob("*.png")}
    assert pictures == {path.relative_to(whole) for path in sorted(whole.rglob("*.png"))[:2]}
    for path in pictures:
        np.testing.assert_array_equal(read_png(out / path), read_png(whole / path))


def _next_or_interrupt(calls):
    for call in calls:
        return call
    raise KeyboardInterrupt


def test_another_band_other_cameras_and_another_model_are_refused(run, cameras, tmp_path):
    out = render_sequence(run, cameras, RenderRequest(), tmp_path / "out", [0], video=False)
    with pytest.raises(RunError, match=r"band_hz = null, not \[1.0, 6.0\]"):
        render_sequence(run, cameras, RenderRequest(Magnification.of(0.0, (1.0, 6.0))), out, [0], video=False)
    with pytest.raises(RunError, match="other cameras"):
        render_sequence(run, cameras[:1], RenderRequest(), out, [0], video=False)
    space = run.load_space()
    run.save_space(replace(space, opacities=space.opacities * 0.5), {})
    with pytest.raises(RunError, match="of another model"):
        render_sequence(run, cameras, RenderRequest(), out, [0], video=False)


def test_an_orbit_has_a_picture_a_camera_while_time_runs(run, dataset, tmp_path):
    cameras = orbit(load_capture(dataset), 4)
    same = tuple(replace(cameras[0], name=camera.name) for camera in cameras)
    out = render_orbit(run, same, RenderRequest(Magnification.of(20), slow=2), tmp_path / "out")
    names = {path.name for path in out.iterdir()}
    assert names == {"orbit.mp4", "render.json", *(f"r_{i:03d}.png" for i in range(4))}
    pose, _, _ = pose_of(run, RenderRequest(Magnification.of(20)))
    for i in range(4):  # at half speed, picture i shows time i / 2
        expected = render_image(pose(i / 2), same[0].viewmat, same[0].K, 32, 32)
        np.testing.assert_allclose(read_png(out / f"r_{i:03d}.png") / 255, expected, atol=0.5 / 255 + 1e-6)
    assert json.loads((out / "render.json").read_text())["slow"] == 2


def test_on_the_capture_s_path_picture_t_is_from_pose_t(run, dataset, tmp_path):
    capture = load_capture(dataset)
    said = r"timestep 0 has pictures from [0-9]+ poses: --path capture needs one"
    with pytest.raises(CaptureError, match=said):
        capture_path(capture)
    one = capture.selected(np.array([int(np.flatnonzero(capture.timesteps == t)[t % 2]) for t in range(4)]))
    path = capture_path(replace(one, n_timesteps=4))
    assert [camera.name for camera in path] == ["r_000", "r_001", "r_002", "r_003"]
    out = render_path(run, path, RenderRequest(Magnification.of(20)), tmp_path / "out")
    assert (out / "path.mp4").stat().st_size > 0
    pose, _, _ = pose_of(run, RenderRequest(Magnification.of(20)))
    for t in range(4):
        expected = render_image(pose(t), one.viewmats[t], one.Ks[t], 32, 32)
        np.testing.assert_allclose(read_png(out / f"r_{t:03d}.png") / 255, expected, atol=0.5 / 255 + 1e-6)
