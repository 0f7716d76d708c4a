"""A dataset's report measures what an analytic set holds, and says what is absent."""

import json

import numpy as np
import pytest

pytest.importorskip("jinja2", reason="the report needs jinja2")
pytest.importorskip("skimage", reason="the report needs scikit-image")

from PIL import Image

from dataset_gen.report import write_report
from dataset_gen.report.__main__ import main
from dataset_gen.report.page import _step, find
from dataset_gen.truth import write_exr
from tests.show.report.page_checks import check, read_page, words

SIZE, DISTANCE, ANGLE = 32, 4.0, 0.6
FOCAL = 0.5 * SIZE / np.tan(0.5 * ANGLE)
SWAY, HEAVE = 0.02, 0.01  # of the two modes, scene units, along x and along z
FPS, T = 30.0, 10
SIGMA = 0.03  # noise of the pictures


def pose(shift=0.0):
    """A camera above the plane z = 0 that looks down on it."""
    made = np.eye(4)
    made[:3, 3] = (shift, 0.0, DISTANCE)
    return made


def gains(frequencies):
    """[K, T]"""
    return np.exp(2j * np.pi * np.outer(frequencies, np.arange(T)) / FPS)


class Plane:
    """A square |x|, |y| < 1 in z = 0, of which |x| < 0.5 sways along x and heaves along z, in that order."""

    def __init__(self, root, frequencies=(3.0, 6.0), camera_moves=False):
        self.root, self.frequencies, self.camera_moves = root, list(frequencies), camera_moves
        self.noise = np.random.default_rng(0).normal(0, SIGMA, (SIZE, SIZE, 3))
        self.displaced = (-1j * gains(self.frequencies) * np.array([[SWAY], [HEAVE]])).real  # [2, T]

    def write(self, alphas=(5,), test=True, **scene):
        description = {"fps": FPS, "n_timesteps": T, "scene": "plane", "alphas": list(alphas), **scene}
        self.root.mkdir(parents=True)
        (self.root / "scene.json").write_text(json.dumps(description))
        for t in range(T):
            for split in ("train", "test") if test else ("train",):
                self.view(t, split)
                for alpha in alphas if split == "test" else ():
                    self.picture(t, alpha, self.root / f"magnified/x{alpha:03d}/{t:03d}/test/r_000.png")
        self.motion()
        return self.root

    def view(self, t, split):
        folder = self.root / f"{t:03d}"
        matrix = pose(0.1 * t if self.camera_moves else 0.0).tolist()
        frame = {"file_path": f"./{split}/r_000", "transform_matrix": matrix, "time": t / FPS}
        data = {"camera_angle_x": ANGLE, "w": SIZE, "h": SIZE, "frames": [frame]}
        self.picture(t, 0, folder / split / "r_000.png")
        (folder / f"transforms_{split}.json").write_text(json.dumps(data))

    def moves(self, x):
        return np.abs(x) < 0.5

    def picture(self, t, alpha, path):
        """The square in grey, what moves in a pattern that goes along with x; noise as a renderer's."""
        columns = (np.arange(SIZE) + 0.5 - SIZE / 2) / FOCAL * DISTANCE
        rest = columns - (1 + alpha) * self.displaced[0, t]
        value = np.where(self.moves(columns), 0.5 + 0.25 * np.sin(12 * rest), 0.4)
        image = np.repeat(np.repeat(value[None, :, None], SIZE, 0), 3, 2) + self.noise
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray((np.clip(image, 0, 1) * 255 + 0.5).astype(np.uint8)).save(path)

    def truth(self):
        """Per-pixel truth of the test camera."""
        centre = (np.arange(SIZE) + 0.5 - SIZE / 2) / FOCAL
        for t in range(T):
            sway, heave = self.displaced[:, t]
            shift = 0.1 * t if self.camera_moves else 0.0
            position = np.zeros((SIZE, SIZE, 3))
            position[..., 0] = centre[None] * DISTANCE + shift
            position[..., 1] = -centre[:, None] * DISTANCE
            here = self.moves(position[..., 0] - sway)
            position[here, 0] = np.broadcast_to(centre[None] * (DISTANCE - heave), (SIZE, SIZE))[here] + shift
            position[here, 1] = np.broadcast_to(-centre[:, None] * (DISTANCE - heave), (SIZE, SIZE))[here]
            position[here, 2] = heave
            seen = np.abs(position[..., 1]) < 1
            displacement = np.where(here[..., None], [sway, 0.0, heave], 0.0) * seen[..., None]
            depth = np.where(seen, DISTANCE - position[..., 2], 1e10)
            passes = {
                "Depth": depth,
                "Normal": position * 0,
                "Position": position,
                "Displacement": displacement,
            }
            write_exr(self.root / f"truth/test/{t:03d}/r_000.exr", passes)

    def motion(self):
        x, y = (v.ravel() for v in np.meshgrid(np.linspace(-0.95, 0.95, 39), np.linspace(-0.95, 0.95, 39)))
        index = np.arange(39 * 39).reshape(39, 39)
        a, b, c = index[:-1, :-1].ravel(), index[:-1, 1:].ravel(), index[1:, :-1].ravel()
        faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([b, index[1:, 1:].ravel(), c])])
        mode = np.zeros((2, len(x), 3), np.complex64)
        mode[0, self.moves(x), 0], mode[1, self.moves(x), 2] = -1j * SWAY, -1j * HEAVE
        (self.root / "truth").mkdir(exist_ok=True)
        np.savez(
            self.root / "truth/motion.npz",
            objects=np.array(["square"]),
            frequencies_hz=np.array(self.frequencies),
            gains=gains(self.frequencies),
            magnified=np.array([True, False]),
            rest_0=np.column_stack([x, y, 0 * x]).astype(np.float32),
            faces_0=faces.astype(np.int32),
            mode_0=mode,
        )


@pytest.fixture(scope="module")
def plane(tmp_path_factory):
    """A whole set of `Plane`, with its report."""
    made = Plane(tmp_path_factory.mktemp("set") / "plane_3Hz_0_02")
    made.write(unit_scale_m=0.1, modes=[{"name": "sway", "kind": "rigid"}, {"name": "heave"}])
    made.truth()
    write_report(made.root)
    return made.root


def test_motion_in_pixels_is_what_the_pinhole_says(plane):
    found = find(plane)
    sways = np.abs(Plane(plane).displaced[0]).max()
    (view,) = found.views
    assert view.name == "r_000"
    # In the middle of the picture, heave moves nothing across it; away from it, it adds to the sway.
    assert view.maximum >= view.p95 >= view.median > 0.9 * FOCAL * sways / DISTANCE
    assert view.maximum < FOCAL * (sways + 0.5 * HEAVE) / (DISTANCE - HEAVE)


def test_what_lies_outside_of_a_picture_has_no_motion_in_it(plane):
    # Seen, beside the picture, behind the camera.
    rest = np.array([[0.0, 0, 0], [9.0, 0, 0], [0.0, 0, 2 * DISTANCE]])
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


def test_the_page_is_sound_and_says_the_numbers(plane):
    page = (plane / "report/index.html").read_text(encoding="utf-8")
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
