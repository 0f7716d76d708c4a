"""How splats answer to their own motion, a block of Gaussians at a time: against one pass over all for each column."""

from __future__ import annotations

import numpy as np
import pytest

from tests.fit.rasterize.oracle import make_scene
from tg4mm.fit.motion.jacobian.packed import COLUMNS, DOF
from tg4mm.fit.motion.jacobian.projection import splat_jacobian
from tg4mm.fit.rasterize.kernels import linearised
from tg4mm.fit.rasterize.kernels.layout import POWER
from tg4mm.fit.rasterize.kernels.project import ROWS, empty_splats, pack_camera, project_forward
from tg4mm.fit.rasterize.kernels.project_backward import project_backward

N = 2 * ROWS + 37


def column_by_column(arrays, degree, camera, size, splats):
    """[N, 8, DOF]; a rotation about a world axis turns a quaternion wxyz by half its product with the axis."""
    means, quats, scales, sh = arrays
    w, x, y, z = quats.T
    turned = 0.5 * np.stack([[-x, w, -z, y], [-y, z, w, -x], [-z, -y, x, w]]).transpose(2, 0, 1)
    out = np.zeros((len(means), COLUMNS, DOF), np.float32)
    for c, column in enumerate(linearised.COLUMNS):
        v_splats, v_means, v_quats = np.zeros_like(splats), np.zeros_like(means), np.zeros_like(quats)
        v_splats[:, column] = 1
        unused = (np.zeros_like(a) for a in (scales, scales[:, 0], sh))
        project_backward(
            means, quats, scales, sh, degree, False, camera, *size, splats, v_splats, False,
            v_means, v_quats, *unused, np.zeros((0, 12), np.float32), False,
        )  # fmt: skip
        out[:, c, :3] = v_means
        out[:, c, 3:] = np.einsum("nkq,nq->nk", turned, v_quats)
    return out


@pytest.mark.parametrize("degree", [0, 3])
def test_it_is_the_gradient_of_every_column(degree: int) -> None:
    scene = make_scene(2, n=N)
    scene.means[:5] *= -20  # behind the camera, or beside what it sees
    arrays = [a.float().numpy() for a in (scene.means, 1.5 * scene.quats, scene.scales, scene.colors)]
    size, splats = (scene.width, scene.height), empty_splats(N)
    camera = pack_camera(
        scene.viewmats[0].float().numpy(), scene.Ks[0].float().numpy(), 0.01, 100.0, 0.3, 1e-4
    )
    means, quats, scales, sh = arrays
    opacities = scene.opacities.float().numpy()
    project_forward(means, quats, scales, opacities, sh, degree, False, camera, *size, splats)
    found = splat_jacobian(means, quats, scales, sh, degree, camera, size, splats)
    visible = splats[:, POWER] > 0
    assert 0.9 * N < visible.sum() < N
    expected = column_by_column(arrays, degree, camera, size, splats)
    assert np.abs(expected[visible]).max() > 1
    largest = np.maximum(np.abs(expected).max((0, 2)), 1e-6)[:, None]  # of each column
    np.testing.assert_allclose(found / largest, expected / largest, rtol=1e-4, atol=1e-5)
    assert not found[~visible].any()
