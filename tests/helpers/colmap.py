"""A COLMAP model as text: two cameras, three images, two points."""

from pathlib import Path

import numpy as np
from PIL import Image

SIZE = (12, 8)


NAMES = ("a/r_2.png", "a/r_10.png", "b.png")


CAMERAS = """# Camera list
1 PINHOLE 12 8 20 21 6 4.5
2 SIMPLE_RADIAL 12 8 25 6 4 0
"""


# One image without features: its second line is empty.
IMAGES = """# Image list
1 0.5 0.5 0.5 0.5 1 2 3 1 a/r_2.png
3.5 4.5 7 1.0 2.0 -1
2 1 0 0 0 0 0 4 2 a/r_10.png

3 0 0 1 0 0.5 0 4 1 b.png
3.5 4.5 9
"""


POINTS = """# 3D point list
7 1.5 2.5 3.5 10 20 30 0.25 1 0
9 -1 0 1 200 100 0 0.5 3 0
"""


def pictures(root: Path) -> Path:
    for i, name in enumerate(NAMES):
        path = root / "images" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(np.full((SIZE[1], SIZE[0], 3), 100 + i, np.uint8)).save(path)
    return root
