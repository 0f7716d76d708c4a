"""Which pictures are matched: those that look alike, whole groups tied together, lonely ones with all others."""

import numpy as np
import pytest
from PIL import Image

from tests.capture.sfm.scenes import intrinsics, orbit, picture, save
from tg4mm.capture import load_capture
from tg4mm.capture.sfm import engine, mapping, pairs, reconstruct
from tg4mm.capture.sfm.config import SfmConfig
from tg4mm.capture.sfm.pairs import most_alike


@pytest.fixture
def photographs(tmp_path):
    """Twelve of a box, and one of something else."""
    size = (240, 180)
    for i, viewmat in enumerate(orbit(12, turn=2.4)):
        save(tmp_path / "in" / f"p_{i:02d}.png", picture(viewmat, intrinsics(*size, 250.0), size))
    noise = np.random.default_rng(0).integers(0, 256, (18, 24, 3), np.uint8)
    Image.fromarray(noise).resize(size, Image.Resampling.BICUBIC).save(tmp_path / "in" / "z.png")
    return tmp_path / "in"


def test_of_many_photographs_the_likely_pairs_place_all(photographs, tmp_path, monkeypatch):
    """The one that is like none is tried with all others, the rest with their nearest alone."""
    pytest.importorskip("pycolmap")
    monkeypatch.setattr(pairs, "CHOSEN_FROM", 6)
    monkeypatch.setattr(pairs, "most_alike", lambda alike: most_alike(alike, most=4))
    asked: list[list[pairs.Pair]] = []

    def counting(database, some, *rest):
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
