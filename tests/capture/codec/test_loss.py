"""What a codec takes from a known tone is found from the file alone, within its ±."""

import itertools
import json
from dataclasses import replace

import av
import numpy as np
import pytest
from skimage import data

from tests.capture.sfm.videos import encoded, still, texture, write_video
from tg4mm.capture.codec import (
    Loss,
    MeasuredTone,
    before_compression,
    codec_losses,
    coded_change,
    is_lossless,
    trial,
)
from tg4mm.capture.codec import loss as loss_module
from tg4mm.capture.codec.loss import AmplitudeSearch
from tg4mm.capture.codec.trial import gain_of, probe, shifts_of
from tg4mm.capture.planes import Orientation
from tg4mm.capture.scene import video_file
from tg4mm.capture.tracking.template import slope as slope_of
from tg4mm.cli import main
from tg4mm.core.errors import CaptureError

FPS, N, AMPLITUDE = 30.0, 120, 0.04
REGION = np.zeros((120, 160), bool)
REGION[36:84, 46:114] = True


def film(path, hz, codec, noise=3.0, tiles=1, **options):
    """Noisy pictures, the texture `tiles` times across, whose middle moves right by AMPLITUDE pixels at `hz`."""
    rng, base = np.random.default_rng(0), np.tile(texture(), (tiles, tiles, 1))
    slope, middle = slope_of(base, 1), tiles // 2
    rows, columns = slice(120 * middle + 24, 120 * middle + 96), slice(160 * middle + 30, 160 * middle + 130)
    moves = np.zeros((*base.shape[:2], 1))
    moves[rows, columns] = 1
    slope *= moves
    moved = [base - AMPLITUDE * np.cos(2 * np.pi * hz * k / FPS) * slope for k in range(N)]
    frames = [np.clip(m + rng.normal(0, noise, m.shape), 0, 255).astype(np.uint8) for m in moved]
    return encoded(path, frames, codec, **options)


def measured(path, hz, region=REGION):
    """The amplitude that is left, pixels, and its standard error."""
    made = probe(path, 0.0, N)
    times = np.arange(N) / FPS
    (u,) = shifts_of(made.luma, [region.astype(np.float32)], times)
    found = gain_of(u, [MeasuredTone(hz, np.array([AMPLITUDE + 0j, 0]))], 0, times)
    return found.gain * AMPLITUDE, found.error * AMPLITUDE


@pytest.mark.parametrize("hz", [2.5, 9.0])
@pytest.mark.parametrize(
    ("codec", "options"),
    [
        ("libx264", {"b": "1500000"}),
        ("libx264", {"b": "400000"}),
        ("libx264", {"crf": "22"}),
        ("libx265", {"b": "500000", "x265-params": "log-level=none"}),
    ],
)
def test_what_is_lost_is_estimated_without_the_original(tmp_path, codec, options, hz):
    path = film(tmp_path / "a.mp4", hz, codec, **options)
    amplitude, error = measured(path, hz)
    (loss,) = codec_losses(path, [REGION], [[MeasuredTone(hz, np.array([amplitude, 0]))]], FPS)[0]
    true = amplitude / AMPLITUDE
    assert abs(loss.gain - true) < 3 * np.hypot(loss.deviation, error / AMPLITUDE)
    assert bool(loss.why) == (loss.gain < 0.5)


@pytest.mark.parametrize(
    ("options", "size"),
    [
        ({"crf": "22"}, (192, 224)),
        ({"qp": "24"}, (192, 224)),
        ({"crf": "22", "x264-params": "aq-mode=2"}, (360, 480)),  # its quality depends on the whole picture
        ({"b": "3000000"}, (360, 480)),
    ],
)
def test_a_region_is_encoded_alone_where_that_is_the_same(tmp_path, monkeypatch, options, size):
    path = film(tmp_path / "a.mp4", 5.0, "libx264", tiles=3, **options)
    region = np.pad(REGION, ((120, 120), (160, 160)))
    amplitude, error = measured(path, 5.0, region)
    sizes, encode = [], trial._encode
    monkeypatch.setattr(
        trial, "_encode", lambda p, made, *a: sizes.append(made.luma.shape[1:]) or encode(p, made, *a)
    )
    (loss,) = codec_losses(path, [region], [[MeasuredTone(5.0, np.array([amplitude, 0]))]], FPS)[0]
    assert set(sizes) == {size}
    assert abs(loss.gain - amplitude / AMPLITUDE) < 3 * np.hypot(loss.deviation, error / AMPLITUDE)


