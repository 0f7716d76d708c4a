"""A dataset's report: what it measures agrees with an analytic set; what is absent is said; pages are sound."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("jinja2", reason="the report needs jinja2")
pytest.importorskip("skimage", reason="the report needs scikit-image")

from PIL import Image

from dataset_gen.errors import GenerateError
from dataset_gen.report import write_overview, write_report
from dataset_gen.report.__main__ import main
from dataset_gen.report.dataset import read_dataset, read_picture
from dataset_gen.report.modes import peak_of_phasor, phasor_maps, spectrum, summarise, together, track_point
from dataset_gen.report.noise_floor import find_pairs, noise_floor
from dataset_gen.report.pictures import contact_rows, overlay, sheet
from dataset_gen.report.pixels import (
    motion_from_truth,
    motion_from_vertices,
    project,
    seen_motion,
    unproject,
)
from dataset_gen.report.sizes import shares
from dataset_gen.report.text import length, metres
from dataset_gen.truth import write_exr
from tests.report.page_checks import outside_loads, read_page

SIZE, DISTANCE, ANGLE = 32, 4.0, 0.6
FOCAL = 0.5 * SIZE / np.tan(0.5 * ANGLE)
SWAY, HEAVE = 0.02, 0.01  # of the two modes, scene units, along x and along z
FPS, T = 30.0, 10
SIGMA = 0.03  # noise of the pictures


def pose(shift: float = 0.0) -> np.ndarray:
    """A camera above the plane z = 0 that looks down on it."""
    made = np.eye(4)
    made[:3, 3] = (shift, 0.0, DISTANCE)
    return made


def gains(frequencies: list[float]) -> np.ndarray:
    """[K, T]"""
    return np.exp(2j * np.pi * np.outer(frequencies, np.arange(T)) / FPS)


class Plane:
    """A square |x|, |y| < 1 in z = 0, of which |x| < 0.5 sways along x and heaves along z, in that order."""

    def __init__(self, root: Path, frequencies: tuple[float, float] = (3.0, 6.0), camera_moves: bool = False):
        self.root, self.frequencies, self.camera_moves = root, list(frequencies), camera_moves
        self.noise = np.random.default_rng(0).normal(0, SIGMA, (SIZE, SIZE, 3))
        self.displaced = (-1j * gains(self.frequencies) * np.array([[SWAY], [HEAVE]])).real  # [2, T]

    def write(self, alphas: tuple[int, ...] = (5,), test: bool = True, **scene: Any) -> Path:
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

    def view(self, t: int, split: str) -> None:
        folder = self.root / f"{t:03d}"
        matrix = pose(0.1 * t if self.camera_moves else 0.0).tolist()
        frame = {"file_path": f"./{split}/r_000", "transform_matrix": matrix, "time": t / FPS}
        data = {"camera_angle_x": ANGLE, "w": SIZE, "h": SIZE, "frames": [frame]}
        self.picture(t, 0, folder / split / "r_000.png")
        (folder / f"transforms_{split}.json").write_text(json.dumps(data))

    def moves(self, x: np.ndarray) -> np.ndarray:
        return np.abs(x) < 0.5

    def picture(self, t: int, alpha: float, path: Path, noise: np.ndarray | None = None) -> None:
        """The square in grey, what moves in a pattern that goes along with x; noise as a renderer's."""
        columns = (np.arange(SIZE) + 0.5 - SIZE / 2) / FOCAL * DISTANCE
        rest = columns - (1 + alpha) * self.displaced[0, t]
        value = np.where(self.moves(columns), 0.5 + 0.25 * np.sin(12 * rest), 0.4)
        image = np.repeat(np.repeat(value[None, :, None], SIZE, 0), 3, 2) + (
            self.noise if noise is None else noise
        )
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray((np.clip(image, 0, 1) * 255 + 0.5).astype(np.uint8)).save(path)

    def truth(self) -> None:
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

    def motion(self) -> None:
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

    def reseed(self, alphas: tuple[int, ...] = (0, 5), rest: bool = True) -> None:
        """Second renders at timestep 2, with other noise."""
        draw = np.random.default_rng(1)
        folder = self.root / "report/reseeded"
        for alpha in alphas:
            place = folder / (f"magnified/x{alpha:03d}" if alpha else ".") / "002/test/r_000.png"
            self.picture(2, alpha, place, draw.normal(0, SIGMA, self.noise.shape))
        if rest:
            other = draw.normal(0, SIGMA, self.noise.shape)
            self.picture(2, -1, folder / "rest/002/test/r_000.png", other)


