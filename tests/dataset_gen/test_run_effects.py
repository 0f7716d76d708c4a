"""Whole, tiny runs with capture kinds and effects: what lies on disk, what the truth says, going on, mending."""

import io
import json
import os

import numpy as np
import pytest
from PIL import Image

pytest.importorskip("bpy")
pytest.importorskip("OpenEXR")

from dataset_gen.cameras import cameras_at, clock_offsets
from dataset_gen.effects import RecordingEffects
from dataset_gen.effects.codec import encode
from dataset_gen.options import parser, request_from
from dataset_gen.plan import UNCODED
from dataset_gen.prepare import builtin_bodies, motion_of, plan
from dataset_gen.run import finish_parts, generate, missing_files, prepare_parts, render_part
from dataset_gen.truth import read_exr

TINY = "--size 32 --timesteps 5 --test-views 1 --alphas 20 --samples 2 --points 200 --truth none"
EVERY = (
    "--background white --shake 0.5 --exposure-drift 5 --flicker 2 "
    "--sensor phone --jpeg 0 --codec h264 --keep-video"
)


def tiny(*more):
    arguments = " ".join(["mic --out x", TINY, *more]).split()
    return request_from(parser().parse_args(arguments)).sets[0]


def made(folder, *more):
    return generate(tiny(*more), folder, 1, io.StringIO())


def pixels(path):
    return np.asarray(Image.open(path)).astype(float)


def frames(root, timestep, split="train"):
    return json.loads((root / f"{timestep:03d}/transforms_{split}.json").read_text())["frames"]


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    return made(tmp_path_factory.mktemp("plain"), "--views 3 --background white --samples 16")


@pytest.fixture(scope="module")
def every(tmp_path_factory):
    return made(tmp_path_factory.mktemp("every"), "--views 3", EVERY)


@pytest.mark.slow
def test_a_tripods_sweep_shows_the_scene_at_rest(tmp_path):
    root = made(tmp_path, "--cameras sweep --views 2 --motion", str(_cosine(tmp_path)))
    scene = json.loads((root / "scene.json").read_text())
    assert (scene["kind"], scene["n_at_rest"], scene["n_train"]) == ("tripod", 2, 3)
    first = frames(root, 0)
    assert ["time" in frame for frame in first] == [True, False, False]
    assert [frame["time"] for t in range(1, 5) for frame in frames(root, t)] == pytest.approx(
        [t / 30 for t in range(1, 5)]
    )
    job = plan(tiny("--cameras sweep --views 2 --motion", str(tmp_path / "m.yaml")), tmp_path)
    states = {p.path: shot.state for shot in job.shots for p in shot.pictures}
    assert states["000/train/r_001.png"].at_rest
    assert not states["000/train/r_000.png"].at_rest  # the motion is at its peak at timestep 0


def _cosine(folder):
    path = folder / "m.yaml"
    mode = "name: a, kind: translate, frequency: 3, amplitude: 0.05, direction: [1, 0, 0], phase: 90"
    path.write_text(f"modes:\n  - {{{mode}}}\n")
    return path


@pytest.mark.slow
def test_cameras_with_clocks_of_their_own_show_the_scene_at_their_own_times(tmp_path):
    options = "--cameras rig --views 3 --clock-offsets 0.3"
    root = made(tmp_path, options)
    truth = json.loads((root / "truth/cameras.json").read_text())
    assert json.loads((root / "scene.json").read_text())["clocks"] == "independent"
    settings = plan(tiny(options), tmp_path).settings
    offsets = clock_offsets(settings.cameras)
    assert [camera["clock_offset_s"] for camera in truth["cameras"].values()] == list(offsets)
    assert [frame["time"] for frame in frames(root, 2)] == pytest.approx([2 / 30] * 3)  # on their own clocks
    motion = motion_of(settings, builtin_bodies("mic"))
    states = {p.path: s.state for s in plan(tiny(options), tmp_path).shots for p in s.pictures}
    for i, offset in enumerate(offsets):
        seen = states[f"002/train/r_{i:03d}.png"].gains[0]
        assert seen == pytest.approx(np.sin(2 * np.pi * 5 * (2 / 30 + offset)), abs=1e-8)
        ahead = truth["cameras"][f"r_{i:03d}"]["phases_rad"][0]
        assert seen == pytest.approx(np.sin(2 * np.pi * 5 * 2 / 30 + ahead), abs=1e-8)
    assert states["002/test/r_000.png"] == motion.state(2)


