"""benchmarks/fox_phone.py: figures that know a right answer from a wrong one, on a small truth of our own."""

import json

import numpy as np
import pytest
import torch
from PIL import Image

from benchmarks.__main__ import main
from benchmarks.fox_phone import FoxTruth, WorldAlignment, comparison, scored, similarity
from tg4mm.core.files import write_json
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion import ModalMotion
from tg4mm.run import Run

F1, F2, FPS, T = 3.4, 7.0, 30.0, 30
SIZE = 64
K = np.array([[80.0, 0, 32], [0, 80.0, 32], [0, 0, 1]])


def rotation(rng):
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


def poses(rng, count):
    """[count, 4, 4] camera-to-world, some 2 units before the plane z = 0, looking at it."""
    c2w = np.tile(np.eye(4), (count, 1, 1))
    c2w[:, :3, 3] = np.column_stack([rng.uniform(-0.2, 0.2, (count, 2)), -2 + rng.uniform(-0.1, 0.1, count)])
    return c2w


def carried(c2w, world):
    """Camera-to-world of the truth's world in the run's."""
    return np.stack([np.linalg.inv(world.viewmat_of(pose)) for pose in c2w])


@pytest.fixture
def world():
    rng = np.random.default_rng(3)
    return WorldAlignment(1.7, rotation(rng), rng.normal(size=3))


def moving_patch():
    """A true field [20, 20, 2] of which a quarter moves, and its weights."""
    true = np.zeros((20, 20, 2), complex)
    true[:10, :10] = [0.3, 0.4j]
    return true, np.ones((20, 20))


def test_wrong_answers_are_distinguished():
    true, weights = moving_patch()
    small = comparison(0.9 * true, true, weights)
    assert small["error"] == pytest.approx(0.1)
    assert small["amplitude_ratio"] == pytest.approx(0.9)
    leaking = true.copy()
    leaking[10:, 10:] = [0.0, 0.05]
    figures = comparison(leaking, true, weights)
    assert figures["error"] == pytest.approx(0, abs=1e-12)
    assert figures["leak"] == pytest.approx(0.1 * np.sqrt(1 / 3))
    assert figures["mac"] < 0.995
    across = comparison(true[..., ::-1] * [1, -1], true, weights)
    assert across["direction_deg"] > 10
    nothing = comparison(0 * true, true, weights)
    assert nothing["error"] == pytest.approx(1)
    assert nothing["direction_deg"] == 90


def test_similarity_is_found_from_poses(world):
    rng = np.random.default_rng(1)
    true = poses(rng, 6)
    true[:, :3, :3] = [rotation(rng) for _ in true]
    found = similarity(carried(true, world), true)
    assert found.scale == pytest.approx(world.scale)
    assert np.allclose(found.rotation, world.rotation)
    assert np.allclose(found.shift, world.shift)
    with pytest.raises(ValueError, match="one place"):
        similarity(np.tile(np.eye(4), (3, 1, 1)), true[:3])


# A whole run.


def write_truth(folder):
    """A plate of 24 × 24 points whose middle moves up at the one frequency, whose left edge out at the other."""
    rng = np.random.default_rng(5)
    side = np.linspace(-0.7, 0.7, 24)
    x, y = (a.ravel() for a in np.meshgrid(side, side))
    # Uneven: the order in depth is no matter of rounding.
    means = np.stack([x, y, rng.uniform(-0.02, 0.02, len(x))], 1)
    first, second = np.zeros_like(means), np.zeros_like(means)
    first[:, 1] = 0.01 * np.exp(-(x**2 + y**2) / 0.1) * (x**2 + y**2 < 0.25)
    second[:, 2] = 0.02 * np.clip(-x - 0.4, 0, None)
    folder.mkdir()
    arrays = {"means": means, "opacities": np.full(len(means), 0.95, np.float32)}
    np.savez(folder / "gauss.npz", shape_3_4Hz=first, shape_7Hz=second, **arrays)
    sweep = poses(rng, 6)
    values = {
        "f_hz": [F1, F2], "fps": FPS, "K": K.tolist(), "W": SIZE, "H": SIZE,
        "cams_sweep": sweep.tolist(), "c2w_fixed": sweep[2].tolist(), "c2w_novel": sweep[3].tolist(),
        "clips": {"cams": [0, 1, 2], "phases": [0.0, 1.0, 2.0]}, "hand": poses(rng, T).tolist(),
    }  # fmt: skip
    (folder / "truth.json").write_text(json.dumps(values))
    return FoxTruth.load(folder)


