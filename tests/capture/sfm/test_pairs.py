"""Which pictures are matched: those that look alike, whole groups tied together, lonely ones with all others."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from tests.capture.sfm.scenes import intrinsics, orbit, picture, save
from tg4mm.capture import load_capture
from tg4mm.capture.sfm import engine, mapping, pairs, reconstruct
from tg4mm.capture.sfm.config import SfmConfig
from tg4mm.capture.sfm.engine import opened
from tg4mm.capture.sfm.pairs import loosely_tied, matched, most_alike


def neighbours(chosen: list[tuple[int, int]], i: int) -> set[int]:
    return {a + b - i for a, b in chosen if i in (a, b)}


def test_each_is_paired_with_those_most_like_it_and_rarer_ones_beyond() -> None:
    n, most = 30, 3
    along = np.arange(n)
    alike = 1000 - 10 * np.abs(along[:, None] - along)
    chosen = most_alike(alike, most)
    assert len(set(chosen)) == len(chosen)
    assert all(a < b for a, b in chosen)
    assert {1, 2, 3} <= neighbours(chosen, 0)
    assert {6, 12, 24} <= neighbours(chosen, 0)
    assert not {20, 21, 22} & neighbours(chosen, 0)


def test_groups_of_pictures_from_one_place_are_tied_together() -> None:
    """Two groups each larger than the number of nearest ones, hardly alike across."""
    group = np.repeat([0, 1], 12)
    alike = np.where(group[:, None] == group, 500, 5)
    chosen = np.array(most_alike(alike, most=4))
    edges = csr_matrix((np.ones(len(chosen)), chosen.T), shape=(24, 24))
    assert connected_components(edges, directed=False)[0] == 1


def test_mutually_nearest_descriptors_are_counted_and_doubtful_ones_are_not() -> None:
    rng = np.random.default_rng(0)
    first = rng.normal(size=(50, 128)).astype(np.float32)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    assert matched(first, first[::-1].copy()) == 50
    assert matched(first[:20], first) == 20
    twice = np.concatenate([first, first]) + rng.normal(scale=0.02, size=(100, 128)).astype(np.float32)
    twice /= np.linalg.norm(twice, axis=1, keepdims=True)
    assert matched(first, twice) == 0  # each has two that are equally near
    assert matched(first, twice[:50]) == 50
    assert matched(first, np.zeros((0, 128), np.float32)) == 0


def test_few_firm_pairs_or_a_part_of_its_own_are_loose() -> None:
    firm = np.zeros((16, 16), bool)
    firm[:9, :9] = firm[10:, 10:] = True  # a large part, picture 9 alone, a small part
    np.fill_diagonal(firm, False)
    firm[9, :3] = firm[:3, 9] = True
    assert np.flatnonzero(loosely_tied(firm)).tolist() == list(range(9, 16))
    firm[9, 3] = firm[3, 9] = True
    assert np.flatnonzero(loosely_tied(firm)).tolist() == list(range(10, 16))


@pytest.fixture
def photographs(tmp_path: Path) -> Path:
    """Twelve of a box, and one of something else."""
    size = (240, 180)
    for i, viewmat in enumerate(orbit(12, turn=2.4)):
        save(tmp_path / "in" / f"p_{i:02d}.png", picture(viewmat, intrinsics(*size, 250.0), size))
    noise = np.random.default_rng(0).integers(0, 256, (18, 24, 3), np.uint8)
    Image.fromarray(noise).resize(size, Image.Resampling.BICUBIC).save(tmp_path / "in" / "z.png")
    return tmp_path / "in"


def test_of_many_photographs_the_likely_pairs_place_all(
    photographs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The one that is like none is tried with all others, the rest with their nearest alone."""
    pytest.importorskip("pycolmap")
    monkeypatch.setattr(reconstruct, "CHOSEN_FROM", 6)
    monkeypatch.setattr(pairs, "most_alike", lambda alike: most_alike(alike, most=4))
    asked: list[list[pairs.Pair]] = []

    def counting(database: Path, some: list[pairs.Pair], *rest: int) -> int:
        asked.append(some)
        return engine.match(database, some, *rest)

    monkeypatch.setattr(mapping, "match", counting)
    with pytest.warns(
        UserWarning, match=r"1 pictures could not be placed and are left out: photographs/z\.png"
    ):
        reconstruct.reconstruct(photographs, tmp_path / "out", SfmConfig(), threads=1)
    assert len(load_capture(tmp_path / "out").paths) == 12
    tried = [frozenset(pair) for some in asked for pair in some]
    assert len(tried) == len(set(tried)) < 13 * 12 // 2
    assert sum("photographs/z.png" in pair for pair in tried) == 12


def test_large_pictures_are_searched_as_they_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not doubled first, and in the order asked for whatever their sizes."""
    c = pytest.importorskip("pycolmap")
    size = (240, 180)
    viewmats = orbit(3, turn=0.4)
    for i, viewmat in enumerate(viewmats):
        save(tmp_path / f"{i}.png", picture(viewmat, intrinsics(*size, 250.0), size))
    names = [f"{i}.png" for i in range(3)]
    counts = {}
    for large in (10_000, 200):
        monkeypatch.setattr(engine, "LARGE_PX", large)
        database = tmp_path / f"{large}.db"
        opened(database).__exit__()
        c.import_images(database, tmp_path, c.CameraMode.SINGLE, names)
        counts[large] = engine.extract(database, tmp_path, names, None, threads=2)
    assert all(0 < few < many for few, many in zip(counts[200], counts[10_000], strict=True))
