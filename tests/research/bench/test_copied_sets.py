"""Datasets with fewer timesteps or with noise: what changes, and that the original does not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tg4mm.capture import load_capture, load_images
from tg4mm.research.bench import BenchError
from tg4mm.research.bench.ablation.catalogue import ABLATIONS
from tg4mm.research.bench.ablation.run import _job
from tg4mm.research.bench.ablation.sets import with_noise, with_timesteps
from tg4mm.research.bench.measure import Plan
from tg4mm.research.bench.sets import open_set


def contents(root: Path) -> dict[str, bytes]:
    return {str(p.relative_to(root)): p.read_bytes() for p in sorted(root.rglob("*")) if p.is_file()}


def test_the_first_timesteps(data: Path, tmp_path: Path) -> None:
    before = contents(data)
    whole = open_set(data, "a")
    cut = open_set(with_timesteps(whole, 4, tmp_path), "a")
    assert (cut.n_timesteps, cut.n_views, cut.alphas) == (4, whole.n_views, whole.alphas)
    assert load_capture(cut.root, split="test", magnification=20).n_timesteps == 4
    assert cut.digest != whole.digest
    assert contents(data) == before
    with pytest.raises(BenchError, match="has 6 timesteps, 7 are asked for"):
        with_timesteps(whole, 7, tmp_path / "more")


def test_noise_of_the_size_asked_for_on_training_pictures_alone(data: Path, tmp_path: Path) -> None:
    before = contents(data)
    root = with_noise(open_set(data, "a"), 5.0, tmp_path)
    clean, noisy = (load_images(load_capture(r)).data.astype(np.float64) for r in (data, root))
    assert (clean[..., 3] == noisy[..., 3]).all()
    # where nothing is clipped
    inside = (clean[..., 3] > 0) & (clean[..., :3].min(-1) > 30) & (clean[..., :3].max(-1) < 225)
    difference = (noisy - clean)[..., :3]
    assert difference[inside].std() == pytest.approx(5.0, rel=0.05)
    assert abs(difference[inside].mean()) < 0.2
    assert (difference[clean[..., 3] == 0] == 0).all()
    assert len(np.unique(difference[:, 16, 16, 0])) > 5  # pictures have noise of their own
    test = "magnified/x020/003/test/r_000.png"
    assert (root / test).read_bytes() == (data / test).read_bytes()
    assert contents(data) == before
    assert contents(with_noise(open_set(data, "a"), 5.0, tmp_path / "again")) == contents(root)


def test_the_first_timesteps_of_noisy_pictures_have_their_noise(data: Path, tmp_path: Path) -> None:
    row = replace(ABLATIONS["timesteps"].rows[0], timesteps=4)
    assert row.noise > 0
    whole = open_set(data, "a")
    job = _job(whole, (row,), "modal", Plan(), tmp_path)
    assert job.data.n_timesteps == 4
    noisy = with_noise(whole, row.noise, tmp_path / "beside")
    picture = "003/train/r_000.png"
    assert (job.data.root / picture).read_bytes() == (noisy / picture).read_bytes()
    assert (job.data.root / picture).read_bytes() != (data / picture).read_bytes()
    assert not (job.data.root / "004").exists()
