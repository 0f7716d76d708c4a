"""The exact motion: an analytic bending beam, rigid motion, objects that stand still, and broken files."""

from dataclasses import replace

import numpy as np
import pytest

from tg4mm.capture.truth_file import Truth, TruthObject, load_truth
from tg4mm.core.errors import CaptureError
from tg4mm.fit.motion.animate import displacement_at
from tg4mm.research.evaluate.displacement import closest_on_triangles, displacement_figures, exact_motion

FPS, T = 30.0, 30
LENGTH, HALF = 2.0, 0.1  # of the beam, along x, and half its square section
AMPLITUDE = 0.005 * np.exp(0.4j)


def box_mesh(n_along=40, n_across=4):
    """Surface of the beam, x in 0..LENGTH, as a triangle mesh with shared vertices within each side."""
    x, s = np.linspace(0, LENGTH, n_along + 1), np.linspace(-HALF, HALF, n_across + 1)
    vertices, faces = [], []
    for side in range(4):
        grid = np.stack(np.meshgrid(x, s, indexing="ij"), -1)
        fixed = np.full(grid.shape[:2], HALF if side < 2 else -HALF)
        y, z = (grid[..., 1], fixed) if side % 2 else (fixed, grid[..., 1])
        start = sum(map(len, vertices))
        vertices.append(np.stack([grid[..., 0], y, z], -1).reshape(-1, 3))
        index = start + np.arange(grid[..., 0].size).reshape(grid.shape[:2])
        a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
        faces += [np.stack(t, -1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))]
    return np.concatenate(vertices), np.concatenate(faces)


def bending(points):
    """Euler-Bernoulli bending w(x) = A x² along z: sections stay plane, u = (−z w', 0, w). [N, 3] complex."""
    x, z = points[:, 0], points[:, 2]
    return np.stack([-z * 2 * AMPLITUDE * x, 0 * x, AMPLITUDE * x**2], 1)


def bending_rotation(points):
    """Half the curl of `bending`: (∂u_x/∂z − ∂u_z/∂x)/2 = −w' about y."""
    w_prime = 2 * AMPLITUDE * points[:, 0]
    return np.stack([0 * w_prime, -w_prime, 0 * w_prime], 1)


def truth_of(*objects, freqs=(3.0,)):
    return Truth(np.array(freqs), objects, FPS, T)


@pytest.fixture(scope="module")
def beam():
    vertices, faces = box_mesh()
    return TruthObject("beam", vertices, faces, bending(vertices)[None])


def surface_points(rng, n, margin):
    """Points on the beam's four long sides, at least `margin` from its ends."""
    along, across = rng.uniform(margin, LENGTH - margin, n), rng.uniform(-HALF, HALF, n)
    side, sign = rng.integers(0, 2, n), rng.choice([-HALF, HALF], n)
    return np.stack([along, np.where(side, sign, across), np.where(side, across, sign)], 1)


def test_points_on_a_bending_beam_move_as_the_analytic_field(beam):
    points = surface_points(np.random.default_rng(0), 500, 0.0)
    motion = exact_motion(truth_of(beam), points)
    assert motion.displacement.shape == (1, 500, 3)
    assert (motion.fps, motion.n_timesteps) == (FPS, T)
    scale = abs(AMPLITUDE) * LENGTH**2
    # What is left is the mesh's own: the field is piecewise linear there, −z w' is off by up to w'' h² / 4.
    mesh_error = abs(AMPLITUDE) * 2 * (LENGTH / 40) ** 2 / 4
    error = np.abs(motion.displacement[0] - bending(points)).max()
    assert mesh_error / 20 < error < 1.01 * mesh_error < 1e-3 * scale


def test_their_rotation_is_half_the_curl(beam):
    points = surface_points(np.random.default_rng(1), 500, 0.05)
    rotation = exact_motion(truth_of(beam), points).rotation[0]
    error = np.linalg.norm(rotation - bending_rotation(points), axis=1)
    scale = abs(AMPLITUDE) * 2 * LENGTH
    assert error.max() < 0.03 * scale
    assert np.sqrt((error**2).mean()) < 0.01 * scale


def test_a_rigid_rotation_is_found_exactly_also_on_a_flat_plate():
    """A plate shows no gradient along its normal; its out-of-plane rotation must not come out halved."""
    grid = np.linspace(-1, 1, 6)
    plate = np.array([(x, y, 0.5) for x in grid for y in grid])
    quads = [(6 * i + j, 6 * i + 6 + j, 6 * i + 7 + j, 6 * i + j + 1) for i in range(5) for j in range(5)]
    faces = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    omega, shift = np.array([0.02j, -0.01, 0.03 + 0.01j]), np.array([0.1, 0.2j, 0.0])
    plate_object = TruthObject("plate", plate, faces, (shift + np.cross(omega, plate))[None])
    points = np.random.default_rng(3).uniform([-1, -1, 0.5], [1, 1, 0.5], (50, 3))
    motion = exact_motion(truth_of(plate_object), points)
    np.testing.assert_allclose(motion.rotation[0], np.tile(omega, (50, 1)), atol=1e-6)
    np.testing.assert_allclose(motion.displacement[0], shift + np.cross(omega, points), atol=1e-7)


