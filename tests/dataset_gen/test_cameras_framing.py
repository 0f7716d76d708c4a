"""No camera that the generator places cuts the scene off at the edge of its picture."""

from dataclasses import replace

import numpy as np
import pytest

from dataset_gen.cameras import CameraSetup, cameras_at
from dataset_gen.cameras.framing import extreme_points, half_widths
from dataset_gen.scenes import NAMES
from tests.dataset_gen import builtin

SETUPS = (
    CameraSetup("rig", views=9),
    CameraSetup("sweep", views=9),
    CameraSetup("handheld", n_timesteps=20, fps=5.0),
    CameraSetup("clips", views=5),
    CameraSetup("flat"),
)


@pytest.mark.parametrize("name", NAMES)
def test_every_vertex_of_a_scene_is_in_every_picture(name):
    shapes = builtin.solved(name)
    parts = {part.name: part.mesh.vertices for part in builtin.built(name).parts}
    rest = np.concatenate(list(parts.values()))
    most = {part: np.abs(shape).sum(0) for part, shape in shapes.items()}
    moved = np.concatenate([parts[part] + sign * most[part] for part in parts for sign in (1, -1)])
    for setup in SETUPS:
        framed = setup.framing(rest)
        assert 1.0 <= framed.clearance < 1.2
        for t in range(0, setup.n_timesteps, 3) if setup.kind == "handheld" else (0,):
            for camera in cameras_at(framed, t)["train"]:
                assert half_widths(camera, moved) < 0.98, (setup.kind, camera.name)


def test_some_scene_was_cut_off_before():
    """So that the test above can fail."""
    points = np.concatenate([part.mesh.vertices for part in builtin.built("materials").parts])
    setup = CameraSetup("rig", views=30, seed=1)
    assert max(half_widths(camera, points) for camera in cameras_at(setup, 0)["train"]) > 1.0


def test_moving_back_keeps_directions_and_the_orbit_stays():
    cube = 1.6 * np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T
    setup = CameraSetup("clips", views=5)
    framed = setup.framing(cube)
    assert framed.clearance > 1.3
    for near, far in zip(cameras_at(setup, 0)["train"], cameras_at(framed, 0)["train"], strict=True):
        np.testing.assert_allclose(far.position, near.position * framed.clearance)
        np.testing.assert_allclose(far.camera_to_world[:3, :3], near.camera_to_world[:3, :3], atol=1e-12)
        assert half_widths(far, cube) <= 0.96
    closer = replace(framed, clearance=framed.clearance / 1.01)
    assert max(half_widths(camera, cube) for camera in cameras_at(closer, 0)["train"]) > 0.96
    assert cameras_at(framed, 0)["test"] == cameras_at(setup, 0)["test"]
    orbit = CameraSetup()
    assert orbit.framing(cube) == orbit


def test_extreme_points_bound_a_cloud():
    rng = np.random.default_rng(0)
    cloud = rng.normal(size=(20000, 3)) * [1.0, 2.0, 0.5]
    few = extreme_points(cloud)
    assert len(few) <= 400
    directions = rng.normal(size=(50, 3))
    reach = (cloud @ directions.T).max(0)
    assert ((few @ directions.T).max(0) > 0.97 * reach).all()


def test_a_point_behind_a_camera_counts_as_outside():
    camera = cameras_at(CameraSetup("flat"), 0)["train"][0]
    assert half_widths(camera, 2.0 * camera.position[None]) == np.inf
