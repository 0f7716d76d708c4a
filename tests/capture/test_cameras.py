"""Poses: what the matrices project where, against the convention on disk and against Blender itself."""

import json
import math
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tg4mm.capture.cameras import read_intrinsics, read_pose, world_to_camera
from tg4mm.core.untrusted import JsonRecord

quaternions = st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: math.hypot(*q) > 0.1)
offsets = st.tuples(*[st.floats(-10, 10)] * 3)
angles = st.floats(0.05, 3.0)
BLENDER = """
import json, random, sys
import bpy
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Euler, Vector
random.seed(0)
scene = bpy.context.scene
scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 64, 48, 100
camera = bpy.data.objects.new("c", bpy.data.cameras.new("c"))
scene.collection.objects.link(camera)
out = []
for _ in range(20):
    camera.location = [random.uniform(-3, 3) for _ in range(3)]
    camera.rotation_euler = Euler([random.uniform(-3, 3) for _ in range(3)])
    camera.data.angle_x = random.uniform(0.3, 1.5)
    bpy.context.view_layer.update()
    local = Vector((random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-9, -1)))
    point = camera.matrix_world @ local
    x, y, depth = world_to_camera_view(scene, camera, point)
    out.append({
        "transform_matrix": [list(row) for row in camera.matrix_world], "camera_angle_x": camera.data.angle_x,
        "point": list(point), "pixel": [64 * x, 48 * (1 - y)], "depth": depth,
    })
print("RESULT" + json.dumps(out))
"""


def rotation(q):
    """Rotation matrix [3, 3] of a quaternion wxyz of any length."""
    w, *xyz = q
    return Rotation.from_quat([*xyz, w]).as_matrix()


def pose_of(q, origin):
    c2w = np.eye(4)
    c2w[:3, :3], c2w[:3, 3] = rotation(q), origin
    return c2w


def intrinsics(angle_x, width, height):
    return read_intrinsics(JsonRecord("f", {}), JsonRecord("f", {"camera_angle_x": angle_x}), width, height)


def project(viewmat, K, point):
    """Pixel coordinates (u to the right, v down) and depth of a world point."""
    camera = viewmat[:3, :3] @ point + viewmat[:3, 3]
    image = K @ camera
    return image[:2] / image[2], camera[2]


@given(quaternions, offsets, angles, st.floats(-3, 3), st.floats(-3, 3), st.floats(0.1, 10))
def test_a_point_lands_where_the_convention_on_disk_says(q, origin, angle_x, right, up, distance):
    """`right`, `up` and `distance` ahead of the camera, by its OpenGL axes, seen in a 64×48 image."""
    c2w = pose_of(q, origin)
    point = (c2w @ [right, up, -distance, 1])[:3]
    (u, v), depth = project(world_to_camera(c2w), intrinsics(angle_x, 64, 48), point)
    half = distance * math.tan(angle_x / 2)  # half the image's width at that distance
    np.testing.assert_allclose(depth, distance, atol=1e-9)
    np.testing.assert_allclose(u, 32 + 32 * right / half, rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(v, 24 - 32 * up / half, rtol=1e-9, atol=1e-6)


@given(quaternions, offsets, st.integers(3, 7))
def test_a_pose_written_with_few_decimals_is_read_as_the_nearest_rigid_one(q, origin, decimals):
    c2w = pose_of(q, origin)
    written = np.round(c2w, decimals + 1)
    read = read_pose(JsonRecord("f", {"transform_matrix": written.tolist()}))
    np.testing.assert_allclose(read[:3, :3].T @ read[:3, :3], np.eye(3), atol=1e-14)
    np.testing.assert_allclose(read[:3, :3], c2w[:3, :3], atol=2 * 10.0**-decimals)
    np.testing.assert_array_equal(read[:3, 3], written[:3, 3])


@pytest.mark.slow
def test_blender_sees_the_point_at_the_same_pixel():
    pytest.importorskip("bpy", reason="needs the generate extra")
    done = subprocess.run(
        [sys.executable, "-c", BLENDER], capture_output=True, text=True, check=True, timeout=300
    )
    cases = json.loads(done.stdout.partition("RESULT")[2].splitlines()[0])
    assert len(cases) == 20
    for case in cases:
        viewmat = world_to_camera(read_pose(JsonRecord("blender", case)))
        pixel, depth = project(viewmat, intrinsics(case["camera_angle_x"], 64, 48), np.array(case["point"]))
        np.testing.assert_allclose(pixel, case["pixel"], atol=1e-3)
        np.testing.assert_allclose(depth, case["depth"], atol=1e-4)
