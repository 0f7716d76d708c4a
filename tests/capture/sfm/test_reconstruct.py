"""tg4mm sfm from photographs, fixed cameras and a video: known cameras come back, up to a similarity."""

import json
import shutil

import numpy as np
import pytest
from PIL import Image

from tests.capture.conftest import refused
from tests.capture.sfm.scenes import intrinsics, orbit, picture, save, surface_distance, umeyama
from tests.capture.sfm.videos import still
from tg4mm.capture import load_capture, load_images
from tg4mm.capture.cameras import optical_axes
from tg4mm.capture.sfm.clip import find_sources
from tg4mm.capture.sfm.config import open_request
from tg4mm.capture.sfm.reconstruct import SfmConfig, reconstruct
from tg4mm.cli import main
from tg4mm.core.errors import RunError, Tg4mmError

pytest.importorskip("pycolmap")
SIZE, FOCAL, BEND = (240, 180), 250.0, 0.35
N = 12


def shoot(path, viewmat, k1=BEND, plain=False):
    save(path, picture(viewmat, intrinsics(*SIZE, FOCAL), SIZE, k1, plain))


@pytest.fixture(scope="module")
def cameras():
    return orbit(N, turn=2.4)


@pytest.fixture(scope="module")
def photographs(tmp_path_factory, cameras):
    folder = tmp_path_factory.mktemp("photographs")
    for i, viewmat in enumerate(cameras):
        shoot(folder / f"p_{i}.png", viewmat)
    return folder


@pytest.fixture(scope="module")
def dataset(tmp_path_factory, photographs):
    out = tmp_path_factory.mktemp("sfm") / "box"
    report = reconstruct(photographs, out, SfmConfig(), threads=1)
    assert (report["pictures"], report["placed"]) == (N, N)
    return out


def aligned(capture, cameras):
    """The similarity from the dataset's world to the true one, and the largest error of a camera's place."""
    ours, _ = optical_axes(capture.viewmats)
    true, _ = optical_axes(cameras)
    scale, rotation, shift = umeyama(ours, true)
    error = np.linalg.norm(scale * ours @ rotation.T + shift - true, axis=1).max()
    return scale, rotation, shift, float(error)


def test_cameras_come_back_up_to_a_similarity(dataset, cameras):
    capture = load_capture(dataset)
    assert [path.name for path in capture.paths] == [f"p_{i}.png" for i in range(N)]
    _, rotation, _, error = aligned(capture, cameras)
    assert error < 0.03  # of a distance of 4: 0.7 %
    turn = capture.viewmats[:, :3, :3] @ rotation.T @ np.swapaxes(cameras[:, :3, :3], 1, 2)
    degrees = np.degrees(np.arccos(np.clip((np.trace(turn, axis1=1, axis2=2) - 1) / 2, -1, 1)))
    # of eight random textures one turned the first camera, which has neighbours on one side alone, by 1.3 degrees
    assert np.median(degrees) < 0.6
    assert degrees.max() < 2
    # in the wrong order they do not
    assert aligned(capture, cameras[::-1])[3] > 0.5


def test_points_lie_on_the_surface(dataset, cameras):
    capture = load_capture(dataset)
    scale, rotation, shift, _ = aligned(capture, cameras)
    distance = surface_distance(scale * capture.points.xyz @ rotation.T + shift)
    assert len(distance) > 200
    assert np.median(distance) < 0.02  # .004 to .018 with eight random textures
    assert np.quantile(distance, 0.9) < 0.05


def test_the_lens_is_found_and_the_pictures_are_straight(dataset, cameras):
    """A pinhole with the written intrinsics sees at the true pose what the written picture shows."""
    capture = load_capture(dataset)
    K = capture.Ks[0]
    assert K[0, 0] == pytest.approx(FOCAL, rel=0.05)  # its deviation over eight random textures is 1.2 %
    assert (capture.width, capture.height) != SIZE
    images = load_images(capture)
    for i in (0, 5):
        true = picture(cameras[i], capture.Ks[i], (capture.width, capture.height))
        solid = true[..., 3] == 255
        difference = np.abs(images.data[i].astype(int) - true.astype(int))[solid][:, :3]
        raw = np.asarray(Image.open(capture.root / "sfm/images/photographs" / f"p_{i}.png"))
        bent = raw[: capture.height, : capture.width].astype(int)
        assert difference.mean() < 0.5 * np.abs(bent - true[..., :3])[solid].mean()


