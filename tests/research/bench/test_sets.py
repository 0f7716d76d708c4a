"""Datasets of a benchmark: which are taken and their names; flow, parts and tracks from their true motion."""

import json
import shutil
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from tg4mm.capture import load_capture
from tg4mm.capture.truth_file import load_truth
from tg4mm.cli import main
from tg4mm.research.bench import BenchError
from tg4mm.research.bench.sets import check_alphas, open_set, open_sets

NEAR, FAR, HALF, SLIDE = 3.0, 4.0, 0.5, 0.4  # depths, half an edge of the card, amplitude


def one_line(match):
    return pytest.raises(BenchError, match=rf"\A[^\n]*{match}[^\n]*\Z")


def test_pixels_are_those_of_the_projected_vertices(data):
    found, capture = open_set(data, "x"), load_capture(data)
    truth = load_truth(data, capture.fps, capture.n_timesteps)
    viewmat, k = capture.viewmats[0], capture.Ks[0]

    def pixels(points):
        seen = (points @ viewmat[:3, :3].T + viewmat[:3, 3]) @ k.T
        return seen[:, :2] / seen[:, 2:]

    largest = max(
        np.linalg.norm(pixels(b.rest + (1e-3 * m * np.exp(1j * phase)).real) - pixels(b.rest), axis=1).max()
        for b in truth.objects
        for m in b.modes
        for phase in np.linspace(0, np.pi, 721)
    )
    assert found.amplitude_px == pytest.approx(1e3 * largest, rel=1e-3)
    assert (found.frequency_hz, found.band_hz, found.alphas) == (5.0, (3.5, 6.5), (5, 20))
    assert (found.width, found.n_views, found.n_timesteps, found.group) == (32, 5, 6, "32×32, rig, 0.2 px")


def test_a_name_is_the_folders_own_or_the_one_given_whatever_else_is_opened(data, tmp_path):
    other = tmp_path / "px002" / data.name
    shutil.copytree(data, other)
    given = Path(f"px002={other}")
    assert [s.label for s in open_sets([data, given])] == [data.name, "px002"]
    assert [s.label for s in open_sets([given])] == ["px002"]
    with one_line(f"are both called {data.name}: give one as NAME=DIR"):
        open_sets([data, other])
    with one_line("the name may hold"):
        open_sets([Path(f"a b={other}")])
    with one_line("is named twice"):
        open_sets([data, Path(f"again={data}")])


def test_what_cannot_be_benchmarked_is_refused(data, tmp_path):
    with one_line("is named twice"):
        open_sets([data, data / ".." / data.name])
    with one_line("no dataset is named"):
        open_sets([])
    bare = tmp_path / "bare"
    shutil.copytree(data, bare, ignore=shutil.ignore_patterns("truth"))
    with one_line(r"bare has no truth/motion.npz"):
        open_sets([bare])
    shutil.copytree(data, tmp_path / "plain", ignore=shutil.ignore_patterns("magnified"))
    with one_line(r"plain has no magnified/x… folder"):
        open_sets([tmp_path / "plain"])
    with one_line(r"--alphas 7: dataset .* has ground truth for 5, 20"):
        check_alphas(open_sets([data]), (7.0,))
    check_alphas(open_sets([data]), (7.0, 20.0))


@pytest.fixture(scope="module")
def root(data, tmp_path_factory):
    root = tmp_path_factory.mktemp("truth") / data.name
    shutil.copytree(data, root)
    capture = load_capture(root, split="test")
    world = np.linalg.inv(capture.viewmats[0])

    def in_world(points):
        return np.asarray(points) @ world[:3, :3].T + world[:3, 3]

    def quad(depth, half):
        return in_world([(x * half, y * half, depth) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))])

    faces, along = np.array([[0, 1, 2], [0, 2, 3]], np.int32), SLIDE * world[:3, 0]
    still, slides = np.zeros((1, 4, 3), np.complex64), np.tile(-1j * along, (1, 4, 1)).astype(np.complex64)
    np.savez(
        root / "truth" / "motion.npz", objects=np.array(["wall", "card"]), frequencies_hz=np.array([5.0]),
        rest_0=quad(FAR, 4).astype(np.float32), faces_0=faces, mode_0=still,
        rest_1=quad(NEAR, HALF).astype(np.float32), faces_1=faces, mode_1=slides,
    )  # fmt: skip
    for t in range(capture.n_timesteps):
        shift, (x, y) = SLIDE * np.sin(2 * np.pi * t / 6), rays(capture)
        card = (np.abs(x * NEAR - shift) < HALF) & (np.abs(y * NEAR) < HALF)
        depth = np.where(card, NEAR, FAR)
        moved = card[..., None] * shift * world[:3, 0]
        position = in_world(np.stack([x, y, np.ones_like(x)], -1) * depth[..., None])
        channels = {"Depth.V": depth.astype(np.float32)}
        for name, values in (("Position", position), ("Displacement", moved), ("Normal", 0 * moved)):
            channels |= {
                f"{name}.{a}": np.ascontiguousarray(values[..., i], np.float32) for i, a in enumerate("XYZ")
            }
        path = root / "truth" / "test" / f"{t:03d}" / "r_000.exr"
        path.parent.mkdir(parents=True)
        with OpenEXR.File({"type": OpenEXR.scanlineimage}, channels) as file:
            file.write(str(path))
    assert main(["bench", "truth", str(root)]) == 0
    return root


