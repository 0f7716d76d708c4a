"""Scores of pictures: known answers, the mask of what moves, and files that will not do."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tg4mm.capture import Capture, load_capture
from tg4mm.core.metrics import ssim_map
from tg4mm.core.pictures.frames import write_png
from tg4mm.research.bench import BenchError
from tg4mm.research.bench.scored import cameras_of, moving_pixels, score_pictures, video_of, with_closure


@pytest.fixture(scope="module")
def truth(data: Path) -> Capture:
    return load_capture(data, split="test", magnification=20)


def written(capture: Capture, folder: Path, share: float, offset: float = 0.0) -> Path:
    """Pictures whose change over time is `share` of the truth's, all brighter by `offset`."""
    for rows in cameras_of(capture):
        video = video_of(capture, rows)
        made = video.mean(0) + share * (video - video.mean(0)) + offset
        for i, image in zip(rows, made, strict=True):
            write_png(folder / capture.paths[i].relative_to(capture.root), image)
    return folder


def test_the_truth_itself_is_perfect(truth: Capture) -> None:
    scores = score_pictures(truth, truth.root)
    assert (scores["ssim"], scores["psnr_db"], scores["flip"]) == (1.0, 100.0, 0.0)
    assert (scores["ssim_moving"], scores["psnr_moving_db"]) == (1.0, 100.0)
    assert scores["gain"] == pytest.approx(1)
    assert scores["residual"] == pytest.approx(0, abs=1e-6)
    assert scores["n_images"] == len(truth)


def test_moments_without_error_do_not_rule_the_psnr_of_what_moves(truth: Capture, tmp_path: Path) -> None:
    """Half of the pictures are the truth itself: half of the squared error, 3 dB more, and no mean with 100 dB."""
    whole, half = written(truth, tmp_path / "whole", 0.0), written(truth, tmp_path / "half", 0.0)
    for i in range(0, len(truth), 2):
        own = truth.paths[i]
        (half / own.relative_to(truth.root)).write_bytes(own.read_bytes())
    all_wrong, half_wrong = (score_pictures(truth, f)["psnr_moving_db"] for f in (whole, half))
    assert all_wrong is not None
    assert half_wrong is not None
    assert half_wrong - all_wrong == pytest.approx(3, abs=0.5)


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_the_gain_is_the_share_of_the_motion_whatever_stands_still_wrong(
    truth: Capture, tmp_path: Path, share: float
) -> None:
    scores = score_pictures(truth, written(truth, tmp_path, share, offset=-0.02))
    assert scores["gain"] == pytest.approx(share, abs=0.02)
    assert scores["residual"] == pytest.approx(0, abs=0.06)


def test_the_residual_is_what_the_motion_does_not_explain(truth: Capture, tmp_path: Path) -> None:
    """Half of the motion, and noise of its own: by least squares on the files, camera by camera."""
    rng, change, true = np.random.default_rng(0), [], []
    for rows in cameras_of(truth):
        video = video_of(truth, rows)
        noise = rng.normal(0, 0.03, video.shape)
        made = np.clip(video.mean(0) + 0.5 * (video - video.mean(0)) + noise, 0, 1)
        for i, image in zip(rows, made, strict=True):
            write_png(tmp_path / truth.paths[i].relative_to(truth.root), image)
        found = video_of(truth, rows, tmp_path)
        change.append((found - found.mean(0)).ravel())
        true.append((video - video.mean(0)).ravel())
    a, c = np.concatenate(change).astype(np.float64), np.concatenate(true).astype(np.float64)
    (gain,), (squares,), *_ = np.linalg.lstsq(c[:, None], a, rcond=None)
    scores = score_pictures(truth, tmp_path)
    assert scores["gain"] == pytest.approx(gain, rel=1e-5)
    assert scores["residual"] == pytest.approx(np.sqrt(squares / (c @ c)), rel=1e-5)
    assert scores["residual"] > 0.2


def test_what_moves_is_scored_by_itself(truth: Capture, tmp_path: Path) -> None:
    folder = written(truth, tmp_path, 0.0)
    scores = score_pictures(truth, folder)
    values = []
    for rows in cameras_of(truth):
        video, made = video_of(truth, rows), video_of(truth, rows, folder)
        inside = np.abs(video - video.mean(0)).max((0, 3)) > 8 / 255
        inside[:5], inside[-5:], inside[:, :5], inside[:, -5:] = False, False, False, False
        values += [ssim_map(m, v)[inside].mean() for m, v in zip(made, video, strict=True)]
    assert scores["ssim_moving"] == pytest.approx(np.mean(values))
    assert scores["ssim_moving"] < scores["ssim"]
    assert 0 < scores["moving_share"] < 1


def test_nothing_that_moves() -> None:
    assert not moving_pixels(np.full((5, 8, 8, 3), 0.5, np.float32)).any()


def test_pictures_that_will_not_do(truth: Capture, tmp_path: Path) -> None:
    folder = written(truth, tmp_path / "made", 1.0)
    first = folder / truth.paths[0].relative_to(truth.root)
    whole = first.read_bytes()
    first.unlink()
    with pytest.raises(BenchError, match=r"r_000.png does not exist"):
        score_pictures(truth, folder)
    Image.new("RGB", (8, 9)).save(first)
    with pytest.raises(BenchError, match=r"is 8×9 pixels, expected 32×32"):
        score_pictures(truth, folder)
    elsewhere = tmp_path / "elsewhere.png"
    elsewhere.write_bytes(whole)
    first.unlink()
    first.symlink_to(elsewhere)
    with pytest.raises(BenchError, match="leads out of its folder"):
        score_pictures(truth, folder)
    shutil.rmtree(folder)


def test_closure_is_nothing_without_its_two_ends() -> None:
    rows = {"nothing moves": {"ssim": 0.9}, "theirs": {"ssim": 0.95}, "ceiling": {"ssim": 0.98}}
    with_closure(rows, "nothing moves", "ceiling")
    assert rows["theirs"]["closure"] == pytest.approx(0.625)
    alone = {"theirs": {"ssim": 0.95}}
    with_closure(alone, "nothing moves", "ceiling")
    assert alone["theirs"]["closure"] is None


def test_every_camera_moves_the_progress(truth: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[tuple[object, ...]] = []

    @contextmanager
    def progress(label: str, total: int, **_: object) -> Iterator[Callable[[int], None]]:
        said.append((label, total))
        yield lambda done: said.append((done,))

    monkeypatch.setattr("tg4mm.research.bench.scored.progress", progress)
    score_pictures(truth, truth.root, label="modal, α = 5, scores")
    steps = np.cumsum([len(rows) for rows in cameras_of(truth)])
    assert said == [("modal, α = 5, scores", len(truth)), *((n,) for n in steps)]
