"""A dataset's report measures what an analytic set holds, and says what is absent."""

import numpy as np
import pytest

pytest.importorskip("jinja2", reason="the report needs jinja2")
pytest.importorskip("skimage", reason="the report needs scikit-image")

from PIL import Image

from dataset_gen.report import write_report
from dataset_gen.report.__main__ import main
from dataset_gen.report.page import _step, find
from tests.dataset_gen.planes import DISTANCE, FOCAL, HEAVE, SWAY, Plane
from tests.show.report.page_checks import check, read_page, words


def test_motion_in_pixels_is_what_the_pinhole_says(plane):
    found = find(plane)
    sways = np.abs(Plane(plane).displaced[0]).max()
    (view,) = found.views
    assert view.name == "r_000"
    # In the middle of the picture, heave moves nothing across it; away from it, it adds to the sway.
    assert view.maximum >= view.p95 >= view.median > 0.9 * FOCAL * sways / DISTANCE
    assert view.maximum < FOCAL * (sways + 0.5 * HEAVE) / (DISTANCE - HEAVE)


def test_what_lies_outside_of_a_picture_has_no_motion_in_it(plane):
    rest = np.array(
        [[0.0, 0, 0], [9.0, 0, 0], [0.0, 0, 2 * DISTANCE]]
    )  # seen, beside the picture, behind the camera
    steps = _step(rest, np.full((3, 3), [SWAY, 0, 0]), find(plane).test, 0)
    assert steps[0] == pytest.approx(FOCAL * SWAY / DISTANCE)
    assert np.isnan(steps[1:]).all()


def test_modes_are_those_of_the_truth(plane):
    found = find(plane)
    sway, heave = found.modes
    assert (sway.name, sway.frequency_hz, sway.magnified) == ("sway", 3.0, True)
    assert (heave.name, heave.frequency_hz, heave.magnified) == ("heave", 6.0, False)
    assert sway.amplitude == pytest.approx(SWAY)
    assert heave.parts == (("square", pytest.approx(HEAVE)),)
    displaced = Plane(plane).displaced
    np.testing.assert_allclose(found.strength, np.linalg.norm(displaced, axis=0), atol=1e-6)


def test_the_page_is_sound_and_says_the_numbers(page, plane):
    check(page)
    said = words(page)
    for title in ("The pictures", "How it moves"):
        assert title in said
    assert "3 Hz" in said
    assert "0.02 units (2 mm)" in said
    assert "square (100 %)" in said
    assert "absent" not in said
    assert Image.open(plane / "report/contact_sheet.png").width > 3 * 168
    assert not list((plane / "report").glob(".*"))


def test_what_is_absent_is_said(tmp_path):
    made = Plane(tmp_path / "a")
    made.write(alphas=(), test=False)
    (made.root / "truth/motion.npz").unlink()
    text = write_report(made.root).read_text()
    check(text)
    said = words(text)
    assert "Ground truth of magnified motion is absent" in said
    assert "truth/motion.npz is absent" in said
    assert "no test views" in said
    assert "Scale unknown" in said


def test_a_frequency_between_bins_is_warned_of(tmp_path):
    made = Plane(tmp_path / "a", frequencies=(3.1, 6.0))
    made.write(modes=[{"name": "sway"}, {"name": "heave"}])
    said = words(write_report(made.root).read_text())
    assert "The frequency of sway, 3.1 Hz, lies between the bins" in said
    assert "frequency of heave" not in said


def test_a_hostile_name_stays_text(tmp_path):
    evil = "<script>alert(1)</script>"
    made = Plane(tmp_path / "a&b")
    made.write(modes=[{"name": evil, "kind": evil}], **{"scene": evil})
    reader = read_page(write_report(made.root).read_text())
    assert not reader.errors
    assert reader.tags.count("script") == 1


def test_the_command_writes_reports(plane, capsys):
    assert main([str(plane)]) == 0
    assert capsys.readouterr().out.splitlines() == [str(plane / "report/index.html")]
    assert main([str(plane / "nothing")]) == 2
    assert capsys.readouterr().err.startswith("error: ")
