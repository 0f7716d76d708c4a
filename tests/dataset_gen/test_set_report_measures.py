"""What a dataset's report measures agrees with an analytic set."""

import numpy as np
import pytest

pytest.importorskip("jinja2", reason="the report needs jinja2")
pytest.importorskip("skimage", reason="the report needs scikit-image")


from dataset_gen.report import write_report
from dataset_gen.report.dataset import read_dataset
from dataset_gen.report.modes import phasor_maps, track_point
from dataset_gen.report.noise_floor import noise_floor
from dataset_gen.report.pixels import motion_from_truth, seen_motion
from tests.dataset_gen.planes import DISTANCE, FOCAL, HEAVE, SIGMA, SIZE, SWAY, Plane
from tests.show.report.page_checks import check, words


def test_motion_in_pixels_is_what_the_pinhole_says(plane):
    dataset = read_dataset(plane)
    seen = seen_motion(dataset, dataset.by_camera("test")["r_000"])
    found = motion_from_truth(seen, dataset.amplitude)
    assert found.source == "truth"
    sways = np.abs(Plane(plane).displaced[0]).max()
    # In the middle of the picture, heave moves nothing across it; away from it, it adds to the sway.
    centre = seen.peak_pixels[SIZE // 2 - 1 : SIZE // 2 + 1, SIZE // 2 - 1 : SIZE // 2 + 1]
    np.testing.assert_allclose(centre, FOCAL * sways / DISTANCE, rtol=0.02)
    assert found.maximum >= found.p95 >= found.median > 0.9 * FOCAL * sways / DISTANCE
    assert found.maximum < FOCAL * (sways + 0.5 * HEAVE) / (DISTANCE - HEAVE)
    assert 0.4 < found.still < 0.6  # half of the square stands still


def test_modes_are_told_apart_in_the_truth_of_the_pixels(plane):
    dataset = read_dataset(plane)
    seen = seen_motion(dataset, dataset.by_camera("test")["r_000"])
    assert seen is not None
    assert dataset.motion is not None
    maps = phasor_maps(seen, dataset.motion)
    middle = maps[:, SIZE // 2, SIZE // 2]
    np.testing.assert_allclose(middle, [[-1j * SWAY, 0, 0], [0, 0, -1j * HEAVE]], atol=1e-6)
    still = maps[:, SIZE // 2, 2]
    np.testing.assert_allclose(still, 0, atol=1e-9)


def test_a_camera_that_moves_has_no_maps_per_pixel(tmp_path):
    made = Plane(tmp_path / "a", camera_moves=True)
    made.write()
    made.truth()
    dataset = read_dataset(made.root)
    seen = seen_motion(dataset, dataset.views["test"])
    assert seen is not None
    assert dataset.motion is not None
    assert phasor_maps(seen, dataset.motion) is None
    rest = next(row for row in noise_floor(dataset) if row.alpha == 5)
    assert rest.still is None  # the rest picture is from elsewhere
    text = write_report(made.root).read_text()
    check(text)
    assert "does not tell the modes apart" in words(text)


def test_the_point_over_time_is_the_analytic_one(plane):
    dataset = read_dataset(plane)
    made = Plane(plane)
    for seen in (seen_motion(dataset, dataset.views["test"]), None):
        track = track_point(dataset, seen)
        assert track.view == ("r_000" if seen else "")
        expected = np.column_stack([made.displaced[0], 0 * made.displaced[0], made.displaced[1]])
        np.testing.assert_allclose(track.displacement, expected, atol=1e-6)


def test_a_perfect_method_scores_what_the_noise_says(plane):
    rows = {row.alpha: row for row in noise_floor(read_dataset(plane))}
    expected = -20 * np.log10(SIGMA)
    for row in rows.values():
        assert row.pair.psnr_db == pytest.approx(expected - 3.01, abs=0.3)
        assert row.perfect_psnr_db == pytest.approx(expected, abs=0.3)
        assert row.still.psnr_db > row.still_own_noise.psnr_db
    assert rows[5].still.psnr_db < rows[0].still.psnr_db
    assert rows[5].still_own_noise.psnr_db < rows[5].perfect_psnr_db
