"""Likes of the paper's real captures, breathing, standing and baby: generated, laid out as 3DMM's, trained, scored.

A person of ellipsoids stands on a floor with crates; everything is textured, the floor and the crates stand still.
Rates, lengths, bands and layouts are those of [TG4MM] section IV and [3DMM]'s real captures, the truth is exact.
"""

import json
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from tg4mm.capture import Capture, load_capture, load_images
from tg4mm.capture.convert import write_colmap
from tg4mm.capture.sfm.clip import save_png
from tg4mm.core.files import write_json
from tg4mm.run import UNCERTAINTY, Run

RADIUS = 1.2  # of the sphere that the generator scales a mesh to
TALL, WIDE = 1.3, 0.75  # of the person, and half the floor, before that
ALPHA = 20

OPTIONS = {
    "out": {"type": Path, "metavar": "DIR"},
    "--likes": {"nargs": "*", "default": ["breathing", "standing", "baby"], "metavar": "NAME"},
    "--size": 96,  # edge of the pictures, pixels
    "--samples": 16,  # light paths a pixel
    "--processes": 1,  # render processes at once
    "--set": {"action": "append", "default": [], "metavar": "KEY=VALUE", "help": "a setting of tg4mm train"},
}


@dataclass(frozen=True)
class Like:
    """A capture of the paper, and what stands for it."""

    timesteps: int
    fps: float  # Hz
    hz: float  # of the motion, inside the band
    band: tuple[float, float]  # Hz
    pixels: float  # largest motion
    cameras: str  # of the generator
    motion: dict[str, Any]  # a mode; lengths before scaling


SWAY = {"kind": "bending", "base": [0, 0, 0], "tip": [0, 0, TALL], "direction": [1.0, 0.0, 0.0]}
BREATH = {"kind": "membrane", "centre": [0, 0.1, 0.85], "normal": [0.35, 0.3, 0.88], "radius": 0.5}
LIKES = {
    "breathing": Like(30, 30, 1.0, (0.8, 1.2), 0.5, "sweep", BREATH),
    "standing": Like(15, 15, 1.0, (0.5, 1.5), 1.0, "sweep", SWAY),
    "baby": Like(60, 30, 0.6, (0.1, 1.1), 0.5, "handheld", BREATH),
}
_BODY = (  # name, centre, half axes, texture
    ("leg_left", (-0.11, 0, 0.33), (0.09, 0.1, 0.34), "cloth"),
    ("leg_right", (0.11, 0, 0.33), (0.09, 0.1, 0.34), "cloth"),
    ("torso", (0, 0, 0.83), (0.2, 0.14, 0.3), "shirt"),
    ("arm_left", (-0.25, 0.02, 0.8), (0.06, 0.07, 0.28), "shirt"),
    ("arm_right", (0.25, 0.02, 0.8), (0.06, 0.07, 0.28), "shirt"),
    ("head", (0, 0.01, 1.2), (0.11, 0.12, 0.13), "skin"),
)
_TEXTURES = {
    "cloth": (60, 80, 130),
    "shirt": (190, 70, 60),
    "skin": (205, 160, 130),
    "floor": (130, 125, 110),
    "crate": (150, 110, 60),
}


def run(options: Any) -> None:
    """Everything that is not there yet, and a table."""
    rows = ["| like | α | amplitude ratio | displacement error | closure |", "|---|---:|---:|---:|---:|"]
    for name in options.likes:
        scores = _scored(name, LIKES[name], options)
        rows.append(_row(name, scores))
        print(rows[-1], flush=True)
    print("\n".join(rows))


def _scored(name: str, like: Like, options: Any) -> dict[str, Any]:
    work = options.out / name
    work.mkdir(parents=True, exist_ok=True)
    made = _generated(work, name, like, options)
    data = _laid_out(made, work / "data", like)
    run, scores = work / "run", work / "scores.json"
    band = [f"{f:g}" for f in like.band]
    settings = [part for pair in options.set for part in ("--set", pair)]
    _command("train", str(data), "--out", str(run), "--band", *band, *settings)
    shown = ("--alpha", str(ALPHA), "--band", *band, "--path", "capture", "--out", str(work / "x20"))
    _command("render", str(run), *shown)
    scored = _with_truth(Run.open(run), work / "scored", made)
    _command("evaluate", str(scored), "--alphas", str(ALPHA), "--band", *band, "--out", str(scores))
    return json.loads(scores.read_text())


