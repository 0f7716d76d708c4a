"""Optical flow from Blender's own Vector pass against the projected displacement of the truth.

Blender works out Vector from a mesh animated with shape keys and keyframes; the truth knows positions and
displacements of one state alone. Both must tell the same motion between frames.
"""

import re

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")
OpenEXR = pytest.importorskip("OpenEXR")

from dataset_gen import build, render  # noqa: E402
from dataset_gen.cameras import train_cameras  # noqa: E402
from dataset_gen.prepare import builtin_bodies  # noqa: E402
from dataset_gen.scenes import SCENES  # noqa: E402
from dataset_gen.settings import Quality, motion_file  # noqa: E402
from dataset_gen.vibration import read_motion, solve  # noqa: E402

SIZE = 64
FPS = 31.0  # no three neighbouring frames of 5 Hz have gains in common
NOW = 2
ALPHA = 20.0
CAMERA = train_cameras(30)[5]


@pytest.fixture(scope="module")
def motion():
    return solve(read_motion(motion_file("mic")), builtin_bodies("mic"), FPS, None, 0)


@pytest.fixture(scope="module")
def animated():
    """The stage; `play` adds shape keys and keyframes for the timesteps around NOW."""
    stage = build.build(SCENES["mic"]())
    render.configure(stage, Quality(SIZE, SIZE, samples=1, seed=0, threads=1))
    build.set_view(stage, CAMERA)
    return stage


def displacements(motion, timestep):
    state = motion.state(timestep, ALPHA)
    return [motion.displacement(i, state) for i in range(len(motion.shapes))]


def play(stage, motion):
    """Every timestep a shape key that is 1 at its frame and 0 at the others."""
    for i, obj in enumerate(stage.objects):
        obj.shape_key_add(name="Basis")
        for t in range(NOW - 1, NOW + 2):
            key = obj.shape_key_add(name=f"{t}", from_mix=False)
            vertices = stage.rest[i] + displacements(motion, t)[i]
            key.data.foreach_set("co", vertices.astype(np.float32).ravel())
            for frame in range(NOW - 1, NOW + 2):
                key.value = float(frame == t)
                key.keyframe_insert("value", frame=frame)
    stage.scene.frame_set(NOW)


def vector_pass(stage, path):
    """[H, W, 4]: previous − now, now − next, pixels, as Blender writes them (y up)."""
    layer = stage.scene.view_layers[0]
    render.use_data(stage)
    layer.use_pass_vector = True
    stage.scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    layer.use_pass_vector = False
    with OpenEXR.File(str(path), separate_channels=True) as file:
        found = {}
        for name, channel in file.channels().items():
            if match := re.search(r"(?:^|\.)Vector\.([A-Z])$", name):
                found[match.group(1)] = channel.pixels
    return np.stack([found[c] for c in "XYZW"], -1)


def test_flow_from_vector_is_the_projected_displacement(animated, motion, tmp_path):
    stage = animated
    build.move(stage, displacements(motion, NOW))
    render.use_data(stage)
    truth = render.data_passes(stage)
    play(stage, motion)
    vector = vector_pass(stage, tmp_path / "v.exr")

    seen = truth["Depth"] < 1e9
    position = truth["Position"][seen].astype(float)
    displacement = truth["Displacement"][seen].astype(float)
    gain = {t: motion.state(t, ALPHA).gains[0] for t in range(NOW - 1, NOW + 2)}
    assert len({round(g, 2) for g in gain.values()}) == 3
    now, _ = CAMERA.project(position, SIZE, SIZE)
    # The motion is linear in its one gain, so the same surface point is known at the neighbouring frames.
    there = {t: position + displacement * (gain[t] / gain[NOW] - 1.0) for t in gain}
    before, _ = CAMERA.project(there[NOW - 1], SIZE, SIZE)
    after, _ = CAMERA.project(there[NOW + 1], SIZE, SIZE)
    flip = np.array([1.0, -1.0])  # Blender's y is up
    expected = np.hstack([(before - now) * flip, (now - after) * flip])
    got = vector[seen]
    assert np.abs(expected).max() > 0.5  # there is motion to be seen
    still = np.abs(displacement).max(1) == 0
    assert 20 < still.sum() < len(still)
    error = np.abs(got - expected).max(1)
    assert np.percentile(error, 99) < 1e-4
    assert error.max() < 1e-3
    # And with the wrong sign, or the neighbours exchanged, it would not have passed.
    assert np.percentile(np.abs(got + expected).max(1), 99) > 0.1
    assert np.percentile(np.abs(got[:, [2, 3, 0, 1]] - expected).max(1), 99) > 0.1
