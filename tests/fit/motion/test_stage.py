"""The motion stage on pictures whose motion is known: how near it comes, and that a kill costs one step at most.

A mode of hundredths of a pixel beside one of two pixels: iterations for the large one do not cost the small one.
"""

import logging
from dataclasses import replace

import numpy as np
import pytest

from tests.helpers import synthetic
from tests.helpers.motion_stage import NEVER, same_motion, stop_after
from tests.helpers.runs import copied
from tests.helpers.space_train import Killed
from tests.helpers.synthetic import exact_run, with_phasors
from tg4mm.capture import ImageStack, load_capture, load_images
from tg4mm.core.errors import RunError, Tg4mmError
from tg4mm.fit.motion import MotionConfig
from tg4mm.research.evaluate.displacement import displacement_figures
from tg4mm.run.stages import train_motion
from tg4mm.show.maps import blending_weights

FREQS = (3.0, 6.0)  # the post's and the ball's
SHORT = MotionConfig(components=2, iterations=5, tolerance=1e-6)
STEPS = ("noise", "smoothness", "first_pass_0", "first_pass_1", "second_pass_0", "second_pass_1")
LARGE_HZ, SMALL_HZ = 5.0, 3.0  # the post, two and a half pixels at its tip; the ball, a twenty-fifth
CONFIG = MotionConfig(components=8, smoothness_weight=30.0)


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """A run whose Gaussians are exact, of a set of a tenth of a pixel, and the true motion of them."""
    root = tmp_path_factory.mktemp("motion")
    run, motion = exact_run(root, n_views=6, n_timesteps=10, size=64, freqs=FREQS, amplitude=0.005, detail=2)
    return run, motion


@pytest.fixture(scope="module")
def fitted(scene):
    run, _ = scene
    capture = load_capture(run.dataset)
    config = MotionConfig(components=2)
    return train_motion(run, capture, load_images(capture), config), capture


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """784 Gaussians, three cameras, five timesteps."""
    root = tmp_path_factory.mktemp("small")
    run, _ = exact_run(root, n_views=3, n_timesteps=5, size=32, freqs=(6.0,))
    capture = load_capture(root / "data")
    return run, capture, load_images(capture)


@pytest.fixture(scope="module")
def unbroken(small, tmp_path_factory):
    """What SHORT finds on the small run when nothing kills it."""
    run, capture, images = small
    copy = copied(run, tmp_path_factory.mktemp("unbroken") / "run")
    return train_motion(copy, capture, images, SHORT)


@pytest.fixture
def new_run(small, tmp_path):
    """A copy of the small run, space stage done, each time it is called."""
    return lambda: copied(small[0], tmp_path / f"run{len(list(tmp_path.iterdir()))}")


def assert_stored(saved, fitted):
    """As a run keeps it, as few fields: equal up to single precision."""
    for name in ("freqs_hz", "displacement", "rotation"):
        exact = getattr(fitted, name)
        np.testing.assert_allclose(getattr(saved, name), exact, rtol=0, atol=1e-6 * np.abs(exact).max())


def test_the_displacement_is_found(scene, fitted):
    """.12 on a coarse scene. Nothing moves: 1; half the motion: .5."""
    (run, true), (found, capture) = scene, fitted
    weights = blending_weights(run.load_space(), capture)
    figures = displacement_figures(found, true, weights)
    assert figures["relative_error"] < 0.2
    assert figures["static_leak"] < 0.1
    for row in figures["per_frequency"]:
        assert row["amplitude_ratio"] == pytest.approx(1, abs=0.1)
        assert row["direction_error_deg"] < 5
        assert abs(row["phase_error_deg"]) < 3
    for factor in (0.0, 0.5):  # what the thresholds are there to tell apart
        less = with_phasors(true, displacement=np.complex64(factor) * true.displacement)
        assert displacement_figures(less, true, weights)["relative_error"] > 0.2