def test_the_whole_tree_with_every_effect(every):
    found = {str(p.relative_to(every)) for p in every.rglob("*") if p.is_file()}
    found = {name for name in found if not name.startswith("report/")}
    expected = {"scene.json", "points3d.ply", "truth/motion.npz", "truth/cameras.json"}
    for t in range(5):
        expected |= {f"{t:03d}/transforms_{s}.json" for s in ("train", "test")}
        expected |= {f"{t:03d}/train/r_{i:03d}.png" for i in range(3)} | {f"{t:03d}/test/r_000.png"}
        expected |= {f"magnified/x020/{t:03d}/{n}" for n in ("transforms_test.json", "test/r_000.png")}
    expected |= {f"video/r_{i:03d}.mp4" for i in range(3)}
    assert found == expected
    scene = json.loads((every / "scene.json").read_text())
    assert scene["effects"] == {
        "shake_px": 0.5, "exposure_drift": 5.0, "flicker": 2.0, "flicker_hz": 100.0, "codec": "h264", "crf": 20,
        "keep_video": True,
    }  # fmt: skip


def test_the_pose_file_has_the_nominal_pose_and_the_truth_the_true_one(every):
    truth = json.loads((every / "truth/cameras.json").read_text())
    assert len(truth["frames"]) == 15
    nominal = cameras_at(tiny("--views 3").cameras, 0)["train"]
    turned = []
    for t in range(5):
        for frame, camera in zip(frames(every, t), nominal, strict=True):
            pose = np.array(frame["transform_matrix"])
            np.testing.assert_allclose(pose, camera.camera_to_world)
            true = np.array(truth["frames"][f"{t:03d}/train/{camera.name}.png"]["transform_matrix"])
            np.testing.assert_allclose(true[:3, 3], pose[:3, 3])
            np.testing.assert_allclose(true[:3, :3] @ true[:3, :3].T, np.eye(3), atol=1e-12)
            turned.append(np.arccos(np.clip((np.trace(true[:3, :3].T @ pose[:3, :3]) - 1) / 2, -1, 1)))
    assert 1e-3 < np.sqrt(np.mean(np.square(turned))) < 0.05  # half a pixel at a focal length of 44


def test_gains_are_in_the_pictures(tmp_path, plain):
    root = made(tmp_path, "--views 3 --background white --samples 16 --exposure-drift 20 --flicker 5")
    truth = json.loads((root / "truth/cameras.json").read_text())["frames"]
    for t in range(5):
        name = f"{t:03d}/train/r_001.png"
        background = pixels(root / name)[0, 0] / 255.0
        linear = np.where(background <= 0.04045, background / 12.92, ((background + 0.055) / 1.055) ** 2.4)
        np.testing.assert_allclose(linear, truth[name]["gain"], atol=0.006)
    assert (root / "003/test/r_000.png").read_bytes() == (plain / "003/test/r_000.png").read_bytes()
    spread = np.ptp([frame["gain"][1] for frame in truth.values()])
    assert 0.15 < spread < 0.25


@pytest.mark.slow
def test_truth_of_a_shaking_camera_is_what_it_saw_where_it_was(tmp_path):
    root = made(tmp_path, "--views 3 --shake 3 --truth all")
    settings = tiny("--views 3 --shake 3 --truth all")
    record = RecordingEffects(settings.effects, settings.cameras, settings.size, settings.seed)
    camera = cameras_at(settings.cameras, 0)["train"][2]
    seen = [read_exr(root / f"truth/train/{t:03d}/r_002.exr") for t in range(5)]
    row, column = np.nonzero(seen[3]["Depth"] < 1e9)
    points = seen[3]["Position"][row, column].astype(float)
    centres = np.column_stack([column, row]) + 0.5
    true = record.true_camera("train", camera, 3).project(points, 32, 32)[0]
    np.testing.assert_allclose(true, centres, atol=0.02)
    assert np.abs(camera.project(points, 32, 32)[0] - centres).max() > 0.3


