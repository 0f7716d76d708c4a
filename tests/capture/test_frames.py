"""Pictures that are frames of a video in the dataset, decoded on demand."""

import shutil
from dataclasses import replace
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image

from tests.capture.conftest import edit
from tests.capture.sfm.videos import still, write_video
from tg4mm.capture import load_capture, load_images
from tg4mm.capture.convert import write_nerfstudio
from tg4mm.capture.frames import _Reader, each_picture, read_ahead
from tg4mm.capture.pictures import FilePictures
from tg4mm.capture.planes import colours, opaque
from tg4mm.capture.sfm.clip import Clip, TimeWindow
from tg4mm.capture.sfm.dataset import Track, video_frames_of
from tg4mm.capture.sfm.reconstruct import reconstruct
from tg4mm.capture.sfm.undistort import Lens
from tg4mm.capture.video import video_frames
from tg4mm.core.errors import CaptureError
from tg4mm.fit.space import rest_views

T = 60


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    """Key frames at 0, 24, 48 …, B pictures between; stored lying on its side, after #s in its name."""
    return write_video(tmp_path_factory.mktemp("in") / "a#3.mp4", still(T), rotation=90, between=3)


@pytest.fixture(scope="module")
def dataset(video, tmp_path_factory):
    out = tmp_path_factory.mktemp("out") / "flat"
    reconstruct(video, out)
    return out


@pytest.fixture(scope="module")
def truth(video):
    return [frame.pixels for frame in video_frames(video)]


def test_frames_and_files_come_once_each(video, truth, tmp_path):
    Image.fromarray(truth[0]).save(tmp_path / "0.png")
    paths = [Path(f"{video}#7"), tmp_path / "0.png", Path(f"{video}#2"), Path(f"{video}#7")]
    found: dict[int, np.ndarray] = {}
    assert list(each_picture(paths, lambda k, image: found.setdefault(k, image))) == [1, 2, 3, 4]
    for k, number in enumerate((7, 0, 2, 7)):
        np.testing.assert_array_equal(found[k][..., :3], truth[number])


def test_a_dataset_holds_the_video_and_no_pictures(dataset, truth):
    capture = load_capture(dataset)
    assert not list(dataset.rglob("0*/**/*.png"))
    np.testing.assert_array_equal(load_images(capture).data[..., :3], np.stack(truth))
    strip = FilePictures(capture).strips([3, 50, 4])
    np.testing.assert_array_equal(strip(slice(5, 9))[..., :3], np.stack([truth[k][5:9] for k in (3, 50, 4)]))


@pytest.mark.parametrize("_", range(5))
def test_the_mean_of_a_video_asks_for_its_frames_in_their_order(dataset, truth, monkeypatch, _):
    """Out of order each is decoded again from a key frame on; a mean picture took nine times as long."""
    asked, read = [], _Reader.read
    monkeypatch.setattr(_Reader, "read", lambda self, number: asked.append(number) or read(self, number))
    found = rest_views(load_capture(dataset), FilePictures(load_capture(dataset)))
    assert asked == sorted(asked)
    np.testing.assert_allclose(found.rgb[0], np.mean(truth, 0) / 255, atol=1e-6)


def test_reading_ahead_changes_neither_order_nor_errors():
    def items():
        yield from range(5)
        raise CaptureError("the sixth")

    got = list[int]()
    with pytest.raises(CaptureError, match="the sixth"):
        got.extend(read_ahead(items(), 3))
    assert list(read_ahead(iter(range(100)))) == list(range(100))
    assert got == list(range(5))
    made = list[int]()
    some = read_ahead((made.append(k) or k for k in range(100)), 2)
    assert [next(some), next(some)] == [0, 1]
    some.close()
    assert len(made) <= 5


def test_a_window_and_its_repeats_count_from_the_first_frame(video, tmp_path):
    clip = Clip("a", video).without([4, 9])
    numbers = [k for k in range(15, T) if k not in (19, 24)]
    poses = np.tile(np.eye(4), (len(numbers), 1, 1))
    track = Track("a", clip, Lens(np.eye(3), (120, 160), None), poses, window=TimeWindow(0.5))
    assert video_frames_of(tmp_path, track) == [f"video/a#3.mp4#{k}" for k in numbers]
    # the container tells of others
    assert video_frames_of(tmp_path, replace(track, viewmats=poses[1:])) is None


def test_conversion_writes_them_out(dataset, truth, tmp_path):
    write_nerfstudio([load_capture(dataset)], tmp_path / "out")
    capture = load_capture(tmp_path / "out")
    assert len(capture) == T
    np.testing.assert_array_equal(load_images(capture).data[..., :3], np.stack(truth))


@pytest.mark.parametrize(
    ("file_path", "said"),
    [
        ("../video/a#3.mp4#60", r"the video has 60 frames, 0 to 59"),
        ("../video/b.mp4#0", r"video .*b\.mp4 does not exist"),
        ("../../x.mp4#0", r"leads outside the dataset's folder"),
        ("/x.mp4#0", r"is absolute"),
        ("../video/a#3.mp4", r"has an unsupported type"),
        ("../scene.json#0", r"does not exist"),
    ],
)
def test_bad_addresses_are_refused(dataset, tmp_path, file_path, said):
    shutil.copytree(dataset, tmp_path / "d")
    edit(
        tmp_path / "d" / "004" / "transforms_train.json", lambda v: v["frames"][0].update(file_path=file_path)
    )
    with pytest.raises(CaptureError, match=said):
        load_capture(tmp_path / "d")


def test_a_video_that_was_cut_off_is_refused(dataset, tmp_path):
    shutil.copytree(dataset, tmp_path / "d")
    own = tmp_path / "d" / "video" / "a#3.mp4"
    whole = own.read_bytes()
    own.write_bytes(whole[: len(whole) * 2 // 3])
    with pytest.raises(CaptureError, match=r"a#3\.mp4"):
        load_images(load_capture(tmp_path / "d"))


@pytest.mark.parametrize("kind", ["yuv420p", "yuvj420p", "yuv444p", "yuv420p10le", "yuva420p", "gray"])
@pytest.mark.parametrize("size", [(48, 64), (50, 66), (18, 34), (75, 101), (80, 640), (30, 1920), (77, 112)])
def test_a_frame_is_opaque_and_has_its_colours(kind, size):
    """For every width: in columns beside whole blocks FFmpeg's own RGBA has any values."""
    picture = np.random.default_rng(0).integers(0, 256, (*size, 3), dtype=np.uint8)
    frame = av.VideoFrame.from_ndarray(picture, format="rgb24").reformat(format=kind)
    found = opaque(frame)
    np.testing.assert_array_equal(found[..., :3], colours(frame))
    assert (found[..., 3] == 255).all()
