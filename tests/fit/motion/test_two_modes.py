"""A mode of hundredths of a pixel beside one of two pixels: iterations for the large one do not cost the small one."""

from dataclasses import replace

import numpy as np
import pytest

from tests.helpers import synthetic
from tests.helpers.runs import copied
from tg4mm.capture import load_capture, load_images
from tg4mm.fit.motion import MotionConfig
from tg4mm.run.stages.motion import train_motion

LARGE_HZ, SMALL_HZ = 5.0, 3.0  # the post, two and a half pixels at its tip; the ball, a twenty-fifth
CONFIG = MotionConfig(components=8, smoothness_weight=30.0)


def _made(root):
    modes = synthetic._modes

    def unequal(*args):
        floor, post, ball = modes(*args)
        return [floor, post, np.float32(0.015) * ball]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(synthetic, "_modes", unequal)
        run, true = synthetic.exact_run(
            root, n_views=6, n_timesteps=30, size=64, freqs=(LARGE_HZ, SMALL_HZ), amplitude=0.12, detail=2
        )
    return run, true


def _error(found, true, k):
    """Relative, of what moves at the truth's frequency k by a third of the most or more."""
    expected = true.displacement[k]
    length = np.linalg.norm(expected, axis=1)
    own = length > length.max() / 3
    at = found.displacement[np.argmin(np.abs(found.freqs_hz - true.freqs_hz[k]))]
    return float(np.linalg.norm((at - expected)[own]) / np.linalg.norm(expected[own]))


@pytest.fixture(scope="module")
def errors(tmp_path_factory):
    """Errors of the large mode and the small one, in the linear fit and after three Gauss-Newton iterations."""
    root = tmp_path_factory.mktemp("two")
    run, true = _made(root)
    capture = load_capture(root / "data")
    images = load_images(capture)
    out = []
    for count in (0, 3):
        copy = copied(run, root / f"{count}")
        found = train_motion(copy, capture, images, replace(CONFIG, gauss_newton=count))
        assert copy.log()["motion"]["gauss_newton"] == count
        out.append([_error(found, true, k) for k in range(2)])
    return out


@pytest.mark.slow
def test_the_large_mode_is_found(errors):
    """The iterations bring it, not what the linear fit is corrected by."""
    linear, after = (e[0] for e in errors)
    assert after < 0.15
    assert after < 0.5 * linear


@pytest.mark.slow
def test_the_small_mode_stays_as_the_linear_fit_found_it(errors):
    """No state shows it. Erased, its error would be 1."""
    linear, after = (e[1] for e in errors)
    assert linear < 0.3
    assert after < 1.1 * linear
