"""Small videos written with PyAV, whole and spoilt."""

from fractions import Fraction

import av
import numpy as np
from PIL import Image

from tg4mm.capture.sfm.clip import WHOLE, Clip
from tg4mm.capture.sfm.survey import survey_clip

SIZE = (160, 120)  # width, height


def texture(size=SIZE, seed=0):
    """[H, W, 3] float64 in 0 … 255: smooth blobs, so that what a codec leaves can still be tracked."""
    width, height = size
    rng = np.random.default_rng(seed)
    coarse = rng.integers(30, 226, (max(3, height // 8), max(3, width // 8), 3), np.uint8)
    return np.asarray(Image.fromarray(coarse).resize(size, Image.Resampling.BICUBIC), np.float64)


def still(n, shifts=None, noise=4.0, size=SIZE):
    """n noisy pictures of one thing, frame i moved to the right by shifts[i] pixels."""
    rng = np.random.default_rng(1)
    wide = texture((size[0] + 128, size[1]))
    frames = []
    for i in range(n):
        start = 64 - (shifts[i] if shifts is not None else 0)
        cut = wide[:, start : start + size[0]]
        frames.append(np.clip(cut + rng.normal(0, noise, cut.shape), 0, 255).astype(np.uint8))
    return frames


def write_video(
    path, frames, rate=30, times=None, time_base=None, rotation=None, created=None, crf=14, between=None
):
    """H.264 in the container that the name asks for, which lists its frames before them (so that a cut one opens).

    times: of each frame, in whole numbers of time_base; without, frame k is at k / rate. between: B pictures between
    others, always as many; without, as the encoder likes.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    options = {"movflags": "faststart"} if path.suffix in (".mp4", ".mov") else {}
    with av.open(str(path), "w", options=options) as container:
        if created is not None:
            container.metadata["creation_time"] = created
        stream = container.add_stream("libx264", rate=rate)
        stream.height, stream.width = frames[0].shape[:2]
        stream.pix_fmt = "yuv420p"
        stream.codec_context.thread_count = 3  # on any machine: what x264 makes depends on it
        stream.codec_context.gop_size = 10
        stream.codec_context.options = {"crf": str(crf), "preset": "veryfast"}
        if between is not None:
            more = {"x264-params": f"bframes={between}:b-adapt=0:keyint=250:scenecut=0"}
            stream.codec_context.options = stream.codec_context.options | more
            stream.codec_context.gop_size = 250
        base = Fraction(1) / rate if time_base is None else time_base
        stream.time_base = stream.codec_context.time_base = base
        if rotation is not None:
            stream.set_display_rotation(rotation)
        for i, pixels in enumerate(frames):
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(pixels), format="rgb24")
            frame.pts, frame.time_base = (i if times is None else times[i]), base
            for packet in stream.encode(frame):
                container.mux(packet)
        for packet in stream.encode():
            container.mux(packet)
    return path


def encoded(path, frames, codec, gop=30, **options):
    """By another of FFmpeg's encoders."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=30)
        stream.height, stream.width = frames[0].shape[:2]
        stream.pix_fmt = "yuv420p"
        stream.bit_rate = int(options.pop("b", "0"))
        stream.codec_context.gop_size = gop
        stream.codec_context.options = {key.replace("_", "-"): value for key, value in options.items()}
        for i, pixels in enumerate(frames):
            frame = av.VideoFrame.from_ndarray(pixels, format="rgb24")
            frame.pts, frame.time_base = i, Fraction(1, 30)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def cut_off(path, share):
    """Leave only the first part of a file."""
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * share)])
    return path


def spoil(path, share, length=2000):
    """Overwrite some bytes in the middle with noise."""
    data = bytearray(path.read_bytes())
    at = int(len(data) * share)
    data[at : at + length] = np.random.default_rng(0).integers(0, 256, length, np.uint8).tobytes()
    path.write_bytes(bytes(data))
    return path


def looked(path, window=WHOLE):
    """What the first pass over a video or a folder of PNG finds."""
    pictures = tuple(sorted(path.glob("*.png"))) if path.is_dir() else ()
    return survey_clip(Clip(path.stem, path, pictures), path.parent / "survey", window)
