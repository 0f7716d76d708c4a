"""Motions solved on bodies: amplitudes, phases, parts, time laws, states, linearity; and the file of the truth."""

import numpy as np
import pytest

from dataset_gen import truth
from dataset_gen.errors import GenerateError
from dataset_gen.vibration import Body, MotionDescription, pixel_displacement, solve

FPS = 30.0
SWAY = {
    "name": "sway", "kind": "bending", "frequency": 5, "amplitude": 0.01,
    "base": [0, 0, -0.3], "tip": [0, 0, 0.2], "direction": [3, 4, 0],
}  # fmt: skip
WAVE = {
    "name": "wave", "kind": "wave", "frequency": 3.7, "amplitude": 0.004,
    "direction": [1, 0, 0], "wavelength": 0.8, "polarisation": [0, 0, 1],
}  # fmt: skip
DRIFT = {"name": "drift", "kind": "drift", "rate": 0.03, "direction": [0, 1, 0], "magnified": False}
HUM = {"name": "hum", "kind": "translate", "frequency": 5, "amplitude": 0.002, "direction": [0, 1, 1]}
T = 24
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


def body(name="body", count=200, seed=0, follow=1.0, groups=None):
    where = np.random.default_rng(seed).uniform(-1, 1, (count, 3))
    weights = np.broadcast_to(np.asarray(follow, float), (count,))
    return Body(name, where, np.array([[0, 1, 2]]), weights, groups or {})


def motion(*modes, bodies=None, fps=FPS, reference=None, seed=0):
    description = MotionDescription.from_json({"modes": list(modes)}, "x.yaml")
    return solve(description, bodies or [body()], fps, reference, seed)


def series(solved, n=3000, span=10.0, index=0):
    """Displacements [n, V, 3] over `span` seconds, finely sampled, straight from shapes and time laws."""
    t = np.linspace(0, span * FPS, n)
    gains = np.array([law.gain(t, solved.fps) for law in solved.laws])
    return np.tensordot(gains.T, solved.shapes[index], axes=1).real


@pytest.mark.parametrize("alpha", [0.0, 5.0, 0.5, -1.0])
def test_displacement_is_the_law_of_the_description(alpha):
    solved = motion(SWAY | {"phase": 30, "decay": 0.7}, WAVE, DRIFT)
    where = body().vertices
    for t in (0, 1, 7, 29, 1000):
        seconds = t / FPS
        z, lift = solved.shapes[0], np.zeros_like(where)
        # The bending as the description says it: a sine, 30° ahead, ringing down.
        bending = np.abs(z[0]) * np.sign((z[0] * 1j * np.exp(-1j * np.pi / 6)).real)
        lift += (1 + alpha) * bending * np.sin(2 * np.pi * 5 * seconds + np.pi / 6) * np.exp(-seconds / 0.7)
        travel = 2 * np.pi * (3.7 * seconds - where[:, 0] / 0.8)
        lift[:, 2] += (1 + alpha) * 0.004 * np.sin(travel)
        lift[:, 1] += 0.03 * seconds  # the drift is not magnified
        np.testing.assert_allclose(solved.displacement(0, solved.state(t, alpha)), lift, atol=2e-10)


def test_a_sine_is_at_rest_in_the_reference_frame_for_every_alpha():
    solved = motion(SWAY)
    assert solved.state(0) == solved.state(0, 50.0)
    assert solved.state(0).at_rest
    assert not solved.state(1).at_rest
    np.testing.assert_array_equal(solved.displacement(0, solved.state(0)), 0.0)
    assert motion(SWAY | {"phase": 90}).state(0).gains == (1.0,)
    assert not motion(WAVE).state(0).at_rest


@pytest.mark.parametrize(
    "mode", [SWAY, WAVE | {"polarisation": "rayleigh"}, SWAY | {"phases": "random"}, HUM | {"phase": 77}]
)
def test_the_amplitude_is_the_largest_displacement_over_all_vertices_and_all_time(mode):
    bodies = [body("a", follow=0.7), body("b", seed=1)]
    solved = motion(mode, bodies=bodies)
    largest = [np.linalg.norm(series(solved, index=i), axis=2).max() for i in (0, 1)]
    assert max(largest) == pytest.approx(mode["amplitude"], rel=1e-4)
    assert min(largest) > 0.1 * mode["amplitude"]


def camera():
    """Camera-to-world, OpenGL axes, aslant, and its focal lengths in pixels."""
    back = np.array([2.0, -3.0, 1.5])
    z = back / np.linalg.norm(back)
    x = np.cross([0, 0, 1.0], z)
    x /= np.linalg.norm(x)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = np.stack([x, np.cross(z, x), z], 1), back
    return pose, 300.0, 280.0


def project(where):
    """Pixels [..., 2] of world points, principal point at 0, y down."""
    pose, fl_x, fl_y = camera()
    local = (where - pose[:3, 3]) @ pose[:3, :3]
    return np.stack([fl_x * local[..., 0] / -local[..., 2], -fl_y * local[..., 1] / -local[..., 2]], -1)


@pytest.mark.parametrize("mode", [SWAY, WAVE | {"polarisation": "rayleigh"}, SWAY | {"phases": "random"}])
def test_the_amplitude_in_pixels_is_what_the_reference_camera_sees_over_time(mode):
    bodies = [body("a"), body("b", seed=1)]
    described = {k: v for k, v in mode.items() if k != "amplitude"} | {"amplitude_px": 0.01}
    solved = motion(described, bodies=bodies, reference=lambda x, s: pixel_displacement(x, s, *camera()))
    pixels = [
        np.linalg.norm(project(b.vertices + series(solved, index=i)) - project(b.vertices), axis=2).max()
        for i, b in enumerate(bodies)
    ]
    assert max(pixels) == pytest.approx(0.01, rel=1e-3)


