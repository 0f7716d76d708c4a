"""A motion as fields and series: the same phasors, in no more fields than it needs."""

import numpy as np
import pytest

from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.show.web.pack import MotionFields, motion_fields


def modal(displacement: np.ndarray, rotation: np.ndarray) -> ModalMotion:
    freqs = np.arange(1.0, 1 + len(displacement))
    return ModalMotion(freqs, displacement.astype(np.complex64), rotation.astype(np.complex64), 30.0, 30)


def phasors(found: MotionFields) -> np.ndarray:
    sized = found.fields * found.sizes.repeat(3, axis=1)[:, None]
    return np.tensordot(found.series, sized, axes=1)


def noise(*shape: int, seed: int = 3) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.normal(size=shape) + 1j * rng.normal(size=shape)


def relative_error(found: MotionFields, motion: ModalMotion) -> list[float]:
    both = phasors(found)
    pairs = (both[..., :3], motion.displacement), (both[..., 3:], motion.rotation)
    return [float(np.linalg.norm(a - b) / np.linalg.norm(b)) for a, b in pairs]


@pytest.mark.parametrize("n", [50, 10_000])
def test_phasors_come_back(n):
    motion = modal(1e-3 * noise(2, n, 3), 5 * noise(2, n, 3, seed=4))
    found = motion_fields(motion)
    assert found.fields.shape == (4, n, 6)
    assert max(relative_error(found, motion)) < 1e-5
    assert max(relative_error(found, modal(1.01 * motion.displacement, motion.rotation))) > 5e-3


def test_many_modes_of_one_field_are_one_field():
    shape, series = noise(1, 80, 6).real, noise(15, 1, 1)
    found = motion_fields(modal(series * shape[..., :3], series * shape[..., 3:]))
    assert found.fields.shape[0] == 1
    assert np.abs(found.fields).max() == pytest.approx(1)


def test_a_weak_field_is_kept_and_a_negligible_one_left_out():
    strong, weak = noise(1, 40, 3), noise(1, 40, 3, seed=4)
    assert len(motion_fields(modal(np.concatenate([strong, 1e-3 * weak]), np.zeros((2, 40, 3)))).fields) == 4
    assert len(motion_fields(modal(np.concatenate([strong, 1e-5 * weak]), np.zeros((2, 40, 3)))).fields) == 2


def test_what_does_not_move_or_turn_has_no_field():
    nothing = np.zeros((2, 40, 3))
    assert motion_fields(modal(nothing, nothing)).fields.shape == (0, 40, 6)
    found = motion_fields(modal(noise(2, 40, 3), nothing))
    assert not found.fields[..., 3:].any()
    assert not found.sizes[:, 1].any()
