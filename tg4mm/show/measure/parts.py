"""Which part of the scene is which sensor: a picture with every region coloured and named."""

from collections.abc import Sequence

import numpy as np
from PIL import Image

from tg4mm.capture.pictures import over_white
from tg4mm.core.pictures.frames import to_bytes
from tg4mm.show.labels import write_labels
from tg4mm.show.measure.measurement import Measurement
from tg4mm.show.measure.sensors import STILL, Sensor
from tg4mm.show.regions import COLOURS
from tg4mm.show.render.cameras import Camera
from tg4mm.show.render.image import render_features, render_image

_EDGE = 720  # pixels of the longer side, about
_TINT, _PALE = 0.55, 0.35  # of a region's colour, and of white in the rest of the picture
_CAMERAS = 6  # that are tried
_VISIBLE = 0.3  # of what a pixel shows: it belongs to the region


def parts_picture(found: Measurement) -> np.ndarray | None:
    """The scene at rest, [h, w, 3] uint8, with the sensors' regions in colour and their names; None without any.

    From the camera that sees most of them. What stands still and the whole scene are no regions.
    """
    parts = [s for s in found.sensors if _is_part(s.sensor)]
    if not parts:
        return None
    scene = found.prepared
    if not scene.capture.kind.sees_depth:
        masks = np.stack([s.mask for s in parts if s.mask is not None], -1)
        raw = scene.observations.pictures.strips(scene.observations.frames[0].rows[:1].tolist())
        first = over_white(raw(slice(None)), scene.observations.pictures.maximum)[0]
        return _coloured(first, masks, [part.name for part in parts])
    features = np.stack([np.clip(s.body.weights, 0, 1) for s in parts], 1).astype(np.float32)
    frames, (width, height) = scene.observations.frames, scene.observations.size
    some = np.unique(np.linspace(0, len(frames) - 1, min(_CAMERAS, len(frames))).round().astype(int))
    cameras = [
        Camera(frames[i].name, frames[i].viewmat.astype(float), frames[i].K.astype(float), width, height)
        for i in some
    ]
    maps = [render_features(scene.gaussians, features, camera)[0] for camera in cameras]
    best = int(np.argmax([np.sqrt((own > _VISIBLE).sum((0, 1))).sum() for own in maps]))
    camera, shares = cameras[best], maps[best]
    rest = render_image(scene.gaussians, camera.viewmat, camera.K, width, height)
    return _coloured(rest, shares, [part.name for part in parts])


def _coloured(rest: np.ndarray, shares: np.ndarray, names: Sequence[str]) -> np.ndarray:
    """A picture [H, W, 3] in which pixels with a large share [H, W, S] of a region have its colour, and its name."""
    height, width = rest.shape[:2]
    shown = np.repeat(rest.mean(2, keepdims=True), 3, 2) * (1 - _PALE) + _PALE
    labels = []
    for k, name in enumerate(names):
        inside = (shares[..., k] > _VISIBLE) & (shares[..., k] >= shares.max(2))
        colour = np.array(COLOURS[k % len(COLOURS)]) / 255
        shown[inside] = (1 - _TINT) * shown[inside] + _TINT * colour
        if inside.any():
            rows, columns = np.nonzero(inside)
            near = np.argmin((rows - np.median(rows)) ** 2 + (columns - np.median(columns)) ** 2)
            labels.append((name, (float(columns[near]), float(rows[near]))))
    scale = max(1, round(_EDGE / max(width, height)))
    out = Image.fromarray(to_bytes(shown)).resize((scale * width, scale * height), Image.Resampling.BICUBIC)
    write_labels(out, [(name, (scale * x, scale * y)) for name, (x, y) in labels])
    return np.asarray(out)


def _is_part(sensor: Sensor) -> bool:
    return sensor.region != "all" and (sensor.region, sensor.values) != ("cluster", (float(STILL),))