def _with_truth(run: Run, path: Path, made: Path) -> Path:
    """The run as one of the generator's dataset, whose pictures are the same, and which has the truth."""
    if not (path / "motion.safetensors").is_file():
        copy = Run.create(path, made, run.preset, run.settings)
        copy.save_space(run.load_space(), {})
        copy.save_part(UNCERTAINTY, run.load_part(UNCERTAINTY)[0])
        motion = run.load_motion()
        assert motion is not None
        copy.save_motion(motion, run.log()["motion"])
    return path


def _row(name: str, scores: dict[str, Any]) -> str:
    ratio = scores["displacement"]["per_frequency"][0]["amplitude_ratio"]
    error = scores["displacement_error"]["ours"]
    closure = next(row for row in scores["alphas"] if row["alpha"] == ALPHA)["closure"]
    return f"| {name} | {ALPHA} | {ratio:.2f} | {error:.2f} | {closure:.2f} |"


def _generated(work: Path, name: str, like: Like, options: Any) -> Path:
    """The generator's dataset."""
    motion = work / "motion.json"
    scale = write_person(work / "person.obj")
    mode = {"name": name, "frequency": like.hz, "amplitude_px": like.pixels, **like.motion}
    centre = np.array([0, 0, TALL / 2])
    for key in ("base", "tip", "centre"):
        if key in mode:
            mode[key] = ((np.array(mode[key]) - centre) * scale).round(6).tolist()
    if "radius" in mode:
        mode["radius"] *= scale
    mode["parts"] = [part[0] for part in _BODY]
    write_json(motion, {"modes": [mode]})
    _command(
        *("generate", "--mesh", str(work / "person.obj"), "--name", name, "--motion", str(motion)),
        *("--cameras", like.cameras, *(("--views", "30") if like.cameras == "sweep" else ())),
        *("--test-views", "1", "--timesteps", str(like.timesteps), "--fps", f"{like.fps:g}"),
        *("--size", str(options.size), "--samples", str(options.samples), "--sensor", "machine-vision"),
        *("--background", "white", "--alphas", str(ALPHA), "--truth", "test", "--out", str(work / "set")),
        *("--processes", str(options.processes)),
    )
    return next(path for path in (work / "set").iterdir() if (path / "scene.json").is_file())


def _laid_out(made: Path, data: Path, like: Like) -> Path:
    """As [3DMM]'s loader finds it: `data/tripod/NAME` or `data/handheld/NAME`."""
    capture = load_capture(made)
    if (data / "scene.json").is_file():
        return data
    still = np.flatnonzero(~np.isfinite(capture.times_s))
    moving = np.flatnonzero(np.isfinite(capture.times_s))
    moving = moving[np.argsort(capture.timesteps[moving], kind="stable")]
    is_tripod = like.cameras == "sweep"
    registered = [*still, moving[0]] if is_tripod else [*still, *moving]
    pictures = load_images(capture)
    plain = data.parent / "registered"
    named = _renamed(capture, pictures.data, registered, plain)
    write_colmap(named, data)
    if is_tripod:
        for t, i in enumerate(moving):
            target = data / "video_frames_1" / f"frame_{t + 1:05d}.png"
            target.parent.mkdir(exist_ok=True)
            save_png(target, pictures.data[i, ..., :3])
    scene = {"fps": like.fps} | ({} if is_tripod else {"dynamic_start": len(still) + 1})
    write_json(data / "scene.json", scene)
    return data


def _renamed(capture: Capture, data: np.ndarray, rows: Sequence[int], folder: Path) -> Capture:
    """The pictures `rows` as 000.png, 001.png … of a capture of one timestep."""
    paths = []
    for k, i in enumerate(rows):
        paths.append(folder / f"{k:03d}.png")
        folder.mkdir(parents=True, exist_ok=True)
        save_png(paths[-1], data[i, ..., :3])
    some = capture.selected(np.array(rows))
    return replace(some, root=folder, paths=tuple(paths), n_timesteps=1, timesteps=np.zeros(len(rows), int))


