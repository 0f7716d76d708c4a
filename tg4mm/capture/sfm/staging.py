"""The pictures that poses are found from, laid out as COLMAP reads them, and its database of them."""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

import numpy as np
from PIL import Image

from tg4mm.capture.cameras import check_picture_size
from tg4mm.capture.sfm.clip import SWEEP, Clip
from tg4mm.capture.sfm.engine import colmap, opened
from tg4mm.capture.sfm.survey import Survey
from tg4mm.core.errors import CaptureError
from tg4mm.core.files import link_or_copy, write_atomic
from tg4mm.core.pictures.decode import DAMAGE, FORMATS, THREADS, decode, image_header
from tg4mm.core.progress import progress

_LINKED = (".png", ".jpg", ".jpeg")  # what COLMAP reads; others become PNG


@dataclass(frozen=True)
class StagedPicture:
    """One picture for COLMAP."""

    name: str  # below images/, with /
    path: Path  # the original
    group: str  # pictures of one group share their intrinsics
    clip: str  # name of the clip that it is of
    index: int = 0  # of a moving camera's frame
    turns: int = 0  # quarter turns counterclockwise that bring it upright, as its EXIF says

    def upright(self, size: tuple[int, int]) -> tuple[int, int]:
        """Width and height once turned upright."""
        return (size[1], size[0]) if self.turns % 2 else size


def photograph_shots(photographs: Clip, each: bool) -> list[StagedPicture]:
    """Every photograph. each: every one has intrinsics of its own."""
    names = [f"photographs/{path.name}" for path in photographs.pictures]
    return [
        StagedPicture(name, path, name if each else "shared", photographs.name, turns=exif_turns(path))
        for name, path in zip(names, photographs.pictures, strict=True)
    ]


def camera_shots(surveys: Sequence[Survey], each: bool) -> list[StagedPicture]:
    """The mean picture of every fixed camera. each: every camera has intrinsics of its own."""
    return [
        StagedPicture(f"cameras/{s.mean.name}", s.mean, s.name if each else "shared", s.name) for s in surveys
    ]


def frame_shots(clip: Clip, frames: Sequence[Path]) -> list[StagedPicture]:
    """All frames of a camera that moves."""
    return [
        StagedPicture(f"frames/{path.name}", path, "shared", clip.name, i) for i, path in enumerate(frames)
    ]


def sweep_shots(pictures: Sequence[Path], size: tuple[int, int], each: bool) -> list[StagedPicture]:
    """Pictures of the scene at rest. Those of the recordings' size are taken for the same camera's, unless `each`."""
    shots = []
    for path in pictures:
        header = image_header(path)
        wh = (header.width, header.height)
        group = "shared" if wh == size and not each else f"{SWEEP} {wh[0]}×{wh[1]}"
        shots.append(StagedPicture(f"{SWEEP}/{path.name}", path, group, SWEEP, turns=exif_turns(path)))
    return shots


def exif_turns(path: Path) -> int:
    """Quarter turns counterclockwise that a photograph's EXIF orientation asks for; COLMAP takes it as it is stored."""
    if path.suffix.lower() in (".exr", ".tif", ".tiff"):  # a TIFF is turned as it is decoded
        return 0
    image_header(path)  # raises CaptureError for what is no picture, or promises more than its file can hold
    try:
        with Image.open(path, formats=FORMATS) as image:
            return {3: 2, 6: 3, 8: 1}.get(image.getexif().get(0x0112, 1), 0)
    except DAMAGE:
        return 0  # an unreadable EXIF block turns nothing; damaged pixels are reported when they are decoded


def check_sizes(taken: list[StagedPicture]) -> None:
    """Raise CaptureError where pictures that share intrinsics differ in size (a damaged one is named too)."""
    with ThreadPoolExecutor(THREADS) as pool:
        headers = list(pool.map(image_header, [shot.path for shot in taken]))
    first: dict[str, int] = {}
    for i, (shot, header) in enumerate(zip(taken, headers, strict=True)):
        check_picture_size(shot.path, header.width, header.height)
        k = first.setdefault(shot.group, i)
        if (header.width, header.height) != (headers[k].width, headers[k].height):
            raise CaptureError(
                f"{shot.path}: is {header.width}×{header.height} pixels, but {taken[k].path} is "
                f"{headers[k].width}×{headers[k].height}; cameras that differ need --intrinsics each"
            )


def stage(taken: list[StagedPicture], folder: Path) -> Path | None:
    """images/ and, if any picture is transparent in places, masks/ below `folder`; returns masks/ or None.

    Opaque 8-bit PNG and JPEG files are linked (with what their cameras wrote into them), others become PNGs over white.
    Pictures staged before are kept.
    """
    masks = folder / "masks"

    def one(shot: StagedPicture) -> None:
        target = folder / "images" / staged_name(shot)
        if not target.exists():
            _stage_one(shot.path, target, masks / f"{staged_name(shot)}.png")

    with (
        ThreadPoolExecutor(THREADS) as pool,
        progress("staging", len(taken), "pictures", brief=True) as update,
    ):
        for done, _ in enumerate(pool.map(one, taken), 1):
            update(done)
    return masks if masks.is_dir() else None


def _stage_one(path: Path, target: Path, mask: Path) -> None:
    """Decode one picture completely, which also detects damage."""
    pixels = decode(path)
    maximum = np.iinfo(pixels.dtype).max
    opaque = pixels[..., 3].min() == maximum
    if opaque and maximum == 255 and path.suffix.lower() in _LINKED:
        link_or_copy(path, target)
        return
    alpha = pixels[..., 3] / maximum
    if not opaque:
        _save(mask, np.where(alpha > 0.5, 255, 0))
    _save(target, 255 * (pixels[..., :3] / maximum * alpha[..., None] + 1 - alpha[..., None]))


def staged_name(shot: StagedPicture) -> str:
    """The picture's name below images/: percent-encoded (COLMAP's lists part names at spaces); a PNG if need be."""
    name = quote(shot.name, safe="/")
    return name if shot.path.suffix.lower() in _LINKED else f"{name}.png"


def make_database(
    taken: list[StagedPicture], folder: Path, camera_model: str, focal_px: float | None
) -> Path:
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
    groups: dict[str, list[StagedPicture]] = {}
    for shot in taken:
        groups.setdefault(shot.group, []).append(shot)
    for members in groups.values():
        options = c.ImageReaderOptions()
        options.camera_model = camera_model
        names = [staged_name(shot) for shot in members]
        if focal_px is not None:
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
    header = image_header(picture)
    size = header.width, header.height
    camera = c.Camera.create_from_model_name(c.INVALID_CAMERA_ID, camera_model, focal_px, *size)
    return ", ".join(repr(float(x)) for x in camera.params)


def _save(path: Path, values: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    image = Image.fromarray((values + 0.5).astype(np.uint8))
    write_atomic(path, lambda temporary: image.save(temporary, format="PNG", compress_level=1))
