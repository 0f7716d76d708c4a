"""Makes docs/images/scenes.png: the eight built-in scenes, one picture each.

python docs/images/scenes.py
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parents[1]))

from PIL import Image  # noqa: E402

from dataset_gen import build, render  # noqa: E402
from dataset_gen.cameras import train_cameras  # noqa: E402
from dataset_gen.pictures import PictureFormat  # noqa: E402
from dataset_gen.scenes import SCENES  # noqa: E402
from dataset_gen.settings import Quality  # noqa: E402

SIZE, SAMPLES, COLUMNS = 320, 128, 4
# (scene, number of the training view that shows it best)
SHOWN = (
    ("hotdog", 3), ("chair", 17), ("ship", 17), ("ficus", 17),
    ("mic", 7), ("lego", 3), ("drums", 17), ("materials", 3),
)  # fmt: skip


def picture(name: str, view: int, folder: Path) -> np.ndarray:
    """[SIZE, SIZE, 3] uint8, over white."""
    stage = build.build(SCENES[name]())
    render.configure(stage, Quality(SIZE, SIZE, SAMPLES, 0))
    build.set_view(stage, train_cameras(30)[view])
    return PictureFormat(background="white").pixels(render.linear_picture(stage))


def main() -> None:
    with tempfile.TemporaryDirectory() as scratch:
        tiles = [picture(name, view, Path(scratch)) for name, view in SHOWN]
    rows = [np.hstack(tiles[i : i + COLUMNS]) for i in range(0, len(tiles), COLUMNS)]
    Image.fromarray(np.vstack(rows)).quantize(256).save(HERE / "scenes.png", optimize=True)


if __name__ == "__main__":
    main()
