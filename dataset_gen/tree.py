"""The dataset on disk (docs/conventions.md): scene.json, poses, atomic writing, linking, what a complete file is."""

import contextlib
import json
import os
import shutil
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.core.files import replacing
from tg4mm.core.pictures import exr
from tg4mm.core.work_folder import WorkFolder

from .cameras import SceneCamera, cameras_at, clock_offsets, films, scene_time, transforms
from .effects import RecordingEffects
from .errors import GenerateError
from .plan import UNCODED, magnified_folder, picture_path
from .settings import Settings
from .vibration import Motion

FORMAT_VERSION = 1
TIMING = {"pictures": int, "seconds": float, "processes": int}  # report/timing.json
CAMERAS = "truth/cameras.json"


def write_bytes(path: Path, data: bytes) -> None:
    """Writes a file under a temporary name, then renames it."""
    with whole(path) as temporary:
        temporary.write_bytes(data)


@contextlib.contextmanager
def whole(path: Path) -> Iterator[Path]:
    """A name with the suffix of `path` to write to, renamed to it at the end; its folder is made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path, path.suffix) as temporary:
        yield temporary


def write_json(path: Path, data: Any) -> None:
    write_bytes(path, (json.dumps(data, indent=2) + "\n").encode())


def complete(root: Path, name: str, settings: Settings) -> bool:
    """Return whether a complete picture or truth file of the right kind and size exists.

    For a picture that goes through a video, the original or its decoded version counts.
    """
    if name.startswith(f"{UNCODED}/") and complete(root, name.removeprefix(f"{UNCODED}/"), settings):
        return True
    check = exr.complete if name.startswith("truth/") else settings.pictures.complete
    return check(root / name, settings.size, settings.size)


def link(source: Path, targets: Iterable[Path]) -> None:
    """Makes every target the same file as `source`: a hard link, or a copy where links are not to be had."""
    for target in targets:
        if target == source:
            continue
        with whole(target) as temporary:
            try:
                os.link(source, temporary)
            except OSError:
                shutil.copyfile(source, temporary)
            # Renaming a link over another link to the same file does nothing: remove the target first.
            target.unlink(missing_ok=True)


def describe(
    settings: Settings, amplitude: float, unit_scale_m: float | None, engine: dict[str, object]
) -> dict[str, Any]:
    """Content of scene.json: everything the files depend on, so two equal descriptions mean equal data.

    `amplitude`: of the main mode, scene units.
    """
    main = settings.motion.main
    return {
        "format_version": FORMAT_VERSION, "scene": settings.scene, "kind": settings.cameras.capture_kind,
        **({"clocks": "independent"} if any(clock_offsets(settings.cameras)) else {}), "fps": settings.fps,
        **({"readout_s": settings.effects.readout_ms / 1e3} if settings.effects.readout_ms else {}),
        **({"noise": settings.noise} if settings.noise != "state" else {}),
        "n_timesteps": settings.timesteps, "frequency_hz": main.frequency_hz, "amplitude": amplitude,
        "unit_scale_m": unit_scale_m, "modes": settings.motion.to_json()["modes"], "seed": settings.seed,
        "engine": engine, "alphas": list(settings.alphas), "background": settings.pictures.background,
        "images": settings.pictures.images, "width": settings.size, "height": settings.size,
        "cameras": settings.cameras.to_json(), "n_train": settings.cameras.n_train(0),
        "n_test": settings.cameras.n_test,
        "n_at_rest": settings.cameras.n_train(0) - 1 if settings.cameras.kind == "sweep" else 0,
        "n_points": settings.points, "truth": settings.truth,
        "sensor": settings.sensor.to_json() if settings.sensor else None,
        "effects": settings.effects.to_json() if settings.effects.any else None,
    }  # fmt: skip


def work_folder(root: Path) -> WorkFolder:
    """The dataset's folder as one that belongs to a request: what scene.json says."""
    return WorkFolder(root, "scene.json", GenerateError)


def write_poses(root: Path, settings: Settings) -> None:
    """All transforms_<split>.json of the set, times in seconds on each camera's own clock."""
    for t in range(settings.timesteps):
        for split, cameras in cameras_at(settings.cameras, t).items():
            folders = [root / f"{t:03d}"]
            if split == "test":
                folders += [root / magnified_folder(a) / f"{t:03d}" for a in settings.alphas]
            size, suffix = settings.size, settings.pictures.suffix
            still = [c for c in cameras if split == "train" and not films(settings.cameras, c)]
            for folder in folders if cameras else ():
                data = transforms(cameras, split, t / settings.fps, size, size, suffix, still)
                write_json(folder / f"transforms_{split}.json", data)


def write_cameras(root: Path, settings: Settings, motion: Motion) -> None:
    """Writes the file, if there is anything to say: clocks that differ, shake, or gains."""
    effects, setup = settings.effects, settings.cameras
    frames = effects.shake_px > 0 or effects.gain
    if not frames and not any(clock_offsets(setup)):
        return
    head = {
        "clocks": "scene time = time in transforms_train.json + clock_offset_s; test views, truth/motion.npz and "
        "magnified/ go by scene time",
        "frequencies_hz": motion.frequencies_hz.tolist(),
        "cameras": _clocks(settings, motion),
    }
    lines = _frames(settings) if frames else []
    # One frame a line: thousands of matrices, spread over a line for each number, would be hard to look through.
    text = json.dumps({**head, "frames": {}}, indent=2).removesuffix("{}\n}")
    body = ",\n".join(f"    {json.dumps(name)}: {json.dumps(frame)}" for name, frame in lines)
    write_bytes(root / CAMERAS, f"{text}{{\n{body}\n  }}\n}}\n".encode())


def _filming(settings: Settings, timestep: int) -> list[SceneCamera]:
    return [c for c in cameras_at(settings.cameras, timestep)["train"] if films(settings.cameras, c)]


def _clocks(settings: Settings, motion: Motion) -> dict[str, Any]:
    """Return each camera's `phases_rad`, by which modes of `frequencies_hz` are ahead at the camera's time 0."""
    found = {}
    for camera in _filming(settings, 0):
        offset = clock_offsets(settings.cameras)[camera.index]
        phases = np.angle(np.exp(2j * np.pi * ((motion.frequencies_hz * offset) % 1.0)))
        found[camera.name] = {"clock_offset_s": offset, "phases_rad": phases.tolist()}
    return found


def _frames(settings: Settings) -> list[tuple[str, dict[str, Any]]]:
    record = RecordingEffects(settings.effects, settings.cameras, settings.size, settings.seed)
    found = []
    for t in range(settings.timesteps):
        for camera in _filming(settings, t):
            gain = record.gain("train", camera, t)
            pose = record.true_camera("train", camera, t).camera_to_world
            frame = {
                "scene_time_s": scene_time(settings.cameras, camera, t),
                "gain": [1.0, 1.0, 1.0] if gain is None else gain.tolist(),
                "transform_matrix": pose.tolist(),
            }
            found.append((picture_path(settings, t, camera), frame))
    return found