@pytest.mark.parametrize("exponent", [1.0, 2.0, 4.0])
@pytest.mark.parametrize("amplitude", [0.04, 0.085, 0.1])
def test_the_search_finds_the_amplitude_of_which_the_measured_one_is_left(amplitude, exponent):
    """A codec that leaves a share of 0.1 pixels' motion, and of less motion a smaller share, as a power of it."""

    def left_of(size):
        return 0.9 * size * (size / 0.1) ** (exponent - 1)

    measured_tone = MeasuredTone(5.0, np.array([left_of(amplitude) + 0j, 0]))
    search = AmplitudeSearch(measured_tone, measured_tone)
    for k in range(5):
        size = float(np.linalg.norm(search.encoded.phasor))
        search.add(trial.TestedTone(left_of(size) / size, 0.01))
        if search.is_done:
            break
        search.encoded = search.following() if k < 4 else search.encoded
    true = left_of(amplitude) / amplitude
    if true < 0.5:  # is marked
        assert search.gain < 0.5
    else:
        assert search.is_done
        assert search.gain == pytest.approx(true, rel=0.06)


@pytest.mark.parametrize("seed", range(5))
def test_little_is_left_of_a_small_motion_of_a_photograph(tmp_path, seed):
    """Dividing by the gain of the measured amplitude goes beyond the true one, where nearly all would be left."""
    rng, base = np.random.default_rng(seed), data.camera()[100:340:2, 160:480:2].astype(float)
    base = np.repeat(base[..., None], 3, 2)
    slope, moves = slope_of(base, 1), np.zeros((120, 160, 1))
    moves[24:96, 30:130] = 1
    waves = 0.1 * np.cos(2 * np.pi * 5 * np.arange(N) / FPS)
    frames = [np.clip(base - w * moves * slope + rng.normal(0, 2, base.shape), 0, 255) for w in waves]
    path = encoded(tmp_path / "a.mp4", [frame.astype(np.uint8) for frame in frames], "libx264", crf="22")
    (u,) = shifts_of(probe(path, 0.0, N).luma, [REGION.astype(np.float32)], np.arange(N) / FPS)
    tone = MeasuredTone(5.0, np.array([0.1 + 0j, 0]))
    true = gain_of(u, [tone], 0, np.arange(N) / FPS)
    (loss,) = codec_losses(path, [REGION], [[replace(tone, phasor=true.gain * tone.phasor)]], FPS)[0]
    assert abs(loss.gain - true.gain) < 3 * np.hypot(loss.deviation, true.error)


@pytest.mark.parametrize(("made_px", "is_made"), [(0.0, False), (0.002, False), (0.02, True), (0.03, True)])
def test_a_line_that_the_codec_makes_of_a_stronger_one_is_distinguished_from_a_true_one(
    tmp_path, monkeypatch, made_px, is_made
):
    """A codec that leaves nine tenths of each tone, and adds `made_px` pixels at the third, beside a strong one."""
    path = film(tmp_path / "a.mp4", 5.0, "libx264", crf="22")
    tones = [MeasuredTone(hz, np.array([px + 0j, 0])) for hz, px in ((3.1, 0.4), (7.7, 0.1), (9.3, 0.03))]

    def through(made, masks, encoded, *_):
        return [[left_of(tone) for tone in of_region] for of_region in encoded]

    def left_of(tone):
        extra = made_px * (tone.frequency_hz == 9.3) / float(np.linalg.norm(tone.phasor))
        return trial.TestedTone(0.9 + extra, 0.03)

    monkeypatch.setattr(loss_module, "through", through)
    losses = codec_losses(path, [REGION], [tones], FPS)[0]
    assert [loss.is_made for loss in losses] == [False, False, is_made]
    assert [loss.gain for loss in losses[:2]] == pytest.approx([0.9, 0.9], abs=0.01)
    if is_made:
        assert losses[2].gain == pytest.approx(0.9 + made_px / 0.03)
        assert before_compression(0.03, 0.001, losses[2]) == pytest.approx((0.03, made_px - 0.003), rel=0.01)
    alone = codec_losses(path, [REGION], [tones[2:]], FPS)[0]
    assert not alone[0].is_made  # of nothing stronger


def test_a_part_of_the_stored_pictures_has_the_colours_of_its_place(tmp_path):
    made = probe(film(tmp_path / "a.mp4", 5.0, "libx264", crf="18"), 0.0, 3)
    part = made.within((slice(16, 96), slice(32, 80)))

    def upsampled(planes):
        frame = av.VideoFrame.from_ndarray(planes, format="yuv420p")
        return frame.reformat(format="yuv444p").to_ndarray().astype(int)

    for planes, whole in zip(part.planes, made.planes, strict=True):
        expected = upsampled(whole)[:, 16:96, 32:80]
        difference = upsampled(np.ascontiguousarray(planes)) - expected
        assert np.abs(difference[:, 4:-4, 4:-4]).max() <= 1  # colours are interpolated at the border
        assert expected.std((1, 2)).min() > 2


def test_pictures_coded_by_themselves_lose_nothing(tmp_path):
    path = encoded(tmp_path / "a.mp4", [texture().astype(np.uint8)] * 8, "libx264", gop=1, crf="18")
    (loss,) = codec_losses(path, [REGION], [[MeasuredTone(2.5, np.array([0.04, 0]))]], FPS)[0]
    assert (loss.gain, loss.deviation, loss.why) == (1.0, 0.0, "")


