"""A window on pictures: cropped, averaged, and its camera sees the same."""

import numpy as np
import pytest

from tg4mm.capture.pictures import Window


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
@pytest.mark.parametrize("is_opaque", [True, False])
def test_averages_are_those_of_premultiplied_colour(kind, is_opaque):
    rng, top = np.random.default_rng(1), np.iinfo(kind).max
    image = rng.integers(0, top, (13, 17, 4), kind, endpoint=True)
    if is_opaque:
        image[..., 3] = top
    window = Window.on(13, 17, 3)
    assert window.size == (4, 5)
    got = window.averaged(image) / 65535
    values = image[:12, :15].astype(np.float64).reshape(4, 3, 5, 3, 4) / top
    alpha = values[..., 3].mean((1, 3))
    colour = (values[..., :3] * values[..., 3:]).mean((1, 3))
    assert np.allclose(got[..., 3], alpha, atol=1 / 65535)
    assert np.allclose(got[..., :3] * got[..., 3:], colour, atol=2 / 65535)


def test_a_camera_through_a_window_sees_a_point_at_the_same_place():
    wanted = np.zeros((40, 60), bool)
    wanted[7:31, 11:50] = True
    window = Window.on(40, 60, 2, wanted)
    K, point = np.array([[50.0, 0, 30], [0, 55, 20], [0, 0, 1]]), np.array([0.1, -0.05, 1.0])
    x, y, _ = K @ point
    u, v, _ = window.K(K) @ point
    assert (u, v) == pytest.approx(((x - window.left) / 2, (y - window.top) / 2))
    assert (window.top, window.left, window.size) == (7, 11, (12, 19))


def test_masks_through_a_window_count_whole_squares():
    mask = np.zeros((4, 4), bool)
    mask[:2, :2] = mask[0, 2] = True
    window = Window.on(4, 4, 2)
    assert window.all_of(mask).tolist() == [[True, False], [False, False]]
    assert window.any_of(mask).tolist() == [[True, True], [False, False]]
