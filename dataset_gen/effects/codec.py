"""A camera's pictures through H.264 (libx264 by PyAV: 4:2:0, eight bits, Rec.709) and back; sets made so.

What is rendered lies in a working folder until all frames of a camera are there. They become one video, and the
video's frames the set's pictures. A picture without its camera's other frames could not be made again, so a
camera is finished as a whole or not at all.
"""

import io
import shutil
from collections.abc import Iterable, Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.core.pictures import png
from tg4mm.core.progress import progress

from .. import tree
from ..cameras import SceneCamera, cameras_at, films
from ..errors import GenerateError
from ..pictures import to_integers
from ..plan import UNCODED, picture_path
from ..settings import Settings

_REC709 = 1  # of colour primaries, transfer and matrix (H.273)
_LIMITED = 1  # range: 16 … 235
_RED, _BLUE = 0.2126, 0.0722  # of luma
VIDEOS = "video"
_SWEEP = "sweep"  # where `tg4mm sfm` looks for photographs beside the videos


def check_package() -> None:
    """Raises GenerateError where PyAV, or libx264 in it, is absent."""
    try:
        from av.codec import codecs_available
    except ImportError:
        raise GenerateError(
            "--codec h264 needs the package av (PyAV), which this Python lacks: pip install av"
        ) from None
    if "libx264" not in codecs_available:
        raise GenerateError("--codec h264: PyAV was built without libx264 here")


def encode(pictures: Iterable[np.ndarray], size: int, fps: float, crf: int) -> bytes:
    """An MP4 of square pictures [size, size, 3] uint8, sRGB, one frame each, at `fps` Hz.

    A key frame each second, as phones write them. The same pictures give the same bytes: on one thread, and without
    macroblock trees, whose vector code reads beyond a small picture (32 × 32 pixels: 17 of 300 files differed).
    """
    import av

    file = io.BytesIO()
    rate = Fraction(fps).limit_denominator(1001)
    with av.open(file, "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=rate)
        context = stream.codec_context
        stream.width = stream.height = size
        stream.pix_fmt = "yuv420p"
        context.color_primaries = context.color_trc = context.colorspace = _REC709
        context.color_range = _LIMITED
        context.thread_count = 1
        context.gop_size = max(1, round(fps))
        stream.options = {"crf": str(crf), "preset": "medium", "threads": "1", "x264-params": "mbtree=0"}
        for number, picture in enumerate(pictures):
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
            frame = frame.reformat(format="yuv420p", dst_colorspace="ITU709", dst_color_range="MPEG")
            frame.pts, frame.time_base = number, 1 / rate
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return file.getvalue()


def decode(path: Path) -> Iterator[np.ndarray]:
    """The frames of such a video in order, [H, W, 3] uint8, sRGB.

    Colours are worked out here, exactly: what FFmpeg does by default repeats chroma from pixel to pixel and is
    one grey level too dark on average.
    """
    import av

    with av.open(f"file:{path}") as container:
        for frame in container.decode(video=0):
            yield to_rgb(*(_plane(plane) for plane in frame.reformat(format="yuv420p").planes))


def to_rgb(luma: np.ndarray, blue: np.ndarray, red: np.ndarray) -> np.ndarray:
    """Return [H, W, 3] uint8 of planes [H, W] and twice [H/2, W/2], Rec.709 in 16 … 235, chroma between the pixels."""
    y, b, r = (luma - 16.0) / 219.0, (_doubled(blue) - 128.0) / 224.0, (_doubled(red) - 128.0) / 224.0
    red_rgb, blue_rgb = y + 2 * (1 - _RED) * r, y + 2 * (1 - _BLUE) * b
    green_rgb = (y - _RED * red_rgb - _BLUE * blue_rgb) / (1 - _RED - _BLUE)
    return to_integers(np.stack([red_rgb, green_rgb, blue_rgb], -1), 8)


def _plane(plane: Any) -> np.ndarray:
    """Return [H, W] uint8 of a plane, whose lines may be padded."""
    lines = np.frombuffer(bytes(plane), np.uint8).reshape(-1, plane.line_size)
    return lines[: plane.height, : plane.width]


def _doubled(plane: np.ndarray) -> np.ndarray:
    """Return [2 H, 2 W] by linear interpolation."""
    wide = plane.astype(np.float64)
    for _ in range(2):
        padded = np.pad(wide, ((1, 1), (0, 0)), mode="edge")
        between = np.stack([0.25 * padded[:-2] + 0.75 * wide, 0.75 * wide + 0.25 * padded[2:]], 1)
        wide = between.reshape(-1, wide.shape[1]).T
    return wide


def begin(root: Path, settings: Settings) -> None:
    """Prepare rendering: if a camera lacks some of its pictures, remove all, so that they are rendered again."""
    for camera in _cameras(settings):
        if not _finished(root, settings, camera) and not _rendered(root, settings, camera):
            for name in _names(settings, camera):
                (root / name).unlink(missing_ok=True)


def finish(root: Path, settings: Settings) -> None:
    """Encode the video of every camera whose frames are complete, and take its pictures from that."""
    cameras = list(_cameras(settings))
    with progress("videos", len(cameras), "cameras", brief=True) as update:
        for done, camera in enumerate(cameras, 1):
            if not _finished(root, settings, camera) and _rendered(root, settings, camera):
                _code(root, settings, camera)
            update(done)


def clean(root: Path, settings: Settings) -> None:
    """Remove intermediate files of a complete set."""
    if not settings.effects.coded:
        return
    shutil.rmtree(root / UNCODED, ignore_errors=True)
    if settings.effects.keep_video:
        sweep = [c for c in cameras_at(settings.cameras, 0)["train"] if not films(settings.cameras, c)]
        for camera in sweep:
            picture = root / picture_path(settings, 0, camera)
            tree.link(picture, [root / VIDEOS / _SWEEP / picture.name])


def _cameras(settings: Settings) -> Iterator[SceneCamera]:
    for camera in cameras_at(settings.cameras, 0)["train"] if settings.effects.coded else ():
        if films(settings.cameras, camera):
            yield camera


def _names(settings: Settings, camera: SceneCamera) -> list[str]:
    return [picture_path(settings, t, camera) for t in range(settings.timesteps)]


def _finished(root: Path, settings: Settings, camera: SceneCamera) -> bool:
    kept = not settings.effects.keep_video or _video(root, camera).is_file()
    return kept and all(tree.complete(root, name, settings) for name in _names(settings, camera))


def _rendered(root: Path, settings: Settings, camera: SceneCamera) -> bool:
    return all((root / UNCODED / name).is_file() for name in _names(settings, camera))


def _video(root: Path, camera: SceneCamera) -> Path:
    return root / VIDEOS / f"{camera.name}.mp4"


def _read(path: Path) -> np.ndarray:
    """Return [H, W, 3] uint8."""
    from tg4mm.core.pictures.decode import decode  # it needs Pillow, which Blender's own Python lacks

    return decode(path)[..., :3]


def _code(root: Path, settings: Settings, camera: SceneCamera) -> None:
    names = _names(settings, camera)
    pictures = (_read(root / UNCODED / name) for name in names)
    video = _video(root, camera) if settings.effects.keep_video else root / UNCODED / f"{camera.name}.mp4"
    tree.write_bytes(video, encode(pictures, settings.size, settings.fps, settings.effects.crf))
    for name, picture in zip(names, decode(video), strict=True):
        tree.write_bytes(root / name, png.encode(picture))
