"""A part of a dataset that is taken for one by itself is named, with the command for the whole."""

import logging
from pathlib import Path

import pytest

from tg4mm.capture.sfm.sources import find_sources
from tg4mm.capture.transforms import whole_dataset
from tg4mm.core.errors import CaptureError
from tg4mm.run.train import _capture


def test_a_timestep_and_its_pictures_are_parts(tree, monkeypatch):
    root = tree.resolve()
    assert whole_dataset(tree / "001") == (root, f"timestep 001 of the dataset {root}")
    pictures = f"the train pictures, timestep 001, of the dataset {root}"
    assert whole_dataset(tree / "001" / "train") == (root, pictures)
    monkeypatch.chdir(tree / "001" / "train")
    assert whole_dataset(Path(".")) == (root, pictures)


def test_whole_datasets_and_other_folders_are_not(tree, folder, tmp_path):
    (tmp_path / "photos" / "train").mkdir(parents=True)
    for other in (tree, folder, tmp_path, tmp_path / "photos", tmp_path / "photos" / "train"):
        assert whole_dataset(other) is None
    root = folder.resolve()
    assert whole_dataset(folder / "train") == (root, f"the train pictures of the dataset {root}")


def test_training_pictures_alone_is_refused(tree, folder):
    for part, root in ((tree / "000" / "train", tree), (folder / "train", folder)):
        with pytest.raises(
            CaptureError, match=rf"train: is no dataset, but .*: tg4mm train {root.resolve()} --out RUN"
        ):
            _capture(part)


def test_training_one_timestep_is_said(tree, caplog):
    with caplog.at_level(logging.WARNING, "tg4mm"):
        assert _capture(tree / "000").n_timesteps == 1
    (line,) = caplog.messages
    assert f"is timestep 000 of the dataset {tree.resolve()}, by itself a still scene" in line
    caplog.clear()
    _capture(tree)
    assert caplog.messages == []


def test_sfm_takes_no_part_of_a_dataset(tree):
    for part in (tree / "000", tree / "000" / "train"):
        with pytest.raises(CaptureError, match="whose poses are known: tg4mm train"):
            find_sources(part)
    with pytest.raises(CaptureError, match="is a dataset already: tg4mm train"):
        find_sources(tree)
