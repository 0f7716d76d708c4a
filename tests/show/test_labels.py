"""Labels do not cover each other and stay in the picture."""

import numpy as np
import pytest
from PIL import Image

from tg4mm.show import regions as labels


def test_labels_of_one_place_and_of_the_edge_are_apart_and_inside(monkeypatch):
    boxes = []
    free = labels._free
    monkeypatch.setattr(labels, "_free", lambda *given: boxes.append(free(*given)) or boxes[-1])
    picture = Image.fromarray(np.full((240, 320, 3), 128, np.uint8))
    points = [(160, 120)] * 6 + [(319, 239)] * 4 + [(0, 0)] * 4
    labels.write_labels(picture, [(f"moving {k}", point) for k, point in enumerate(points)])
    assert len(boxes) == len(points)
    for k, box in enumerate(boxes):
        assert min(box) >= 0
        assert box[2] <= 320
        assert box[3] <= 240
        assert not any(labels._overlap(box, other) for other in boxes[:k])
    assert np.asarray(picture).max() == 255


@pytest.mark.parametrize("apart", [(10, 0), (0, 10)])
def test_boxes_that_touch_overlap(apart):
    a = (0.0, 0.0, 10.0, 10.0)
    assert labels._overlap(a, (apart[0], apart[1], apart[0] + 10, apart[1] + 10))
    assert not labels._overlap(a, (2 * apart[0], 2 * apart[1], 2 * apart[0] + 10, 2 * apart[1] + 10))
