"""truth/cameras.json: what a capture does not say of its cameras: their clocks, true poses and gains."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from . import tree
from .cameras import Camera, cameras_at, clock_offsets, films, scene_time
from .effects import Record
from .plan import picture_path
from .settings import Settings
from .vibration import Motion

FILE = "truth/cameras.json"


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
    tree.write_bytes(root / FILE, f"{text}{{\n{body}\n  }}\n}}\n".encode())


def _filming(settings: Settings, timestep: int) -> list[Camera]:
    return [c for c in cameras_at(settings.cameras, timestep)["train"] if films(settings.cameras, c)]


def _clocks(settings: Settings, motion: Motion) -> dict[str, Any]:
    """Per camera: `phases_rad`, one for each of `frequencies_hz`, by which a mode is ahead at the camera's time 0."""
    found = {}
    for camera in _filming(settings, 0):
        offset = clock_offsets(settings.cameras)[camera.index]
        phases = np.angle(np.exp(2j * np.pi * ((motion.frequencies_hz * offset) % 1.0)))
        found[camera.name] = {"clock_offset_s": offset, "phases_rad": phases.tolist()}
    return found


def _frames(settings: Settings) -> list[tuple[str, dict[str, Any]]]:
    record = Record(settings.effects, settings.cameras, settings.size, settings.seed)
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
