"""Folders that are part of a dataset, taken for one by themselves: a timestep, or the pictures of a split."""

from __future__ import annotations

import shlex
from pathlib import Path

from tg4mm.capture.transforms import SPLITS


def whole_dataset(folder: Path) -> tuple[Path, str] | None:
    """The dataset that `folder` lies in, and what it is of it, for a message; None for any other folder.

    Paths are absolute: what is meant is often the current folder.
    """
    folder = folder.resolve()
    if _is_timestep(folder):
        return folder.parent, f"timestep {folder.name} of the dataset {folder.parent}"
    if folder.name not in SPLITS or not (folder.parent / f"transforms_{folder.name}.json").is_file():
        return None
    if _is_timestep(folder.parent):
        root, moment = folder.parent.parent, f", timestep {folder.parent.name},"
    else:
        root, moment = folder.parent, ""
    return root, f"the {folder.name} pictures{moment} of the dataset {root}"


def train_command(root: Path) -> str:
    """The command line that trains a dataset."""
    return f"tg4mm train {shlex.quote(str(root))} --out RUN"


def _is_timestep(folder: Path) -> bool:
    has_frames = any((folder / f"transforms_{split}.json").is_file() for split in SPLITS)
    return folder.name.isdecimal() and has_frames and (folder.parent / "scene.json").is_file()