def test_what_stands_still_gives_zeros_and_the_nearest_object_decides(beam):
    vertices, faces = box_mesh(4, 2)
    floor = TruthObject("floor", vertices - [0, 0, 1], faces, np.zeros((1, len(vertices), 3), complex))
    points = np.array([[1.5, 0, HALF], [1.5, 0, -1 + HALF], [1.5, 0, -0.46], [1.5, 0, -0.54]])
    for objects in ((beam, floor), (floor, beam)):
        motion = exact_motion(truth_of(*objects), points)
        assert np.abs(motion.displacement[0]).max(1).astype(bool).tolist() == [True, False, True, False]
        assert np.abs(motion.rotation[0]).max(1).astype(bool).tolist() == [True, False, True, False]


def good_arrays():
    vertices, faces = box_mesh(3, 1)
    return {
        "objects": np.array(["beam"]),
        "frequencies_hz": np.array([3.0]),
        "rest_0": vertices.astype(np.float32),
        "faces_0": faces.astype(np.int32),
        "mode_0": bending(vertices)[None].astype(np.complex64),
    }


def write(root, arrays):
    (root / "truth").mkdir(exist_ok=True)
    np.savez_compressed(root / "truth" / "motion.npz", **arrays)
    return root / "truth" / "motion.npz"


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("mode_0", None, "has no mode_0"),
        ("objects", None, "has no objects"),
        ("objects", np.array([], dtype=str), "objects is empty"),
        ("frequencies_hz", np.array([3.0, 5.0]), r"mode_0 has shape \(1, 32, 3\), expected \(2, 32, 3\)"),
        ("frequencies_hz", np.array([-3.0]), "-3 Hz"),
        ("frequencies_hz", np.array([np.nan]), "frequencies_hz holds a value that is not finite"),
        ("faces_0", np.array([[0, 1, 32]]), r"faces_0 \('beam'\) has vertices 0 to 32, expected 0 to 31"),
        ("faces_0", np.array([[0, -1, 2]]), "vertices -1 to 2"),
        ("faces_0", np.array([[0.0, 1, 2]]), "faces_0 has type float64"),
        ("rest_0", np.full((32, 3), np.inf, np.float32), "rest_0 holds a value that is not finite"),
        ("rest_0", np.zeros((32, 2), np.float32), r"rest_0 has shape \(32, 2\), expected \('any', 3\)"),
        ("mode_0", np.zeros((1, 32, 3)), "mode_0 has type float64"),
        ("rest_0", np.array([object()]), "damaged or not an .npz of plain arrays: an array holds Python ob"),
    ],
)
def test_a_broken_file_is_refused_with_its_fault(tmp_path, key, value, message):
    arrays = good_arrays()
    arrays.pop(key)
    if value is not None:
        arrays[key] = value
    write(tmp_path, arrays)
    with pytest.raises(CaptureError, match=message) as caught:
        load_truth(tmp_path, FPS, T)
    assert "motion.npz" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_plain_array_or_nothing_in_its_place_is_refused(tmp_path):
    with pytest.raises(CaptureError, match=r"motion\.npz does not exist"):
        load_truth(tmp_path, FPS, T)
    (tmp_path / "truth").mkdir()
    with (tmp_path / "truth" / "motion.npz").open("wb") as file:
        np.save(file, np.zeros(3))
    with pytest.raises(CaptureError, match=r"damaged or not an \.npz"):
        load_truth(tmp_path, FPS, T)


def test_a_link_out_of_the_dataset_is_refused(tmp_path):
    outside, root = tmp_path / "outside", tmp_path / "root"
    outside.mkdir()
    (root / "truth").mkdir(parents=True)
    (root / "truth" / "motion.npz").symlink_to(write(outside, good_arrays()))
    with pytest.raises(CaptureError, match="leads out of the dataset's folder"):
        load_truth(root, FPS, T)


# Modes that are no steady sinusoids, or are not magnified.


def ring_down(n=T):
    """Gains [2, n]: a 4.3 Hz vibration (between bins) that rings down, and a drift."""
    t = np.arange(n) / FPS
    return np.stack([np.exp(2j * np.pi * 4.3 * t - t / 0.4), 1j * t])