@pytest.mark.slow
def test_rows_of_a_rigid_thing_have_the_phases_of_a_readout(tmp_path):
    (tmp_path / "m.yaml").write_text(
        "modes:\n  - {name: a, kind: translate, frequency: 6, amplitude: 0.02, direction: [1, 0, 0]}\n"
    )
    options = (
        f"--cameras flat --readout 20 --flicker 10 --background white --truth all --motion {tmp_path}/m.yaml"
    )
    root = made(tmp_path, options)
    assert json.loads((root / "scene.json").read_text())["readout_s"] == 0.02
    seen = [read_exr(root / f"truth/train/{t:03d}/r_000.exr") for t in range(5)]
    rows = [r for r in range(32) if (seen[0]["Depth"][r] < 1e9).any() and r < 16]  # its head, above the stand
    moved = np.array([[e["Displacement"][r][e["Depth"][r] < 1e9][:, 0].mean() for r in rows] for e in seen])
    turns = 2 * np.pi * 6 * np.arange(5) / 30
    fit = np.linalg.lstsq(np.stack([np.cos(turns), np.sin(turns)], 1), moved, rcond=None)[0]
    phases = np.unwrap(np.arctan2(fit[0], fit[1]))
    readout_s = np.polyfit((np.array(rows) + 0.5) / 32, phases, 1)[0] / (2 * np.pi * 6)
    assert readout_s == pytest.approx(0.02, rel=0.05)
    background = pixels(root / "000/train/r_000.png")[:, 0].mean(-1)  # white, under a lamp of 100 Hz
    assert np.ptp(background) > 5
    assert np.ptp(pixels(root / "000/test/r_000.png")[:, 0]) == 0


@pytest.mark.slow
def test_a_complete_set_is_left_alone_and_a_damaged_one_is_mended(every):
    seen = io.StringIO()
    settings = tiny("--views 3", EVERY)
    generate(settings, every.parent, 1, seen)
    assert seen.getvalue() == ""
    path = every / "003/train/r_001.png"
    whole, other = path.read_bytes(), os.stat(every / "003/train/r_002.png").st_mtime_ns
    path.unlink()
    (every / "video/r_001.mp4").unlink()
    assert missing_files(plan(settings, every.parent)) == ["003/train/r_001.png"]
    generate(settings, every.parent, 1, seen)
    assert path.read_bytes() == whole
    assert os.stat(every / "003/train/r_002.png").st_mtime_ns == other
    assert not (every / UNCODED).exists()


@pytest.mark.slow
def test_a_run_that_was_stopped_before_its_videos_goes_on(every, tmp_path):
    settings = tiny("--views 3", EVERY)
    prepare_parts(settings, tmp_path, 2)
    render_part(settings, tmp_path, (2, 2), 1, io.StringIO())
    render_part(settings, tmp_path, (1, 2), 1, io.StringIO())
    root = plan(settings, tmp_path).root
    assert not (root / "003/train/r_001.png").exists()
    assert (root / UNCODED / "003/train/r_001.png").is_file()
    uncoded = [np.asarray(Image.open(root / UNCODED / f"{t:03d}/train/r_001.png")) for t in range(5)]
    beside, videos = [], set()  # what lies in memory beside a small picture must not be coded
    for n in range(100):
        beside.append(bytes(97 * n))
        videos.add(encode(uncoded, 32, 10.0, 20))
    assert len(videos) == 1
    finish_parts(settings, tmp_path, io.StringIO())
    for name in ("003/train/r_001.png", "video/r_001.mp4", "truth/cameras.json"):
        assert (root / name).read_bytes() == (every / name).read_bytes()


def test_videos_of_a_tripod_lie_as_structure_from_motion_takes_them(tmp_path):
    sources = pytest.importorskip("tg4mm.capture.sfm.clip")
    root = made(tmp_path, "--cameras sweep --views 3 --background white --codec h264 --keep-video")
    names = sorted(str(p.relative_to(root / "video")) for p in (root / "video").rglob("*") if p.is_file())
    assert names == ["r_000.mp4", *(f"sweep/r_{i:03d}.png" for i in (1, 2, 3))]
    assert (root / "video/sweep/r_002.png").read_bytes() == (root / "000/train/r_002.png").read_bytes()
    assert sources.SWEEP == "sweep"


@pytest.mark.slow
def test_noise_of_its_own_and_an_exposure_change_training_pictures_as_they_say(plain, tmp_path):
    """A motion of 5 Hz at 30 Hz is in the same state at timesteps 0 and 3; an exposure shows less motion."""
    options = "--views 1 --background white --samples 16"
    own = made(tmp_path / "own", options, "--noise picture")

    def at(root, timestep):
        return pixels(root / f"{timestep:03d}/train/r_000.png")

    assert (at(plain, 0) == at(plain, 3)).all()
    assert 0 < np.abs(at(own, 0) - at(own, 3)).mean() < 5
    assert json.loads((own / "scene.json").read_text())["noise"] == "picture"
    fast = f"{options} --samples 64 --frequency 12 --amplitude 0.12"
    smeared, sharp = (
        at(root, 1) - at(root, 4)
        for root in (made(tmp_path / "smeared", fast, "--shutter 33"), made(tmp_path / "sharp", fast))
    )
    assert 0.5 < (sharp * smeared).sum() / (sharp**2).sum() < 0.85  # .76, less by noise and by what is hidden
