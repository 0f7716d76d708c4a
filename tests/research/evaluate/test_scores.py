"""When two poses are the same: the key of a motion state."""

import numpy as np
import pytest

from tg4mm.core.magnification import Magnification
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.research.evaluate.scores import Method

FPS, T = 30.0, 30


def method(
    modes: dict[float, complex], band: tuple[float, float] | None = None, rotation: complex = 0
) -> Method:
    shape = np.array([[1.0, 2.0, 0.0], [0.0, 1.0, 3.0]])
    displacement = np.stack([m * shape for m in modes.values()]).astype(np.complex64)
    motion = ModalMotion(np.array(list(modes)), displacement, rotation * displacement, FPS, T)
    return Method("ours", motion, Magnification.of(1.0, *([band] if band else [])))


def displacement(m: Method, t: int, alpha: float) -> np.ndarray:
    gain = 1 + alpha * (m.magnified.inside(m.motion.freqs_hz) & (m.motion.freqs_hz > 0))  # 0 Hz stands still
    phase = gain * np.exp(2j * np.pi * m.motion.freqs_hz * t / FPS)
    return np.einsum("k,knc->nc", phase, m.motion.displacement).real


@pytest.mark.parametrize(
    "m",
    [
        method({3.0: -1j}),
        method({3.0: 1.0}),
        method({3.0: 0.6 + 0.8j}),
        method({3.0: -1j, 5.0: 1 + 1j}, band=(2, 4)),
        method({0.0: 1.0, 7.0: 0.0}),
    ],
)
def test_keys_are_equal_exactly_when_poses_are(m) -> None:
    moments = [(t, alpha) for t in range(T) for alpha in (0.0, 5.0)]
    poses = [displacement(m, *moment) for moment in moments]
    keys = [m.state(*moment) for moment in moments]
    for i, a in enumerate(poses):
        for j, b in enumerate(poses):
            assert (keys[i] == keys[j]) == np.allclose(a, b, atol=1e-6), (moments[i], moments[j])


def test_a_sine_at_3_hz_has_five_states_in_a_second() -> None:
    """sin(2π t / 10): 0, ±sin 36°, ±sin 72°; a general phase has all ten of its period."""
    assert len({method({3.0: -1j}).state(t, 5.0) for t in range(T)}) == 5
    assert len({method({3.0: 0.6 + 0.8j}).state(t, 5.0) for t in range(T)}) == 10


def test_a_rotation_out_of_phase_with_the_displacement_counts() -> None:
    """Displacement −i, rotation 1: the sine repeats at t = 1 and 4, the rotation does not."""
    plain, turning = method({3.0: -1j}), method({3.0: -1j}, rotation=1j)
    assert plain.state(1, 0.0) == plain.state(4, 0.0)
    assert turning.state(1, 0.0) != turning.state(4, 0.0)


def test_the_rest_pose_is_one_for_all_methods() -> None:
    assert Method("nothing moves", None).state(7, 50.0) == ()
    assert method({3.0: -1j}).state(0, 50.0) == method({3.0: -1j}).state(5, 20.0) == ()
    assert method({3.0: 0.0}).state(3, 50.0) == ()
    assert method({3.0: 1.0}).state(0, 0.0) != ()


def test_methods_that_move_are_kept_apart() -> None:
    ours = method({3.0: -1j})
    other = Method("ceiling", ours.motion)
    assert ours.state(1, 0.0) != other.state(1, 0.0)


def test_band_edges_are_inside() -> None:
    inside = Magnification.of(1.0, (3.0, 4.0)).inside(np.array([2.9, 3.0, 4.0, 4.1]))
    np.testing.assert_array_equal(inside, [False, True, True, False])
    assert Magnification().inside(np.array([0.0, 99.0])).all()
