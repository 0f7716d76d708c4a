"""Small datasets written for the tests: a NeRF-synthetic folder, and a dataset tree."""

import json
import math

import numpy as np
import pytest
from PIL import Image

from tg4mm.capture import load_capture
from tg4mm.core.errors import CaptureError

ANGLE_X = 0.7
FPS = 30  # Hz, of the tree
SIZE = (12, 8)  # width, height


def pose(azimuth=0.3):
    """Camera-to-world, OpenGL axes, four units from the origin and looking at it, Z up."""
    back = np.array([math.cos(azimuth), math.sin(azimuth), 0.5])
    back /= np.linalg.norm(back)
    right = np.cross([0, 0, 1], back)
    right /= np.linalg.norm(right)
    c2w = np.eye(4)
    c2w[:3, :4] = np.stack([right, np.cross(back, right), back, 4 * back], axis=1)
    return c2w.tolist()


def write_folder(folder, split="train", views=2, value=100, time_s=0.0):
    """One NeRF-synthetic folder with a split; every camera keeps its place, whatever the folder."""
    (folder / split).mkdir(parents=True, exist_ok=True)
    frames = []
    for i in range(views):
        pixels = np.full((SIZE[1], SIZE[0], 4), value + i, np.uint8)
        Image.fromarray(pixels, "RGBA").save(folder / split / f"r_{i:03d}.png")
        frames.append(
            {"file_path": f"./{split}/r_{i:03d}", "transform_matrix": pose(0.3 + i), "time": time_s}
        )
    (folder / f"transforms_{split}.json").write_text(
        json.dumps({"camera_angle_x": ANGLE_X, "frames": frames})
    )
    return folder


def write_tree(root, timesteps=3, scene=None):
    """A dataset tree with a train and a test split and ground truth at α = 5."""
    for t in range(timesteps):
        write_folder(root / f"{t:03d}", "train", 2, 100 + 10 * t, t / FPS)
        write_folder(root / f"{t:03d}", "test", 1, 150 + 10 * t, t / FPS)
        write_folder(root / "magnified" / "x005" / f"{t:03d}", "test", 1, 200 + 10 * t, t / FPS)
    (root / "scene.json").write_text(json.dumps({"fps": FPS} if scene is None else scene))
    return root


def edit(path, change):
    """Apply `change` to the JSON in a file, in place."""
    values = json.loads(path.read_text())
    change(values)
    path.write_text(json.dumps(values))


def refused(what, *parts, **options):
    """Assert that a dataset cannot be loaded (with options), or a call fails, in one line that holds all parts."""
    with pytest.raises(CaptureError) as caught:
        what() if callable(what) else load_capture(what, **options)
    message = str(caught.value)
    assert "\n" not in message
    for part in parts:
        assert part in message, message


@pytest.fixture
def folder(tmp_path):
    return write_folder(tmp_path / "mic")


@pytest.fixture
def tree(tmp_path):
    return write_tree(tmp_path / "mic_5Hz_0_005")
