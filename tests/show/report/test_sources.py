"""By how much motion is magnified, which scores count, costs and commands in words, and clips."""

import json
import os
from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.runs import copied
from tg4mm.core.errors import RunError
from tg4mm.core.files import json_digest
from tg4mm.core.magnification import AS_CAPTURED
from tg4mm.run import Run
from tg4mm.show.report import figures as video
from tg4mm.show.report.figures import clip
from tg4mm.show.report.sources import choose_alpha, metrics_of
from tg4mm.show.result.read import result_from
from tg4mm.show.result.reading import reading_of

METRICS = {"format": "tg4mm-metrics", "metrics": [], "alphas": [], "absent": {}, "notes": []}


@pytest.fixture(scope="module")
def reading(run):
    return reading_of(run)


def test_without_truth_it_is_what_shows_the_motion_within_its_noise(reading, tmp_path):
    made = reading.run
    config = {**made.config, "dataset": str(tmp_path), "dataset_from_run": "x"}
    bare = replace(reading, run=Run(made.path, config))
    alpha, why = choose_alpha(bare, result_from(bare).noise_px, AS_CAPTURED)
    limits = reading.limits(reading.motion.is_magnified().astype(float))
    assert limits.pixels * (1 + alpha) <= 0.04 * 48 * 1.001
    assert limits.too_far * (1 + alpha) <= 1
    assert "4 %" in why


def test_scores_newer_than_the_model_are_taken_and_older_ones_made_again(run, tmp_path):
    own = copied(run, tmp_path / "run")
    calls = []

    def evaluate(run):
        calls.append(run)
        return {"format": "tg4mm-metrics"}

    path = own.path / "metrics.json"
    path.write_text(json.dumps(METRICS | {"kept": True}))
    assert metrics_of(own, evaluate).get("kept")
    assert not calls
    os.utime(path, (1, 1))
    assert "kept" not in metrics_of(own, evaluate)
    assert len(calls) == 1
    assert metrics_of(own, None) == {}


def test_scores_that_are_not_those_written_are_refused(run, tmp_path):
    own = copied(run, tmp_path / "run")
    figures = METRICS | {"alphas": [{"alpha": 5, "n_images": 1, "rows": {}, "closure": 0.75}]}
    written = json.dumps(figures | {"digest": json_digest(figures)})
    (own.path / "metrics.json").write_text(written)
    assert metrics_of(own, None)["alphas"][0]["closure"] == 0.75
    (own.path / "metrics.json").write_text(written.replace("0.75", "0.95"))
    with pytest.raises(RunError, match=r"metrics\.json: is damaged or edited: [^\n]*; delete it"):
        metrics_of(own, None)


def test_a_clip_that_is_too_large_is_made_smaller(monkeypatch):
    noise = np.random.default_rng(0).integers(0, 256, (4, 400, 400, 3), dtype=np.uint8)
    whole = clip(noise, 30, 0.1)
    monkeypatch.setattr(video, "_MOST", len(whole) // 2)
    assert len(clip(noise, 30, 0.1)) <= len(whole) // 2