def rays(capture):
    """x and y of each pixel's ray at depth 1, camera axes."""
    k = capture.Ks[0]
    ys, xs = np.mgrid[: capture.height, : capture.width] + 0.5
    return (xs - k[0, 2]) / k[0, 0], (ys - k[1, 2]) / k[1, 1]


def test_flow_and_parts(root):
    capture = load_capture(root, split="test")
    names = json.loads((root / "truth" / "parts.json").read_text())
    assert names == {"1": "wall", "2": "card"}
    for t in range(5):
        parts = np.asarray(Image.open(root / f"truth/parts/test/{t:03d}/r_000.png"))
        x, y = rays(capture)
        card = (np.abs(x * NEAR - SLIDE * np.sin(np.pi * t / 3)) < HALF) & (np.abs(y * NEAR) < HALF)
        np.testing.assert_array_equal(parts, 1 + card)
        with OpenEXR.File(str(root / f"truth/flow/test/{t:03d}/r_000.exr"), separate_channels=True) as file:
            flow = np.stack([file.channels()[f"Flow.{a}"].pixels for a in "XY"], -1)
        step = SLIDE * (np.sin(np.pi * (t + 1) / 3) - np.sin(np.pi * t / 3)) * capture.Ks[0, 0, 0] / NEAR
        np.testing.assert_allclose(flow[..., 0], np.where(card, step, 0), atol=1e-3)
        np.testing.assert_allclose(flow[..., 1], 0, atol=1e-3)
    assert not (root / "truth/flow/test/005").exists()


def test_what_the_card_will_cover_is_hidden(root):
    capture = load_capture(root, split="test")
    hidden = np.asarray(Image.open(root / "truth/occlusion/test/000/r_000.png"))
    x, y = rays(capture)

    def covered(half):
        """Wall that the card covers a timestep later, were its half edge so long."""
        there = (np.abs(x * NEAR - SLIDE * np.sin(np.pi / 3)) < half) & (np.abs(y * NEAR) < half)
        return there & ~((np.abs(x * NEAR) < HALF) & (np.abs(y * NEAR) < HALF))

    pixel = NEAR / capture.Ks[0, 0, 0]
    assert covered(HALF - pixel).sum() > 20
    assert (hidden[covered(HALF - pixel)] == 255).all()
    assert (hidden[~covered(HALF)] == 0).all()


def test_tracks_go_where_their_points_go(root):
    with np.load(root / "truth" / "tracks.npz", allow_pickle=False) as tracks:
        found = dict(tracks)
    assert found["pixels"].shape == (1, 6, len(found["points"]), 2)
    focal = load_capture(root, split="test").Ks[0, 0, 0]
    travelled = found["pixels"][0] - found["pixels"][0, 0]
    for t in range(6):
        step = np.where(found["part"] == 2, SLIDE * np.sin(np.pi * t / 3) * focal / NEAR, 0)
        np.testing.assert_allclose(travelled[t, :, 0], step, atol=2e-3)
    assert found["visible"][0, 0].all()
    assert 0.8 < found["visible"].mean() < 1
    assert found["visible"][..., found["part"] == 2].all()


def test_a_dataset_without_truth_of_its_pixels(data, capsys):
    assert main(["bench", "truth", str(data)]) == 2
    assert "r_000.exr does not exist: generate the dataset with --truth test" in capsys.readouterr().err
