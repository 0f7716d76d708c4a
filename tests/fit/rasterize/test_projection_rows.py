"""Projection works sixteen Gaussians at a time; none may notice which ones stand beside it, or how many there are."""

import numpy as np
import pytest

from tests.fit.rasterize.oracle import make_scene
from tg4mm.fit.rasterize.kernels.layout import POWER, SPLAT_WIDTH
from tg4mm.fit.rasterize.kernels.project import pack_camera, project_forward
from tg4mm.fit.rasterize.kernels.project_backward import project_backward

N = 300  # more than one thread takes at a time
CANARY = np.float32(12345.0)


def fenced(array: np.ndarray, around: float) -> np.ndarray:
    """The same numbers, with others that nobody may use or touch before and behind them."""
    room = np.full(array.size + 64, around, np.float32)
    inner = room[32:-32].reshape(array.shape)
    inner[...] = array
    return inner


def fences_hold(array: np.ndarray) -> bool:
    """Has nothing been written outside a `fenced` array?"""
    room = array.base
    assert room is not None
    assert room.shape == (array.size + 64,)
    return bool((room[:32] == CANARY).all() and (room[-32:] == CANARY).all())


class Case:
    """Gaussians, many of them behind the camera or too faint, with their gradients by the splats."""

    def __init__(self, degree: int, all_coefficients: bool = False, with_depth: bool = True) -> None:
        scene, rng = make_scene(5, n=N), np.random.default_rng(degree + 1)
        scene.means[::17] *= -20
        scene.means[32:64] *= -20  # sixteen of which none is seen, twice
        self.view = (degree, with_depth)
        k = (16 if all_coefficients else (degree + 1) ** 2) if degree >= 0 else 1
        arrays = [scene.means, 1.5 * scene.quats, scene.scales, scene.opacities, scene.colors[:, :k]]
        self.arrays = [np.ascontiguousarray(a.float().numpy()) for a in arrays]
        self.arrays[3][::13] = 1e-4
        self.v_splats = rng.normal(size=(N, SPLAT_WIDTH)).astype(np.float32)
        for hidden, value in (
            (34, np.nan),
            (170, np.nan),
            (187, np.inf),
        ):  # 170 and 187 beside some that are seen
            for a in (self.arrays[0], self.arrays[2], self.arrays[4], self.v_splats):
                a[hidden] = value
        pose = scene.viewmats[0].float().numpy(), scene.Ks[0].float().numpy()
        self.camera = (pack_camera(*pose, 0.01, 100.0, 0.3), scene.width, scene.height)

    def both(self, chosen: np.ndarray, summed: bool = True) -> list[np.ndarray]:
        """Splats and gradients of some of the Gaussians; no numbers but theirs may matter or be changed."""
        arrays = [fenced(a[chosen], np.nan) for a in self.arrays]
        splats = fenced(np.full((len(chosen), SPLAT_WIDTH), np.nan), CANARY)
        project_forward(*arrays, *self.view, *self.camera, splats)
        means, quats, scales, _, features = arrays
        shapes = [a.shape for a in arrays] + [(len(chosen), 12)]
        sums = [fenced(np.ones(shape), CANARY) for shape in shapes]
        v_splats = fenced(self.v_splats[chosen], np.nan)
        project_backward(
            means, quats, scales, features, *self.view, *self.camera, splats, v_splats, summed, *sums, True
        )
        for array in (splats, *sums):
            assert fences_hold(array)
        return [splats, *sums]


@pytest.mark.parametrize(
    ("degree", "all_coefficients", "with_depth", "summed"),
    [
        (-1, False, True, True),
        (0, False, True, True),
        (1, False, True, True),
        (2, False, True, False),
        (3, False, True, True),
        (0, True, False, True),
        (2, True, False, False),
    ],
)
def test_a_gaussian_comes_out_alike_wherever_it_stands(
    degree: int, all_coefficients: bool, with_depth: bool, summed: bool
) -> None:
    case = Case(degree, all_coefficients, with_depth)
    whole = case.both(np.arange(N), summed)
    visible = whole[0][:, POWER] > 0
    assert 0.5 * N < visible.sum() < N
    assert not visible[32:64].any()
    assert not visible[[170, 187]].any()
    assert all(np.isfinite(a[visible]).all() for a in whole)
    rng = np.random.default_rng(1)
    for count in (1, 2, 15, 16, 17, 33, 257, 290):
        chosen = rng.permutation(N)[:count]
        seen, parts = visible[chosen], case.both(chosen, summed)
        for part, of_all in zip(parts, whole, strict=True):
            np.testing.assert_array_equal(part[seen], of_all[chosen][seen])
        assert not (parts[0][~seen, POWER] > 0).any()
        assert all((gradients[~seen] == 1).all() for gradients in parts[1:])
    for gradients in whole[1:]:
        assert (gradients[~visible] == 1).all()  # what is not seen adds nothing
    used = 3 * (degree + 1) ** 2 if degree >= 0 else 3
    for k, gradients in enumerate(whole[1:]):
        columns = gradients[visible].reshape(visible.sum(), -1)
        if k == 4:  # coefficients beyond the degree are left alone
            assert (columns[:, used:] == 1).all()
            columns = columns[:, :used]
        assert (columns != 1).any(0).all()