def _command(*arguments: str) -> None:
    subprocess.run([sys.executable, "-m", "tg4mm", *arguments], check=True)


def write_person(path: Path) -> float:
    """The scene as an OBJ with its textures; the factor by which the generator scales it."""
    rng = np.random.default_rng(0)
    for name, colour in _TEXTURES.items():
        Image.fromarray(_texture(rng, colour)).save(path.with_name(f"{name}.png"))
    material = [f"newmtl {name}\nKd 1 1 1\nmap_Kd {name}.png\n" for name in _TEXTURES]
    path.with_suffix(".mtl").write_text("\n".join(material))
    lines, first = [f"mtllib {path.stem}.mtl"], 1
    boxes = [
        (f"crate_{k}", (0.56 * np.cos(a), 0.56 * np.sin(a), 0.12), (0.11, 0.09, 0.12))
        for k, a in enumerate((0.5, 1.9, 3.3, 4.6, 5.6))
    ]
    shapes = [(n, _ellipsoid(c, r), t) for n, c, r, t in _BODY]
    shapes += [(n, _box(c, h), "crate") for n, c, h in boxes]
    shapes.append(("floor", _box((0, 0, -0.02), (WIDE, WIDE, 0.02)), "floor"))
    for name, (vertices, uv, faces), texture in shapes:
        lines += [f"o {name}", f"usemtl {texture}"]
        lines += [f"v {x:.6f} {z:.6f} {-y:.6f}" for x, y, z in vertices]  # y up, as OBJ files are
        lines += [f"vt {u:.5f} {v:.5f}" for u, v in uv]
        lines += ["f " + " ".join(f"{i + first}/{i + first}" for i in face) for face in faces]
        first += len(vertices)
    path.write_text("\n".join(lines) + "\n")
    low, high = np.array([-WIDE, -WIDE, -0.04]), np.array([WIDE, WIDE, 1.33])
    return RADIUS / float(np.linalg.norm(high - low) / 2)


def _texture(rng: np.random.Generator, colour: Sequence[int]) -> np.ndarray:
    """[256, 256, 3] uint8: noise of several octaves about a colour."""
    out = np.zeros((256, 256))
    for size in (8, 16, 32, 64):
        grid = Image.fromarray(rng.normal(size=(size, size)).astype(np.float32))
        out += np.asarray(grid.resize((256, 256), Image.Resampling.BICUBIC))
    factor = np.exp(0.35 * out / out.std())[..., None]
    return np.clip(np.array(colour) * factor, 0, 255).astype(np.uint8)


def _ellipsoid(centre: Sequence[float], half: Sequence[float], n: int = 28) -> tuple:
    v, u = np.meshgrid(np.linspace(0.02, np.pi - 0.02, n // 2), np.linspace(0, 2 * np.pi, n), indexing="ij")
    unit = np.stack([np.sin(v) * np.cos(u), np.sin(v) * np.sin(u), np.cos(v)], -1).reshape(-1, 3)
    uv = np.stack([u / (2 * np.pi), v / np.pi], -1).reshape(-1, 2)
    i, j = np.meshgrid(np.arange(n // 2 - 1), np.arange(n - 1), indexing="ij")
    a = (i * n + j).ravel()
    faces = np.stack([a, a + n, a + n + 1, a + 1], 1)
    return unit * np.array(half) + np.array(centre), uv, faces


def _box(centre: Sequence[float], half: Sequence[float]) -> tuple:
    vertices: list[np.ndarray] = []
    uv: list[tuple[int, int]] = []
    faces: list[np.ndarray] = []
    for axis in range(3):
        for side in (-1.0, 1.0):
            corners = np.zeros((4, 3))
            corners[:, axis] = side
            corners[:, (axis + 1) % 3] = side * np.array([-1, 1, 1, -1])
            corners[:, (axis + 2) % 3] = [-1, -1, 1, 1]
            faces.append(np.arange(4) + len(vertices))
            vertices += list(corners * np.array(half) + np.array(centre))
            uv += [(0, 0), (1, 0), (1, 1), (0, 1)]
    return np.array(vertices), np.array(uv), np.array(faces)
