"""The pictures that poses are found from, laid out as COLMAP reads them, and its database of them."""

from __future__ import annotations

import os
import shutil
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

import numpy as np
from PIL import Image

from tg4mm.capture.decode import THREADS, decode, image_header
from tg4mm.errors import CaptureError
from tg4mm.files import write_atomic
from tg4mm.sfm.engine import colmap, opened
from tg4mm.sfm.sources import SWEEP, Sources


@dataclass(frozen=True)
class Shot:
    """One picture for COLMAP."""

    name: str  # below images/, with /
    path: Path  # the original
    group: str  # pictures of one group share their intrinsics


def shots(sources: Sources, each: bool) -> list[Shot]:
    """Every photograph, or the first frame of every fixed camera and the whole sweep.

    each: every photograph or fixed camera has intrinsics of its own; a sweep's are always shared.
    """
    found = []
    for clip in sources.clips:
        pictures = clip.pictures[:1] if sources.fixed else clip.pictures
        for path in pictures:
            name = f"{clip.name if sources.fixed else 'photographs'}/{path.name}"
            found.append(Shot(name, path, name if each else "shared"))
    if sources.sweep is not None:
        found += [Shot(f"{SWEEP}/{path.name}", path, SWEEP) for path in sources.sweep.pictures]
    return found


def check_sizes(taken: list[Shot]) -> None:
    """Raise CaptureError where pictures that share intrinsics differ in size (a damaged one is named too)."""
    with ThreadPoolExecutor(THREADS) as pool:
        headers = list(pool.map(image_header, [shot.path for shot in taken]))
    first: dict[str, int] = {}
    for i, (shot, header) in enumerate(zip(taken, headers, strict=True)):
        k = first.setdefault(shot.group, i)
        if (header.width, header.height) != (headers[k].width, headers[k].height):
            raise CaptureError(
                f"{shot.path}: is {header.width}×{header.height} pixels, but {taken[k].path} is "
                f"{headers[k].width}×{headers[k].height}; cameras that differ need --intrinsics each"
            )


def stage(taken: list[Shot], folder: Path) -> Path | None:
    """images/ and, if any picture is transparent in places, masks/ below `folder`; returns masks/ or None.

    Opaque 8-bit PNG and JPEG files are linked (with what their cameras wrote into them), others become PNGs over white.
    Pictures staged before are kept.
    """
    masks = folder / "masks"
    for shot in taken:
        target = folder / "images" / staged_name(shot)
        if target.exists():
            continue
        target.parent.mkdir(parents=True, exist_ok=True)
        header = image_header(shot.path)
        pixels = decode(shot.path)
        alpha = pixels[..., 3] / np.iinfo(pixels.dtype).max
        if alpha.min() < 1:
            _save(masks / f"{staged_name(shot)}.png", np.where(alpha > 0.5, 255, 0))
        if alpha.min() < 1 or header.bits > 8 or shot.path.suffix.lower() == ".exr":
            colour = pixels[..., :3] / np.iinfo(pixels.dtype).max
            _save(target, 255 * (colour * alpha[..., None] + 1 - alpha[..., None]))
        else:
            _link(shot.path, target)
    return masks if masks.is_dir() else None


def staged_name(shot: Shot) -> str:
    """The picture's name below images/: percent-encoded, since COLMAP's lists part names at spaces; EXR as PNG."""
    name = quote(shot.name, safe="/")
    return f"{name}.png" if shot.path.suffix.lower() == ".exr" else name


def make_database(taken: list[Shot], folder: Path, camera_model: str, focal_px: float | None) -> Path:
    """folder/database.db with every picture and its camera, no features yet; one that is there is kept.

    The focal length is focal_px (pixels), or what the picture's EXIF says, or 1.2 times the longer side, to be refined.
    """
    c = colmap("structure from motion")
    path = folder / "database.db"
    if path.exists():
        return path
    temporary = folder / ".database.db.tmp"
    for leftover in folder.glob(".database.db.tmp*"):
        leftover.unlink()
    opened(temporary).__exit__()
    groups: dict[str, list[Shot]] = {}
    for shot in taken:
        groups.setdefault(shot.group, []).append(shot)
    for members in groups.values():
        options = c.ImageReaderOptions()
        options.camera_model = camera_model
        names = [staged_name(shot) for shot in members]
        if focal_px is not None and members[0].group != SWEEP:
            options.camera_params = _params(c, folder / "images" / names[0], camera_model, focal_px)
        c.import_images(temporary, folder / "images", c.CameraMode.SINGLE, names, options)
    with opened(temporary) as db:
        known = db.num_images()
    if known != len(taken):
        raise CaptureError(f"{len(taken) - known} of {len(taken)} pictures cannot be read by COLMAP")
    os.replace(temporary, path)
    return path


def _params(c, picture: Path, camera_model: str, focal_px: float) -> str:
    """COLMAP's list of parameters: the focal lengths, the picture's centre, no distortion."""
    with Image.open(picture) as image:
        width, height = image.size
    camera = c.Camera.create_from_model_name(c.INVALID_CAMERA_ID, camera_model, focal_px, width, height)
    return ", ".join(repr(float(x)) for x in camera.params)


def _save(path: Path, values: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    image = Image.fromarray((values + 0.5).astype(np.uint8))
    write_atomic(path, lambda temporary: image.save(temporary, format="PNG", compress_level=1))


def _link(source: Path, target: Path) -> None:
    try:
        os.link(source.resolve(), target)
    except OSError:  # another disk, or a file system without links
        write_atomic(target, lambda temporary: shutil.copyfile(source, temporary))