def test_a_phase_per_part_delays_its_sine():
    bodies = [body("a"), body("b"), body("c")]
    solved = motion(SWAY | {"phase": 10, "phases": {"*": 5, "b": 40}}, bodies=bodies)
    a, b = solved.shapes[0], solved.shapes[1]
    np.testing.assert_allclose(b, a * np.exp(1j * np.radians(35)), atol=1e-15)  # the last glob counts
    np.testing.assert_array_equal(solved.shapes[2], a)
    # Ahead by 40 + 10 degrees, and still a sine.
    moved = np.array([solved.displacement(1, solved.state(t)) for t in range(6)])
    expected = np.sin(np.pi / 3 * np.arange(6) + np.radians(50))
    peak = np.abs(b).max()
    v, axis = np.unravel_index(np.abs(b[0]).argmax(), b[0].shape)
    assert np.abs(moved[:, v, axis]) == pytest.approx(peak * np.abs(expected), abs=1e-10)


def test_a_vertex_group_moves_its_weights():
    weights = np.linspace(0, 2, 200)
    mode = {
        "name": "g", "kind": "group", "frequency": 5, "amplitude": 0.01, "group": "lid",
        "direction": [0, 0, 1],
    }  # fmt: skip
    solved = motion(mode, bodies=[body("a", groups={"lid": weights}), body("b")])
    np.testing.assert_allclose(np.abs(solved.shapes[0][0, :, 2]), 0.01 * weights / 2, atol=1e-17)
    np.testing.assert_array_equal(solved.shapes[1], 0.0)


@pytest.mark.parametrize(
    ("mode", "message"),
    [
        (SWAY | {"frequency": 15}, "frequency 15 Hz is not below half the frame rate, 15 Hz (fps 30)"),
        (SWAY | {"parts": ["rod*"]}, "parts: 'rod*' matches no part; there is a, b"),
        (SWAY | {"phases": {"c": 1}}, "phases: 'c' matches no part; there is a, b"),
        (SWAY | {"phases": {"a": 1}, "parts": ["b"]}, "phases: 'a' matches no part; there is b"),
        (SWAY | {"base": [0, 0, 2], "tip": [0, 0, 3]}, "it moves no vertex of a, b"),
        (
            {"name": "sway", "kind": "group", "frequency": 5, "amplitude": 1, "group": "q", "direction": [0, 0, 1]},
            "group: no part has the vertex group 'q'; there is lid",
        ),
        (
            {k: v for k, v in SWAY.items() if k != "amplitude"} | {"amplitude_px": 0.2},
            "amplitude_px 0.2 needs a reference camera, there is none",
        ),
    ],
)  # fmt: skip
def test_what_does_not_fit_the_bodies_is_one_line(mode, message):
    bodies = [body("a", groups={"lid": np.ones(200)}), body("b")]
    with pytest.raises(GenerateError) as caught:
        motion(mode, bodies=bodies)
    assert str(caught.value) == f"x.yaml: mode 'sway': {message}"


# The file of the truth.


def bodies():
    """Two small meshes well apart: every vertex is the corner of a triangle of its own body."""
    out = []
    for i, name in enumerate("ab"):
        where = np.random.default_rng(i).uniform(-0.4, 0.4, (30, 3)) + [i * 3.0, 0, 0]
        out.append(Body(name, where, np.arange(30).reshape(10, 3), np.linspace(0, 1, 30)))
    return out


@pytest.fixture
def described():
    return solve(MotionDescription.from_json(MODES), bodies(), FPS, None, 0)


def test_the_arrays_are_those_of_the_contract(tmp_path, described):
    truth.write_motion(tmp_path / "motion.npz", bodies(), described, T)
    with np.load(tmp_path / "motion.npz", allow_pickle=False) as arrays:
        kinds = {name: (arrays[name].shape, arrays[name].dtype.name) for name in arrays.files}
        assert arrays["objects"].tolist() == ["a", "b"]
        assert arrays["magnified"].tolist() == [True, False, False]
        assert arrays["frequencies_hz"].tolist() == [4.3, 9.0, 0.0]
        assert not arrays["mode_1"][1].any()  # b is not a part of the hum
    kinds.pop("objects")
    expected = {"frequencies_hz": ((3,), "float64"), "magnified": ((3,), "bool")}
    expected["gains"] = ((3, T), "complex128")
    for i in (0, 1):
        expected |= {f"rest_{i}": ((30, 3), "float32"), f"faces_{i}": ((10, 3), "int32")}
        expected[f"mode_{i}"] = ((3, 30, 3), "complex64")
    assert kinds == expected


@pytest.mark.parametrize("alpha", [0.0, 20.0])
def test_the_evaluation_reads_the_exact_motion_back(tmp_path, described, alpha):
    pytest.importorskip("scipy")
    pytest.importorskip("torch")
    from tg4mm.capture.truth_file import load_truth
    from tg4mm.fit.motion.animate import displacement_at
    from tg4mm.research.evaluate.displacement import exact_motion

    truth.write_motion(tmp_path / "truth" / "motion.npz", bodies(), described, T)
    corners = np.concatenate([b.vertices for b in bodies()])
    exact = exact_motion(load_truth(tmp_path, FPS, T), corners)
    for t in (0, 1, 11, T - 1):
        moved = np.concatenate([described.displacement(i, described.state(t, alpha)) for i in (0, 1)])
        np.testing.assert_allclose(displacement_at(exact, t, alpha), moved, rtol=0, atol=1e-7 * (1 + alpha))
        assert np.abs(moved).max() > (0 if t == 0 else 1e-3)