def two_modes():
    arrays = good_arrays()
    mode = arrays["mode_0"]
    shift = np.zeros_like(mode) + np.array([0, -0.02j, 0], np.complex64)
    return arrays | {
        "frequencies_hz": np.array([4.3, 0.0]),
        "mode_0": np.concatenate([mode, shift]),
        "gains": ring_down(),
        "magnified": np.array([True, False]),
    }


@pytest.mark.parametrize("alpha", [0.0, 10.0])
def test_a_decaying_mode_and_a_drift_move_exactly_as_their_gains_say_at_every_alpha(tmp_path, alpha):
    arrays = two_modes()
    write(tmp_path, arrays)
    motion = exact_motion(load_truth(tmp_path, FPS, T), arrays["rest_0"].astype(float))
    for t in (0, 1, 13, T - 1):
        seconds = t / FPS
        swing = np.exp(2j * np.pi * 4.3 * seconds) * np.exp(-seconds / 0.4)
        expected = (1 + alpha) * (arrays["mode_0"][0] * swing).real + np.array([0, 0.02 * seconds, 0])
        np.testing.assert_allclose(displacement_at(motion, t, alpha), expected, atol=1e-7 * (1 + alpha))


def test_the_displacement_error_of_an_exact_ring_down_against_itself_is_zero(tmp_path):
    arrays = two_modes()
    write(tmp_path, arrays)
    motion = exact_motion(load_truth(tmp_path, FPS, T), arrays["rest_0"].astype(float))
    weights = np.ones(len(arrays["rest_0"]))
    assert displacement_figures(motion, motion, weights)["relative_error"] == 0.0
    steady = replace(motion, gains=None)
    # A sinusoid that does not ring down is not the same motion: the gains are looked at.
    assert displacement_figures(steady, motion, weights)["relative_error"] > 0.5


def test_the_figures_per_frequency_are_the_fourier_sums_of_the_true_series(tmp_path):
    arrays = two_modes()
    write(tmp_path, arrays)
    motion = exact_motion(load_truth(tmp_path, FPS, T), arrays["rest_0"].astype(float))
    series = np.stack([displacement_at(motion, t) for t in range(T)])
    turn = np.exp(-2j * np.pi * 4.3 * np.arange(T) / FPS)
    phasor = 2 / T * np.tensordot(turn, series, 1)
    figures = displacement_figures(motion, motion, np.ones(series.shape[1]))["per_frequency"]
    row = next(r for r in figures if r["frequency_hz"] == 4.3)
    assert row["amplitude_true"] == pytest.approx(np.sqrt((np.abs(phasor) ** 2).sum(1).mean()), rel=1e-5)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("gains", ring_down(T - 1), r"gains has shape \(2, 29\), expected \(2, 30\)"),
        ("gains", ring_down()[:1], r"gains has shape \(1, 30\), expected \(2, 30\)"),
        ("gains", ring_down().real, "gains has type float64, expected complexfloating"),
        ("gains", np.full((2, T), np.nan + 0j), "gains holds a value that is not finite"),
        ("magnified", np.array([1, 0]), "magnified has type int64, expected bool"),
        ("magnified", np.array([True]), r"magnified has shape \(1,\), expected \(2,\)"),
    ],
)
def test_broken_gains_are_refused(tmp_path, key, value, message):
    write(tmp_path, two_modes() | {key: value})
    with pytest.raises(CaptureError, match=message) as caught:
        load_truth(tmp_path, FPS, T)
    assert "\n" not in str(caught.value)


def brute_force_distance(point, corners, n=400):
    """Least distance from a point to a dense grid on the triangle: an upper bound, close to exact."""
    u, v = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n))
    keep = u + v <= 1 + 1e-12
    grid = np.stack([1 - u[keep] - v[keep], u[keep], v[keep]], 1) @ corners
    return float(np.linalg.norm(grid - point, axis=1).min())


def test_the_closest_point_is_the_brute_force_one():
    rng = np.random.default_rng(0)
    corners, points = rng.standard_normal((60, 3, 3)), 2 * rng.standard_normal((60, 3))
    barycentric, distance = closest_on_triangles(points, corners)
    assert (barycentric >= 0).all()
    np.testing.assert_allclose(barycentric.sum(1), 1)
    feet = (barycentric[..., None] * corners).sum(1)
    np.testing.assert_allclose(np.linalg.norm(feet - points, axis=1), distance)
    expected = np.array([brute_force_distance(p, c) for p, c in zip(points, corners, strict=True)])
    assert (distance <= expected + 1e-12).all()
    np.testing.assert_allclose(distance, expected, atol=2e-3)
    # Feet inside, on edges and on corners all occur, so that each branch is compared.
    assert set(np.unique((barycentric > 1e-9).sum(1))) == {1, 2, 3}