def test_a_stopped_one_goes_on_to_the_same_dataset(dataset, photographs, tmp_path):
    out = tmp_path / "box"
    shutil.copytree(dataset, out)
    for path in ("scene.json", "transforms_train.json", "points3d.ply", "train/p_3.png"):
        (out / path).unlink()
    shutil.rmtree(out / "sfm" / "sparse")
    (out / ".scene.json.node7-1.tmp").write_text("half")
    reconstruct(photographs, out, SfmConfig(), threads=1)
    for path in ("scene.json", "transforms_train.json", "points3d.ply", "train/p_3.png"):
        expected = (dataset / path).read_bytes()
        assert (out / path).read_bytes() == expected, path  # one thread, one seed: bit for bit


def test_another_request_in_the_same_folder_is_refused(dataset, photographs, tmp_path):
    opencv, other = SfmConfig(camera_model="OPENCV"), tmp_path / "other"
    said = 'was made with camera_model = "SIMPLE_RADIAL", not "OPENCV"'
    refused(lambda: reconstruct(photographs, dataset, opencv), said)
    shutil.copytree(photographs, other)
    refused(lambda: reconstruct(other, dataset), "was made of other pictures, or they have changed")
    refused(lambda: reconstruct(photographs, other), "holds p_0.png; expected a new or empty folder")


def test_a_baseline_gives_the_scale_later(dataset, photographs, tmp_path):
    out = tmp_path / "box"
    shutil.copytree(dataset, out)
    reconstruct(photographs, out, SfmConfig(baseline=("p_0", "p_3.png", 2.0)), threads=1)
    capture = load_capture(out)
    centres, _ = optical_axes(capture.viewmats)
    assert capture.unit_scale_m == pytest.approx(2.0 / np.linalg.norm(centres[0] - centres[3]))
    with pytest.raises(Tg4mmError, match="names p_99, which is not a placed camera; there are p_0"):
        reconstruct(photographs, out, SfmConfig(baseline=("p_0", "p_99", 2.0)), threads=1)


@pytest.mark.parametrize(
    ("config", "match"),
    [
        (SfmConfig(camera_model="FISH"), "--camera-model is FISH, expected SIMPLE_PINHOLE, "),
        (SfmConfig(focal_px=-3.0), "--focal-px is -3.0, expected a finite number above 0"),
        (SfmConfig(kind="drone"), "--kind is drone, expected photos, flat, tripod"),
        (SfmConfig(kind="rig"), "--kind is rig, but .* holds 12 photographs, which can be photos"),
        (SfmConfig(start_s=-1.0), "--from is -1.0, expected a finite number of at least 0"),
        (SfmConfig(start_s=2.0, stop_s=1.5), "--until is 1.5, expected a finite number above 2"),
        (SfmConfig(frames=50), "--frames is 50, but there is no video of a moving camera"),
        (SfmConfig(unit_scale_m=1.0, baseline=("a", "b", 1.0)), "cannot be used together"),
        (SfmConfig(synchronous=True), "--synchronous is for the cameras of a rig, but .* holds 12 photogr"),
        (SfmConfig(test_every=1), "--test-every is 1, expected 0, or a whole number of at least 2"),
        (SfmConfig(baseline=("a", "b", float("nan"))), "--baseline is nan"),
    ],
)
def test_bad_settings_are_refused_before_anything_is_made(photographs, tmp_path, config, match):
    with pytest.raises(Tg4mmError, match=match):
        reconstruct(photographs, tmp_path / "out", config)
    assert not (tmp_path / "out").exists()


def test_pictures_without_texture_are_refused(tmp_path, cameras):
    for i in range(4):
        save(tmp_path / "in" / f"{i}.png", np.full((60, 80, 4), 90, np.uint8))
    said = "too little texture: 4 of 4 pictures have fewer than 20 features, "
    refused(lambda: reconstruct(tmp_path / "in", tmp_path / "out", threads=1), said)


def test_a_picture_of_something_else_is_left_out_and_named(tmp_path, photographs, cameras):
    folder = tmp_path / "in"
    folder.mkdir()
    for i in range(6):
        shutil.copy(photographs / f"p_{i}.png", folder / f"p {i}.png")
    rng = np.random.default_rng(0)
    noise = Image.fromarray(rng.integers(0, 256, (18, 24, 3), np.uint8))
    noise.resize(SIZE, Image.Resampling.BICUBIC).save(folder / "an odd ä.png")
    said = r"1 pictures could not be placed and are left out: photographs/an odd ä.png"
    with pytest.warns(UserWarning, match=said):
        report = reconstruct(folder, tmp_path / "out", threads=1)
    assert (report["pictures"], report["placed"]) == (7, 6)
    assert [p.name for p in load_capture(tmp_path / "out").paths] == [f"p {i}.png" for i in range(6)]


