"""The video that a dataset keeps: what scene.json says of it is checked."""

import json

import pytest

from tests.capture.sfm.videos import still, write_video
from tg4mm.capture.scene import video_file
from tg4mm.cli import main
from tg4mm.core.errors import CaptureError


def test_a_flat_dataset_keeps_its_video(tmp_path):
    path = write_video(tmp_path / "a.mp4", still(20))
    assert main(["sfm", str(path), "--kind", "flat", "--out", str(tmp_path / "set"), "--from", "0.2"]) == 0
    kept = video_file(tmp_path / "set")
    assert kept.path.read_bytes() == path.read_bytes()
    assert (kept.from_s, kept.repeats) == (0.2, ())
    kept.path.unlink()
    assert video_file(tmp_path / "set") is None


@pytest.mark.parametrize(
    ("video", "said"),
    [
        ("a.mp4", "video is 'a.mp4', expected an object"),
        ({"file": 3, "from_s": 0}, "file is 3; expected the name of a video"),
        ({"file": "../a.mp4", "from_s": 0}, "leads outside the dataset's folder"),
        ({"file": "a.mp4", "from_s": 0, "repeats": ["x"]}, "expected a list of frames"),
        ({"file": "a.mp4", "from_s": "soon"}, "from_s is 'soon'; expected a finite number"),
    ],
)
def test_what_is_no_video_is_refused(tmp_path, video, said):
    (tmp_path / "set").mkdir()
    (tmp_path / "set" / "a.mp4").touch()
    (tmp_path / "set" / "scene.json").write_text(json.dumps({"fps": 30, "video": video}))
    with pytest.raises(CaptureError, match=said):
        video_file(tmp_path / "set")
