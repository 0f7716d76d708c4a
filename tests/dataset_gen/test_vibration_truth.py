"""truth/motion.npz: what is written is what moves, as the evaluation reads it."""

import numpy as np
import pytest

from dataset_gen import truth
from dataset_gen.vibration import Body, MotionDescription, solve

FPS, T = 30.0, 24
MODES = {
    "modes": [
        {
            "name": "sway", "kind": "bending", "frequency": 4.3, "amplitude": 0.01, "decay": 0.4,
            "base": [0, 0, -0.3], "tip": [0, 0, 0.2], "direction": [3, 4, 0],
        },
        {
            "name": "hum", "kind": "translate", "frequency": 9, "amplitude": 0.003, "direction": [0, 0, 1],
            "magnified": False, "parts": "a", "phase": 50,
        },
        {"name": "sag", "kind": "drift", "rate": 0.02, "direction": [0, 1, 0], "magnified": False},
    ]
}  # fmt: skip


def bodies():
    """Two small meshes well apart: every vertex is the corner of a triangle of its own body."""
    out = []
    for i, name in enumerate("ab"):
        where = np.random.default_rng(i).uniform(-0.4, 0.4, (30, 3)) + [i * 3.0, 0, 0]
        out.append(Body(name, where, np.arange(30).reshape(10, 3), np.linspace(0, 1, 30)))
    return out


@pytest.fixture
def motion():
    return solve(MotionDescription.from_json(MODES), bodies(), FPS, None, 0)


def test_the_arrays_are_those_of_the_contract(tmp_path, motion):
    truth.write_motion(tmp_path / "motion.npz", bodies(), motion, T)
    with np.load(tmp_path / "motion.npz", allow_pickle=False) as arrays:
        kinds = {name: (arrays[name].shape, arrays[name].dtype.name) for name in arrays.files}
        assert arrays["objects"].tolist() == ["a", "b"]
        assert arrays["magnified"].tolist() == [True, False, False]
        assert arrays["frequencies_hz"].tolist() == [4.3, 9.0, 0.0]
        assert not arrays["mode_1"][1].any()  # b is not a part of the hum
    kinds.pop("objects")
    expected = {
        "frequencies_hz": ((3,), "float64"),
        "gains": ((3, T), "complex128"),
        "magnified": ((3,), "bool"),
    }
    for i in (0, 1):
        expected |= {f"rest_{i}": ((30, 3), "float32"), f"faces_{i}": ((10, 3), "int32")}
        expected[f"mode_{i}"] = ((3, 30, 3), "complex64")
    assert kinds == expected


@pytest.mark.parametrize("alpha", [0.0, 20.0])
def test_the_evaluation_reads_the_exact_motion_back(tmp_path, motion, alpha):
    pytest.importorskip("scipy")
    pytest.importorskip("torch")
    from tg4mm.capture.truth_file import load_truth
    from tg4mm.fit.motion.animate import displacement_at
    from tg4mm.research.evaluate.truth import exact_motion

    truth.write_motion(tmp_path / "truth" / "motion.npz", bodies(), motion, T)
    corners = np.concatenate([b.vertices for b in bodies()])
    exact = exact_motion(load_truth(tmp_path, FPS, T), corners)
    for t in (0, 1, 11, T - 1):
        moved = np.concatenate([motion.displacement(i, motion.state(t, alpha)) for i in (0, 1)])
        np.testing.assert_allclose(displacement_at(exact, t, alpha), moved, rtol=0, atol=1e-7 * (1 + alpha))
        assert np.abs(moved).max() > (0 if t == 0 else 1e-3)