def test_every_part_moves_in_its_own_bin_and_phase(scene, fitted):
    """Sine phase: −i times the shape. The post is the middle of the mesh's rows, the ball their end."""
    (_, true), (found, _) = scene, fitted
    np.testing.assert_allclose(found.freqs_hz, [3, 6, 9, 12, 15])
    for k, frequency in enumerate(FREQS):
        part = np.linalg.norm(true.displacement[k], axis=1) > 0.003
        assert part.sum() > 100
        strength = np.linalg.norm(found.displacement[:, part], axis=(1, 2))
        assert found.freqs_hz[strength.argmax()] == frequency
        assert strength[k] > 5 * np.delete(strength, k).max()
        ratio = (found.displacement[k, part] * true.displacement[k, part].conj()).sum()
        assert abs(np.angle(ratio)) < np.radians(3)


def test_the_post_turns_as_it_bends(scene, fitted):
    """u = (0, a z²/1.3², 0) has the slope 2 a z / 1.3². Its Gaussians are balls, turned half as much."""
    (run, true), (found, _) = scene, fitted
    z = run.load_space().means[:, 2].numpy()
    post = (np.linalg.norm(true.displacement[0], axis=1) > 0.001) & (z > 0.5) & (z < 1.1)
    slope = -2 * 0.005 * z[post] / 1.3**2
    turned = found.rotation[0, post]
    assert (turned[:, 0].imag * -slope).sum() / (slope**2).sum() == pytest.approx(0.5, abs=0.1)
    assert np.linalg.norm(turned[:, 1:]) < 0.4 * np.linalg.norm(turned[:, 0])


def test_the_run_holds_the_motion_and_its_figures(scene, fitted):
    (run, _), (found, _) = scene, fitted
    saved = run.load_motion()
    assert_stored(saved, found)
    assert (saved.fps, saved.n_timesteps) == (30.0, 10)
    log = run.log()["motion"]
    assert (log["components"], log["views"], log["n_frequencies"]) == (2, 6, 5)
    assert 0 < log["seconds"] < 600
    assert 50 < log["peak_memory_mib"] < 16_000
    assert 0.95 < log["explained_by_components"] <= 1
    assert run.load_checkpoint("motion") is None


@pytest.mark.parametrize("killed_after", range(1, len(STEPS) + 1))
def test_killed_after_a_part_it_goes_on_after_it(killed_after, small, unbroken, new_run, monkeypatch):
    """To the bit; and what was saved is not computed again."""
    (_, capture, images), run = small, new_run()
    with monkeypatch.context() as patch:
        assert tuple(kill(run, killed_after, small, patch)) == STEPS[:killed_after]
    assert not run.has_motion
    computed = stop_after(NEVER, monkeypatch)
    assert same_motion(train_motion(run, capture, images, SHORT), unbroken)
    assert tuple(computed) == STEPS[killed_after:]
    assert run.load_checkpoint("motion") is None
    assert run.log()["motion"]["seconds"] > 0


def kill(run, killed_after, small, patch):
    computed = stop_after(killed_after, patch)
    with pytest.raises(Killed):
        train_motion(run, *small[1:], SHORT)
    return computed


def test_a_checkpoint_of_another_version_is_computed_anew(small, unbroken, new_run, monkeypatch):
    (_, capture, images), run = small, new_run()
    with monkeypatch.context() as patch:
        kill(run, 5, small, patch)
    saved = run.load_checkpoint("motion")
    assert saved is not None
    tensors, state = saved
    state["version"] -= 1
    run.save_checkpoint("motion", tensors, state)
    computed = stop_after(NEVER, monkeypatch)
    assert same_motion(train_motion(run, capture, images, SHORT), unbroken)
    assert tuple(computed) == STEPS


def test_a_checkpoint_of_another_scene_is_not_taken_up(small, new_run, monkeypatch):
    """The space stage was done again."""
    _, capture, images = small
    run, other = new_run(), new_run()
    with monkeypatch.context() as patch:
        kill(run, 3, small, patch)
    gaussians = run.load_space()
    for each in (run, other):
        each.save_space(replace(gaussians, means=gaussians.means + 0.01), {})
    assert same_motion(train_motion(run, capture, images, SHORT), train_motion(other, capture, images, SHORT))


