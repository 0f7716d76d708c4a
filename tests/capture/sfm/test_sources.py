"""What a folder of pictures is taken for, and what is refused."""

from pathlib import Path

import numpy as np
import pytest

from tests.capture.conftest import refused
from tests.capture.sfm.scenes import save
from tg4mm.capture.sfm.clip import find_sources, suggested_command
from tg4mm.capture.sfm.kind import possible_kinds
from tg4mm.capture.sfm.staging import check_sizes, photograph_shots, stage, staged_name
from tg4mm.cli import main

PIXELS = np.full((6, 8, 4), 200, np.uint8)
DATASETS = (
    "scene.json",
    "transforms_train.json",
    "transforms.json",
    "000/transforms_train.json",
    "sparse/0/images.bin",
)


def fill(folder, n, shape=(6, 8)):
    for i in range(n):
        save(folder / f"f_{i}.png", np.full((*shape, 4), 100 + i, np.uint8))


def videos(folder, *names):
    """Files that are videos by name; the kind of input is found without opening them."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        (folder / name).write_bytes(b"")


def test_photographs(tmp_path):
    fill(tmp_path, 12)
    (tmp_path / "notes.txt").write_text("x")
    (tmp_path / ".hidden.png").write_text("x")
    sources = find_sources(tmp_path)
    assert (sources.clips, sources.sweep, possible_kinds(sources)) == ((), None, ("photos",))
    assert [p.name for p in sources.photographs.pictures] == [f"f_{i}.png" for i in range(12)]  # 2 before 10
    assert {shot.group for shot in photograph_shots(sources.photographs, each=False)} == {"shared"}
    assert len({shot.group for shot in photograph_shots(sources.photographs, each=True)}) == 12


@pytest.mark.parametrize(
    ("names", "kinds"),
    [
        (["a.mp4"], ("flat", "handheld", "photos")),
        (["a.mp4", "sweep.mov"], ("tripod", "handheld")),
        (["a.mp4", "b.mp4"], ("rig", "clips")),
        (["a.mp4", "b.mp4", "sweep.mp4"], ("rig", "clips")),
    ],
)
def test_what_recordings_can_be(tmp_path, names, kinds):
    videos(tmp_path / "in", *names)
    sources = find_sources(tmp_path / "in")
    assert possible_kinds(sources) == kinds
    assert [clip.name for clip in sources.clips] == [Path(n).stem for n in names if "sweep" not in n]


def test_folders_of_frames_are_recordings_too(tmp_path):
    for name, n in (("cam_0", 3), ("cam_1", 2), ("sweep", 5)):
        fill(tmp_path / name, n)
    (tmp_path / "empty").mkdir()
    sources = find_sources(tmp_path)
    assert [(clip.name, len(clip.pictures)) for clip in sources.clips] == [("cam_0", 3), ("cam_1", 2)]
    assert len(sources.sweep.pictures) == 5


def test_pictures_with_a_rate_are_a_recording(tmp_path):
    fill(tmp_path / "cam", 4)
    sources = find_sources(tmp_path / "cam", timed=True)
    assert sources.photographs is None
    assert [(clip.name, len(clip.pictures)) for clip in sources.clips] == [("cam", 4)]


def test_what_is_refused(tmp_path):
    def check(name, *parts):
        refused(lambda: find_sources(tmp_path / name), *parts)

    check("nowhere", "nowhere: does not exist")
    (tmp_path / "a.txt").write_text("x")
    check("a.txt", "a.txt: is neither a folder nor a video")
    check("", "holds no pictures; expected photographs, one video")
    fill(tmp_path / "two", 2)
    check("two", "two: holds 2 pictures, at least 3 are needed")
    videos(tmp_path / "lone", "sweep.mp4")
    check("lone", "lone: holds nothing but sweep; expected")
    fill(tmp_path / "mixed", 4)
    fill(tmp_path / "mixed" / "cam", 4)
    check("mixed", "mixed: holds pictures and cam beside them;", " belong in sweep/")
    videos(tmp_path / "phone", "cam.mp4")
    (tmp_path / "phone" / "sweep").mkdir()
    check("phone", "sweep: holds no pictures; expected .png")
    (tmp_path / "phone" / "sweep" / "IMG_1.HEIC").write_bytes(b"x")
    check("phone", "IMG_1.HEIC: .HEIC is not read; convert it to .jpg")
    videos(tmp_path / "twice", "cam.mp4", "cam.mov")
    check("twice", "twice: camera cam appears twice")


@pytest.mark.parametrize("file", DATASETS)
def test_a_dataset_is_said_to_be_one(tmp_path, capsys, file):
    path = tmp_path / "in it" / file
    path.parent.mkdir(parents=True)
    path.write_text("{}")
    assert main(["sfm", str(tmp_path / "in it"), "--out", str(tmp_path / "out")]) == 2
    said = f"tg4mm: {tmp_path}/in it: is a dataset already: tg4mm train '{tmp_path}/in it' --out RUN\n"
    assert capsys.readouterr().err == said


def test_training_on_them_says_the_command_in_one_line(tmp_path, capsys):
    videos(tmp_path / "my films", "cam.mp4")
    fill(tmp_path / "photos", 4)
    for path in (tmp_path / "my films" / "cam.mp4", tmp_path / "my films", tmp_path / "photos"):
        assert main(["train", str(path), "--out", str(tmp_path / "run")]) == 2
        error = capsys.readouterr().err
        command = suggested_command(path)
        assert error == f"tg4mm: {path}: is no dataset yet; make one with: {command}\n"
        assert not (tmp_path / "run").exists()


def test_sizes_may_differ_only_where_intrinsics_do(tmp_path):
    fill(tmp_path, 2, (12, 16))
    fill(tmp_path / "other", 1, (16, 12))
    (tmp_path / "other" / "f_0.png").rename(tmp_path / "g.png")
    photographs = find_sources_of(tmp_path)
    check_sizes(photograph_shots(photographs, each=True))
    shots = photograph_shots(photographs, each=False)
    refused(lambda: check_sizes(shots), "g.png: is 12×16 pixels, but ", " is 16×12; ", "--intrinsics each")


def find_sources_of(folder):
    """The photographs of a folder, whatever folders lie beside them."""
    for path in folder.iterdir():
        if path.is_dir():
            path.rmdir()
    photographs = find_sources(folder).photographs
    assert photographs is not None
    return photographs


def test_transparent_pictures_are_staged_over_white_with_a_mask(tmp_path):
    from PIL import Image

    half = PIXELS.copy()
    half[:, :4, 3] = 0
    for i in range(3):
        save(tmp_path / "in" / f"{i}.png", half if i else PIXELS | 255, opaque=False)
    taken = photograph_shots(find_sources_of(tmp_path / "in"), each=False)
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
