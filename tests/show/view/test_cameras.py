"""The browser's camera shows what the capture's did, and its pixels lie where the page's do."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tg4mm.show.render.cameras import Camera, look_at
from tg4mm.show.view.cameras import camera_of, middle_depth, overview, rotation_of, standpoint_of


@pytest.fixture
def camera() -> Camera:
    viewmat = look_at(np.array([1.0, -3.0, 2.0]), np.array([0.2, 0.1, 0.5]))
    K = np.array([[70.0, 0, 32], [0, 70.0, 24], [0, 0, 1]])
    return Camera("r_000", viewmat, K, 64, 48)


def pixel(camera: Camera, point: np.ndarray) -> np.ndarray:
    seen = camera.K @ (camera.viewmat[:3, :3] @ point + camera.viewmat[:3, 3])
    return seen[:2] / seen[2]


def from_standpoint(camera: Camera, size: tuple[int, int]) -> Camera:
    to = standpoint_of(camera, 3.0, size[0] / size[1])
    z = to.target - to.position
    z = z / np.linalg.norm(z)
    x = np.cross(-to.up, z)
    rotation = np.stack([x / np.linalg.norm(x), np.cross(z, x / np.linalg.norm(x)), z], axis=1)
    return camera_of(to.position, rotation, to.fov, size[0] / size[1], size)


def test_a_canvas_of_the_capture_s_shape_shows_the_same_pixels(camera):
    shown = from_standpoint(camera, (128, 96))
    point = np.array([0.1, 0.3, 0.8])
    np.testing.assert_allclose(pixel(shown, point), 2 * pixel(camera, point), atol=1e-9)


@pytest.mark.parametrize("size", [(200, 96), (96, 200)])
def test_any_other_canvas_shows_all_of_the_picture(camera, size):
    shown = from_standpoint(camera, size)
    corner = np.linalg.inv(camera.K) @ [0.0, 0.0, 1.0]
    point = camera.position + camera.viewmat[:3, :3].T @ corner * 3
    u, v = pixel(shown, point)
    assert -1e-6 <= u <= size[0]
    assert -1e-6 <= v <= size[1]
    assert min(u, v) == pytest.approx(0, abs=1e-6)


def test_quaternions_are_read_as_w_first():
    q = Rotation.from_rotvec([0.3, -0.5, 0.9])
    np.testing.assert_allclose(rotation_of(q.as_quat(scalar_first=True)), q.as_matrix(), atol=1e-12)


def test_a_size_in_whole_pixels_keeps_the_field_of_view():
    shown = camera_of(np.zeros(3), np.eye(3), math.pi / 2, 1.337, (133, 100))
    assert shown.K[1, 1] == pytest.approx(50)
    assert 133 / 2 / shown.K[0, 0] == pytest.approx(1.337)


def test_the_point_to_turn_around_lies_amid_what_is_seen(camera):
    near, far = camera.position + 2 * camera.forward, camera.position + 5 * camera.forward
    behind = camera.position - camera.forward
    assert middle_depth(np.stack([near, far, behind]), np.array([1.0, 0.4, 9.0]), camera) == pytest.approx(
        2.0
    )
    assert middle_depth(np.stack([behind]), np.ones(1), camera) == 1.0


def test_the_overview_sees_the_scene():
    means = np.random.default_rng(0).uniform(-1, 1, (500, 3))
    seen = overview(means)
    at = np.array([pixel(seen, p) for p in means])
    assert ((at > 0) & (at < seen.width)).all()
