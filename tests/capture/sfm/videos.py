"""Small videos written with PyAV, whole and spoilt."""

import struct
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
    path,
    frames,
    rate=30,
    times=None,
    time_base=None,
    rotation=None,
    created=None,
    crf=14,
    between=None,
    faststart=True,
    about=None,
):
    """H.264 in the container that the name asks for, which lists its frames before them (so that a cut one opens).

    times: of each frame, in whole numbers of time_base; without, frame k is at k / rate. between: B pictures between
    others, always as many; without, as the encoder likes.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    flags = "+faststart" * faststart + "+use_metadata_tags" * bool(about)
    options = {"movflags": flags} if flags and path.suffix in (".mp4", ".mov") else {}
    with av.open(str(path), "w", options=options) as container:
        if created is not None:
            container.metadata["creation_time"] = created
        container.metadata.update(about or {})
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


def as_shown(path, matrix):
    """The MP4 with another display matrix: a, b, c, d of x' = a x + c y, y' = b x + d y."""
    data = bytearray(path.read_bytes())
    a, b, c, d = (round(65536 * value) for value in matrix)
    struct.pack_into(">9i", data, data.index(b"tkhd") + 44, a, b, 0, c, d, 0, 0, 0, 1 << 30)
    path.write_bytes(data)
    return path


def _boxes(data, start, end):
    while start < end:
        size, kind = struct.unpack_from(">I4s", data, start)
        yield kind.decode(), (start, start + size)
        start += size


def edited(path, edits):
    """The MOV whose index is at its end with an edit list: seconds shown, from which second on (-1: nothing), speed."""
    data = bytearray(path.read_bytes())
    moov = dict(_boxes(data, 0, len(data)))["moov"]
    inside = dict(_boxes(data, moov[0] + 8, moov[1]))
    track = dict(_boxes(data, inside["trak"][0] + 8, inside["trak"][1]))
    media = dict(_boxes(data, track["mdia"][0] + 8, track["mdia"][1]))
    scale, ticks = (struct.unpack_from(">I", data, box[0] + 20)[0] for box in (inside["mvhd"], media["mdhd"]))
    rows = [
        struct.pack(">Iii", round(s * scale), -1 if begin < 0 else round(begin * ticks), round(speed * 65536))
        for s, begin, speed in edits
    ]
    body = struct.pack(">II", 0, len(edits)) + b"".join(rows)
    new = struct.pack(">I4sI4s", 16 + len(body), b"edts", 8 + len(body), b"elst") + body
    start, stop = track.get("edts", (track["mdia"][0],) * 2)
    data[start:stop] = new
    for box in (moov, inside["trak"]):
        struct.pack_into(">I", data, box[0], box[1] - box[0] + len(new) - (stop - start))
    path.write_bytes(data)
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


def write_resized(path, frames):
    """VP8 whose pictures change their size, as browsers record a call."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libvpx", rate=30)
        stream.height, stream.width = frames[0].shape[:2]
        stream.pix_fmt = "yuv420p"
        encoder = stream.codec_context
        for k, pixels in enumerate(frames):
            height, width = pixels.shape[:2]
            if (encoder.width, encoder.height) != (width, height):
                encoder = av.CodecContext.create("libvpx", "w")
                encoder.width, encoder.height, encoder.pix_fmt = width, height, "yuv420p"
                encoder.time_base = Fraction(1, 30)
            frame = av.VideoFrame.from_ndarray(pixels, format="rgb24")
            frame.pts, frame.time_base = k, Fraction(1, 30)
            for packet in encoder.encode(frame):
                packet.stream = stream
                container.mux(packet)
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
