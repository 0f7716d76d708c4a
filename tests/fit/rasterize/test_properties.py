"""What must hold of any rendering, whatever the numbers: symmetries, and the balance of light."""

from dataclasses import replace

import numpy as np
import torch
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.fit.rasterize.oracle import make_scene, random_rotations, render, with_channels
from tg4mm.fit.gaussians import rotation_matrices
from tg4mm.fit.rasterize.kernels.layout import DEPTH, POWER

quick = settings(max_examples=15, deadline=None)
seeds = st.integers(0, 10_000)


def shown(scene, sh_degree=None, **options):
    """Image and alpha, in float32."""
    return render([t.detach() for t in scene.tensors(torch.float32)], scene, sh_degree, **options)[:2]


def assert_same_image(a, b):
    """To float32 rounding; a pixel at a threshold (1 in 1000) may differ by a contribution of 1/255."""
    error = (a - b).abs()
    scale = a.abs().max()
    assert scale > 0.05
    assert (error > 1e-4 * scale).double().mean() <= 1e-3
    assert error.max() <= scale / 200


@quick
@given(seed=seeds)
def test_moving_scene_and_camera_together_leaves_the_image(seed):
    rng = torch.Generator().manual_seed(seed)
    scene = with_channels(make_scene(seed, cameras=2), 3)  # plain channels: harmonics live in world axes
    R = random_rotations(rng, 1)[0]
    shift = torch.randn(3, generator=rng, dtype=torch.float64) * 3
    motion = torch.eye(4, dtype=torch.float64)
    motion[:3, :3], motion[:3, 3] = R, shift
    turned = Rotation.from_matrix(R) * Rotation.from_matrix(rotation_matrices(scene.quats))
    moved = replace(
        scene,
        means=scene.means @ R.T + shift,
        quats=torch.from_numpy(turned.as_quat()[:, [3, 0, 1, 2]].copy()),
        viewmats=scene.viewmats @ torch.linalg.inv(motion),
    )
    for a, b in zip(shown(scene), shown(moved), strict=True):
        assert_same_image(a, b)


@quick
@given(seed=seeds)
def test_the_order_of_the_gaussians_does_not_matter(seed):
    scene = make_scene(seed, n=200, scale=(0.02, 0.2))
    _, _, meta = render([t.detach() for t in scene.tensors(torch.float32)], scene, 3)
    splats = meta["projected"][0].splats
    visible = splats[splats[:, POWER] > 0, DEPTH]
    assume(len(np.unique(visible)) == len(visible))  # equal depths blend in the order given
    p = torch.randperm(200, generator=torch.Generator().manual_seed(seed))
    shuffled = replace(
        scene, means=scene.means[p], quats=scene.quats[p], scales=scene.scales[p],
        opacities=scene.opacities[p], colors=scene.colors[p],
    )  # fmt: skip
    for a, b in zip(shown(scene, 3), shown(shuffled, 3), strict=True):
        assert torch.allclose(a, b, atol=1e-6)


@quick
@given(seed=seeds, factor=st.floats(1e-2, 1e3))
def test_the_unit_of_length_does_not_matter(seed, factor):
    """Scene and camera made `factor` times as large: the same picture."""
    scene = make_scene(seed)
    viewmats = scene.viewmats.clone()
    viewmats[:, :3, 3] *= factor
    larger = replace(scene, means=scene.means * factor, scales=scene.scales * factor, viewmats=viewmats)
    a, b = (shown(s, 3, near_plane=1e-4 * unit)[0] for s, unit in ((scene, 1.0), (larger, factor)))
    assert_same_image(a, b)


@quick
@given(seed=seeds)
def test_background_shows_by_the_transmittance(seed):
    scene = make_scene(seed, cameras=2)
    background = torch.tensor([[0.2, 0.5, 0.9], [1.0, 0.0, 0.3]])
    plain, alpha = shown(scene, 3)
    filled, same_alpha = shown(scene, 3, backgrounds=background)
    assert torch.equal(alpha, same_alpha)
    assert torch.allclose(filled - plain, (1 - alpha) * background[:, None, None], atol=2e-6)


@quick
@given(seed=seeds)
def test_weights_and_transmittance_add_up_to_one(seed):
    """Channels that are 1 everywhere render to the sum of the blending weights."""
    scene = make_scene(seed, n=300, scale=(0.02, 0.5), opacity=(0.01, 1.0))
    image, alpha = shown(replace(scene, colors=torch.ones(300, 2, dtype=torch.float64)))
    assert torch.allclose(image, alpha.expand_as(image), atol=2e-6)
