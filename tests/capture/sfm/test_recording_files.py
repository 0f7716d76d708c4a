"""Recordings in files as people have them: other containers, bare streams, TIFF, Photron, Phantom, odd names."""

import logging
import shutil
import struct
from fractions import Fraction

import av
import numpy as np
import pytest
import tifffile
from PIL import Image
from scipy.ndimage import gaussian_filter, shift

from benchmarks.calibration import film
from tests.capture.conftest import refused
from tests.capture.sfm.videos import encoded, still, texture, write_video
from tg4mm.capture.look import look
from tg4mm.capture.look.recording import read_recording
from tg4mm.capture.pictures import load_images
from tg4mm.capture.readers import load_capture
from tg4mm.capture.sfm.clip import TimeWindow
from tg4mm.capture.sfm.reconstruct import SfmConfig, reconstruct
from tg4mm.capture.video import grey_frames, video_frames, video_info
from tg4mm.cli import main
from tg4mm.core.files import argument

RATE = 240
N = 48
ODD = (
    "12:30:00.mp4",
    "http:o.mp4",
    "alpha:20.mp4",
    "-x.mp4",
    "--x.mp4",
    "file:a.mp4",
    "a%03d.mp4",
    "ü ?#1.mp4",
)


def tone(n=N, hz=30.0):
    """[n, H, W] uint16 of 12 bits: a texture that sways by half a pixel at `hz` of RATE, with noise."""
    rng = np.random.default_rng(3)
    still = gaussian_filter(texture()[..., 1].astype(float), 1.5) / 255
    sways = 0.5 * np.sin(2 * np.pi * hz * np.arange(n) / RATE)
    moved = [shift(still, (0, sway), order=3, mode="nearest") for sway in sways]
    noisy = np.clip(moved + rng.normal(0, 0.002, (n, *still.shape)), 0, 1)
    return np.rint(4095 * noisy).astype(np.uint16)


def write_cine(path, frames, rate):
    """Phantom's file of 12 bits in 16, its header as documented (Cine File Format, Vision Research)."""
    n, h, w = frames.shape
    setup = bytearray(12432)
    struct.pack_into("<H", setup, 140, 0x5453)  # "ST"
    struct.pack_into("<H", setup, 142, len(setup) - 144)
    struct.pack_into("<I", setup, 768, rate)
    struct.pack_into("<I", setup, 896, 12)  # RealBPP
    offsets_at = 44 + 40 + len(setup)
    first, step = offsets_at + 8 * n, 8 + 2 * w * h
    head = struct.pack("<2sHHHiIiIIIIQ", b"CI", 44, 0, 1, 0, n, 0, n, 44, 84, offsets_at, 0)
    bitmap = struct.pack("<IiiHHIIiiII", 40, w, h, 1, 16, 0, 2 * w * h, 0, 0, 0, 4096)
    offsets = struct.pack(f"<{n}q", *(first + k * step for k in range(n)))
    images = (struct.pack("<II", 8, 2 * w * h) + frame[::-1].astype("<u2").tobytes() for frame in frames)
    path.write_bytes(head + bitmap + bytes(setup) + offsets + b"".join(images))
    return path


def packed_12(frames):
    """Photron's 12 bits: two pixels in three bytes."""
    a, b = frames.reshape(-1, 2).T
    return np.stack([a >> 4, (a & 15) << 4 | b >> 8, b & 255], axis=1).astype(np.uint8).tobytes()


def write_photron(path, frames, rate, bits=16, side="Lower", xml=False, **changed):
    n, h, w = frames.shape
    values = {
        "Record Rate(fps)": rate, "Total Frame": n, "Image Width": w, "Image Height": h, "Color Type": "Mono",
        "Color Bit": bits, "File Format": "MRaw", "EffectiveBit Depth": min(bits, 12), "EffectiveBit Side": side,
    } | changed  # fmt: skip
    data = {8: lambda: (frames >> 4).astype(np.uint8).tobytes(), 12: lambda: packed_12(frames)}
    shifted = frames << 4 if side == "Higher" else frames
    path.with_suffix(".mraw").write_bytes(data.get(bits, lambda: shifted.astype("<u2").tobytes())())
    if xml:
        v = list(values.values())
        path.write_text(
            f"junk\n<cih><recordInfo><recordRate>{v[0]}</recordRate></recordInfo><frameInfo><totalFrame>{v[1]}</totalFrame>"
            f"</frameInfo><imageDataInfo><resolution><width>{v[2]}</width><height>{v[3]}</height></resolution><colorInfo>"
            f"<type>{v[4]}</type><bit>{v[5]}</bit></colorInfo><effectiveBit><depth>{v[7]}</depth><side>{v[8]}</side>"
            f"</effectiveBit></imageDataInfo><imageFileInfo><fileFormat>{v[6]}</fileFormat></imageFileInfo></cih>\n"
        )
    else:
        path.write_text("#Camera Information Header\n" + "".join(f"{k} : {v}\n" for k, v in values.items()))
    return path


