"""An SPZ file holds the scene at rest: read back by gsply, and by the reference library itself."""

from dataclasses import replace

import gsply
import numpy as np
import pytest

from tests.core.splatfile.formats.conftest import angles, turned
from tg4mm.core.errors import SplatFileError
from tg4mm.core.splatfile.axes import y_up
from tg4mm.core.splatfile.spz import write_spz

HALF_STEPS = {"alphas": 0.5 / 255, "sh0": 0.5 / (0.15 * 255), "sh": 0.5 / 128, "scales": 0.5 / 16}
ROUNDING = 1.001


def test_a_reader_of_others_gets_what_was_written(splat, tmp_path):
    write_spz(tmp_path / "a.spz", splat)
    read, want = gsply.read_spz(str(tmp_path / "a.spz")), y_up(splat)
    np.testing.assert_allclose(read.means, want.means, atol=2.0**-21)
    assert angles(read.quats, turned(want)).max() < 0.25
    np.testing.assert_allclose(read.scales, np.log(want.scales), atol=HALF_STEPS["scales"] * ROUNDING)
    np.testing.assert_allclose(read.sh0, want.sh[:, 0], atol=HALF_STEPS["sh0"] * ROUNDING)
    np.testing.assert_allclose(read.shN, want.sh[:, 1:], atol=HALF_STEPS["sh"] * ROUNDING)


def test_the_reference_library_gets_what_was_written(splat, tmp_path, read_with_node):
    write_spz(tmp_path / "a.spz", splat)
    read, want = read_with_node("spz.cjs", tmp_path / "a.spz"), y_up(splat)
    n = len(splat)
    assert (read["numPoints"], read["shDegree"]) == (n, 3)
    np.testing.assert_allclose(np.reshape(read["positions"], (n, 3)), want.means, atol=2.0**-21)
    assert angles(np.reshape(read["rotations"], (n, 4))[:, [3, 0, 1, 2]], turned(want)).max() < 0.25
    np.testing.assert_allclose(read["alphas"], want.opacities, atol=HALF_STEPS["alphas"] * ROUNDING)
    scales = np.log(np.reshape(read["scales"], (n, 3)))
    np.testing.assert_allclose(scales, np.log(want.scales), atol=HALF_STEPS["scales"] * ROUNDING)
    sh = np.reshape(read["sh"], (n, 15, 3))
    np.testing.assert_allclose(sh, want.sh[:, 1:], atol=HALF_STEPS["sh"] * ROUNDING)


@pytest.mark.parametrize("size", [1e-6, 1.0, 1e4])
def test_a_motion_far_below_the_usual_grid_survives(splat, tmp_path, size):
    """The usual grid of 1/4096 would leave nothing of a motion of a hundred-thousandth of the scene."""
    shift = np.float32(1e-5 * size)
    for name, moved in (("a", 0.0), ("b", shift)):
        means = (size * np.clip(splat.means, -3, 3) + [moved, 0, 0]).astype(np.float32)
        write_spz(tmp_path / f"{name}.spz", replace(splat, means=means))
    step = gsply.read_spz(str(tmp_path / "b.spz")).means - gsply.read_spz(str(tmp_path / "a.spz")).means
    np.testing.assert_allclose(step[:, 0], shift, rtol=0.2 if size >= 1 else 1.0)


def test_what_is_out_of_range_is_the_nearest_there_is(splat, tmp_path):
    write_spz(
        tmp_path / "a.spz",
        replace(splat, scales=np.full_like(splat.scales, 1e-9), sh=np.full_like(splat.sh[:, :1], 9.0)),
    )
    read = gsply.read_spz(str(tmp_path / "a.spz"))
    np.testing.assert_array_equal(read.scales, -10)
    np.testing.assert_allclose(read.sh0, 0.5 / 0.15, rtol=1e-6)


def test_positions_that_do_not_fit_are_refused(splat, tmp_path):
    far = replace(splat, means=splat.means * np.float32(1e8))
    with pytest.raises(
        SplatFileError, match=r"a\.spz: a position is .* scene units off the origin; spz holds up to"
    ):
        write_spz(tmp_path / "a.spz", far)
    assert list(tmp_path.iterdir()) == []