@pytest.fixture(scope="module")
def plane(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = Plane(tmp_path_factory.mktemp("set") / "plane_3Hz_0_02")
    made.write(unit_scale_m=0.1, modes=[{"name": "sway", "kind": "rigid"}, {"name": "heave"}])
    made.truth()
    made.reseed()
    return made.root


@pytest.fixture(scope="module")
def page(plane: Path) -> str:
    return write_report(plane).read_text(encoding="utf-8")


def words(text: str) -> str:
    return " ".join(" ".join(read_page(text).text).split())


def check(text: str) -> None:
    reader = read_page(text)
    assert not reader.errors
    assert not reader.open
    assert not outside_loads(text)


def test_projection_and_its_inverse_agree(plane: Path) -> None:
    view = read_dataset(plane).views["test"][0]
    depth = np.random.default_rng(0).uniform(1, 9, (SIZE, SIZE))
    pixel, found = project(unproject(depth, view), view)
    np.testing.assert_allclose(found, depth, rtol=1e-12)
    rows, columns = np.mgrid[:SIZE, :SIZE] + 0.5
    np.testing.assert_allclose(pixel, np.stack([columns, rows], -1), atol=1e-9)


def test_motion_in_pixels_is_what_the_pinhole_says(plane: Path) -> None:
    dataset = read_dataset(plane)
    seen = seen_motion(dataset, dataset.by_camera("test")["r_000"])
    assert seen is not None
    found = motion_from_truth(seen, dataset.amplitude)
    assert found.source == "truth"
    sways = np.abs(Plane(plane).displaced[0]).max()
    # In the middle of the picture, heave moves nothing across it; away from it, it adds to the sway.
    centre = seen.peak_pixels[SIZE // 2 - 1 : SIZE // 2 + 1, SIZE // 2 - 1 : SIZE // 2 + 1]
    np.testing.assert_allclose(centre, FOCAL * sways / DISTANCE, rtol=0.02)
    assert found.maximum >= found.p95 >= found.median > 0.9 * FOCAL * sways / DISTANCE
    assert found.maximum < FOCAL * (sways + 0.5 * HEAVE) / (DISTANCE - HEAVE)
    assert 0.4 < found.still < 0.6  # half of the square stands still


def test_vertices_give_nearly_the_same_as_pixels(plane: Path) -> None:
    dataset = read_dataset(plane)
    views = dataset.by_camera("test")["r_000"]
    seen = seen_motion(dataset, views)
    assert seen is not None
    assert dataset.motion is not None
    pixels = motion_from_truth(seen, dataset.amplitude)
    vertices = motion_from_vertices(dataset.motion, views, dataset.amplitude)
    assert vertices.source == "vertices"
    for name in ("maximum", "p95", "median"):
        assert getattr(vertices, name) == pytest.approx(getattr(pixels, name), rel=0.05)


def test_modes_are_told_apart_in_the_truth_of_the_pixels(plane: Path) -> None:
    dataset = read_dataset(plane)
    seen = seen_motion(dataset, dataset.by_camera("test")["r_000"])
    assert seen is not None
    assert dataset.motion is not None
    maps = phasor_maps(seen, dataset.motion)
    assert maps is not None
    middle = maps[:, SIZE // 2, SIZE // 2]
    np.testing.assert_allclose(middle, [[-1j * SWAY, 0, 0], [0, 0, -1j * HEAVE]], atol=1e-6)
    still = maps[:, SIZE // 2, 2]
    np.testing.assert_allclose(still, 0, atol=1e-9)


def test_modes_that_go_alike_are_shown_together(tmp_path: Path) -> None:
    made = Plane(tmp_path / "a", frequencies=(3.0, 3.0))
    made.write()
    made.truth()
    dataset = read_dataset(made.root)
    seen = seen_motion(dataset, dataset.views["test"])
    assert seen is not None
    assert dataset.motion is not None
    assert phasor_maps(seen, dataset.motion) is None
    motion, groups = together(dataset.motion)
    assert groups == [[0, 1]]
    maps = phasor_maps(seen, motion)
    assert maps is not None
    np.testing.assert_allclose(maps[0, SIZE // 2, SIZE // 2], [-1j * SWAY, 0, -1j * HEAVE], atol=1e-6)
    assert "mode 1 and mode 2 together, 3 Hz" in words(write_report(made.root).read_text())


def test_a_camera_that_moves_has_no_maps_per_pixel(tmp_path: Path) -> None:
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


def test_the_modes_are_summed_up(plane: Path) -> None:
    motion = read_dataset(plane).motion
    assert motion is not None
    sway, heave = summarise(motion)
    assert (sway.frequency_hz, heave.frequency_hz) == (3.0, 6.0)
    assert sway.amplitude == pytest.approx(SWAY, rel=1e-6)
    assert heave.amplitude == pytest.approx(HEAVE, rel=1e-6)
    assert sway.parts[0][0] == "square"
    assert sway.moving_area == pytest.approx(1.0 / 1.9, abs=0.05)


def test_a_circular_phasor_has_its_radius_and_a_straight_one_its_length() -> None:
    assert peak_of_phasor(np.array([3.0, -3j, 0])) == pytest.approx(3)
    assert peak_of_phasor(np.array([3.0, 4.0, 0]) * np.exp(0.7j)) == pytest.approx(5)


def test_the_point_over_time_is_the_analytic_one(plane: Path) -> None:
    dataset = read_dataset(plane)
    made = Plane(plane)
    for seen in (seen_motion(dataset, dataset.views["test"]), None):
        track = track_point(dataset, seen)
        assert track is not None
        assert track.view == ("r_000" if seen else "")
        expected = np.column_stack([made.displaced[0], 0 * made.displaced[0], made.displaced[1]])
        np.testing.assert_allclose(track.displacement, expected, atol=1e-6)


def test_the_spectrum_of_a_sine_is_its_amplitude_at_its_frequency() -> None:
    frequencies, amplitudes = spectrum(0.3 * np.sin(2 * np.pi * 5 * np.arange(30) / 30), 30.0)
    assert frequencies[np.argmax(amplitudes)] == 5
    assert amplitudes.max() == pytest.approx(0.3)
    assert spectrum(np.array([2.0, -2.0]), 30.0)[1][-1] == pytest.approx(2)  # at half the frame rate


def test_a_perfect_method_scores_what_the_noise_says(plane: Path) -> None:
    rows = {row.alpha: row for row in noise_floor(read_dataset(plane))}
    expected = -20 * np.log10(SIGMA)
    for row in rows.values():
        assert row.pair is not None
        assert row.pair.psnr_db == pytest.approx(expected - 3.01, abs=0.3)
        assert row.perfect_psnr_db == pytest.approx(expected, abs=0.3)
        assert row.still is not None
        assert row.still_own_noise is not None
        assert row.still.psnr_db > row.still_own_noise.psnr_db
    assert rows[5].still.psnr_db < rows[0].still.psnr_db
    assert rows[5].still_own_noise.psnr_db < rows[5].perfect_psnr_db


def test_pairs_are_found_where_the_second_renders_lie(plane: Path) -> None:
    pairs = find_pairs(read_dataset(plane))
    assert [(p.alpha, p.view.timestep) for p in pairs] == [(0, 2), (5, 2)]
    assert all(p.truth != p.other and p.other.is_file() for p in pairs)


def test_equal_second_renders_are_said_to_be_equal(tmp_path: Path) -> None:
    made = Plane(tmp_path / "a")
    made.write()
    made.picture(2, 0, made.root / "report/reseeded/002/test/r_000.png")
    row = noise_floor(read_dataset(made.root))[0]
    assert row.pair is not None
    assert row.pair.psnr_db == row.perfect_psnr_db == 100
    assert "Here the second render is equal" in words(write_report(made.root).read_text())


def test_the_page_is_sound_and_says_the_numbers(page: str, plane: Path) -> None:
    check(page)
    said = words(page)
    for title in (
        "The pictures",
        "How it moves",
        "Motion in pixels",
        "What a perfect method would score",
        "How it was made",
    ):
        assert title in said
    assert "3 Hz and 6 Hz" in said
    assert "0.02 units (2 mm)" in said
    assert "square (100 %)" in said
    assert "per-pixel truth" in said
    assert "vertices" in said
    found = json.loads((plane / "report/summary.json").read_text())
    assert f"{found['scores'][-1]['perfect_psnr_db']:.2f}" in said
    assert Image.open(plane / "report/contact_sheet.png").width > 4 * 168
    assert not list((plane / "report").glob(".*"))


def test_the_same_set_gives_the_same_report(page: str, plane: Path) -> None:
    files = ("index.html", "contact_sheet.png", "summary.json", "thumbnail.png")
    before = [(plane / "report" / name).read_bytes() for name in files]
    write_report(plane)
    assert [(plane / "report" / name).read_bytes() for name in files] == before


def test_what_is_absent_is_said(tmp_path: Path) -> None:
    made = Plane(tmp_path / "a")
    made.write(alphas=(), test=False)
    (made.root / "truth/motion.npz").unlink()
    text = write_report(made.root).read_text()
    check(text)
    said = words(text)
    assert "Ground truth of magnified motion is absent" in said
    assert "truth/motion.npz is absent" in said
    assert "no test views" in said
    assert "Neither per-pixel truth nor truth/motion.npz" in said
    assert "Scale unknown" in said
    assert "not recorded" in said


def test_without_second_renders_only_nothing_moves_is_scored(tmp_path: Path) -> None:
    made = Plane(tmp_path / "a")
    made.write()
    said = words(write_report(made.root).read_text())
    assert "Not measured: report/reseeded/" in said
    assert "perfect method" not in said.split("Not measured")[1].split("PSNR and SSIM")[0]
    assert "nothing moves, same noise" in said
    assert "there is no per-pixel truth that could be used" in said


def test_an_absent_picture_is_drawn_as_absent(tmp_path: Path) -> None:
    made = Plane(tmp_path / "a")
    made.write(alphas=(5, 50))
    for path in (made.root / "magnified/x050").rglob("*.png"):
        path.unlink()
    rows = contact_rows(read_dataset(made.root))
    cells = rows[0][1]
    assert [cell.image is None for cell in cells][-2:] == [False, True]
    assert cells[-1].label.startswith("alpha = 50")
    sheet(rows)


def test_links_are_counted_once(tmp_path: Path) -> None:
    made = Plane(tmp_path / "a")
    made.write()
    first = made.root / "000/train/r_000.png"
    for t in range(1, T):
        (made.root / f"{t:03d}/train/r_000.png").unlink()
        os.link(first, made.root / f"{t:03d}/train/r_000.png")
    found = {share.kind: share for share in shares(made.root)}
    train = found["training pictures"]
    assert (train.names, train.files) == (T, 1)
    assert train.as_named == T * train.on_disk == T * first.stat().st_size
    assert found["test pictures"].files == T


def test_an_overlay_keeps_what_stands_still_grey() -> None:
    image = np.random.default_rng(0).uniform(size=(4, 4, 3))
    amounts = np.zeros((4, 4))
    amounts[0, 0], amounts[0, 1] = 1.0, np.nan
    made = overlay(image, amounts, 1.0)
    assert np.ptp(made[0, 0]) > 0.2
    assert np.ptp(made.reshape(-1, 3)[1:], axis=-1).max() == pytest.approx(0)


def test_linear_exr_pictures_are_read_as_srgb_over_white(tmp_path: Path) -> None:
    from dataset_gen.exr import encode

    pixels = np.zeros((12, 12, 4), np.float32)
    pixels[:6] = (0.25, 0.25, 0.25, 0.5)  # half covered by linear 0.5
    (tmp_path / "a.exr").write_bytes(encode(pixels))
    image = read_picture(tmp_path / "a.exr")
    srgb = 1.055 * 0.5 ** (1 / 2.4) - 0.055
    np.testing.assert_allclose(image[0, 0], 0.5 * srgb + 0.5, atol=1e-3)
    np.testing.assert_allclose(image[-1, 0], 1.0)


def test_lengths_have_metres_only_with_a_scale() -> None:
    assert length(0.02, None) == "0.02 units"
    assert length(0.02, 0.1) == "0.02 units (2 mm)"
    assert metres(2.5e-5) == "25 µm"


def test_the_overview_links_every_report_and_names_what_has_none(plane: Path, page: str) -> None:
    parent = plane.parent
    (parent / "unfinished").mkdir(exist_ok=True)
    (parent / "unfinished/scene.json").write_text("{}")
    text = write_overview(parent).read_text(encoding="utf-8")
    reader = read_page(text)
    assert not reader.errors
    links = {load for load in reader.loads if not load.startswith("data:")}
    assert links == {"plane_3Hz_0_02/report/index.html"}
    assert (parent / links.pop()).is_file()
    said = words(text)
    assert "Without a report, since not finished: unfinished" in said
    found = json.loads((plane / "report/summary.json").read_text())
    assert f"{found['scores'][-1]['perfect_psnr_db']:.2f}" in said
    assert "2 datasets" in said


def test_a_hostile_name_stays_text(tmp_path: Path) -> None:
    evil = "<script>alert(1)</script>"
    made = Plane(tmp_path / "sets" / "a&b")
    made.write(modes=[{"name": evil, "kind": evil}], engine={evil: evil}, **{"scene": evil})
    for text in (write_report(made.root).read_text(), write_overview(made.root.parent).read_text()):
        reader = read_page(text)
        assert not reader.errors
        assert reader.tags.count("script") == 1


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda root: (root / "scene.json").unlink(), "scene.json: cannot be read"),
        (lambda root: (root / "scene.json").write_text('{"fps": 0}'), "fps is 0"),
        (lambda root: (root / "scene.json").write_text("[]"), "no JSON object"),
        (lambda root: (root / "truth/motion.npz").write_bytes(b"PK"), "motion.npz: cannot be read"),
        (lambda root: (root / "000/test/r_000.png").write_bytes(b"no"), "r_000.png: cannot be read"),
        (
            lambda root: (root / "000/transforms_test.json").write_text('{"frames": [{}]}'),
            "transforms_test.json",
        ),
    ],
)
def test_a_damaged_set_is_refused_with_one_line(tmp_path: Path, spoil: Any, message: str) -> None:
    made = Plane(tmp_path / "a")
    made.write()
    spoil(made.root)
    with pytest.raises(GenerateError, match=message) as caught:
        write_report(made.root)
    assert "\n" not in str(caught.value)
    assert not (made.root / "report/index.html").exists()


def test_a_picture_outside_the_folder_is_not_opened(tmp_path: Path) -> None:
    made = Plane(tmp_path / "a")
    made.write()
    path = made.root / "000/transforms_train.json"
    path.write_text(path.read_text().replace("./train/r_000", "../../../secret"))
    with pytest.raises(GenerateError, match="leads outside"):
        write_report(made.root)


def test_a_folder_without_sets_has_no_overview(tmp_path: Path) -> None:
    with pytest.raises(GenerateError, match="holds no dataset"):
        write_overview(tmp_path)


def test_a_package_that_is_not_installed_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.startswith("dataset_gen.report.")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "PIL", None)
    with pytest.raises(GenerateError, match="needs the package PIL"):
        write_report(tmp_path)


def test_the_command_writes_reports_and_an_overview(plane: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(plane), "--overview", str(plane.parent)]) == 0
    out = capsys.readouterr().out.splitlines()
    assert out == [str(plane / "report/index.html"), str(plane.parent / "index.html")]
    assert main([str(plane / "nothing")]) == 2
    assert capsys.readouterr().err.startswith("error: ")
