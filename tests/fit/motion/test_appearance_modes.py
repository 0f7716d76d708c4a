"""AppearanceModes in a run's motion file: beside the motion, optional, and only where it fits."""

from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.motion_animate import gaussians, motion
from tests.helpers.motion_appearance import N, appearance, change_of
from tg4mm.core.errors import RunError
from tg4mm.fit.motion.modes import AppearanceModes
from tg4mm.run import Run


@pytest.fixture
def run(tmp_path):
    run = Run.create(tmp_path / "run", tmp_path, "modal", {})
    run.save_space(gaussians(), {})
    return run


def test_what_is_read_back_equals_that_written(run):
    m = replace(motion(), appearance=appearance())
    run.save_motion(m, {})
    back = run.load_motion()
    assert back.appearance.shapes.dtype == np.float32
    np.testing.assert_array_equal(back.appearance.shapes, m.appearance.shapes)
    np.testing.assert_array_equal(back.appearance.series, m.appearance.series)


@pytest.mark.parametrize(
    "bad",
    [
        AppearanceModes(change_of(N - 1, 2), appearance().series),
        AppearanceModes(change_of(N, 2), appearance(modes=2).series),
        AppearanceModes(change_of(N, 3), appearance().series),
        AppearanceModes(
            np.zeros((2, N, 9, 3), np.float32), appearance().series
        ),  # more than the Gaussians have
        AppearanceModes(
            change_of(N, 2)[:, :, :2], appearance().series
        ),  # neither the mean alone nor with all tilts
        AppearanceModes(change_of(N, 2).astype(np.float64), appearance().series),
        AppearanceModes(change_of(N, 2), appearance().series.real),
    ],
)
def test_what_does_not_fit_is_refused(run, bad):
    with pytest.raises(RunError, match=r"motion to save: light has shapes \(.*expected \[R, 20, 1 or 4"):
        run.save_motion(replace(motion(), appearance=bad), {})
    assert not run.has_motion
