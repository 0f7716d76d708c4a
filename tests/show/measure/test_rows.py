"""Rows that are read one after another: of a pole that sways as a whole, every height has the same phase."""

import json
from fractions import Fraction

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import gaussian_filter, map_coordinates

from tests.capture.sfm.videos import write_video
from tests.show.measure.filmed import FPS, model, modes, of_parts, pictures, run_of, sine
from tg4mm.cli import main
from tg4mm.core.errors import RunError
from tg4mm.show.measure import measure, parse_sensor, prepare
from tg4mm.show.result.reading import reading_of

HZ = 6.0


def read_by_rows(run, move, readout_s, in_turn=4):
    """The pictures of the run's dataset anew, each `in_turn` rows at their own time."""
    rng = np.random.default_rng(1)
    for folder in sorted(p for p in run.dataset.iterdir() if p.name.isdecimal()):
        frames = json.loads((folder / "transforms_train.json").read_text())["frames"]
        poses = (np.array(f["transform_matrix"]) @ np.diag([1.0, -1.0, -1.0, 1.0]) for f in frames)
        viewmats = [np.linalg.inv(pose) for pose in poses]
        shown = None
        for top in range(0, 48, in_turn):
            t = int(folder.name) / FPS + readout_s * ((top + in_turn / 2) / 48 - 0.5)
            whole = pictures(model(), move(t), np.stack(viewmats), 0.002, rng)
            shown = whole if shown is None else shown
            shown[:, top : top + in_turn] = whole[:, top : top + in_turn]
        for frame, picture in zip(frames, shown, strict=True):
            Image.fromarray(picture).save(folder / f"{frame['file_path']}.png", compress_level=1)


def say_readout(dataset, readout_s):
    path = dataset / "scene.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"readout_s": readout_s}))


def phases(found, names):
    """Degrees after the first sensor of motion along the picture's rows at HZ, on the clock of their own times."""
    out = []
    for name in names:
        series = found[name].series
        turning = np.exp(-2j * np.pi * HZ * series.times_s) * np.hanning(len(series.times_s))
        right = np.argmax((series.displacement**2).sum(0))
        out.append((turning * series.displacement[:, right]).sum())
    return np.degrees(np.angle(np.array(out) / out[0]))


@pytest.mark.parametrize("views", [1, 4])
def test_every_height_of_a_swaying_post_has_one_phase_where_the_readout_is_given(tmp_path, views):
    """Before one flat camera each region has its own rows' times; before a rig all have the middle row's."""
    readout_s, sway = 0.03, sine(HZ, [0.02, 0.0, 0.0])
    move = of_parts(post=sway, ball=sway)
    kind = {"kind": "flat"} if views == 1 else {}
    run = run_of(tmp_path, move, n_views=views, n_timesteps=60, **kind)
    read_by_rows(run, move, readout_s)
    heights = [0.3, 0.6, 0.9, 1.2]
    sensors = [parse_sensor(f"z{k}=box:-0.6,-0.25,{z},-0.1,0.25,{z + 0.25}") for k, z in enumerate(heights)]
    names = [s.name for s in sensors]
    without = phases(measure(prepare(run, keep=False), sensors), names)
    assert np.ptp(without) > 8
    say_readout(run.dataset, readout_s)
    with pytest.raises(RunError, match=r"trained with a readout of 0 ms, but .* says 30 ms: train again"):
        prepare(run, keep=False)
    with pytest.raises(RunError, match="trained with a readout of 0 ms"):
        reading_of(run)
    run.save_motion(modes({}, 60), {"readout_s": readout_s})
    found = measure(prepare(run, keep=False), sensors)
    assert np.ptp(phases(found, names)) < 4
    late = [float(found[n].times_s[0]) for n in names]
    if views == 1:
        assert (np.diff(late) < -1e-3).all()
        assert without == pytest.approx(360 * HZ * (np.array(late) - late[0]), abs=4)
    else:
        assert not any(late)


def pole(path, readout_s):
    """Three seconds of 96×160 pixels: a textured pole of full height sways by .3 px before a still wall."""
    rng, (width, height) = np.random.default_rng(0), (96, 160)
    y, x = np.mgrid[:height, :width].astype(float)
    wall, bar = (gaussian_filter(rng.normal(size=y.shape), sigma) for sigma in (2.0, 1.2))
    wall, bar = 140 + 15 * wall / wall.std(), 110 + 25 * bar / bar.std()
    frames = []
    for k in range(90):
        t = k / 30 + readout_s * ((y[:, :1] + 0.5) / height - 0.5)
        shift = 0.3 * np.sin(2 * np.pi * HZ * t)
        inside = 1 / (1 + np.exp(-2 * (14 - np.abs(x - shift - 48))))
        grey = wall * (1 - inside) + map_coordinates(bar, [y, x - shift], order=3, mode="nearest") * inside
        noisy = grey + rng.normal(0, 2, grey.shape)
        frames.append(np.clip(noisy, 0, 255).astype(np.uint8)[..., None].repeat(3, 2))
    return write_video(path, frames, Fraction(30), crf=4)


@pytest.mark.slow
@pytest.mark.parametrize(("given", "least", "most"), [("20", 0, 5), ("", 9, 20)])
def test_a_film_of_a_swaying_pole_is_measured_by_row_times(tmp_path, given, least, most):
    """20 ms are 43° at 6 Hz: between heights 12 and 148 of 160, 37°, which is 12° rms."""
    video = pole(tmp_path / "pole.mp4", 0.02)
    asked = ["--readout", given] if given else []
    assert main(["sfm", str(video), "--out", str(tmp_path / "set"), "--kind", "flat", *asked]) == 0
    assert main(["train", str(tmp_path / "set"), "--out", str(tmp_path / "run")]) == 0
    heights = np.linspace(12, 148, 9).round().astype(int)
    sensors = [word for y in heights for word in ("--sensor", f"p{y}=pixel:pole,48,{y},7")]
    out = tmp_path / "measured"
    assert main(["measure", str(tmp_path / "run"), *sensors, "--no-animate", "--out", str(out)]) == 0
    found = []
    for sensor in json.loads((out / "measure.json").read_text())["sensors"]:
        times = np.array(sensor["series"][0]["times_s"])
        right = np.array(sensor["series"][0]["displacement"])[:, 0]
        found.append(np.degrees(np.angle((np.exp(-2j * np.pi * HZ * times) * right).sum())))
    off = np.array(found) + 90  # a sine
    assert least <= float(np.sqrt((off**2).mean())) < most
    if not given:
        assert np.ptp(off) == pytest.approx(360 * HZ * 0.02 * 136 / 160, abs=6)