def test_an_encoder_that_is_not_named_is_judged_by_the_pictures_and_no_video_is_marked(tmp_path):
    path = film(tmp_path / "a.mp4", 9.0, "mpeg4", b="500000")
    for said in ("% of its pixels repeat the frame before", ""):
        (loss,) = codec_losses(path, [REGION], [[MeasuredTone(9.0, np.array([0.02, 0]))]], FPS)[0]
        assert np.isnan(loss.gain)
        assert said in loss.why
        path.write_bytes(b"nothing of a video")
    assert "cannot be tested" in loss.why


def test_an_amplitude_is_corrected_by_what_was_let_through_unless_it_is_marked():
    """An amplitude of .4 ± .03 with a gain of .8 ± .1 becomes .5; relative deviations add in squares."""
    size, deviation = before_compression(0.4, 0.03, Loss(0.8, 0.1))
    assert size == pytest.approx(0.5)
    assert deviation / size == pytest.approx(np.hypot(0.03 / 0.4, 0.1 / 0.8))
    assert before_compression(0.4, 0.03, None) == (0.4, 0.03)
    assert before_compression(0.4, 0.03, Loss(0.3, 0.1, "smaller")) == (0.4, 0.03)
    assert before_compression(0.4, 0.03, Loss(1.06, 0.1))[0] == 0.4  # nothing is added by a codec
    assert (
        before_compression(0.4, 0.03, Loss(1.25, 0.1, faster=0.2))[0] == 0.32
    )  # but by a decay that it makes


@pytest.mark.parametrize("flags", list(itertools.product([False, True], repeat=3)))
def test_directions_turn_with_the_picture(flags):
    """A picture with a gradient to the right and down, as it is stored, has it where the stored vector points."""
    orientation, shown = Orientation(*flags), np.arange(5.0) + 3 * np.arange(4.0)[:, None]
    stored = orientation.stored(shown)
    assert (orientation.shown(stored) == shown).all()
    down, right = (float(g.mean()) for g in np.gradient(stored))
    assert orientation.stored_vector(np.array([1.0, 3.0])) == pytest.approx([right, down])


@pytest.mark.parametrize(
    ("codec", "options", "keeps"),
    [
        ("ffv1", {}, True),
        ("utvideo", {}, True),
        ("libx264", {"qp": "0"}, True),
        ("libx264", {"crf": "12"}, False),
        ("mpeg4", {}, False),
    ],
)
def test_a_codec_that_keeps_every_pixel_is_recognised(tmp_path, codec, options, keeps):
    path = tmp_path / ("a.avi" if codec in ("utvideo", "mpeg4") else "a.mkv")
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=25, options=options)
        stream.width, stream.height = 64, 48
        stream.pix_fmt = "yuv420p"
        for k in range(4):
            noise = np.random.default_rng(k).integers(0, 255, (48, 64), np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(noise, format="gray")))
        container.mux(stream.encode())
    assert is_lossless(path) == keeps
    assert not is_lossless(tmp_path / "absent.mkv")


def test_a_flat_dataset_keeps_its_video(tmp_path):
    path = write_video(tmp_path / "a.mp4", still(20))
    assert main(["sfm", str(path), "--kind", "flat", "--out", str(tmp_path / "set"), "--from", "0.2"]) == 0
    kept = video_file(tmp_path / "set")
    assert kept.path.read_bytes() == path.read_bytes()
    assert (kept.from_s, kept.repeats) == (0.2, ())
    kept.path.unlink()
    assert video_file(tmp_path / "set") is None


@pytest.mark.parametrize(
    ("video", "said"),
    [
        ("a.mp4", "video is 'a.mp4', expected an object"),
        ({"file": 3, "from_s": 0}, "file is 3; expected the name of a video"),
        ({"file": "../a.mp4", "from_s": 0}, "leads outside the dataset's folder"),
        ({"file": "a.mp4", "from_s": 0, "repeats": ["x"]}, "expected a list of frames"),
        ({"file": "a.mp4", "from_s": "soon"}, "from_s is 'soon'; expected a finite number"),
    ],
)
def test_what_is_no_video_is_refused(tmp_path, video, said):
    (tmp_path / "set").mkdir()
    (tmp_path / "set" / "a.mp4").touch()
    (tmp_path / "set" / "scene.json").write_text(json.dumps({"fps": 30, "video": video}))
    with pytest.raises(CaptureError, match=said):
        video_file(tmp_path / "set")


def test_what_predicted_frames_lack_bounds_what_a_codec_may_change():
    kinds = np.array(([1] + [2, 3, 3] * 9 + [2]) * 2)
    noise = np.select([kinds == 1, kinds == 2], [4.0, 2.0], 1.0)
    found = coded_change(noise, kinds)
    assert found.most == pytest.approx(np.log(2))  # predicted from one side: half of what is coded alone
    assert found.size == pytest.approx(np.sqrt(2.0))
    assert coded_change(np.ones(60), np.ones(60, int)).most == 0
