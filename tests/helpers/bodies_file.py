"""What is found in a small scene of two bodies."""

import numpy as np

from dataset_gen.cameras import SceneCamera, look_at
from dataset_gen.sources.bodies_file import FileContents
from dataset_gen.vibration.fields import Body

VERTICES = np.array([[0.1, 0.2, 0.3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


FOUND = FileContents(
    bodies=(
        Body(
            "a/b ü",
            VERTICES,
            np.array([[0, 1, 2]], np.int32),
            np.ones(3),
            {"tip.1": np.array([0.0, 0.5, 1.0])},
        ),
        Body("bare", VERTICES + 2.0, np.array([[2, 1, 0]], np.int32), np.ones(3), {}),
    ),
    unit_scale_m=0.01,
    own_unit=("mm", 10.0),
    cameras=(SceneCamera(0, look_at(np.array([4.0, 1.0, 2.0]), np.zeros(3)), angle_x=0.8, shift=(0.1, 0.0)),),
    camera_names=("Camera",),
    warnings=("left out, volume: smoke",),
    centre=(0.5, 0.25, 1.0),
    radius=1.5,
)
