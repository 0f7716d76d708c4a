"""[3DMM]'s real captures and its published ground truth, as they lie; lenses that bend straight lines."""

import json
import shutil

import numpy as np
import pytest
from PIL import Image

from tests.capture.conftest import refused
from tg4mm.capture import load_capture, load_images
from tg4mm.capture.convert import write_nerfstudio
from tg4mm.capture.dataset_tree import magnified_alphas

W, H = 64, 48
POSES = "".join(f"{i + 1} 1 0 0 0 {i} 0 5 1 {i:03d}.png\n\n" for i in range(5))


def seen(x, y):
    """[..., 3] what is seen along the ray (x, y, 1), smooth."""
    return 0.5 + 0.3 * np.stack([np.sin(7 * x), np.sin(6 * y), np.cos(5 * (x + y))], -1)


def save(path, values):
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.round(255 * values).astype(np.uint8)).save(path)


def capture_folder(root, camera=f"1 PINHOLE {W} {H} 60 60 32 24", scene='{"fps": 15}'):
    """Five registered pictures."""
    sparse = root / "sparse" / "0"
    sparse.mkdir(parents=True)
    for name, text in (("cameras", camera), ("images", POSES), ("points3D", "1 0 0 0 9 9 9 0\n")):
        (sparse / f"{name}.txt").write_text(text)
    for i in range(5):
        save(root / "images" / f"{i:03d}.png", np.full((H, W, 3), 0.1 * i))
    (root / "scene.json").write_text(scene)
    return root


@pytest.fixture
def tripod(tmp_path):
    root = capture_folder(tmp_path / "breathing")
    for t in range(15):
        save(root / "video_frames_1" / f"frame_{t + 1:05d}.png", np.full((H, W, 3), 0.05 * t))
    return root


@pytest.fixture
def handheld(tmp_path):
    return capture_folder(tmp_path / "baby", scene='{"fps": 30, "dynamic_start": 3}')


def test_a_tripods_frames_have_the_pose_of_the_last_picture(tripod):
    capture = load_capture(tripod)
    assert (capture.kind, capture.fps, capture.n_timesteps, len(capture)) == ("tripod", 15, 15, 19)
    frames = np.isfinite(capture.times_s)
    assert frames.sum() == 15
    np.testing.assert_array_equal(capture.viewmats[frames, 0, 3], 4)
    np.testing.assert_allclose(np.sort(capture.times_s[frames]), np.arange(15) / 15)
    assert sorted(capture.viewmats[~frames, 0, 3]) == [0, 1, 2, 3]
    shown = load_images(capture).data[frames, 0, 0, 0][np.argsort(capture.timesteps[frames])]
    np.testing.assert_allclose(shown, 255 * 0.05 * np.arange(15), atol=1)


def test_a_handheld_captures_timesteps_begin_at_its_start(handheld):
    capture = load_capture(handheld)
    assert (capture.kind, capture.n_timesteps, len(capture)) == ("handheld", 3, 5)
    moving = np.isfinite(capture.times_s)
    assert capture.viewmats[moving][np.argsort(capture.timesteps[moving]), 0, 3].tolist() == [2, 3, 4]
    (handheld / "scene.json").write_text('{"fps": 30, "dynamic_start": 2, "n_timesteps": 2}')
    assert load_capture(handheld).n_timesteps == 2


def test_what_is_missing_is_said_in_one_line(tripod, handheld):
    (tripod / "video_frames_1" / "frame_00007.png").unlink()
    refused(tripod, "frame 7 is missing, after frame_00006.png")
    shutil.rmtree(tripod / "video_frames_1")
    (tripod / "video_frames_1").mkdir()
    refused(tripod, "video_frames_1: holds no pictures")
    save(tripod / "images" / "005.png", np.zeros((H, W, 3)))
    refused(tripod, "005.png shows the tripod's view, but is not registered in sparse/0")
    (tripod / "scene.json").unlink()
    refused(tripod, 'scene.json: does not exist; write {"fps": 30}')
    save(handheld / "images" / "005.png", np.zeros((H, W, 3)))
    refused(handheld, "005.png: is a timestep, but is not registered")
    (handheld / "scene.json").write_text('{"fps": 30, "dynamic_start": 9}')
    refused(handheld, "dynamic_start is 9; expected a picture's number, 1 to 6")


@pytest.mark.parametrize(
    "camera",
    ["1 OPENCV 64 48 60 61 31 24 -0.2 0.05 0.004 -0.003", "1 OPENCV_FISHEYE 64 48 60 60 32 24 0.02 0 0 0"],
)
def test_a_lens_that_bends_is_straightened(tripod, camera, tmp_path):
    """A known scene through the lens is that of the pinhole, away from the edge, to a grey level or two."""
    pycolmap = pytest.importorskip("pycolmap")
    (tripod / "sparse/0/cameras.txt").write_text(camera)
    _, model, _, _, *numbers = camera.split()
    lens = pycolmap.Camera(model=model, width=W, height=H, params=[float(n) for n in numbers])
    u, v = np.meshgrid(np.arange(W) + 0.5, np.arange(H) + 0.5)
    rays = np.asarray(lens.cam_from_img(np.stack([u, v], -1).reshape(-1, 2)))[:, :2].reshape(H, W, 2)
    for path in (*(tripod / "images").iterdir(), *(tripod / "video_frames_1").iterdir()):
        save(path, seen(rays[..., 0], rays[..., 1]))
    capture = load_capture(tripod)
    K = capture.Ks[0]
    u, v = np.meshgrid(np.arange(capture.width) + 0.5, np.arange(capture.height) + 0.5)
    wanted = seen((u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1])
    found = load_images(capture).data[3, ..., :3] / 255
    assert np.abs(found - wanted)[3:-3, 3:-3].max() < 3 / 255
    written = write_nerfstudio([capture], tmp_path / "out")
    again = load_images(load_capture(written)).data[3, ..., :3] / 255
    np.testing.assert_array_equal(again, found)
    save(tripod / "video_frames_1" / "frame_00003.png", np.zeros((H, W - 2, 3)))
    refused(tripod, "frame_00003.png: is 62×48 pixels, but its camera's pictures are 64×48")


def test_the_published_ground_truth_is_read(tmp_path):
    root = tmp_path / "synthetic" / "mic_3Hz_0_005"
    eye = np.eye(4).tolist()
    for t in range(3):
        for split in ("train", "test"):
            frames = [{"file_path": f"./{split}/r_{i}", "transform_matrix": eye} for i in range(2)]
            (root / f"{t:03d}" / split).mkdir(parents=True)
            file = root / f"{t:03d}" / f"transforms_{split}.json"
            file.write_text(json.dumps({"camera_angle_x": 0.7, "frames": frames}))
            for i in range(2):
                save(root / f"{t:03d}" / split / f"r_{i}.png", np.full((8, 8, 3), 0.0))
        for i in range(2):
            picture = np.full((8, 8, 3), (10 * t + i) / 255)
            save(tmp_path / "mag_50x_test" / "mic" / f"{t:03d}" / f"{i}.png", picture)
    (root / "scene.json").write_text('{"fps": 30}')
    assert magnified_alphas(root) == [50]
    truth = load_capture(root, magnification=50)
    assert (truth.n_timesteps, truth.split) == (3, "test")
    assert load_images(truth).data[:, 0, 0, 0].tolist() == [0, 1, 10, 11, 20, 21]
    (tmp_path / "mag_50x_test/mic/001/1.png").unlink()
    refused(root, "holds 1 pictures, expected 2, one for each test view", magnification=50)
