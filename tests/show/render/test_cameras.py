"""Orbits look where the capture looks and keep up; transforms files are read exactly or refused."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.synthetic import CENTRE, RADIUS
from tg4mm.capture import load_capture
from tg4mm.core.errors import CaptureError, RunError
from tg4mm.show.render.cameras import cameras_from_file, look_at, orbit, transforms_json


@pytest.fixture
def capture(dataset):
    return load_capture(dataset)


def test_orbit_is_a_level_circle_with_the_median_radius_and_elevation(capture):
    cameras = orbit(capture, 5)
    arms = np.array([camera.position for camera in cameras]) - CENTRE
    np.testing.assert_allclose(np.linalg.norm(arms, axis=1), RADIUS, rtol=1e-9)
    np.testing.assert_allclose(arms[:, 2], arms[0, 2])
    first = capture.viewmats[:3]
    heights = [(-v[:3, :3].T @ v[:3, 3] - CENTRE)[2] / RADIUS for v in first]
    assert math.asin(arms[0, 2] / RADIUS) == pytest.approx(np.median(np.arcsin(heights)))
    azimuths = np.unwrap(np.arctan2(arms[:, 1], arms[:, 0]))
    np.testing.assert_allclose(np.diff(azimuths), 2 * math.pi / 5)


def seen_from(capture, azimuths_deg):
    """The capture with cameras at these azimuths."""
    views = []
    for degrees in azimuths_deg:
        a = math.radians(degrees)
        position = CENTRE + RADIUS * np.array([math.cos(a) * 0.8, math.sin(a) * 0.8, 0.6])
        views.append(look_at(position, CENTRE))
    count = len(capture.viewmats) // len(views) + 1
    return replace(capture, viewmats=np.tile(np.array(views), (count, 1, 1))[: len(capture.viewmats)])


def degrees_of(cameras):
    arms = np.array([camera.position for camera in cameras]) - CENTRE
    return np.degrees(np.arctan2(arms[:, 1], arms[:, 0]))


@pytest.mark.parametrize("turned", [0.0, 170.0])
def test_where_cameras_saw_a_part_of_the_circle_it_goes_to_and_fro_there(capture, turned):
    found = degrees_of(orbit(seen_from(capture, [turned + d for d in (10, -30, 40, 0)]), 60))
    found = (found - turned + 180) % 360 - 180
    assert found[0] == pytest.approx(10)
    assert found.min() == pytest.approx(-30, abs=0.2)
    assert found.max() == pytest.approx(40, abs=0.2)
    assert np.abs(np.diff(np.append(found, found[0]))).max() < 5  # it ends where it began


def test_a_fixed_camera_needs_a_centre_to_orbit_around(capture):
    rows = np.flatnonzero(capture.camera_ids == 0)
    names = ("viewmats", "Ks", "timesteps", "camera_ids", "times_s")
    arrays = {name: getattr(capture, name)[rows] for name in names}
    fixed = replace(capture, **arrays, paths=tuple(capture.paths[i] for i in rows))
    with pytest.raises(RunError, match="in one direction, so"):
        orbit(fixed, 4)
    cameras = orbit(fixed, 4, centre=np.array([0.0, 0.0, 0.3]))
    for camera in cameras:
        offset = np.array([0.0, 0.0, 0.3]) - camera.position
        np.testing.assert_allclose(camera.forward, offset / np.linalg.norm(offset), atol=1e-9)


def test_written_cameras_are_read_back(capture, tmp_path):
    cameras = orbit(capture, 3)
    path = tmp_path / "orbit.json"
    path.write_text(json.dumps(transforms_json(cameras)))
    for back, camera in zip(cameras_from_file(path), cameras, strict=True):
        assert (back.name, back.width, back.height) == (camera.name, camera.width, camera.height)
        np.testing.assert_allclose(back.viewmat, camera.viewmat, atol=1e-12)
        np.testing.assert_allclose(back.K, camera.K)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"frames": []}, "at least one frame"),
        ({"frames": 3}, "at least one frame"),
        ({"frames": [5]}, r"frames\[0\]: is 5"),
        ({"frames": [None]}, r"frames\[0\]: is None"),
        ({"frames": [{"transform_matrix": [[1, 0], [0, 1]]}]}, "expected 4×4"),
        ({"frames": [{"transform_matrix": (2 * np.eye(4)).tolist()}]}, "not rigid: its last row"),
        ({"frames": [{"transform_matrix": np.diag([2.0, 2, 2, 1]).tolist()}]}, "not rigid: its axes"),
        ({"frames": [{"transform_matrix": np.diag([-1.0, 1, 1, 1]).tolist()}]}, "determinant -1"),
        ({"frames": [{"transform_matrix": (np.eye(4) * math.nan).tolist()}]}, "holds nan"),
        ({"frames": [{"transform_matrix": (np.eye(4) + 1e300 * np.eye(4, k=3)).tolist()}]}, r"1e\+300 units"),
        ({"frames": [{}]}, "transform_matrix is missing"),
        ({"camera_angle_x": 0.0}, "camera_angle_x is 0.0"),
        ({"camera_angle_x": 7}, "camera_angle_x is 7"),
        ({"w": 0}, "w is 0; expected a whole number"),
        ({"w": 10_000_000}, "w is 10000000; expected a whole number of at most 16384"),
        ({"h": 1e400}, "h is inf"),
        ({"cx": math.nan}, "cx is nan"),
        ({"fl_y": -3}, "fl_y is -3"),
        ({"k1": 0.5}, "k1 is 0.5; expected 0: undistort"),
    ],
)
def test_bad_camera_files_are_refused_with_the_reason(tmp_path, change, message):
    good = {"camera_angle_x": 0.7, "w": 8, "h": 8, "frames": [{"transform_matrix": np.eye(4).tolist()}]}
    path = tmp_path / "cameras.json"
    path.write_text(json.dumps(good))
    assert len(cameras_from_file(path)) == 1
    path.write_text(json.dumps({**good, **change}))
    with pytest.raises(CaptureError, match=message) as caught:
        cameras_from_file(path)
    assert str(path) in str(caught.value)


def test_a_camera_file_that_is_absent_or_not_json_is_refused(tmp_path):
    with pytest.raises(CaptureError, match="cannot be read: No such file"):
        cameras_from_file(tmp_path / "none.json")
    (tmp_path / "bad.json").write_text("{")
    with pytest.raises(CaptureError, match="is not valid JSON"):
        cameras_from_file(tmp_path / "bad.json")