@pytest.fixture(scope="module")
def fixed(tmp_path_factory, cameras):
    """Three fixed cameras far apart, six frames each, and a sweep between them."""
    folder = tmp_path_factory.mktemp("fixed")
    for k, i in enumerate((0, 5, 10)):
        for t in range(6):
            pixels = picture(cameras[i], intrinsics(*SIZE, FOCAL), SIZE)
            noise = np.random.default_rng(t).integers(-3, 4, pixels.shape)
            noise[..., 3] = 0
            save(folder / f"cam_{k}" / f"{t:04d}.png", np.clip(pixels + noise, 0, 255).astype(np.uint8))
    for i, viewmat in enumerate(cameras):
        shoot(folder / "sweep" / f"{i:03d}.png", viewmat + 1e-3, k1=0.0)
    return folder


def test_fixed_cameras_become_a_tree_with_one_pose_each(fixed, tmp_path, cameras):
    out = tmp_path / "box_5Hz"
    arguments = ["sfm", str(fixed), "--out", str(out), "--fps", "30", "--threads", "1"]
    arguments += ["--camera-model", "SIMPLE_PINHOLE", "--focal-px", "240", "--unit-scale-m", "0.5"]
    assert main(arguments) == 0
    capture = load_capture(out)
    assert (capture.kind, capture.fps, capture.n_timesteps, capture.unit_scale_m) == ("rig", 30.0, 6, 0.5)
    assert capture.clocks == "independent"  # nobody said --synchronous
    names = [path.relative_to(out).as_posix() for path in capture.paths]
    cameras_of = [[f"{t:03d}/train/cam_{k}.png" for k in range(3)] for t in range(6)]
    assert names == [
        *cameras_of[0],
        *(f"000/train/sweep_{i:03d}.png" for i in range(N)),
        *(name for names in cameras_of[1:] for name in names),
    ]
    assert capture.camera_ids[-15:].tolist() == [0, 1, 2] * 5
    assert np.isnan(capture.times_s[3 : 3 + N]).all()
    np.testing.assert_allclose(capture.times_s[-15:], np.repeat(np.arange(1, 6), 3) / 30)
    assert (out / "001/train/cam_1.png").read_bytes() == (fixed / "cam_1/0001.png").read_bytes()
    ours, _ = optical_axes(capture.viewmats[:3])
    true, _ = optical_axes(cameras[[0, 5, 10]])
    ratio = [np.linalg.norm(c[0] - c[1]) / np.linalg.norm(c[1] - c[2]) for c in (ours, true)]
    assert ratio[0] == pytest.approx(ratio[1], rel=0.01)


def test_too_few_fixed_cameras_that_can_be_placed_are_an_error(fixed, tmp_path):
    folder = tmp_path / "in"
    shutil.copytree(fixed, folder)
    shutil.rmtree(folder / "cam_0")
    for t, pixels in enumerate(still(6, size=SIZE)):  # of something else
        Image.fromarray(pixels).save(folder / "cam_1" / f"{t:04d}.png")
    said = "1 of 2 pictures could not be placed: cameras/cam_1.png; a sweep/"
    refused(lambda: reconstruct(folder, tmp_path / "out", SfmConfig(fps=30.0), threads=1), said)


def test_a_test_split_is_held_out(dataset, photographs, tmp_path):
    out = tmp_path / "box"
    shutil.copytree(dataset / "sfm", out / "sfm")
    request = json.loads((out / "sfm/request.json").read_text())
    request["settings"]["test_every"] = 4
    (out / "sfm/request.json").write_text(json.dumps(request))
    reconstruct(photographs, out, SfmConfig(test_every=4), threads=1)
    assert [p.stem for p in load_capture(out, "test").paths] == ["p_2", "p_6", "p_10"]
    assert len(load_capture(out)) == N - 3


def test_two_processes_do_not_make_one_dataset(photographs, tmp_path):
    sources = find_sources(photographs)
    work = open_request(tmp_path / "out", sources, SfmConfig().settings())
    with work.owned.locked("busy"), pytest.raises(RunError, match="in use: another process makes this"):
        reconstruct(photographs, tmp_path / "out", SfmConfig(), threads=1)
