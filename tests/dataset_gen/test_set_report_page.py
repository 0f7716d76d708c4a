"""A dataset's report as a page: sound, the same each time, and what is absent is said."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("jinja2", reason="the report needs jinja2")
pytest.importorskip("skimage", reason="the report needs scikit-image")

from PIL import Image

from dataset_gen.report import write_report
from dataset_gen.report.closing import shares
from dataset_gen.report.dataset import read_picture
from tests.dataset_gen.planes import (
    Plane,
    T,
    check,
    words,
)


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


def test_linear_exr_pictures_are_read_as_srgb_over_white(tmp_path: Path) -> None:
    from dataset_gen.exr import encode

    pixels = np.zeros((12, 12, 4), np.float32)
    pixels[:6] = (0.25, 0.25, 0.25, 0.5)  # half covered by linear 0.5
    (tmp_path / "a.exr").write_bytes(encode(pixels))
    image = read_picture(tmp_path / "a.exr")
    srgb = 1.055 * 0.5 ** (1 / 2.4) - 0.055
    np.testing.assert_allclose(image[0, 0], 0.5 * srgb + 0.5, atol=1e-3)
    np.testing.assert_allclose(image[-1, 0], 1.0)