def stack(folder, name):
    """A recording of `tone` in the file, or folder, of that name."""
    path = folder / name
    if name == "pictures":
        path.mkdir()
        for k, frame in enumerate(tone()):
            tifffile.imwrite(path / f"a_{k:04d}.tif", frame << 4)
    elif path.suffix == ".tif":
        tifffile.imwrite(path, tone() << 4, photometric="minisblack", bigtiff=name == "big.tif")
    elif path.suffix == ".cine":
        write_cine(path, tone(), RATE)
    else:
        bits = int(path.stem.strip("ab"))
        side = "Higher" if "b" in name else "Lower"
        write_photron(path, tone(), RATE, bits, side, xml=path.suffix == ".cihx")
    return path


@pytest.mark.parametrize(
    ("name", "fps"),
    [
        ("pictures", RATE), ("pages.tif", RATE), ("big.tif", RATE), ("a.cine", None),
        ("a8.cih", None), ("a12.cih", None), ("a16.cih", None), ("b16.cih", None), ("a12.cihx", None),
    ],
)  # fmt: skip
def test_a_high_speed_recording_is_looked_at_and_becomes_a_dataset(tmp_path, name, fps):
    path = stack(tmp_path, name)
    series, repeats = read_recording(path, fps)
    assert repeats == ()
    np.testing.assert_allclose(series.times_s, np.arange(N) / RATE, atol=1e-6)
    sways = np.nanmedian(series.shift[..., 0], axis=1)
    expected = 0.5 * np.sin(2 * np.pi * 30 * series.times_s)
    np.testing.assert_allclose(sways - sways.mean(), expected - expected.mean(), atol=0.05)
    reconstruct(path, tmp_path / "out", SfmConfig(kind="flat", fps=fps), 1)
    capture = load_capture(tmp_path / "out")
    assert (capture.n_timesteps, capture.fps) == (N, RATE)
    images = load_images(capture)
    deep = name != "a8.cih"
    got = np.stack([images.rgb(k)[..., 0] for k in range(0, N, 16)])
    np.testing.assert_allclose(got, tone()[::16] / 4095, atol=3e-4 if deep else 4e-3)


def test_the_pictures_of_a_photron_header_are_found_from_either_file(tmp_path):
    write_photron(tmp_path / "a.cih", tone(4), RATE)
    assert video_info(tmp_path / "a.mraw") == video_info(tmp_path / "a.cih")


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"Total Frame": 5}, "is cut off"),
        ({"Total Frame": 10**30}, "Total Frame is '1000"),
        ({"Image Width": "x"}, "Image Width is 'x'"),
        ({"Record Rate(fps)": 0}, "Record Rate(fps) is '0'"),
        ({"Record Rate(fps)": "nan"}, "Record Rate(fps) is 'nan'"),
        ({"Color Type": "Bayer"}, "expected MRAW, Mono"),
        ({"Color Bit": 24}, "expected MRAW, Mono"),
        ({"File Format": "TIFF"}, "expected MRAW, Mono"),
    ],
)
def test_a_photron_header_that_lies_is_refused(tmp_path, changed, message):
    write_photron(tmp_path / "a.cih", tone(4), RATE, **changed)
    refused(lambda: list(video_frames(tmp_path / "a.cih")), message)


def test_what_has_no_times_asks_for_the_rate_and_takes_no_window(tmp_path):
    path = stack(tmp_path, "pages.tif")
    for call in (lambda: look(path), lambda: reconstruct(path, tmp_path / "out", SfmConfig(kind="flat"), 1)):
        with pytest.raises(Exception, match="--fps"):
            call()
    refused(
        lambda: look(path, RATE, TimeWindow(0.1)), "has no time stamps, so --from and --until cannot be used"
    )


