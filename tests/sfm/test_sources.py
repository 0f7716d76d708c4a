"""What a folder of pictures is taken for, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.sfm.scenes import save
from tg4mm.errors import CaptureError
from tg4mm.sfm.mapping import OVERLAP, picture_pairs
from tg4mm.sfm.sources import check_frames, find_sources
from tg4mm.sfm.staging import check_sizes, shots, stage, staged_name

PIXELS = np.full((6, 8, 4), 200, np.uint8)


def fill(folder: Path, n: int, shape: tuple[int, int] = (6, 8)) -> None:
    for i in range(n):
        save(folder / f"f_{i}.png", np.full((*shape, 4), 100 + i, np.uint8))


def test_photographs(tmp_path: Path) -> None:
    fill(tmp_path, 12)
    (tmp_path / "notes.txt").write_text("x")
    (tmp_path / ".hidden.png").write_text("x")
    sources = find_sources(tmp_path)
    assert (sources.fixed, sources.sweep) == (False, None)
    assert [p.name for p in sources.clips[0].pictures] == [f"f_{i}.png" for i in range(12)]  # 2 before 10
    taken = shots(sources, each=False)
    assert {shot.group for shot in taken} == {"shared"}
    assert len({shot.group for shot in shots(sources, each=True)}) == 12


def test_fixed_cameras_and_their_sweep(tmp_path: Path) -> None:
    for name, n in (("cam_0", 3), ("cam_1", 3), ("sweep", 5)):
        fill(tmp_path / name, n)
    (tmp_path / "empty").mkdir()
    sources = find_sources(tmp_path)
    assert sources.fixed
    assert [clip.name for clip in sources.clips] == ["cam_0", "cam_1"]
    assert check_frames(sources) == 3
    taken = shots(sources, each=False)
    assert [shot.name for shot in taken[:2]] == ["cam_0/f_0.png", "cam_1/f_0.png"]
    assert len(taken) == 2 + 5
    assert [shot.group for shot in taken[2:]] == ["sweep"] * 5
    assert [shot.group for shot in shots(sources, each=True)[:2]] == ["cam_0/f_0.png", "cam_1/f_0.png"]


def test_cameras_out_of_step_are_refused(tmp_path: Path) -> None:
    fill(tmp_path / "cam_0", 3)
    fill(tmp_path / "cam_1", 2)
    with pytest.raises(CaptureError, match="camera cam_1 has 2 frames, cam_0 has 3"):
        check_frames(find_sources(tmp_path))


def test_what_is_refused(tmp_path: Path) -> None:
    with pytest.raises(CaptureError, match="nowhere: does not exist"):
        find_sources(tmp_path / "nowhere")
    (tmp_path / "a.txt").write_text("x")
    with pytest.raises(CaptureError, match=r"a\.txt: is neither a folder nor a video"):
        find_sources(tmp_path / "a.txt")
    with pytest.raises(CaptureError, match="holds no pictures; expected pictures, one video"):
        find_sources(tmp_path)
    fill(tmp_path / "two", 2)
    with pytest.raises(CaptureError, match="two: holds 2 pictures, at least 3 are needed"):
        find_sources(tmp_path / "two")
    fill(tmp_path / "lone" / "cam", 4)
    with pytest.raises(CaptureError, match="lone: holds one fixed camera, cam; at least 2 are needed"):
        find_sources(tmp_path / "lone")
    fill(tmp_path / "mixed", 4)
    fill(tmp_path / "mixed" / "cam", 4)
    with pytest.raises(CaptureError, match="mixed: holds pictures and cam beside them"):
        find_sources(tmp_path / "mixed")


def test_sizes_may_differ_only_where_intrinsics_do(tmp_path: Path) -> None:
    fill(tmp_path / "cam_0", 1)
    fill(tmp_path / "cam_1", 1, (8, 6))
    sources = find_sources(tmp_path)
    check_sizes(shots(sources, each=True))
    with pytest.raises(CaptureError, match=r"f_0\.png: is 6×8 pixels, but .* is 8×6; .*--intrinsics each"):
        check_sizes(shots(sources, each=False))


def test_transparent_pictures_are_staged_over_white_with_a_mask(tmp_path: Path) -> None:
    from PIL import Image

    half = PIXELS.copy()
    half[:, :4, 3] = 0
    for i in range(3):
        save(tmp_path / "in" / f"{i}.png", half if i else PIXELS | 255, opaque=False)
    taken = shots(find_sources(tmp_path / "in"), each=False)
    masks = stage(taken, tmp_path / "work")
    assert masks == tmp_path / "work" / "masks"
    clear, solid = taken[1], taken[0]
    mask = np.asarray(Image.open(masks / f"{staged_name(clear)}.png"))
    assert (mask[:, :4].max(), mask[:, 4:].min()) == (0, 255)
    picture = np.asarray(Image.open(tmp_path / "work" / "images" / staged_name(clear)))
    assert picture.shape == (6, 8, 3)
    assert (picture[:, :4] == 255).all()
    assert not (masks / f"{staged_name(solid)}.png").exists()
    assert (tmp_path / "work" / "images" / staged_name(solid)).read_bytes() == solid.path.read_bytes()


def test_every_pair_or_a_sequence() -> None:
    names = [f"{i:03d}" for i in range(100)]
    assert len(picture_pairs(names[:6], sequential=False)) == 15
    pairs = picture_pairs(names, sequential=True)
    assert len(set(pairs)) == len(pairs)
    steps = {int(b) - int(a) for a, b in pairs}
    assert steps == {*range(1, OVERLAP + 1), 2 * OVERLAP, 4 * OVERLAP, 8 * OVERLAP}
