"""No camera that the generator places cuts the scene off at the edge of its picture."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from dataset_gen.cameras import CameraSetup, cameras_at
from dataset_gen.cameras.paths import half_widths, moving_points
from dataset_gen.prepare import bodies_of, framed
from dataset_gen.scenes import NAMES
from dataset_gen.settings import Settings, motion_file
from dataset_gen.vibration import read_motion, solve
from tests.dataset_gen import builtin

SETUPS = (
    CameraSetup("rig", views=9),
    CameraSetup("sweep", views=9),
    CameraSetup("handheld", n_timesteps=48, fps=24.0),
    CameraSetup("clips", views=5),
    CameraSetup("flat"),
)
ALPHA = 100  # the largest of the presets
MARGIN = 0.97  # of the half width; cameras stand so that the points that they were placed by are within 0.96


def settings_of(name: str, cameras: CameraSetup) -> Settings:
    motion = read_motion(motion_file(name))
    return Settings(name, motion=motion, cameras=cameras, alphas=(ALPHA,), size=128, samples=1, truth="none")


QUICK = ("mic", "hotdog")
SOME = [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in NAMES]


@lru_cache(maxsize=1)
def moved(name):
    """Bodies of a scene, and its points at some timesteps, as captured and magnified."""
    bodies = bodies_of(builtin.built(name))
    motion = solve(read_motion(motion_file(name)), bodies, 30.0, None, 0)

    def scene(alpha, timesteps):
        return [
            np.concatenate([b.vertices + motion.displacement(i, state) for i, b in enumerate(bodies)])
            for state in (motion.state(t, alpha) for t in timesteps)
        ]

    return bodies, scene(0.0, (2, 7)), scene(ALPHA, (1, 4, 8))


@pytest.mark.parametrize("setup", SETUPS, ids=lambda setup: setup.kind)
@pytest.mark.parametrize("name", SOME)  # scene by scene: each is built once
def test_all_that_moves_is_in_every_picture(setup, name):
    """Every vertex at several timesteps, projected into every camera of every kind."""
    bodies, captured, magnified = moved(name)
    cameras = framed(settings_of(name, setup), bodies).cameras
    assert 1.0 <= cameras.clearance < 1.2
    assert 1.0 <= cameras.test_clearance < 1.45
    for t in range(0, setup.n_timesteps, 9) if setup.kind == "handheld" else (0,):
        for camera in cameras_at(cameras, t)["train"]:
            assert max(half_widths(camera, points) for points in captured) < MARGIN, camera.name
    if setup.kind != "flat":  # whose test view is that of its one camera
        for camera in cameras_at(cameras, 0)["test"]:
            assert max(half_widths(camera, points) for points in magnified) < MARGIN, camera.name


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
    orbit = CameraSetup()
    assert orbit.framing(cube) == orbit


def test_test_cameras_stand_back_for_what_they_alone_see():
    cube = 0.5 * np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T
    setup = CameraSetup("rig", views=5)
    assert setup.framing(cube) == setup
    framed = setup.framing(cube, 3.0 * cube)
    assert framed.clearance == 1.0
    assert framed.test_clearance > 1.2
    assert cameras_at(framed, 0)["train"] == cameras_at(setup, 0)["train"]
    assert all(half_widths(camera, 3.0 * cube) <= 0.96 for camera in cameras_at(framed, 0)["test"])
    assert CameraSetup.from_json(framed.to_json()) == framed
    assert "test_clearance" not in setup.to_json()


def test_moving_points_are_where_the_motion_takes_them():
    rng = np.random.default_rng(4)
    points, basis = rng.normal(size=(3000, 3)), 0.5 * rng.normal(size=(2, 3000, 3))
    gains = np.array([np.sin(np.arange(12)), np.cos(np.arange(12))])
    every = (points + np.einsum("gt,gpc->tpc", gains, basis)).reshape(-1, 3)
    few = moving_points(points, basis, gains)
    assert len(few) == 400
    directions = rng.normal(size=(50, 3))
    assert ((few @ directions.T).max(0) > 0.97 * (every @ directions.T).max(0)).all()
    assert {tuple(p) for p in few.round(9)} <= {tuple(p) for p in every.round(9)}
