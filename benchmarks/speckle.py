"""A speckle plate that moves by a twentieth of a pixel: our sensor beside pyidi's Lucas–Kanade on the same frames.

python -m benchmarks speckle make data/speckle            # 96×96, 60 frames, a flat capture; and frames.npz
tg4mm train data/speckle --out runs/speckle
python -m benchmarks speckle pyidi data/speckle           # needs pyidi, in an environment of its own; pyidi.npz
python -m benchmarks speckle compare runs/speckle data/speckle
"""

import argparse
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np

SIZE, FRAMES, FPS, NOISE = 96, 60, 30.0, 0.008
AMPLITUDE_PX, HZ = (0.05, 0.02), (4.3, 4.3)  # right, down
PLATE = (24.0, 24.0, 72.0, 72.0)  # the plate moves, the wall behind it does not
AT, RADIUS = (48.0, 48.0), 12.0  # what is compared


def shifts() -> np.ndarray:
    """[T, 2] pixels, right and down."""
    times = np.arange(FRAMES)[:, None] / FPS
    return np.array(AMPLITUDE_PX) * np.sin(2 * np.pi * np.array(HZ) * times + [0.3, 1.0])


def frames() -> np.ndarray:
    """[T, H, W] uint8: blurred speckles, drawn at exact places, with noise of a sensor."""
    rng = np.random.default_rng(0)
    places = rng.uniform(-4, SIZE + 4, (1400, 2))
    heights = rng.uniform(0.15, 0.5, 1400) * rng.choice([-1, 1], 1400)
    inside = ((places > PLATE[:2]) & (places < PLATE[2:])).all(1)
    y, x = np.mgrid[:SIZE, :SIZE] + 0.5
    out = np.empty((FRAMES, SIZE, SIZE), np.uint8)
    for t, shift in enumerate(shifts()):
        at = places + inside[:, None] * shift
        near = np.exp(-((x[..., None] - at[:, 0]) ** 2 + (y[..., None] - at[:, 1]) ** 2) / (2 * 1.3**2))
        picture = 0.5 + near @ heights + NOISE * rng.normal(size=(SIZE, SIZE))
        out[t] = (picture.clip(0, 1) * 255 + 0.5).astype(np.uint8)
    return out


def make(out: Path) -> None:
    """The dataset of the frames, as `tg4mm sfm` writes a flat capture, and frames.npz."""
    from PIL import Image

    video = frames()
    c2w = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])  # looks along +y, OpenGL axes
    for t, picture in enumerate(video):
        folder = out / f"{t:03d}" / "train"
        folder.mkdir(parents=True)
        Image.fromarray(picture).convert("RGB").save(folder / "cam_00.png")
        frame = {"file_path": "./train/cam_00", "transform_matrix": c2w.tolist(), "time": t / FPS}
        values = {"camera_angle_x": 2 * float(np.arctan(0.5)), "frames": [frame]}
        (folder.parent / "transforms_train.json").write_text(json.dumps(values))
    (out / "scene.json").write_text(json.dumps({"fps": FPS, "kind": "flat", "unit_scale_m": None}))
    np.savez(out / "frames.npz", frames=video)


def by_pyidi(data: Path) -> None:
    """pyidi.npz: `series` [T, 2] pixels, right and down, of one subset as large as our region."""
    from pyidi import LucasKanade, VideoReader

    video = np.load(data / "frames.npz")["frames"]
    method = LucasKanade(VideoReader(video, root=str(data), fps=FPS))
    side = round(RADIUS * float(np.sqrt(np.pi))) // 2 * 2 + 1
    method.set_points(np.array([[AT[1] - 0.5, AT[0] - 0.5]]))
    method.configure(roi_size=(side, side), verbose=0, show_pbar=False)
    found = np.asarray(method.get_displacements())[0]
    np.savez(data / "pyidi.npz", series=found[:, ::-1])


def compare(run: Path, data: Path) -> None:
    """Print both series' errors, and how many samples of ours lie within their deviation."""
    from tg4mm.run import Run
    from tg4mm.show.measure import measure, parse_sensor, prepare

    scene = prepare(Run.open(run), keep=False)
    text = f"plate=pixel:cam_00,{AT[0]:g},{AT[1]:g},{RADIUS:g}"
    result = measure(scene, [parse_sensor(text)])["plate"]
    ours = result.displacement[:, :2] * result.px_per_unit * [1, -1]
    deviation = result.deviation[:, :2] * result.px_per_unit
    noise = result.series.noise[:, :2] * result.px_per_unit
    truth = shifts() - shifts().mean(0)
    theirs = np.load(data / "pyidi.npz")["series"]
    theirs = theirs - theirs.mean(0)
    print(
        f"rms error, px: ours {_rms(ours - truth)}, pyidi {_rms(theirs - truth)}; between them {_rms(ours - theirs)}"
    )
    print(f"our deviation, px: {_rms(deviation)}, of it noise {_rms(noise)}")
    print(f"within one deviation: {(np.abs(ours - truth) < deviation).mean():.2f}")
    for peak in result.spectrum.peaks:
        amplitude = peak.amplitude * result.px_per_unit
        found = f"{peak.frequency_hz:.4f} ± {peak.frequency_deviation_hz:.4f} Hz, {amplitude[:2].round(4)} px"
        print(f"{found}; truth {HZ[0]} Hz, {AMPLITUDE_PX}")


def _rms(values: np.ndarray) -> str:
    return ", ".join(f"{v:.5f}" for v in np.sqrt((values**2).mean(0)))


OPTIONS = {"command": {"choices": ["make", "pyidi", "compare"]}, "paths": {"nargs": "+", "type": Path}}


def run(options: argparse.Namespace) -> None:
    """Do one of the three steps."""
    steps: dict[str, Callable] = {"make": make, "pyidi": by_pyidi, "compare": compare}
    steps[options.command](*options.paths)
