"""What must hold of any rendering, whatever the numbers: symmetries, and the balance of light."""

from dataclasses import replace

import numpy as np
import torch
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.fit.rasterize.oracle import make_scene, random_rotations, render, with_channels
from tg4mm.fit.rasterize import rasterization
from tg4mm.fit.rasterize.kernels.layout import DEPTH, POWER
from tg4mm.fit.rasterize.reference import rotation_matrices

quick = settings(max_examples=15, deadline=None)
seeds = st.integers(0, 10_000)


def shown(scene, sh_degree=None, **options):
    """Image and alpha, in float32."""
    return render([t.detach() for t in scene.tensors(torch.float32)], scene, sh_degree, **options)[:2]


def assert_same_image(a, b, largest=None):
    """To float32 rounding; a pixel at a threshold (1 in 1000) may differ by a contribution of 1/255.

    largest: what is blended of one Gaussian, at most; None: about as much as the picture shows.
    """
    error = (a - b).abs()
    scale = a.abs().max()
    assert scale > 0.05
    assert (error > 1e-4 * scale).double().mean() <= 1e-3
    assert error.max() <= (scale / 200 if largest is None else largest / 255)


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
    for a, b in zip(shown(scene, render_mode="RGB+D"), shown(moved, render_mode="RGB+D"), strict=True):
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
@example(seed=147, factor=29.0)  # a Gaussian at a threshold, farther away than the mean of any pixel
def test_the_unit_of_length_does_not_matter(seed, factor):
    """Scene and camera made `factor` times as large: the same picture, depths times `factor`."""
    scene = make_scene(seed)
    viewmats = scene.viewmats.clone()
    viewmats[:, :3, 3] *= factor
    larger = replace(scene, means=scene.means * factor, scales=scene.scales * factor, viewmats=viewmats)
    a = shown(scene, 3, render_mode="RGB+D", near_plane=1e-4)[0]
    b = shown(larger, 3, render_mode="RGB+D", near_plane=1e-4 * factor)[0].clone()
    b[..., 3] /= factor
    assert_same_image(a[..., :3], b[..., :3])
    depths = scene.means @ scene.viewmats[0, 2, :3] + scene.viewmats[0, 2, 3]
    assert_same_image(a[..., 3], b[..., 3], float(depths.max()))


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


def test_expected_depth_of_a_wall_is_its_distance():
    """ED of an opaque sheet, seen face on, is the depth of the sheet; D is that times alpha."""
    n = 400
    rng = torch.Generator().manual_seed(0)
    means = torch.cat([torch.rand(n, 2, generator=rng) * 4 - 2, torch.full((n, 1), 3.0)], 1)
    arguments = (
        means, torch.tensor([[1.0, 0, 0, 0]]).repeat(n, 1), torch.tensor([[0.3, 0.3, 1e-3]]).repeat(n, 1),
        torch.full((n,), 0.9), torch.ones(n, 1), torch.eye(4)[None],
        torch.tensor([[[30.0, 0, 16], [0, 30, 12], [0, 0, 1]]]), 32, 24,
    )  # fmt: skip
    expected, alpha, _ = rasterization(*arguments, render_mode="ED")
    blended, _, _ = rasterization(*arguments, render_mode="D")
    assert alpha.min() > 0.99
    assert torch.allclose(expected, torch.tensor(3.0), rtol=1e-5)
    assert torch.allclose(blended, 3.0 * alpha, rtol=1e-5)
