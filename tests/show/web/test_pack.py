"""The block of a page holds the scene to the errors its docstring states."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from tg4mm.core.errors import RunError
from tg4mm.fit.gaussians import Gaussians
from tg4mm.show.web.pack import SH_STEP, MotionFields, Packed, motion_fields, pack, unpack


@pytest.fixture(scope="module")
def packed(moving_run) -> Packed:
    motion = moving_run.load_motion()
    return pack(moving_run.load_space(), motion_fields(motion), motion.appearance)


def test_positions_and_opacities_are_exact(moving_run, packed):
    exact, _ = unpack(packed.block, packed.layout)
    gaussians = moving_run.load_space()
    np.testing.assert_array_equal(exact[:, :3], gaussians.means)
    np.testing.assert_array_equal(exact[:, 3], gaussians.opacities)


def test_shape_and_colour_come_back_to_their_stated_errors(moving_run, packed):
    values = unpack(packed.block, packed.layout)[1].astype(np.float64)
    gaussians = moving_run.load_space()
    np.testing.assert_allclose(np.exp(values[:, :3]), gaussians.scales, rtol=4e-3)
    quats = torch.nn.functional.normalize(gaussians.quats, dim=1).numpy()
    np.testing.assert_allclose(values[:, [6, 3, 4, 5]], quats, atol=5e-4)
    sh = values[:, 7 : 7 + 48].reshape(-1, 16, 3)
    np.testing.assert_allclose(sh[:, 0], gaussians.sh[:, 0], rtol=5e-4, atol=1e-6)
    np.testing.assert_allclose(sh[:, 1:], gaussians.sh[:, 1:], atol=SH_STEP / 2 + 1e-6)


def test_motion_and_light_come_back(moving_run, packed):
    values = unpack(packed.block, packed.layout)[1].astype(np.float64)
    motion = moving_run.load_motion()
    fields, layout = motion_fields(motion), packed.layout
    first = 7 + 3 * layout.sh_count
    last = first + 6 * layout.n_fields
    held = values[:, first:last].reshape(-1, layout.n_fields, 6).transpose(1, 0, 2)
    np.testing.assert_allclose(held, fields.fields, rtol=5e-4, atol=1e-7)
    light = values[:, last:].reshape(-1, layout.n_lights, layout.light_count, 3).transpose(1, 0, 2, 3)
    light = light * packed.light_sizes[:, None, None, None]
    np.testing.assert_allclose(light, motion.appearance.shapes, rtol=5e-4, atol=1e-8)


def test_a_colour_past_float16_is_refused(moving_run):
    gaussians = moving_run.load_space()
    sh = gaussians.sh.clone()
    sh[3, 2, 1] = 1e5
    with pytest.raises(RunError, match="coefficient of colour is 100000; a page holds up to 65504"):
        pack(replace(gaussians, sh=sh), motion_fields(moving_run.load_motion()))


def test_more_fields_than_a_page_holds_are_refused(moving_run):
    gaussians = moving_run.load_space()
    fields = MotionFields(
        np.zeros((97, len(gaussians), 6), np.float32), np.ones((97, 2)), np.ones((60, 97), complex)
    )
    with pytest.raises(RunError, match="has 97 independent fields; a page holds up to 96"):
        pack(gaussians, fields)


def test_fifty_thousand_gaussians_with_two_modes_fit_in_15_mb(repo_root):
    """Noise, which nothing can compress: a real scene takes less."""
    n, rng = 50_000, np.random.default_rng(0)

    def values(*shape: int) -> torch.Tensor:
        return torch.as_tensor(rng.normal(size=shape), dtype=torch.float32)

    gaussians = Gaussians(
        values(n, 3), values(n, 4), values(n, 3).exp(), values(n).sigmoid(), 0.1 * values(n, 16, 3)
    )
    fields = MotionFields(
        rng.uniform(-1, 1, (4, n, 6)).astype(np.float32), np.ones((4, 2)), np.ones((2, 4), complex)
    )
    program = (repo_root / "tg4mm" / "show" / "web" / "player" / "dist" / "player.js").stat().st_size
    size = program + 4 / 3 * len(pack(gaussians, fields).block)
    assert 8e6 < size < 15e6