def test_what_cannot_be_resolved_is_a_warning_of_one_line_and_in_the_log(small, new_run, caplog):
    """With one camera, the motion along its sight."""
    _, capture, images = small
    keep = np.flatnonzero(capture.camera_ids == 0)
    one = replace(
        capture, viewmats=capture.viewmats[keep], Ks=capture.Ks[keep], timesteps=capture.timesteps[keep],
        camera_ids=capture.camera_ids[keep], times_s=capture.times_s[keep],
        paths=tuple(capture.paths[i] for i in keep),
    )  # fmt: skip
    run = new_run()
    with caplog.at_level(logging.WARNING, "tg4mm"):
        train_motion(run, one, ImageStack(images.data[keep]), SHORT)
    said = [record.getMessage() for record in caplog.records]
    assert said == run.log()["motion"]["notes"]
    (line,) = [text for text in said if "line of sight" in text]
    assert "\n" not in line


def test_pictures_that_do_not_change_give_no_motion(small, new_run):
    _, capture, images = small
    still = images.data.copy()
    for camera in range(3):
        rows = capture.camera_ids == camera
        still[rows] = still[rows][:1]
    found = train_motion(new_run(), capture, ImageStack(still), SHORT)
    assert np.abs(found.displacement).max() < 1e-6


def test_gaussians_that_no_camera_sees_are_reported_in_one_line(small, new_run):
    run, capture, images = new_run(), *small[1:]
    gaussians = run.load_space()
    run.save_space(replace(gaussians, means=gaussians.means + 1_000.0), {})
    match = rf"\A{run.path}: none of the 784 Gaussians is seen by a camera whose pictures show motion\Z"
    with pytest.raises(RunError, match=match):
        train_motion(run, capture, images, SHORT)


def test_settings_are_checked_before_the_fit(small, new_run):
    with pytest.raises(Tg4mmError, match=r"motion\.components is 0, expected 1 to 100,000"):
        train_motion(new_run(), *small[1:], MotionConfig(components=0))


def _made(root):
    modes = synthetic._modes

    def unequal(*args):
        floor, post, ball = modes(*args)
        return [floor, post, np.float32(0.015) * ball]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(synthetic, "_modes", unequal)
        scene = {"n_views": 6, "n_timesteps": 30, "size": 64, "amplitude": 0.12, "detail": 2}
        run, true = synthetic.exact_run(root, **scene, freqs=(LARGE_HZ, SMALL_HZ))
    return run, true


def _error(found, true, k):
    """Relative, of what moves at the truth's frequency k by a third of the most or more."""
    expected = true.displacement[k]
    length = np.linalg.norm(expected, axis=1)
    own = length > length.max() / 3
    at = found.displacement[np.argmin(np.abs(found.freqs_hz - true.freqs_hz[k]))]
    return float(np.linalg.norm((at - expected)[own]) / np.linalg.norm(expected[own]))


@pytest.fixture(scope="module")
def errors(tmp_path_factory):
    """Errors of the large mode and the small one, in the linear fit and after three Gauss-Newton iterations."""
    root = tmp_path_factory.mktemp("two")
    run, true = _made(root)
    capture = load_capture(root / "data")
    images = load_images(capture)
    out = []
    for count in (0, 3):
        copy = copied(run, root / f"{count}")
        found = train_motion(copy, capture, images, replace(CONFIG, gauss_newton=count))
        assert copy.log()["motion"]["gauss_newton"] == count
        out.append([_error(found, true, k) for k in range(2)])
    return out


@pytest.mark.slow
def test_iterations_find_the_large_mode_and_leave_the_small_one_as_it_was_found(errors):
    """They bring the large one, not what the linear fit is corrected by. The small one erased, its error would be 1."""
    (large, small), (large_after, small_after) = errors
    assert large_after < min(0.15, 0.5 * large)
    assert small < 0.3
    assert small_after < 1.1 * small