def test_pictures_that_are_missing_amid_a_recording_are_named(tmp_path):
    path = stack(tmp_path, "pictures")
    (path / "a_0007.tif").unlink()
    config = SfmConfig(kind="flat", fps=RATE)
    for call in (lambda: look(path, RATE), lambda: reconstruct(path, tmp_path / "out", config, 1)):
        refused(call, "a_0006.tif: pictures between it and a_0008.tif are missing")


@pytest.mark.parametrize("suffix", [".ts", ".mts", ".3gp", ".h264", ".gif", ".avi"])
def test_other_containers_give_their_frames(tmp_path, suffix):
    frames = still(12)
    path = tmp_path / f"a{suffix}"
    if suffix == ".gif":
        pictures = [Image.fromarray(frame) for frame in frames]
        pictures[0].save(path, save_all=True, append_images=pictures[1:], duration=40, loop=0)
    else:
        write_video(path, frames, 25)
    fps = 25.0 if suffix == ".h264" else None
    got = list(video_frames(path))
    assert len(got) == 12
    assert float(got[-1].time) == pytest.approx(11 / 25, abs=2e-3)
    assert np.abs(got[5].pixels.astype(float) - frames[5]).mean() < 12  # a palette
    if fps is None:
        assert video_info(path).rates[0] == pytest.approx(25, abs=0.1)


@pytest.mark.parametrize("name", ODD)
def test_a_name_is_a_file_and_nothing_else(tmp_path, monkeypatch, name):
    write_video(tmp_path / "a.mp4", still(40))
    shutil.copy(tmp_path / "a.mp4", tmp_path / name)
    monkeypatch.chdir(tmp_path)
    assert main(["sfm", name, "--kind", "flat", "--out", "alpha:20"]) == 0
    assert load_capture("alpha:20").n_timesteps == 40
    assert load_images(load_capture("alpha:20")).rgb(39).std() > 0.05


def test_a_list_of_other_files_is_no_video(tmp_path):
    write_video(tmp_path / "a.mp4", still(8))
    (tmp_path / "b.ts").write_text("#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\na.mp4\n#EXT-X-ENDLIST\n")
    (tmp_path / "c.avi").write_text("ffconcat version 1.0\nfile a.mp4\n")
    for name in ("b.ts", "c.avi"):
        refused(lambda name=name: list(video_frames(tmp_path / name)), "is not a video")


def test_pixels_that_are_not_square_are_refused_by_name(tmp_path):
    path = tmp_path / "a.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=25)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        stream.codec_context.sample_aspect_ratio = Fraction(4, 3)
        for pixels in still(8, size=(64, 48)):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(pixels, format="rgb24")))
        container.mux(stream.encode())
    refused(lambda: video_info(path), "is anamorphic: its pixels are 4:3, not square")


def test_interlaced_rows_are_said(tmp_path, caplog):
    path = encoded(tmp_path / "a.mkv", still(8), "libx264", **{"x264-params": "interlaced=1"})
    with caplog.at_level(logging.WARNING, "tg4mm"):
        assert len(list(grey_frames(path))) == 8
        list(grey_frames(path))
    (said,) = (record.getMessage() for record in caplog.records)
    assert "is interlaced: even and odd rows are of different moments" in said


def test_ten_bits_stay_and_their_curve_is_said(tmp_path, caplog):
    ramp = np.broadcast_to(np.arange(64, 64 + 4 * 64, 4, np.uint16), (2, 48, 64))
    film.write_video(tmp_path / "a.mp4", ramp, 30, film.Coding("libx265", 4_000_000))
    with caplog.at_level(logging.WARNING, "tg4mm"):
        first = next(grey_frames(tmp_path / "a.mp4")).grey
    assert "is HDR (HLG, 10 bits): values stay as they are coded" in caplog.text
    np.testing.assert_allclose(first, ramp[0] / 4, atol=0.5)
    assert (np.round(first * 4) % 4).any()  # quarters of a grey level


def test_a_file_that_grows_while_it_is_read_is_refused(tmp_path):
    path = write_video(tmp_path / "a.mkv", still(12))
    frames = grey_frames(path)
    next(frames)
    with path.open("ab") as file:
        file.write(bytes(100))
    refused(lambda: list(frames), "changed while it was read, from ", " it is still being recorded")


def test_a_command_that_is_shown_takes_no_name_for_an_option():
    assert argument("-x y.mp4") == "'./-x y.mp4'"
    assert argument("a.mp4") == "a.mp4"