def write_tripod(folder, truth, world):
    """A tripod's dataset in the run's world: photographs 0, 1, 3 and one fixed camera, all white."""
    white = Image.fromarray(np.full((SIZE, SIZE, 3), 255, np.uint8))
    values = truth.values
    for t in range(T):
        places = {"cam_00": values["c2w_fixed"]}
        if t == 0:
            places |= {f"{i:03d}": values["cams_sweep"][i] for i in (0, 1, 3)}
        frames = []
        for name, pose in places.items():
            moved = np.linalg.inv(world.viewmat_of(np.array(pose))) @ np.diag([1.0, -1.0, -1.0, 1.0])
            record = {"file_path": f"./train/{name}.png", "transform_matrix": moved.tolist()}
            record |= {"w": SIZE, "h": SIZE}
            record |= {"fl_x": K[0, 0], "fl_y": K[1, 1], "cx": K[0, 2], "cy": K[1, 2]}
            frames.append(record | ({"time": t / FPS} if name == "cam_00" else {}))
            file = folder / f"{t:03d}" / "train" / f"{name}.png"
            file.parent.mkdir(parents=True, exist_ok=True)
            white.save(file)
        write_json(folder / f"{t:03d}" / "transforms_train.json", {"frames": frames})
    write_json(folder / "scene.json", {"format_version": 1, "kind": "tripod", "fps": FPS, "n_timesteps": T})


def write_run(folder, dataset, truth, world, gain):
    """Gaussians at the truth's means in the run's world, moving `gain` times as they should at the first frequency."""
    run = Run.create(folder, dataset, "modal", {})
    n = len(truth.means)
    means = (truth.means - world.shift) @ world.rotation / world.scale
    means_t = torch.from_numpy(means).float()
    quats, scales = torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(n, 1), torch.full((n, 3), 0.03 / world.scale)
    run.save_space(Gaussians(means_t, quats, scales, torch.full((n,), 0.95), torch.zeros(n, 1, 3)), {})
    modes = world.vectors_to_run(truth.phasors(truth.means))
    modes[0] *= gain
    freqs = np.array([F1, F2])
    motion = ModalMotion.of_phasors(
        freqs, modes.astype(np.complex64), np.zeros((2, n, 3), np.complex64), FPS, T
    )
    run.save_motion(motion, {"clip_phases_deg": {"cam_00": {"3.4": 0.0}, "cam_01": {"3.4": np.degrees(1.0)}}})
    return run


def test_an_exact_run_in_a_world_of_its_own_scores_no_error(tmp_path, world):
    truth = write_truth(tmp_path / "truth")
    write_tripod(tmp_path / "set", truth, world)
    run = write_run(tmp_path / "run", tmp_path / "set", truth, world, 1.0)
    figures = scored(run, truth, pictures=False)
    assert figures["scale"] == pytest.approx(world.scale)
    assert figures["camera_rms"] < 1e-9
    assert figures["false_peaks"] == []
    for row in figures["frequencies"]:
        assert row["found"]
        assert row["picture"]["error"] < 1e-3
        assert row["space"]["error"] < 1e-3
        assert row["space"]["mac"] == pytest.approx(1, abs=1e-5)
        assert row["picture"]["phase_deg"] == pytest.approx(0, abs=0.1)
    assert figures["clip_phases"][0]["errors_deg"] == pytest.approx({"cam_00": 0, "cam_01": 0}, abs=1e-6)


def test_a_wrong_run_is_scored_as_wrong_as_it_is(tmp_path, world, capsys):
    truth = write_truth(tmp_path / "truth")
    write_tripod(tmp_path / "set", truth, world)
    write_run(tmp_path / "run", tmp_path / "set", truth, world, 0.8 * np.exp(0.5j))
    out = tmp_path / "scores.json"
    arguments = [
        "fox_phone", str(tmp_path / "run"), "--truth", str(tmp_path / "truth"), "--out", str(out),
        "--no-pictures",
    ]  # fmt: skip
    assert main(arguments) == 0
    row = json.loads(out.read_text())["frequencies"][0]
    for name in ("picture", "space"):
        assert row[name]["error"] == pytest.approx(0.2, abs=0.01)
        assert row[name]["amplitude_ratio"] == pytest.approx(0.8, abs=0.01)
        assert row[name]["phase_deg"] == pytest.approx(np.degrees(0.5), abs=0.5)
    assert "3.4 Hz: found" in capsys.readouterr().out


def test_a_run_that_is_none_ends_in_one_line(tmp_path, capsys):
    assert main(["fox_phone", str(tmp_path / "nowhere"), "--truth", str(tmp_path)]) == 2
    assert capsys.readouterr().err.count("\n") == 1
