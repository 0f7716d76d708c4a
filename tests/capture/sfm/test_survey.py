"""One look through a recording: what its camera does, and what is wrong with it."""

import numpy as np
import pytest
from PIL import Image

from tests.capture.sfm.scenes import save
from tests.capture.sfm.videos import SIZE, looked, still, texture, write_video
from tg4mm.capture.sfm.clip import SWEEP, Clip, Sources
from tg4mm.capture.sfm.config import DEFAULTS, SfmConfig
from tg4mm.capture.sfm.defects import check_usable
from tg4mm.capture.sfm.kind import divided, kind_of
from tg4mm.capture.sfm.steadiness import ShiftMeter, reduced
from tg4mm.core.errors import CaptureError

WALK, STAND = 60, 75  # frames at 30 Hz
HAND = 3.0  # pixels


@pytest.mark.parametrize(("shape", "k"), [((361, 403), 2), ((90, 1201), 4), ((30, 40), 1)])
def test_a_reduced_picture_has_the_means_of_squares(shape, k):
    picture = np.random.default_rng(0).integers(0, 256, (*shape, 3), dtype=np.uint8)[..., 1]
    rows, columns = (n // k for n in shape)
    squares = picture[: rows * k, : columns * k].reshape(rows, k, columns, k)
    found, by = reduced(picture)
    assert (by, found.dtype) == (k, np.float32)
    np.testing.assert_allclose(found, squares.mean((1, 3)), rtol=1e-7)


class TestShift:
    @pytest.mark.parametrize("shift", [(0.0, 0.0), (0.3, -0.2), (5.4, 3.0), (-17.0, 8.5)])
    def test_a_shifted_picture_is_found_to_a_tenth_of_a_pixel(self, shift):
        from scipy.ndimage import shift as moved

        picture = texture((256, 192))[..., 1].astype(np.float32)
        other = moved(picture, shift[::-1], order=3, mode="nearest").astype(np.float32)
        found = ShiftMeter(picture).shift(other)
        np.testing.assert_allclose(found, shift, atol=0.1)

    def test_a_change_of_exposure_is_no_shift(self):
        picture = texture((256, 192))[..., 1].astype(np.float32)
        np.testing.assert_allclose(ShiftMeter(picture).shift(1.2 * picture + 10), (0, 0), atol=0.01)

    def test_a_thing_that_moves_before_the_camera_is_no_shift_of_it(self):
        picture = texture((256, 192))[..., 1].astype(np.float32)
        other = picture.copy()
        other[40:120, 60:140] = picture[40:120, 57:137]
        np.testing.assert_allclose(ShiftMeter(picture).shift(other), (0, 0), atol=0.05)


class TestFaults:
    def test_a_camera_that_moves_is_not_fixed(self, tmp_path):
        survey = looked(write_video(tmp_path / "a.mp4", still(40, shifts=list(range(40)))))
        with pytest.raises(
            CaptureError,
            match=r"a\.mp4: was not filmed by a fixed camera: its picture moves by [12]\d pixels",
        ):
            check_usable([survey], True)


class TestSurvey:
    def test_the_mean_is_that_of_all_frames(self, tmp_path):
        survey = looked(write_video(tmp_path / "a.mp4", still(30, noise=12), crf=5))
        mean = np.asarray(Image.open(survey.mean)).astype(float)
        true = np.mean(still(1, noise=0), axis=0)
        single = np.abs(still(1, noise=12)[0] - true).mean()
        assert np.abs(mean - true).mean() < 0.6 * single

    def test_transparent_frames_have_a_transparent_mean_of_their_own_colour(self, tmp_path):
        for i in range(3):
            pixels = np.full((40, 60, 4), (200, 100 + 10 * i, 50, 255), np.uint8)
            pixels[:, :30] = (0, 0, 0, 0)
            pixels[::4, 30:, :3] = 30 * i
            save(tmp_path / "cam" / f"{i}.png", pixels, opaque=False)
        mean = np.asarray(Image.open(looked(tmp_path / "cam").mean))
        assert (mean[:, :30, 3] == 0).all()
        assert (mean[:, 30:, 3] == 255).all()
        np.testing.assert_allclose(mean[1, 45], (200, 110, 50, 255), atol=1)

    def test_frames_of_two_sizes_are_refused(self, tmp_path):
        for i, shape in enumerate([(40, 60), (40, 60), (30, 60)]):
            save(tmp_path / "cam" / f"{i}.png", np.full((*shape, 4), 90 + i, np.uint8))
        with pytest.raises(CaptureError, match=r"2\.png: frame 2 is 60×30 pixels, the first is 60×40"):
            looked(tmp_path / "cam")


class TestKind:
    def kind(self, tmp_path, sweep, **videos):
        clips, surveys = [], []
        for name, options in videos.items():
            path = write_video(tmp_path / f"{name}.mp4", **options)
            clips.append(Clip(name, path))
            surveys.append(looked(path))
        sources = Sources(tmp_path, clips=tuple(clips), sweep=Clip("sweep", tmp_path) if sweep else None)
        assert kind_of(sources, surveys, "clips")[0] == "clips"
        return kind_of(sources, surveys, None)

    def test_one_recording_is_recognised_by_how_its_camera_moves(self, tmp_path):
        put = {"frames": still(20)}
        walked = {"frames": still(40, shifts=list(range(40)))}
        assert self.kind(tmp_path, False, a=put) == ("flat", "holds one recording; the camera stays put")
        assert self.kind(tmp_path, True, b=put)[0] == "tripod"
        assert self.kind(tmp_path, False, c=walked) == ("handheld", "holds one recording; the camera moves")

    def test_several_are_a_rig_and_clips_are_named(self, tmp_path):
        put = {"frames": still(20)}
        name, reason = self.kind(tmp_path, False, a=put, b=put)
        assert (name, "--kind clips" in reason) == ("rig", True)

    def test_recordings_begun_after_each_others_end_are_clips(self, tmp_path):
        a = {"frames": still(20), "created": "2026-05-01T10:00:00Z"}
        b = {"frames": still(20), "created": "2026-05-01T10:00:40Z"}
        name, reason = self.kind(tmp_path, False, a=a, b=b)
        assert (name, "--kind rig" in reason) == ("clips", True)
        assert self.kind(tmp_path, False, c=a, d=a)[0] == "rig"


@pytest.mark.parametrize(("between", "period"), [(3, 4), (1, 2), (0, None)])
def test_the_period_of_the_compression_is_known(tmp_path, between, period):
    path = write_video(tmp_path / "cam.mp4", still(25), between=between)
    assert looked(path).codec_period == period
    assert looked(path).codec_period == period  # as it was kept


def walked(n, at=0):
    return [at + 4 * k for k in range(n)]


def video(path, starts, jitter=0.0):
    """Cuts of one wide texture: frame i begins `starts[i]` pixels to the right, and a hand moves it by `jitter`."""
    rng, wide = np.random.default_rng(2), texture((SIZE[0] + 400, SIZE[1] + 40))
    frames = []
    for start in starts:
        x, y = np.rint(jitter * rng.standard_normal(2)).astype(int)
        cut = wide[20 + y : 20 + y + SIZE[1], start + 20 + x : start + 20 + x + SIZE[0]]
        frames.append(np.clip(cut + rng.normal(0, 3, cut.shape), 0, 255).astype(np.uint8))
    return write_video(path, frames)


def found(path, config=DEFAULTS, surveys=None):
    clip = Clip("cam", path, repeats=frozenset({1}))
    return divided(Sources(path, clips=(clip,)), surveys or [looked(path)], config)


@pytest.mark.parametrize(
    ("starts", "stands", "walks"),
    [
        (walked(WALK) + STAND * [4 * WALK], (2.0, 4.5), (0.0, 2.0)),
        (STAND * [0] + walked(WALK), (0.0, 2.5), (2.5, 4.5)),
    ],
)
def test_both_parts_are_found_in_either_order(tmp_path, starts, stands, walks):
    both = found(video(tmp_path / "one.mp4", starts))
    window = both.config.window
    assert window.start_s == pytest.approx(stands[0], abs=0.3)
    assert window.start_s >= stands[0] - 1e-6  # no picture of the walk
    assert window.stop_s == pytest.approx(stands[1], abs=0.3)
    (clip,), sweep = both.sources.clips, both.sources.sweep
    assert clip == Clip("cam", clip.path)  # whose repeats are looked for anew
    assert sweep == Clip(SWEEP, clip.path, window=both.parts.walks)
    assert (both.parts.walks.start_s, both.parts.walks.stop_s) == pytest.approx(walks, abs=0.3)
    assert str(both).startswith("the camera walks from")


@pytest.mark.parametrize(
    ("starts", "jitter"),
    [
        (walked(WALK + STAND), 0.0),  # walks all the time
        ((WALK + STAND) * [0], 0.0),  # stands all the time
        (walked(WALK) + STAND * [4 * WALK], HAND),  # a hand that stops walking
        (walked(WALK) + 20 * [4 * WALK], 0.0),  # stands for less than a second
        (walked(8) + STAND * [32], 0.0),  # is put down, no walk
    ],
)
def test_one_without_the_other_is_left_as_it_is(tmp_path, starts, jitter):
    assert found(video(tmp_path / "one.mp4", starts, jitter)) is None


def test_what_the_user_says_overrules(tmp_path):
    path = video(tmp_path / "one.mp4", walked(WALK) + STAND * [4 * WALK])
    surveys = [looked(path)]
    assert found(path, DEFAULTS, surveys) is not None
    for own in (SfmConfig(kind="handheld"), SfmConfig(start_s=0.5), SfmConfig(stop_s=3.0)):
        assert found(path, own, surveys) is None
